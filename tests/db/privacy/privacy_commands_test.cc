// SPDX-License-Identifier: Apache-2.0
// The privacy verbs as an operator runs them.
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/care/incoming.h"
#include "db/catalogue/manifest.h"
#include "db/privacy/access_log.h"
#include "tests/db/privacy/raw_bytes.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class PrivacyCommands : public StoreTest {
 protected:
  [[nodiscard]] Outcome Db(const std::string& arguments, const std::string& redirect = "2>&1") const {
    return Shell("STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR + "/stratalux-db " + arguments + " " +
                 redirect);
  }
  [[nodiscard]] nlohmann::json Json(const std::string& arguments) const {
    return nlohmann::json::parse(Db(arguments + " --json", "2>/dev/null").out, nullptr, false);
  }
  // Without SQLite's -wal and -shm, which come and go at any opening.
  [[nodiscard]] RawFiles Lasting() const {
    RawFiles raw = ReadRaw(folder_);
    std::erase_if(raw, [](const auto& file) { return file.first.ends_with("-wal") || file.first.ends_with("-shm"); });
    return raw;
  }
};

TEST_F(PrivacyCommands, ConsentIsGivenShownAndWithdrawn) {
  EXPECT_EQ(Db("consent show").code, 0);
  EXPECT_EQ(Db("consent show --visitor v-1").code, 4);
  EXPECT_EQ(Db("consent give --visitor v-1 --text-version 3 --language de --scope fit,research").code, 0);
  EXPECT_EQ(Db("consent give --visitor v-1 --text-version 3 --language de").code, 2);
  EXPECT_EQ(Db("consent give --visitor v-1 --text-version 3 --language de --scope all").code, 2);
  EXPECT_EQ(Db("consent").code, 2);
  const auto rows = Json("consent show --visitor v-1");
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0]["scope"], nlohmann::json({"fit", "research"}));
  EXPECT_EQ(rows[0]["language"], "de");
  EXPECT_TRUE(rows[0]["withdrawn"].is_null());
  EXPECT_EQ(Db("consent withdraw --visitor v-1").code, 0);
  EXPECT_FALSE(Json("consent show")[0]["withdrawn"].is_null());
  EXPECT_EQ(Db("consent withdraw --visitor v-1").code, 4);
}

TEST_F(PrivacyCommands, ForgetAsksFirst) {
  const std::string id = StoreSession(2, {.encryption = Encryption::kPerSession});
  const RawFiles before = Lasting();
  EXPECT_EQ(Db("forget").code, 2);
  EXPECT_EQ(Db("forget " + id).code, 2);
  EXPECT_EQ(Db("forget " + id + " --visitor simulated --yes").code, 2);
  EXPECT_EQ(Db("forget s9 --yes").code, 4);
  EXPECT_EQ(Db("forget --visitor nobody --yes").code, 4);
  const Outcome dry = Db("forget " + id + " --dry-run");
  EXPECT_EQ(dry.code, 0);
  EXPECT_THAT(dry.out, HasSubstr("2 frames"));
  EXPECT_THAT(dry.out, HasSubstr("nothing was changed"));
  const RawFiles after = Lasting();
  EXPECT_TRUE(after == before);
  const auto done = Json("forget " + id + " --yes");
  EXPECT_EQ(done["sessions"][0]["session"], id);
  EXPECT_EQ(done["leftovers"].size(), 0U);
  const Outcome again = Db("forget " + id + " --yes");
  EXPECT_EQ(again.code, 0);
  EXPECT_THAT(again.out, HasSubstr("already forgotten"));
  EXPECT_EQ(Json("deletions")[0]["session"], id);
  EXPECT_EQ(Db("show " + id).code, 4);
}

