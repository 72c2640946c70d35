// SPDX-License-Identifier: Apache-2.0
#include "shared/http/static_files.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::http {
namespace {

namespace fs = std::filesystem;

class OpenBelowTest : public ScratchFolderTest {
 protected:
  void SetUp() override {
    fs::create_directories(folder_ / "root" / "sub");
    std::ofstream(folder_ / "secret") << "secret";
    std::ofstream(folder_ / "root" / "a.html") << "hello";
    std::ofstream(folder_ / "root" / "sub" / "b.png") << "png";
  }
};

TEST_F(OpenBelowTest, OpensRegularFilesBelow) {
  const auto file = OpenBelow(folder_ / "root", "a.html");
  ASSERT_TRUE(file.ok()) << file.status().message();
  EXPECT_EQ(file->bytes, 5U);
  EXPECT_TRUE(OpenBelow(folder_ / "root", "sub/b.png").ok());
}

TEST_F(OpenBelowTest, LeavesTheRootByNoName) {
  fs::create_symlink(folder_ / "secret", folder_ / "root" / "link");
  fs::create_symlink(folder_, folder_ / "root" / "up");
  fs::create_symlink("a.html", folder_ / "root" / "inside");
  fs::create_symlink(folder_ / "root", folder_ / "linked-root");
  ASSERT_EQ(mkfifo((folder_ / "root" / "pipe").c_str(), 0600), 0);
  for (const std::string& name :
       {std::string("../secret"), std::string("sub/../../secret"), (folder_ / "secret").string(), std::string("link"),
        std::string("up/secret"), std::string("inside"), std::string("sub"), std::string("pipe"), std::string(""),
        std::string("."), std::string("sub//b.png"), std::string("a.html/"), std::string("a.html/x"),
        std::string("none"), std::string("a.html\0x", 8), std::string(5000, 'a')}) {
    const auto file = OpenBelow(folder_ / "root", name);
    ASSERT_FALSE(file.ok()) << name;
    EXPECT_EQ(file.status().code(), StatusCode::kNotFound) << name;
  }
  EXPECT_EQ(OpenBelow(folder_ / "linked-root", "a.html").status().code(), StatusCode::kNotFound);
}

TEST(ContentTypeOf, KnowsWhatBrowsersShow) {
  EXPECT_EQ(ContentTypeOf("report/index.html"), "text/html; charset=utf-8");
  EXPECT_EQ(ContentTypeOf("a.png"), "image/png");
  EXPECT_EQ(ContentTypeOf("a.exr"), "application/octet-stream");
  EXPECT_EQ(ContentTypeOf("html"), "application/octet-stream");
}

}  // namespace
}  // namespace stratalux::http
