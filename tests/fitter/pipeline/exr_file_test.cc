// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/exr_file.h"

#include <algorithm>
#include <cmath>
#include <csignal>
#include <fstream>
#include <utility>

#include <gtest/gtest.h>
#include <sys/resource.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

TEST(ExrFile, ReadsBackWhatWasWrittenBitForBit) {
  Image<float> image(7, 5, 3);
  for (size_t i = 0; i < image.size(); ++i) image.pixels()[i] = std::sin(static_cast<float>(i)) * 1e3F;
  const ScratchFolder scratch;
  const auto file = scratch / "image.exr";
  ASSERT_TRUE(WriteExr(file, image, {"R", "G", "B"}).ok());
  const auto back = ReadExr(file, {"R", "G", "B"});
  ASSERT_TRUE(back.ok()) << back.status().message();
  for (size_t i = 0; i < image.size(); ++i) EXPECT_EQ(back->pixels()[i], image.pixels()[i]);
  EXPECT_EQ(ReadExr(file, {"depth"}).status().code(), StatusCode::kNotFound);
  // More lines than are copied at a time, more pixels than a tile of them.
  Image<float> tall(21, 150, 6);
  for (size_t i = 0; i < tall.size(); ++i) tall.pixels()[i] = static_cast<float>(i);
  const std::vector<std::string> names = {"a", "f", "b", "e", "c", "d"};  // not in the file's own order
  ASSERT_TRUE(WriteExr(file, tall, names).ok());
  const auto again = ReadExr(file, names);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_TRUE(std::ranges::equal(again->pixels(), std::as_const(tall).pixels()));
  const auto some = ReadExr(file, {"c", "a"});
  ASSERT_TRUE(some.ok()) << some.status().message();
  for (int y = 0; y < 150; ++y)
    for (int x = 0; x < 21; ++x) {
      ASSERT_EQ((*some)(x, y, 0), tall(x, y, 4));
      ASSERT_EQ((*some)(x, y, 1), tall(x, y, 0));
    }
  std::ofstream(file) << "not an EXR file";
  EXPECT_EQ(ReadExr(file, {"R"}).status().code(), StatusCode::kIntegrity);
  std::filesystem::remove(file);
  EXPECT_EQ(ReadExr(file, {"R"}).status().code(), StatusCode::kNotFound);
}

// As a full disk: the last bytes are written by a destructor of OpenEXR's.
TEST(ExrFile, AFileThatIsNotWrittenWholeIsNoSuccess) {
  Image<float> image(64, 128, 3);
  for (size_t i = 0; i < image.size(); ++i) image.pixels()[i] = std::sin(static_cast<float>(i));
  const ScratchFolder scratch;
  const auto file = scratch / "image.exr";
  ASSERT_TRUE(WriteExr(file, image, {"R", "G", "B"}).ok());
  const auto size = static_cast<rlim_t>(std::filesystem::file_size(file));
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  for (const rlim_t most : {rlim_t{0}, rlim_t{100}, size / 2, size - 1, size}) {
    rlimit limit = before;
    limit.rlim_cur = most;
    ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
    const Status status = WriteExr(file, image, {"R", "G", "B"});
    setrlimit(RLIMIT_FSIZE, &before);
    EXPECT_EQ(status.code(), most == size ? StatusCode::kOk : StatusCode::kFailed) << most << " of " << size;
    if (most < size) {
      EXPECT_NE(status.message().find(file.string()), std::string::npos) << status.message();
    }
  }
  std::signal(SIGXFSZ, old_handler);
}

}  // namespace
}  // namespace stratalux::fit