TEST_F(PrivacyCommands, ForgetKnowsTheTicketOfAKiosk) {
  ASSERT_EQ(Db("consent give --visitor t-7k3qzm0p4t3 --text-version 3 --language de --scope fit").code, 0);
  EXPECT_EQ(Db("forget --ticket 7K3QZ-M0P4T-4 --yes").code, 2) << "mistyped";
  EXPECT_EQ(Db("forget --ticket 12345-67890-1 --yes").code, 4) << "somebody else's";
  EXPECT_EQ(Db("forget --ticket 7K3QZ-M0P4T-3 --visitor t-7k3qzm0p4t3 --yes").code, 2);
  EXPECT_EQ(Db("forget --ticket 7K3QZ-M0P4T-3").code, 2) << "not asked for with --yes";
  EXPECT_EQ(Db("forget --ticket '7k3qz mop4t 3' --yes").code, 0);
  EXPECT_EQ(Db("consent show --visitor t-7k3qzm0p4t3").code, 4);
}

// As a restored home folder, a copy by hand or a broken-off transfer puts it back: `verify` names the command, and it
// must do what it says.
TEST_F(PrivacyCommands, ForgetRemovesAForgottenSessionThatLiesHereAgain) {
  for (const char* place : {"sessions", "incoming"}) {
    SCOPED_TRACE(place);
    const std::string id = StoreSession(2);
    const std::filesystem::path back = folder_ / place / id, copy = folder_.string() + "-by-hand";
    std::filesystem::copy(folder_ / "sessions" / id, copy, std::filesystem::copy_options::recursive);
    ASSERT_EQ(Db("forget " + id + " --yes").code, 0);
    std::filesystem::create_directories(back.parent_path());
    std::filesystem::rename(copy, back);
    EXPECT_EQ(Db("verify").code, 6);
    EXPECT_THAT(Db("verify").out, HasSubstr("`stratalux-db forget " + id + "`"));
    const Outcome asked = Db("forget " + id);
    EXPECT_EQ(asked.code, 2);
    EXPECT_THAT(asked.out, HasSubstr("removes 1 session(s)"));
    EXPECT_TRUE(std::filesystem::exists(back));
    const auto done = Json("forget " + id.substr(0, 9) + " --yes");
    ASSERT_EQ(done["sessions"].size(), 1U);
    EXPECT_EQ(done["sessions"][0]["frames"], 2);
    EXPECT_GT(done["markers"], 2);
    EXPECT_FALSE(std::filesystem::exists(back));
    EXPECT_EQ(Db("verify").code, 0);
    EXPECT_THAT(Db("forget " + id + " --yes").out, HasSubstr("already forgotten"));
  }
}

TEST_F(PrivacyCommands, EveryCommandSaysOfAForgottenSessionThatItWasForgotten) {
  const std::string id = StoreSession(1), out = (folder_ / "out").string();
  ASSERT_EQ(Db("forget " + id + " --yes").code, 0);
  for (const char* command :
       {"show SESSION", "frames SESSION", "verify SESSION", "export SESSION --out OUT", "export SESSION --crate OUT",
        "key export SESSION --out OUT", "transcode SESSION --codec delta"})
    for (const std::string& selector : {id, id.substr(0, 7)}) {
      std::string call = command;
      call.replace(call.find("SESSION"), 7, selector);
      if (const size_t at = call.find("OUT"); at != std::string::npos) call.replace(at, 3, out);
      SCOPED_TRACE(call);
      const Outcome outcome = Db(call);
      EXPECT_EQ(outcome.code, 4);
      EXPECT_THAT(outcome.out, HasSubstr("session " + id + " was forgotten; `stratalux-db deletions`"));
    }
  EXPECT_THAT(Db("show s9").out, HasSubstr("no session 's9'"));
}

