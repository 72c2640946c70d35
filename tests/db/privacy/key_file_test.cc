// SPDX-License-Identifier: Apache-2.0
// A key that is carried by hand.
#include "db/privacy/key_file.h"

#include <thread>

#include "db/privacy/export_marker.h"
#include "shared/base/read_file.h"
#include "tests/db/privacy/forget_fixture.h"
#include "tests/support/held_open.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class KeyFileTest : public ForgetTest {
 protected:
  void SetUp() override {
    ForgetTest::SetUp();
    id_ = Visit(kVisitor, 1, Encryption::kPerSession);
    ASSERT_TRUE(ExportKeyFile(folder_, *OpenStore(AccessMode::kReadOnly).FindSession(id_), exports_ / "k.key").ok());
    const std::string key_id = TracesOf(id_).key_id;
    std::copy(key_id.begin(), key_id.end(), key_id_.begin());
    // A store of another machine, to which it is carried.
    ASSERT_TRUE(SessionStore::Create(other_).ok());
  }
  std::string id_;
  KeyId key_id_{};
  fs::path other_ = exports_ / "other";
};

TEST_F(KeyFileTest, OneOfALaterVersionIsRefused) {
  auto json = nlohmann::json::parse(*ReadFile(exports_ / "k.key"));
  json["schema"] = 2;
  WriteText(exports_ / "later.key", json.dump());
  const auto refused = ImportKeyFile(other_, exports_ / "later.key");
  EXPECT_EQ(refused.status().code(), StatusCode::kNewerSchema);
  EXPECT_THAT(refused.status().message(), HasSubstr("use a newer stratalux"));
  EXPECT_FALSE(FindKey(other_, key_id_).ok());
  json.erase("schema");
  WriteText(exports_ / "none.key", json.dump());
  EXPECT_EQ(ImportKeyFile(other_, exports_ / "none.key").status().code(), StatusCode::kIntegrity);
  EXPECT_EQ(*ImportKeyFile(other_, exports_ / "k.key"), id_);
  EXPECT_TRUE(FindKey(other_, key_id_).ok());
}

// Between the question whether it may come and the lock under which it comes.
TEST_F(KeyFileTest, AForgettingThatBeginsMeanwhileKeepsItOut) {
  WriteText(other_ / "write.lock", "");
  HeldOpen held(other_ / "write.lock", HeldOpen::Against::kWriting);
  if (!held.taken()) GTEST_SKIP() << "no leases here";
  Status imported;
  std::thread import([&] { imported = ImportKeyFile(other_, exports_ / "k.key").status(); });
  const bool waits = held.Wait();
  const Status forgotten =
      AppendToLedger(other_, {LedgerKind::kForgetting, WallNow(), {id_}, "", R"({"reason": "forget"})"});
  held.Release();
  import.join();
  ASSERT_TRUE(waits);
  ASSERT_TRUE(forgotten.ok()) << forgotten.message();
  EXPECT_EQ(imported.code(), StatusCode::kUsage) << imported.message();
  EXPECT_FALSE(FindKey(other_, key_id_).ok());
}

// Whoever made the file that the key is written into could read it there.
TEST_F(KeyFileTest, AFileBesideThatIsNotOfAKilledExportIsNotWrittenInto) {
  const fs::path file = exports_ / "n.key", beside = exports_ / "n.key.new";
  WriteText(beside, "mine");
  for (const int mode : {0644, 0600}) {
    fs::permissions(beside, static_cast<fs::perms>(mode));
    const Status refused = ExportKeyFile(folder_, *OpenStore(AccessMode::kReadOnly).FindSession(id_), file);
    EXPECT_EQ(refused.code(), StatusCode::kUsage) << refused.message();
    EXPECT_THAT(refused.message(), HasSubstr(beside.string()));
    EXPECT_FALSE(fs::exists(file));
    EXPECT_EQ(*ReadFile(beside), "mine");
    EXPECT_FALSE(IsInExport(beside, id_)) << "a forgetting would delete it";
  }
}

TEST_F(KeyFileTest, WhatAKilledExportLeftBesideIsReplaced) {
  const fs::path file = exports_ / "k.key", beside = exports_ / "k.key.new";
  const std::string whole = *ReadFile(file);
  fs::remove(file);
  WriteText(beside, whole.substr(0, 20));
  const auto again = [&] { return ExportKeyFile(folder_, *OpenStore(AccessMode::kReadOnly).FindSession(id_), file); };
  fs::permissions(beside, static_cast<fs::perms>(0644));
  EXPECT_EQ(again().code(), StatusCode::kUsage) << "none of ours has this mode";
  fs::permissions(beside, static_cast<fs::perms>(0600));
  const Status exported = again();
  ASSERT_TRUE(exported.ok()) << exported.message();
  EXPECT_EQ(*ReadFile(file), whole);
  EXPECT_EQ(fs::status(file).permissions(), static_cast<fs::perms>(0600));
  EXPECT_FALSE(fs::exists(beside));
}

TEST_F(KeyFileTest, OtherBytesUnderAKnownIdAreRefused) {
  ASSERT_TRUE(ImportKeyFile(other_, exports_ / "k.key").ok());
  auto json = nlohmann::json::parse(*ReadFile(exports_ / "k.key"));
  json["key"] = std::string(64, 'a');
  WriteText(exports_ / "changed.key", json.dump());
  const auto refused = ImportKeyFile(other_, exports_ / "changed.key");
  EXPECT_EQ(refused.status().code(), StatusCode::kIntegrity) << refused.status().message();
  EXPECT_THAT(refused.status().message(), HasSubstr((exports_ / "changed.key").string()));
  EXPECT_EQ(FindKey(other_, key_id_)->key->bytes, FindKey(folder_, key_id_)->key->bytes);
  EXPECT_TRUE(ImportKeyFile(other_, exports_ / "k.key").ok()) << "the same again is no error";
}

TEST_F(KeyFileTest, AnotherKeyThanThatOfTheListedSessionIsRefused) {
  auto json = nlohmann::json::parse(*ReadFile(exports_ / "k.key"));
  const std::string right = json["key_id"];
  json["key_id"] = std::string(32, 'b');
  WriteText(exports_ / "foreign.key", json.dump());
  const auto refused = ImportKeyFile(folder_, exports_ / "foreign.key");
  EXPECT_EQ(refused.status().code(), StatusCode::kIntegrity) << refused.status().message();
  for (const std::string& part : {id_, right, (exports_ / "foreign.key").string()})
    EXPECT_THAT(refused.status().message(), HasSubstr(part));
  KeyId foreign{};
  foreign.fill(0xbb);
  EXPECT_FALSE(FindKey(folder_, foreign).ok());
  EXPECT_TRUE(ImportKeyFile(folder_, exports_ / "k.key").ok());
}

}  // namespace
}  // namespace stratalux::db
