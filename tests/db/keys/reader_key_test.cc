// SPDX-License-Identifier: Apache-2.0
// A reader's key: private, never replaced, found where the environment says.
#include "db/keys/reader_key.h"

#include <cstdlib>
#include <set>

#include <gmock/gmock.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class ReaderKeyTest : public ScratchFolderTest {
 protected:
  ~ReaderKeyTest() override {
    unsetenv("STRATALUX_READER_KEY");
    unsetenv("CREDENTIALS_DIRECTORY");
  }
  const fs::path file_ = folder_ / "reader.key";
};

TEST_F(ReaderKeyTest, LiesInAFileThatItsOwnerAloneReads) {
  const auto made = ReaderKey::Create(file_);
  ASSERT_TRUE(made.ok()) << made.status().message();
  struct stat info {};
  ASSERT_EQ(stat(file_.c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600U);
  EXPECT_EQ(ReaderKey::Read(file_)->public_key(), made->public_key());
  for (const mode_t mode : {0640, 0604, 0620, 0666}) {
    ASSERT_EQ(chmod(file_.c_str(), mode), 0);
    const Status refused = ReaderKey::Read(file_).status();
    EXPECT_EQ(refused.code(), StatusCode::kFailed) << mode;
    EXPECT_THAT(refused.message(), HasSubstr("can be read by others"));
  }
  ASSERT_EQ(chmod(file_.c_str(), 0400), 0);
  EXPECT_TRUE(ReaderKey::Read(file_).ok());
}

TEST_F(ReaderKeyTest, IsNeverReplaced) {
  const auto first = ReaderKey::Create(file_);
  EXPECT_EQ(ReaderKey::Create(file_).status().code(), StatusCode::kUsage);
  EXPECT_EQ(ReaderKey::Read(file_)->public_key(), first->public_key());
  EXPECT_FALSE(fs::exists(file_.string() + ".new"));
}

// Each that says it made the key made the one that is there.
TEST_F(ReaderKeyTest, IsMadeOnceByProgramsThatBeginTogether) {
  constexpr int kPrograms = 8;
  for (int i = 0; i < kPrograms; ++i)
    if (fork() == 0) {
      const auto made = ReaderKey::Create(file_);
      WriteText(folder_ / std::to_string(i), made.ok() ? ToText(made->public_key()) : "");
      _exit(made.ok() ? 0 : made.status().exit_code());
    }
  std::multiset<int> codes;
  for (int i = 0; i < kPrograms; ++i) {
    int status = 0;
    wait(&status);
    codes.insert(WEXITSTATUS(status));
  }
  EXPECT_EQ(codes.count(0), 1U);
  EXPECT_EQ(codes.count(2), kPrograms - 1U);
  std::string said;
  for (int i = 0; i < kPrograms; ++i) said += ReadText(folder_ / std::to_string(i));
  EXPECT_EQ(said, ToText(ReaderKey::Read(file_)->public_key()));
}

TEST_F(ReaderKeyTest, IsRefusedWhereItIsDamagedOrAnothers) {
  ASSERT_TRUE(ReaderKey::Create(file_).ok());
  const std::string whole = ReadText(file_);
  for (const std::string& text : {whole.substr(0, whole.size() - 2), whole + "00",
                                  std::string("stratalux reader key 2 x25519\n") + whole.substr(30),
                                  std::string("stratalux rig key 1 ed25519\n") + whole.substr(30), std::string()}) {
    WriteText(file_, text);
    EXPECT_EQ(ReaderKey::Read(file_).status().code(), StatusCode::kIntegrity) << text;
  }
  EXPECT_EQ(ReaderKey::Read(folder_).status().code(), StatusCode::kFailed) << "a folder";
  EXPECT_EQ(ReaderKey::Read(folder_ / "none").status().code(), StatusCode::kNotFound);
  ASSERT_EQ(mkfifo((folder_ / "pipe").c_str(), 0600), 0);
  EXPECT_FALSE(ReaderKey::Read(folder_ / "pipe").ok()) << "and waits for nobody";
}

TEST_F(ReaderKeyTest, IsFoundWhereTheEnvironmentSays) {
  EXPECT_EQ(ReaderKey::OfEnvironment().status().code(), StatusCode::kNotFound);
  const auto key = ReaderKey::Create(file_);
  setenv("STRATALUX_READER_KEY", file_.c_str(), 1);
  EXPECT_EQ(ReaderKey::OfEnvironment()->public_key(), key->public_key());
  setenv("STRATALUX_READER_KEY", (folder_ / "none").c_str(), 1);
  EXPECT_THAT(ReaderKey::OfEnvironment().status().message(), HasSubstr((folder_ / "none").string()));
  unsetenv("STRATALUX_READER_KEY");
  setenv("CREDENTIALS_DIRECTORY", folder_.c_str(), 1);
  // As systemd leaves it: root's, with an access list for the account, which shows as the group's right.
  ASSERT_EQ(chmod(file_.c_str(), 0440), 0);
  EXPECT_EQ(ReaderKey::OfEnvironment()->public_key(), key->public_key());
  ASSERT_EQ(chmod(file_.c_str(), 0444), 0);
  EXPECT_EQ(ReaderKey::OfEnvironment().status().code(), StatusCode::kFailed);
  fs::remove(file_);
  EXPECT_EQ(ReaderKey::OfEnvironment().status().code(), StatusCode::kNotFound) << "a unit without the credential";
}

TEST_F(ReaderKeyTest, HasAPublicHalfThatPassesForNoOther) {
  const ReaderPublicKey key = ReaderKey::Create(file_)->public_key();
  const std::string text = ToText(key);
  EXPECT_EQ(*ParseReaderPublicKey(text), key);
  WriteText(folder_ / "reader.pub", text + "\n");
  EXPECT_EQ(*ParseReaderPublicKey(folder_ / "reader.pub"), key);
  const std::string hex = text.substr(7);
  for (const std::string& other :
       {hex, text + "0", text.substr(0, 70), "x25519-" + std::string(64, 'g'), file_.string()})
    EXPECT_EQ(ParseReaderPublicKey(other).status().code(), StatusCode::kUsage) << other;
}

}  // namespace
}  // namespace stratalux::db