TEST_F(PrivacyCommands, EncryptedSessionsAreShownAsSuchAndLeftAloneByATranscodeOfAll) {
  const std::string plain = StoreSession(2), sealed = StoreSession(2, {.encryption = Encryption::kPerSession});
  EXPECT_THAT(Db("show " + sealed).out, HasSubstr(", encrypted"));
  EXPECT_THAT(Db("show " + plain).out, Not(HasSubstr(", encrypted")));
  EXPECT_EQ(Json("show " + sealed)["encrypted"], true);
  const Outcome all = Db("transcode --all --codec raw12");
  EXPECT_EQ(all.code, 3);
  EXPECT_THAT(all.out, HasSubstr("session " + sealed + " is encrypted"));
  EXPECT_THAT(all.out, HasSubstr(plain + "       2"));
  const Outcome one = Db("transcode " + sealed + " --codec raw12");
  EXPECT_EQ(one.code, 2);
  EXPECT_THAT(one.out, Not(HasSubstr("rewritten"))) << "no empty table";
}

TEST_F(PrivacyCommands, AKeyFileThatIsThereStaysAndIsNotLoggedAgain) {
  const std::string id = StoreSession(1, {.encryption = Encryption::kPerSession});
  const std::string command = "key export " + id + " --out " + (folder_ / "carried.key").string();
  ASSERT_EQ(Db(command).code, 0);
  const Outcome again = Db(command);
  EXPECT_EQ(again.code, 2);
  EXPECT_THAT(again.out, HasSubstr("carried.key already exists; remove it first"));
  EXPECT_EQ(Json("access " + id).size(), 1U);
}

TEST_F(PrivacyCommands, AnEmptyListSaysThatItIsEmpty) {
  EXPECT_THAT(Db("verify").out, HasSubstr("store: ok, no sessions"));
  for (const char* list : {"ls", "access", "deletions", "consent show"}) EXPECT_THAT(Db(list).out, HasSubstr("(none)"));
  for (const char* list : {"verify", "ls", "access", "deletions", "consent show"}) EXPECT_EQ(Json(list).size(), 0U);
  const std::string id = StoreSession(1);
  EXPECT_THAT(Db("frames " + id + " --projector 9").out, HasSubstr("(none)"));
}

TEST_F(PrivacyCommands, LeftoversAreDegradedUntilResumed) {
  const std::string id = StoreSession(1);
  WriteText(folder_ / "thumbnail.txt", id);
  const Outcome first = Db("forget " + id + " --yes");
  EXPECT_EQ(first.code, 3);
  EXPECT_THAT(first.out, HasSubstr("thumbnail.txt, offset 0: session id"));
  std::filesystem::remove(folder_ / "thumbnail.txt");
  EXPECT_EQ(Db("forget --resume").code, 0);
  EXPECT_THAT(Db("deletions").out, HasSubstr("yes"));
}

TEST_F(PrivacyCommands, PurgeRemovesWhatIsDueAndADryRunNoByte) {
  const std::string id = StoreSession(2);
  EXPECT_THAT(Db("purge").out, HasSubstr("no session is due"));
  const RawFiles before = Lasting();
  const Outcome dry = Db("purge --dry-run --now 2099-01-01");
  EXPECT_EQ(dry.code, 0);
  EXPECT_THAT(dry.out, HasSubstr("kept for 365"));
  const RawFiles after = Lasting();
  EXPECT_TRUE(after == before);
  EXPECT_EQ(Db("purge --now yesterday").code, 2);
  EXPECT_EQ(Db("purge --dry-run --now 2263-01-01").code, 2) << "no nanosecond counts so far";
  EXPECT_EQ(Db("purge --standard-days -3").code, 2);
  WriteText(folder_ / "rig.toml", "[retention]\nstandard_days = 99999\n");
  EXPECT_THAT(Db("purge --now 2099-01-01 --config " + (folder_ / "rig.toml").string()).out,
              HasSubstr("no session is due"));
  const auto done = Json("purge --now 2099-01-01T00:00:00Z");
  EXPECT_EQ(done["sessions"][0]["session"], id);
  EXPECT_EQ(Json("deletions")[0]["reason"], "purge");
  EXPECT_EQ(Json("ls").size(), 0U);
}

