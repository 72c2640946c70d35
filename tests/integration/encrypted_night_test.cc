// SPDX-License-Identifier: Apache-2.0
// A kiosk's night: encrypted visitors, captured on one machine, pulled to another that has none of its keys, and fitted
// there by who holds the reader's private key; on a third by who is handed the keys of its share.
#include <fstream>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class EncryptedNight : public SmallFit {
 protected:
  void SetUp() override {
    SmallFit::SetUp();
    rig_ = folder_ / "rig";
    there_ = folder_ / "workstation";
    for (const fs::path& store : {rig_, there_}) ASSERT_EQ(Db(store, "init").code, 0);
    const std::string key = (folder_ / "reader.key").string();
    ASSERT_EQ(Execute("stratalux-db key reader-init --out " + key + " > " + (folder_ / "reader.pub").string()).code, 0);
    with_reader_ = "STRATALUX_READER_KEY=" + key + " ";
  }
  // An encrypted visitor on the rig; its id.
  std::string Visitor() {
    EXPECT_EQ(Capture(rig_, "--encrypt").code, 0);
    return Json::parse(Execute("stratalux-db ls --json --store " + rig_.string(), Show::kStdout).out)[0].at("session");
  }
  [[nodiscard]] static Outcome Say(const std::string& environment, const std::string& command, const fs::path& store) {
    return Shell(environment + STRATALUX_BIN_DIR "/" + command + " --store " + store.string() + " 2>&1");
  }
  [[nodiscard]] Outcome Night(const std::string& environment) const {
    return Say(environment, "stratalux-fit batch run --workers 1 " + std::string(kSmallFitOptions), there_);
  }
  [[nodiscard]] std::string Morning() const {
    return Execute("stratalux-fit batch report --text --store " + there_.string(), Show::kStdout).out;
  }
  // The layers of a visitor's only fit, as they are stored; empty: it has none.
  static std::string StoredLayers(const fs::path& store, const std::string& session) {
    std::error_code error;
    for (const auto& fit : fs::directory_iterator(store / "sessions" / session / "fits", error))
      return ReadText(fit.path() / "layers_weight.exr");
    return "";
  }
  // The key itself, as `key export` gives it.
  [[nodiscard]] std::string KeyBytes(const std::string& session) const {
    const fs::path file = folder_ / (session + ".key");
    EXPECT_EQ(Db(rig_, "key export " + session + " --out " + file.string()).code, 0);
    const std::string hex = Json::parse(ReadText(file)).at("key");
    std::string bytes;
    for (size_t i = 0; i + 1 < hex.size(); i += 2)
      bytes.push_back(static_cast<char>(std::stoi(hex.substr(i, 2), nullptr, 16)));
    fs::remove(file);
    return bytes;
  }
  static std::vector<fs::path> FilesWith(const fs::path& folder, const std::string& bytes) {
    std::vector<fs::path> found;
    for (const auto& entry : fs::recursive_directory_iterator(folder, fs::directory_options::follow_directory_symlink))
      if (entry.is_regular_file() && ReadText(entry.path()).find(bytes) != std::string::npos)
        found.push_back(entry.path());
    return found;
  }

  fs::path rig_, there_;
  std::string with_reader_;
};

TEST_F(EncryptedNight, IsFittedWhereTheReadersKeyIsAndNamesWhoseKeyDidNotCome) {
  const std::string unshared = Visitor();
  fs::path keys = rig_ / "keys.sqlite";
  // Its own key is lost before anybody could share it.
  fs::remove(keys);
  EXPECT_EQ(Db(rig_, "key share " + (folder_ / "reader.pub").string()).code, 3);
  const std::string shared = Visitor();
  const Outcome pulled = Db(there_, "pull --from " + rig_.string());
  ASSERT_EQ(pulled.code, 0) << pulled.out;
  ASSERT_FALSE(fs::exists(there_ / "keys.sqlite"));

  // Without the reader's key nobody is fitted, and the morning says why.
  const Outcome blind = Night("");
  EXPECT_THAT(blind.out, HasSubstr("0 visitors to fit")) << blind.out;
  EXPECT_THAT(Morning(), HasSubstr(shared + "  key"));
  EXPECT_THAT(Morning(), HasSubstr("there is a sealed copy, but no reader's key was given"));
  EXPECT_EQ(StoredLayers(there_, shared), "");

  const Outcome night = Night(with_reader_);
  EXPECT_EQ(night.code, 0) << night.out;
  EXPECT_EQ(StoredLayers(there_, shared).substr(0, 7), "SLXSEAL");
  EXPECT_EQ(StoredLayers(there_, unshared), "");
  const std::string morning = Morning();
  EXPECT_THAT(morning, HasSubstr("1 of 1 visitors fitted"));
  EXPECT_THAT(morning, HasSubstr(unshared + "  key"));
  EXPECT_THAT(morning, HasSubstr("no copy of it is sealed to a reader"));
  EXPECT_FALSE(fs::exists(there_ / "keys.sqlite")) << "no key stays";
  EXPECT_THAT(FilesWith(there_, KeyBytes(shared)), IsEmpty());

  const Outcome verify = Say(with_reader_, "stratalux-db verify --deep " + shared, there_);
  EXPECT_EQ(verify.code, 0) << verify.out;
  EXPECT_THAT(verify.out, Not(HasSubstr("not opened")));
  // Whoever has the key sees the report; without it nobody does.
  const std::string report = "stratalux-fit report " + shared + " --out " + (folder_ / "plain").string();
  EXPECT_EQ(Say("", report, there_).code, 4);
  EXPECT_EQ(Say(with_reader_, report, there_).code, 0);
}

