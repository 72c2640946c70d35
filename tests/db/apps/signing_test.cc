// SPDX-License-Identifier: Apache-2.0
// An auditor's commands: from the rig's key to a verdict over a copy of its store.
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/keys/rig_key.h"
#include "tests/db/forged_segment.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class SigningTest : public StoreTest {
 protected:
  void TearDown() override {
    for (const fs::path& folder : {Beside("copy"), Beside("backup"), Beside("pictures")}) fs::remove_all(folder);
    fs::remove(Beside("pub"));
    StoreTest::TearDown();
  }
  [[nodiscard]] fs::path Beside(const std::string& name) const { return folder_.string() + "-" + name; }
  [[nodiscard]] Outcome Db(const std::string& arguments, const fs::path& store) const {
    return Execute("stratalux-db " + arguments + " --store " + store.string());
  }
  [[nodiscard]] Outcome Db(const std::string& arguments) const { return Db(arguments, folder_); }
};

TEST_F(SigningTest, TheAuditorTellsACopyFromAForgery) {
  EXPECT_EQ(Db("key public").code, 4) << "there is none yet";
  ASSERT_EQ(Db("key sign-init > " + Beside("pub").string()).code, 0);
  EXPECT_EQ(Db("key sign-init").code, 2);
  const std::string id = StoreSession(3, {.signing = Signing::kRigKey});
  const std::string hex = Db("key public").out.substr(0, 64);
  EXPECT_EQ(*ParsePublicKey(hex), *ParsePublicKey(Beside("pub")));
  EXPECT_THAT(Db("verify").out, HasSubstr("signed by " + Fingerprint(*ParsePublicKey(hex))));
  const auto json =
      nlohmann::json::parse(Execute("stratalux-db verify --json --store " + folder_.string(), Show::kStdout).out);
  EXPECT_EQ(json[0]["signed_by"], hex);

  ASSERT_EQ(Db("backup --to " + Beside("backup").string()).code, 0);
  EXPECT_FALSE(fs::exists(Beside("backup") / "rig.key")) << "the key stays at the rig";
  EXPECT_TRUE(fs::exists(Beside("backup") / "sessions" / id / "signature.json"));
  ASSERT_EQ(Db("export " + id + " --out " + Beside("pictures").string()).code, 0);
  EXPECT_EQ(ReadBytes(Beside("pictures") / "signature.json"), ReadBytes(folder_ / "sessions" / id / "signature.json"));

  fs::copy(folder_, Beside("copy"), fs::copy_options::recursive);
  fs::remove(Beside("copy") / "rig.key");
  const std::string audit = "verify --deep --public-key " + Beside("pub").string();
  EXPECT_EQ(Db(audit, Beside("copy")).code, 0);
  EXPECT_EQ(Db("verify --deep --public-key " + std::string(64, 'a'), Beside("copy")).code, 6);
  EXPECT_EQ(Db("verify --public-key nonsense", Beside("copy")).code, 2);
  // Every hash made anew, and the rows with them.
  ForgeHeaders(Beside("copy") / "sessions" / id / "frames-0001.seg", [](FrameHeader& h) { h.mean_dn = 3; });
  EXPECT_EQ(Db(audit, Beside("copy")).code, 6);
  EXPECT_THAT(Db(audit, Beside("copy")).out, HasSubstr("signature.json: the signature does not match"));
}

TEST_F(SigningTest, AKeyNeedsAStore) {
  EXPECT_EQ(Db("key sign-init", Beside("nowhere")).code, 4);
  EXPECT_FALSE(fs::exists(Beside("nowhere")));
}

}  // namespace
}  // namespace stratalux::db