// It answers from the index alone, and says so: a night's preview must not walk a hundred thousand folders.
TEST_F(PrivacyCommands, ADryRunOfAPurgeNeedsNoFileOfASession) {
  std::vector<std::string> ids = {StoreSession(2, {.encryption = Encryption::kPerSession}), StoreSession(3)};
  const auto out = folder_ / "out";
  ASSERT_EQ(Db("export " + ids[1] + " --out " + out.string()).code, 0);
  const auto stored = Json("ls");
  std::filesystem::rename(folder_ / "sessions", folder_ / "elsewhere");
  std::filesystem::create_directory(folder_ / "sessions");
  const auto plan = Json("purge --dry-run --now 2099-01-01");
  EXPECT_EQ(plan["by"], "index");
  ASSERT_EQ(plan["sessions"].size(), 2U);
  for (size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(plan["sessions"][i]["session"], ids[i]) << "oldest first";
    EXPECT_EQ(plan["sessions"][i]["frames"], i + 2);
    EXPECT_EQ(plan["sessions"][i]["bytes"], stored[1 - i]["bytes"]) << "ls has the newest first";
    EXPECT_EQ(plan["sessions"][i]["encrypted"], i == 0);
    EXPECT_THAT(plan["sessions"][i]["due"].get<std::string>(), HasSubstr("kept for 365"));
  }
  EXPECT_EQ(plan["sessions"][0]["exports"].size(), 0U);
  ASSERT_EQ(plan["sessions"][1]["exports"].size(), 1U);
  EXPECT_EQ(plan["sessions"][1]["exports"][0]["state"], "deleted");
  EXPECT_EQ(plan["total"]["sessions"], 2);
  EXPECT_EQ(plan["total"]["frames"], 5);
  EXPECT_EQ(plan["total"]["bytes"], stored[0]["bytes"].get<int64_t>() + stored[1]["bytes"].get<int64_t>());
  const std::string text = Db("purge --dry-run --now 2099-01-01").out;
  EXPECT_THAT(text, HasSubstr(", its key (standard"));
  EXPECT_THAT(text, HasSubstr("would be deleted"));
  EXPECT_THAT(text, HasSubstr("2 sessions, 5 frames, 0 fits, " + std::to_string(plan["total"]["bytes"].get<int64_t>()) +
                              " bytes of frames (from the index"));
  const auto none = Json("purge --dry-run");
  EXPECT_EQ(none["sessions"].size(), 0U);
  EXPECT_EQ(none["total"]["sessions"], 0);
}

// A pull was broken off, and its source never came back.
TEST_F(PrivacyCommands, PurgeAndForgetReachWhatABrokenOffPullLeft) {
  StoreSession(1);
  const auto lay = [&](const std::string& id, const std::string& visitor) {
    const auto folder = IncomingFolder(folder_, id);
    std::filesystem::create_directories(folder);
    WriteText(folder / "frames-0001.seg", "the face of " + visitor);
    SessionInfo info;
    info.id = id;
    info.visitor = visitor;
    info.started_wall = WallNow();
    info.retention = Retention::kShort;
    ASSERT_TRUE(WriteManifest(folder, info, 0, {}).ok());
  };
  const auto there = [&](const std::string& id) { return std::filesystem::exists(IncomingFolder(folder_, id)); };
  for (const char* id : {"s1-a", "s2-b", "s3-c"}) lay(id, std::string("v-5f3a91c") + id[1]);
  EXPECT_EQ(Db("forget s1-a").code, 2) << "asks first";
  const Outcome dry = Db("forget s1-a --dry-run");
  EXPECT_THAT(dry.out, HasSubstr("incoming/s1-a: would go"));
  EXPECT_TRUE(there("s1-a"));
  const Outcome one = Db("forget s1-a --yes");
  EXPECT_EQ(one.code, 0) << one.out;
  EXPECT_THAT(one.out, HasSubstr("incoming/s1-a: gone"));
  EXPECT_FALSE(there("s1-a"));
  EXPECT_EQ(Db("forget --visitor v-5f3a91c2 --yes").code, 0);
  EXPECT_FALSE(there("s2-b"));
  EXPECT_EQ(Db("forget --visitor v-5f3a91c2 --yes").code, 4) << "now nothing knows the name";

  const std::string soon = " --now " + ToIso8601({WallNow().ns + int64_t{31} * 86'400 * 1'000'000'000}).substr(0, 10);
  EXPECT_THAT(Db("purge").out, HasSubstr("no session is due"));
  const RawFiles before = Lasting();
  EXPECT_THAT(Db("purge --dry-run" + soon).out, HasSubstr("incoming/s3-c: would go (short: "));
  const auto plan = Json("purge --dry-run" + soon);
  EXPECT_EQ(plan["sessions"].size(), 0U);
  ASSERT_EQ(plan["incoming"].size(), 1U);
  EXPECT_EQ(plan["incoming"][0]["place"], "incoming/s3-c");
  EXPECT_THAT(plan["incoming"][0]["due"].get<std::string>(), HasSubstr("kept for 30"));
  EXPECT_TRUE(Lasting() == before);
  {
    const auto transfer = IncomingLock::Take(folder_);
    ASSERT_TRUE(transfer.ok());
    EXPECT_THAT(Db("purge" + soon).out, HasSubstr("a pull or restore is running"));
    EXPECT_TRUE(there("s3-c"));
  }
  const auto purged = Json("purge" + soon);
  EXPECT_EQ(purged["incoming"][0]["place"], "incoming/s3-c");
  EXPECT_THAT(purged["incoming"][0]["due"].get<std::string>(), HasSubstr("kept for 30"));
  EXPECT_FALSE(there("s3-c"));
  EXPECT_EQ(Json("ls").size(), 1U) << "and nothing else";
}

