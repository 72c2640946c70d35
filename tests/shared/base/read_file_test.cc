// SPDX-License-Identifier: Apache-2.0
#include "shared/base/read_file.h"

#include <fstream>

#include <gmock/gmock.h>
#include <sys/stat.h>

#include "tests/support/scratch_folder.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;

TEST(ReadFile, GivesEveryByteBack) {
  const ScratchFolder scratch;
  const fs::path file = scratch / "file";
  for (const size_t size : {size_t{0}, size_t{1}, size_t{65535}, size_t{65536}, size_t{200001}}) {
    std::string bytes(size, '\0');
    for (size_t i = 0; i < size; ++i) bytes[i] = static_cast<char>(i * 31 % 256);
    std::ofstream(file, std::ios::binary | std::ios::trunc) << bytes;
    const auto read = ReadFile(file);
    ASSERT_TRUE(read.ok()) << read.status().message();
    EXPECT_TRUE(*read == bytes) << size;
  }
}

TEST(ReadFile, NamesWhatIsNoFile) {
  const ScratchFolder scratch;
  const fs::path& folder = scratch.path();
  const Status missing = ReadFile(folder / "stratalux_none").status(), directory = ReadFile(folder).status();
  EXPECT_EQ(missing.code(), StatusCode::kNotFound);
  EXPECT_NE(missing.message().find("stratalux_none: No such file"), std::string::npos) << missing.message();
  EXPECT_EQ(directory.code(), StatusCode::kFailed);
  EXPECT_NE(directory.message().find(folder.string()), std::string::npos) << directory.message();
}

// Nobody makes it anew, or goes on as if there were none.
TEST(ReadFile, WhatIsThereAndCannotBeOpenedIsNotMissing) {
  const ScratchFolder scratch;
  const fs::path& folder = scratch.path();
  std::ofstream(folder / "file") << "text";
  fs::create_symlink("loop", folder / "loop");
  fs::create_symlink("gone", folder / "dangling");
  EXPECT_EQ(ReadFile(folder / "loop").status().code(), StatusCode::kFailed);
  EXPECT_EQ(ReadFile(folder / "dangling").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(ReadFile(folder / "file" / "below").status().code(), StatusCode::kNotFound);
}

TEST(ReadFile, WaitsForNobodyAndReadsNoMoreThanItMay) {
  const ScratchFolder scratch;
  const fs::path& folder = scratch.path();
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  std::ofstream(folder / "sparse").put('x');
  fs::resize_file(folder / "sparse", uintmax_t{10} << 30);
  std::ofstream(folder / "ten") << "0123456789";
  const auto message = [](const Result<std::string>& read) {
    EXPECT_EQ(read.status().code(), StatusCode::kFailed);
    return read.status().message();
  };
  using ::testing::HasSubstr;
  EXPECT_THAT(message(ReadFile("/dev/zero")), HasSubstr("/dev/zero: it is a device, not a file"));
  EXPECT_THAT(message(ReadFile(folder / "pipe")), HasSubstr("a pipe"));
  EXPECT_THAT(message(ReadFile(folder)), HasSubstr("a folder"));
  EXPECT_THAT(message(ReadFile(folder / "sparse")),
              HasSubstr("sparse: it has 10737418240 bytes, at most " + std::to_string(kMostRecordBytes)));
  EXPECT_EQ(*ReadFile(folder / "ten", 10), "0123456789");
  EXPECT_THAT(message(ReadFile(folder / "ten", 9)), HasSubstr("it has 10 bytes, at most 9 are read"));
  EXPECT_FALSE(ReadFile("/proc/self/maps")->empty()) << "a file whose size is said to be 0";
  EXPECT_EQ(ReadFile(fs::path(std::string("/etc/passwd\0.png", 16))).status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace stratalux
