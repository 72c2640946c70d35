// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/exr_file.h"

#include <cmath>
#include <fstream>

#include <gtest/gtest.h>

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
  std::ofstream(file) << "not an EXR file";
  EXPECT_EQ(ReadExr(file, {"R"}).status().code(), StatusCode::kIntegrity);
  std::filesystem::remove(file);
  EXPECT_EQ(ReadExr(file, {"R"}).status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace stratalux::fit