TEST_F(PrivacyCommands, WhatLeavesTheStoreIsLogged) {
  const std::string id = StoreSession(2), other = StoreSession(1);
  const auto out = folder_ / "out";
  ASSERT_EQ(Db("frames " + id + " --extract " + out.string()).code, 0);
  EXPECT_EQ(Db("ls").code + Db("show " + id).code + Db("frames " + id).code, 0);
  const auto log = Json("access");
  ASSERT_EQ(log.size(), 1U) << "lists give nothing away";
  EXPECT_EQ(log[0]["action"], "extract");
  EXPECT_EQ(log[0]["session"], id);
  EXPECT_EQ(log[0]["who"], OperatingSystemUser());
  EXPECT_THAT(log[0]["detail"].get<std::string>(), HasSubstr(":" + std::filesystem::canonical(out).string()));
  EXPECT_EQ(Json("access " + other).size(), 0U);
  EXPECT_EQ(Json("access s000001").size(), 1U);
}

TEST_F(PrivacyCommands, AKeyIsCarriedToAnotherStoreByHand) {
  const std::string id = StoreSession(1, {.encryption = Encryption::kPerSession}), plain = StoreSession(1);
  const auto file = folder_ / "carried" / "a.key";
  EXPECT_EQ(Db("key export " + plain + " --out " + file.string()).code, 2);
  ASSERT_EQ(Db("key export " + id + " --out " + file.string()).code, 0);
  EXPECT_NE(Db("key export " + id + " --out " + file.string()).code, 0) << "never over another file";
  EXPECT_EQ(Json("access")[0]["action"], "key export");
  // As a pull leaves it: everything but the keys.
  std::filesystem::remove(folder_ / "keys.sqlite");
  const std::string read = "frames " + id + " --extract " + (folder_ / "out").string();
  const Outcome without = Db(read);
  EXPECT_EQ(without.code, 4);
  EXPECT_THAT(without.out, HasSubstr("key import"));
  EXPECT_EQ(Db("frames " + plain + " --extract " + (folder_ / "plain").string()).code, 0);
  EXPECT_EQ(Db("verify").code, 0);
  ASSERT_EQ(Db("key import " + file.string()).code, 0);
  EXPECT_EQ(Db(read).code, 0);
  WriteText(folder_ / "no.key", "{}");
  EXPECT_EQ(Db("key import " + (folder_ / "no.key").string()).code, 6);
}

}  // namespace
}  // namespace stratalux::db