TEST_F(EncryptedNight, OnOtherMachinesNeedsTheKeysOfTheShareAloneAndLeavesThemNowhere) {
  ASSERT_EQ(Db(rig_, "key share " + (folder_ / "reader.pub").string()).code, 0);
  const std::string first = Visitor(), second = Visitor();
  ASSERT_EQ(Db(there_, "pull --from " + rig_.string()).code, 0);
  const fs::path results = folder_ / "results", scratch = folder_ / "scratch", seen = folder_ / "seen";
  for (const fs::path& folder : {scratch, seen}) fs::create_directories(folder);
  for (const char* part : {"sessions", "ledger"}) fs::create_directory_symlink(there_ / part, seen / part);
  // Whoever plans needs no key.
  const Outcome plan =
      Say("", "stratalux-fit batch plan " + std::string(kSmallFitOptions) + " --out " + results.string(), there_);
  ASSERT_EQ(plan.code, 0) << plan.out;
  ASSERT_EQ(Json::parse(ReadText(results / "plan.json")).at("visits").size(), 2U);
  const auto shard = [&](const std::string& number, const std::string& environment, const std::string& more) {
    return Say(environment,
               "stratalux-fit batch shard " + number + " --workers 1 --results " + results.string() + " --scratch " +
                   scratch.string() + more,
               seen);
  };
  const auto keys = [&](const std::string& number) {
    return with_reader_ + STRATALUX_BIN_DIR "/stratalux-fit batch keys " + number + " --results " + results.string() +
           " --store " + there_.string();
  };

  const Outcome none = shard("1/2", "", "");
  EXPECT_EQ(none.code, 3) << none.out;
  EXPECT_THAT(ReadText(results / "shard-0001-of-0002.json"), HasSubstr("is encrypted and cannot be read"));
  EXPECT_EQ(Shell(keys("1/2") + " > " + (folder_ / "keys").string() + " 2>/dev/null").code, 2) << "into a file";
  EXPECT_EQ(fs::file_size(folder_ / "keys"), 0U);
  EXPECT_EQ(shard("1/2", "", " --keys < /dev/null").code, 2);
  // The keys of another share are not its own.
  EXPECT_EQ(shard("1/2", keys("2/2") + " 2>/dev/null | ", " --keys").code, 3);
  const Outcome handed = shard("1/2", keys("1/2") + " 2>/dev/null | ", " --keys");
  EXPECT_EQ(handed.code, 0) << handed.out;
  // Nobody answers: who needs a key is not fitted. Then somebody does, told to stop when it is over.
  const Outcome alone = shard("2/2", "", " --ask-keys --ask-minutes 0.01");
  EXPECT_EQ(alone.code, 3) << alone.out;
  EXPECT_THAT(alone.out, HasSubstr("nobody answered"));
  // Whose key is here asks nobody.
  EXPECT_THAT(shard("1/2", with_reader_, " --ask-keys").out, Not(HasSubstr("asking")));
  const std::string answering = (folder_ / "answering").string();
  const std::string answer = "( timeout 300 env " + keys("--answer") + " --every 0.1 >" + answering +
                             " 2>&1 & echo $! >" + answering + ".pid ) && ";
  const Outcome asks = shard("2/2", answer, " --ask-keys");
  EXPECT_EQ(asks.code, 0) << asks.out;
  EXPECT_THAT(asks.out, HasSubstr("1 keys received"));
  EXPECT_EQ(Shell("kill -TERM $(cat " + answering + ".pid)").code, 0);
  const Outcome over = Shell("for i in $(seq 100); do grep -q 'answered in all' " + answering +
                             " && break; sleep 0.1; done; cat " + answering);
  EXPECT_THAT(over.out, HasSubstr("1 shards answered in all, 1 keys"));
  EXPECT_TRUE(fs::is_empty(results / "keys"));
  for (const std::string& session : {first, second})
    for (const fs::path& folder : {results, scratch, there_})
      EXPECT_THAT(FilesWith(folder, KeyBytes(session)), IsEmpty()) << folder;

  const Outcome merged = Say("", "stratalux-fit batch merge " + results.string(), there_);
  EXPECT_EQ(merged.code, 0) << merged.out;
  for (const std::string& session : {first, second})
    EXPECT_EQ(StoredLayers(there_, session).substr(0, 7), "SLXSEAL") << session;
  const Outcome verify = Say(with_reader_, "stratalux-db verify --deep", there_);
  EXPECT_EQ(verify.code, 0) << verify.out;
  EXPECT_THAT(Db(there_, "access").out, HasSubstr("batch keys"));
}

}  // namespace
}  // namespace stratalux
