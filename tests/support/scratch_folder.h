// SPDX-License-Identifier: Apache-2.0
// An empty folder of its own for a test, gone with it.
#pragma once

#include <filesystem>
#include <string>

#include <gtest/gtest.h>
#include <stdlib.h>

namespace stratalux {

class ScratchFolderTest : public ::testing::Test {
 protected:
  ScratchFolderTest() {
    std::string name = (std::filesystem::temp_directory_path() / "stratalux-test-XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw std::filesystem::filesystem_error("mkdtemp", name, {});
    folder_ = name;
  }
  ~ScratchFolderTest() override {
    std::error_code ignored;
    std::filesystem::permissions(folder_, std::filesystem::perms::owner_all, ignored);
    std::filesystem::remove_all(folder_, ignored);
  }

  std::filesystem::path folder_;
};

}  // namespace stratalux
