// SPDX-License-Identifier: Apache-2.0
// What `stratalux-rig safe` goes by when all else is broken: kept whole, and taken from nobody else.
#include "firmware-host/session/last_lights.h"

#include <cstdlib>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class LastLights : public ScratchFolderTest {
 protected:
  [[nodiscard]] fs::path File() const { return folder_ / "lights.json"; }
  void Write(const std::string& text) const { std::ofstream(File()) << text; }
  void ExpectRefused(StatusCode code, const std::string& part) const {
    const auto lights = ReadLights(folder_);
    EXPECT_EQ(lights.status().code(), code) << part;
    EXPECT_THAT(lights.status().message(), HasSubstr(part));
    EXPECT_THAT(lights.status().message(), HasSubstr(File().string()));
  }

  const RigLights lights_ = {{{{"ENABLE0", "", -1}, ActiveLevel::kHigh}, {{"", "pinctrl-rp1", 17}, ActiveLevel::kLow}},
                             {{.device = "/dev/dri/card0", .connector = "HDMI-A-1"}}};
};

TEST_F(LastLights, AreReadAsTheyWereKept) {
  ASSERT_TRUE(KeepLights(folder_, lights_).ok());
  const auto read = ReadLights(folder_);
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_TRUE(*read == lights_);
  ASSERT_TRUE(KeepLights(folder_, {}).ok());
  EXPECT_TRUE(*ReadLights(folder_) == RigLights());
  struct stat info {};
  ASSERT_EQ(stat(File().c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777U, 0600U);
}

TEST_F(LastLights, OfAnybodyElseAreRefused) {
  ASSERT_TRUE(KeepLights(folder_, lights_).ok());
  for (const unsigned mode : {0620U, 0602U, 0666U}) {
    ASSERT_EQ(chmod(File().c_str(), mode), 0);
    ExpectRefused(StatusCode::kFailed, "can be written by others");
  }
  ASSERT_EQ(chmod(File().c_str(), 0600), 0);
  EXPECT_TRUE(ReadLights(folder_).ok());
  if (geteuid() == 0) {
    ASSERT_EQ(chown(File().c_str(), 65534, 65534), 0);
    ExpectRefused(StatusCode::kFailed, "belongs to account 65534");
  }
  fs::rename(File(), folder_ / "elsewhere");
  fs::create_symlink(folder_ / "elsewhere", File());
  ExpectRefused(StatusCode::kFailed, "");
  fs::remove(File());
  fs::create_directory(File());
  ExpectRefused(StatusCode::kFailed, "not a regular file");
  fs::remove(File());
  ASSERT_EQ(mkfifo(File().c_str(), 0600), 0);
  ExpectRefused(StatusCode::kFailed, "not a regular file");
}

TEST_F(LastLights, ThatSayNothingAreErrorsAndNoCrash) {
  ExpectRefused(StatusCode::kNotFound, "");
  for (const char* text : {"", "{", "[]", "7", R"({"schema": 1})", R"({"schema": "one"})",
                           R"({"schema": 1, "enables": [{"name": 7}], "displays": []})",
                           R"({"schema": 1, "enables": 3, "displays": []})"}) {
    Write(text);
    fs::permissions(File(), fs::perms::owner_read | fs::perms::owner_write);
    ExpectRefused(StatusCode::kFailed, "is not what");
  }
  Write(R"({"schema": 2})");
  ExpectRefused(StatusCode::kNewerSchema, "schema 2");
}

TEST_F(LastLights, LieInTheStateFolderOfTheService) {
  setenv("STATE_DIRECTORY", "/run/a:/run/b", 1);
  EXPECT_EQ(StateFolder(), "/run/a");
  unsetenv("STATE_DIRECTORY");
  EXPECT_EQ(StateFolder(), "/var/lib/stratalux");
}

TEST(TakeLights, WithoutAnyLightIsAUsageErrorAndAMissingLineIsNamed) {
  EXPECT_EQ(TakeLights({}).code(), StatusCode::kUsage);
  const Status missing = TakeLights({{{{"STRATALUX_NO_SUCH_LINE", "", -1}, ActiveLevel::kHigh}}, {}});
  EXPECT_FALSE(missing.ok());
  EXPECT_THAT(missing.message(), HasSubstr("STRATALUX_NO_SUCH_LINE"));
}

}  // namespace
}  // namespace stratalux::rig
