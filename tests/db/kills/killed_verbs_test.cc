// SPDX-License-Identifier: Apache-2.0
// Each verb of stratalux-db that writes is killed (SIGKILL) before one of its file calls, as drawn by a seed. What it
// was to leave alone is then whole, and the same command, given again, ends where the undisturbed one does.
#include <cstdlib>
#include <fstream>
#include <random>
#include <sstream>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/catalogue/consent.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

struct Verb {
  const char* name;
  // Shell words behind `stratalux-db`; $A $B $C: session ids; $D: a folder beside the store that each run has afresh.
  const char* arguments;
  // A command whose output tells that the verb is done; empty: only the listing is compared.
  const char* witness = "true";
  // Exit codes of a second run that say: done already.
  std::vector<int> already = {};
  const char* before = "true";  // a command that makes what the verb needs
};

const Verb kVerbs[] = {
    {"init", "init --store $D/new", "stratalux-db ls --store $D/new"},
    {"consent give", "consent give --visitor v-5f3a91c2 --text-version 2 --language de --scope fit",
     "stratalux-db consent show --visitor v-5f3a91c2 --json | grep -c text_version.*2"},
    {"consent withdraw",
     "consent withdraw --visitor v-1a1a1a1a",
     "stratalux-db query retention-due --json | grep -c 'consent withdrawn'",
     {4}},
    {"forget", "forget $A --yes", "stratalux-db deletions | grep -c $A", {4}},
    {"forget of an encrypted session", "forget $B --yes", "stratalux-db deletions | grep -c $B", {4}},
    {"forget of a visitor", "forget --visitor v-1a1a1a1a --yes", "stratalux-db deletions | grep -c $A", {4}},
    {"purge", "purge --now 2100-01-01", "stratalux-db deletions | grep -c yes"},
    {"transcode", "transcode $A --codec raw12", "stratalux-db verify $A --deep > /dev/null"},
    {"reindex", "reindex", "stratalux-db verify --deep > /dev/null"},
    {"backup", "backup --to $D/backup",
     "stratalux-db restore --from $D/backup --store $D/again-$RANDOM$RANDOM 2>&1 | tail -1"},
    {"restore",
     "restore --from $D/backup --store $D/other",
     "stratalux-db ls --store $D/other --json",
     {2},
     "stratalux-db backup --to $D/backup"},
    {"merging restore",
     "restore --from $D/backup --merge --store $D/other",
     "stratalux-db verify --deep --store $D/other > /dev/null",
     {},
     "stratalux-db backup --to $D/backup && stratalux-db init --store $D/other"},
    {"pull",
     "pull --from $STRATALUX_STORE --store $D/other",
     "stratalux-db verify --deep --store $D/other > /dev/null",
     {},
     "stratalux-db init --store $D/other"},
    {"key export", "key export $B --out $D/b.key", "test -s $D/b.key", {2}},
};

int64_t KillsInAll() {
  const char* text = std::getenv("STRATALUX_KILLS");
  return text == nullptr ? 42 : std::atoll(text);
}

