// SPDX-License-Identifier: Apache-2.0
// A key that is carried by hand.
#include "db/privacy/key_file.h"

#include <thread>

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

}  // namespace
}  // namespace stratalux::db
