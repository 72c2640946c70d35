// SPDX-License-Identifier: Apache-2.0
#include "shared/base/read_file.h"

#include <fstream>

#include <gtest/gtest.h>

namespace stratalux {
namespace {

namespace fs = std::filesystem;

TEST(ReadFile, GivesEveryByteBack) {
  const fs::path file = fs::path(::testing::TempDir()) / "stratalux_read_file";
  for (const size_t size : {size_t{0}, size_t{1}, size_t{65535}, size_t{65536}, size_t{200001}}) {
    std::string bytes(size, '\0');
    for (size_t i = 0; i < size; ++i) bytes[i] = static_cast<char>(i * 31 % 256);
    std::ofstream(file, std::ios::binary | std::ios::trunc) << bytes;
    const auto read = ReadFile(file);
    ASSERT_TRUE(read.ok()) << read.status().message();
    EXPECT_TRUE(*read == bytes) << size;
  }
  fs::remove(file);
}

TEST(ReadFile, NamesWhatIsNoFile) {
  const fs::path folder = ::testing::TempDir();
  const Status missing = ReadFile(folder / "stratalux_none").status(), directory = ReadFile(folder).status();
  EXPECT_EQ(missing.code(), StatusCode::kNotFound);
  EXPECT_NE(missing.message().find("stratalux_none: No such file"), std::string::npos) << missing.message();
  EXPECT_EQ(directory.code(), StatusCode::kFailed);
  EXPECT_NE(directory.message().find(folder.string()), std::string::npos) << directory.message();
}

}  // namespace
}  // namespace stratalux