class KilledVerbs : public StoreTest, public ::testing::WithParamInterface<Verb> {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    a_ = Visit("v-1a1a1a1a", 5, Encryption::kNone);
    b_ = Visit("v-2b2b2b2b", 3, Encryption::kPerSession);
    c_ = Visit("v-3c3c3c3c", 4, Encryption::kNone);
    box_ = folder_.string() + ".box";
    fs::create_directories(box_);
    fs::rename(folder_, box_ / "original");
  }
  void TearDown() override {
    fs::remove_all(box_);
    StoreTest::TearDown();
  }

  std::string Visit(const std::string& visitor, int frames, Encryption encryption) {
    auto store = OpenStore();
    EXPECT_TRUE(GiveConsent(folder_, visitor, {"1", "de", true, false, false, {}}).ok());
    SessionInfo info;
    info.rig = "bench";
    info.simulated = true;
    info.visitor = visitor;
    auto writer = store.BeginSession(info, {.group_frames = 2, .encryption = encryption});
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < frames; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return writer->info().id;
  }

  // A copy of the store, and what the verb needs.
  void Fresh(const Verb& verb) {
    for (const char* part : {"store", "beside"}) fs::remove_all(box_ / part);
    fs::copy(box_ / "original", box_ / "store", fs::copy_options::recursive);
    fs::permissions(box_ / "store" / "keys.sqlite", fs::perms::owner_read | fs::perms::owner_write);
    fs::create_directories(box_ / "beside");
    ASSERT_EQ(Do(verb.before).code, 0) << verb.before;
  }
  // A shell command with the verb's words; `arm`: variables in front.
  [[nodiscard]] Outcome Do(const std::string& command, const std::string& arm = "") const {
    const fs::path err = box_ / "stderr";
    const std::string set = "PATH=" STRATALUX_BIN_DIR ":$PATH; export STRATALUX_STORE=" + (box_ / "store").string() +
                            " A=" + a_ + " B=" + b_ + " C=" + c_ + " D=" + (box_ / "beside").string() + "; ";
    Outcome outcome = Shell("bash -c '" + set + arm + command + "' 2>" + err.string());
    outcome.err = ReadText(err);
    return outcome;
  }
  [[nodiscard]] Outcome DoArmed(const Verb& verb, int64_t at) const {
    return Do(std::string("exec stratalux-db ") + verb.arguments,
              std::string("export LD_PRELOAD=" STRATALUX_FAULT_LAYER " STORE_FAULT=\"death ") + std::to_string(at) +
                  " once " + box_.string() + "\" STORE_FAULT_COUNT=" + (box_ / "count").string() + "; ");
  }
  // Who lies in the store with how many frames, in what state.
  [[nodiscard]] std::string Listing() const {
    std::string text;
    const Outcome list = Do("stratalux-db ls --json");
    EXPECT_EQ(list.code, 0) << list.err;
    for (const Json& session : Json::parse(list.out, nullptr, false))
      text += session.value("session", "?") + " " + session.value("status", "?") + " " +
              std::to_string(session.value("frames", -1)) + "\n";
    return text;
  }

  std::string a_, b_, c_;
  fs::path box_;
};

TEST_P(KilledVerbs, EndWhereTheUndisturbedOnesDo) {
  const Verb& verb = GetParam();
  Fresh(verb);
  const Outcome undisturbed = DoArmed(verb, int64_t{1} << 40);
  ASSERT_EQ(undisturbed.code, 0) << undisturbed.err;
  int64_t calls = 0;
  std::ifstream counts(box_ / "count");
  for (int64_t n = 0; counts >> n;) calls = std::max(calls, n);
  ASSERT_GT(calls, 3);
  const std::string listing = Listing();
  const Outcome witness = Do(verb.witness);
  ASSERT_EQ(witness.code, 0) << verb.witness << witness.err;

  const char* text = std::getenv("STRATALUX_SEED");
  std::mt19937_64 random(text == nullptr ? 7 : std::strtoull(text, nullptr, 10));
  const int64_t kills = std::max<int64_t>(1, KillsInAll() / static_cast<int64_t>(std::size(kVerbs)));
  int64_t struck = 0;
  for (int64_t k = 0; k < kills && !HasFailure(); ++k) {
    Fresh(verb);
    const auto at = static_cast<int64_t>(random() % static_cast<uint64_t>(calls));
    SCOPED_TRACE("killed before call " + std::to_string(at) + " of " + std::to_string(calls));
    struck += DoArmed(verb, at).code == 0 ? 0 : 1;
    // Whoever comes next finds a store, and what nobody touched is whole.
    if (Listing().find(c_) != std::string::npos) {
      const Outcome verify = Do("stratalux-db verify --deep $C");
      EXPECT_EQ(verify.code, 0) << verify.out << verify.err;
    } else {
      EXPECT_EQ(listing.find(c_), std::string::npos) << "gone before it was to go";
    }
    const Outcome again = Do(std::string("stratalux-db ") + verb.arguments);
    const bool already = std::ranges::find(verb.already, again.code) != verb.already.end();
    EXPECT_TRUE(again.code == 0 || already) << again.code << ": " << again.err;
    if (already) {
      EXPECT_EQ(Do("stratalux-db forget --resume").code, 0) << "where a forgetting began, it ends";
    }
    EXPECT_EQ(Listing(), listing);
    EXPECT_EQ(Do(verb.witness).code, 0) << verb.witness;
    const Outcome verify = Do("stratalux-db verify --deep");
    EXPECT_EQ(verify.code, 0) << verify.out << verify.err;
  }
  std::printf("%s: killed %lld times within %lld calls\n", verb.name, static_cast<long long>(struck),
              static_cast<long long>(calls));
  EXPECT_GT(struck, 0);
}

INSTANTIATE_TEST_SUITE_P(Each, KilledVerbs, ::testing::ValuesIn(kVerbs), [](const auto& info) {
  std::string name = info.param.name;
  for (char& c : name) c = c == ' ' ? '_' : c;
  return name;
});

}  // namespace
}  // namespace stratalux::db
