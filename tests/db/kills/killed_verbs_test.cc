// SPDX-License-Identifier: Apache-2.0
// Each verb of stratalux-db that writes is killed (SIGKILL) before one of its file calls, as drawn by a seed. What it
// was to leave alone is then whole, and the same command, given again, ends where the undisturbed one does.
#include <cstdlib>
#include <fstream>
#include <random>
#include <set>
#include <sstream>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/catalogue/consent.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"
#include "tests/support/sanitized.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

// What a second run leaves: the listing of the undisturbed one; or that and what else the killed run had got to, for a
// verb whose every run adds a session.
enum class Ends { kAlike, kWithMore };

struct Verb {
  const char* name;
  // Shell words behind `stratalux-db`; $A $B $C: session ids; $D: a folder beside the store that each run has afresh.
  const char* arguments;
  // A command that tells that the verb is done: it succeeds and prints what it prints after the undisturbed run.
  const char* witness;
  // Exit codes of a second run that say: done already.
  std::vector<int> already = {};
  const char* before = "true";  // a command that makes what the verb needs
  Ends ends = Ends::kAlike;
};

// `proven ID`: a forgetting with its proof. `whole STORE`: who lies there, all of it verified.
constexpr const char* kWords = R"(
proven() { stratalux-db deletions | grep -cE "^$1 .* yes "; }
whole() { stratalux-db verify --deep --store $1 >&2 && stratalux-db ls --store $1 --json; }
)";

const Verb kVerbs[] = {
    {"init", "init --store $D/new", "whole $D/new"},
    {"consent give", "consent give --visitor v-5f3a91c2 --text-version 2 --language de --scope fit",
     "stratalux-db consent show --visitor v-5f3a91c2 --json | grep -q 'text_version.*2'"},
    {"consent of a second time",
     "consent give --visitor v-1a1a1a1a --text-version 2 --language de --scope fit,research",
     "stratalux-db consent show --visitor v-1a1a1a1a --json | grep -q 'text_version.*2' && "
     "stratalux-db consent show --visitor v-1a1a1a1a --json | grep 'text_version.*1'"},
    {"consent withdraw",
     "consent withdraw --visitor v-1a1a1a1a",
     "stratalux-db query retention-due --json | grep -c 'consent withdrawn'",
     {4}},
    {"forget", "forget $A --yes", "proven $A"},
    {"forget of an encrypted session", "forget $B --yes", "proven $B"},
    {"forget of a visitor", "forget --visitor v-1a1a1a1a --yes", "proven $A", {4}},
    {"purge", "purge --now 2100-01-01", "proven $A && proven $B && proven $C"},
    {"transcode", "transcode $A --codec raw12", "stratalux-db frames $A --json | grep -c raw12"},
    {"reindex", "reindex", "whole $STRATALUX_STORE"},
    {"backup", "backup --to $D/backup",
     "rm -rf $D/again && stratalux-db restore --from $D/backup --ledger none --store $D/again > /dev/null && "
     "whole $D/again"},
    {"restore",
     "restore --from $D/backup --ledger $STRATALUX_STORE --store $D/other",
     "whole $D/other",
     {2},
     "stratalux-db backup --to $D/backup"},
    {"merging restore",
     "restore --from $D/backup --merge --store $D/other",
     "whole $D/other",
     {},
     "stratalux-db backup --to $D/backup && stratalux-db init --store $D/other"},
    {"pull",
     "pull --from $STRATALUX_STORE --store $D/other",
     "whole $D/other",
     {},
     "stratalux-db init --store $D/other"},
    {"obeying pull",
     "pull --from $STRATALUX_STORE --store $D/other --obey",
     "whole $D/other && stratalux-db deletions --store $D/other | grep -cE \"^$A .* yes \"",
     {},
     "stratalux-db init --store $D/other && stratalux-db pull --from $STRATALUX_STORE --store $D/other && "
     "stratalux-db forget $A --yes"},
    {"import of files",
     "import --manifest $D/pictures/import.toml",
     "stratalux-db verify --deep > /dev/null",
     {},
     "stratalux-db export $C --out $D/pictures",
     Ends::kWithMore},
    {"import of a crate",
     "import --crate $D/crate --store $D/other",
     "whole $D/other",
     {},
     "stratalux-db export $A $C --crate $D/crate --scope research --keep-pseudonym && "
     "stratalux-db init --store $D/other"},
    {"export of a crate",
     "export $A $C --crate $D/crate --scope research --keep-pseudonym",
     "rm -rf $D/other && stratalux-db init --store $D/other > /dev/null && "
     "stratalux-db import --crate $D/crate --store $D/other > /dev/null && whole $D/other",
     {2}},
    {"key export", "key export $B --out $D/b.key", "test -s $D/b.key", {2}},
    {"key import",
     "key import $D/b.key --store $D/other",
     "stratalux-db export $B --out $D/pictures --store $D/other > /dev/null && ls $D/pictures | wc -l",
     {},
     "stratalux-db init --store $D/other && stratalux-db pull --from $STRATALUX_STORE --store $D/other && "
     "stratalux-db key export $B --out $D/b.key"},
    {"key sign-init", "key sign-init", "stratalux-db key public | wc -c", {2}},
    {"key reader-init",
     "key reader-init --out $D/reader.key",
     "stratalux-db key reader-public $D/reader.key | wc -c",
     {2}},
    {"key share",
     "key share $D/reader.pub",
     "stratalux-db key readers --json | grep -c 'sealed.*1' && stratalux-db init --store $D/other > /dev/null && "
     "stratalux-db pull --from $STRATALUX_STORE --store $D/other > /dev/null && STRATALUX_READER_KEY=$D/reader.key "
     "stratalux-db export $B --out $D/pictures --store $D/other > /dev/null && ls $D/pictures | wc -l",
     {},
     "stratalux-db key reader-init --out $D/reader.key > $D/reader.pub"},
    {"key unshare",
     "key unshare $D/reader.pub",
     "find $STRATALUX_STORE -name 'key-*' | wc -l",
     {4},
     "stratalux-db key reader-init --out $D/reader.key > $D/reader.pub && stratalux-db key share $D/reader.pub"},
};

int64_t KillsInAll() {
  const char* text = std::getenv("STRATALUX_KILLS");
  return text == nullptr ? 42 : std::atoll(text);
}

// The line at the end of the program.
class Totals : public ::testing::Environment {
 public:
  static Totals& Get() {
    static auto* totals = new Totals;
    return *totals;
  }
  int64_t verbs = 0, kills = 0, struck = 0, violations = 0;

  void TearDown() override {
    std::printf("all kills: %lld of %lld verbs, %lld struck, %lld violations\n", static_cast<long long>(kills),
                static_cast<long long>(verbs), static_cast<long long>(struck), static_cast<long long>(violations));
  }
};

[[maybe_unused]] const auto* const totals_at_the_end = ::testing::AddGlobalTestEnvironment(&Totals::Get());

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
    Totals::Get().violations += HasFailure() ? 1 : 0;
    fs::remove_all(box_);
    StoreTest::TearDown();
  }

  std::string Visit(const std::string& visitor, int frames, Encryption encryption) {
    auto store = OpenStore();
    EXPECT_TRUE(GiveConsent(folder_, visitor, {"1", "de", true, true, false, {}}).ok());
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
  // A shell command with the verb's words; `arm`: a line before it.
  [[nodiscard]] Outcome Do(const std::string& command, const std::string& arm = "") const {
    const fs::path err = box_ / "stderr", script = box_ / "script";
    WriteText(script, "set -o pipefail\nPATH=" STRATALUX_BIN_DIR ":$PATH\nexport STRATALUX_STORE=" +
                          (box_ / "store").string() + " A=" + a_ + " B=" + b_ + " C=" + c_ +
                          " D=" + (box_ / "beside").string() + "\n" + kWords + arm + "\n" + command + "\n");
    Outcome outcome = Shell("bash " + script.string() + " 2>" + err.string());
    outcome.err = ReadText(err);
    return outcome;
  }
  [[nodiscard]] Outcome DoArmed(const Verb& verb, int64_t at) const {
    return Do(std::string("exec stratalux-db ") + verb.arguments,
              std::string("export LD_PRELOAD=" STRATALUX_FAULT_LAYER " STORE_FAULT=\"death ") + std::to_string(at) +
                  " once " + box_.string() + "\" STORE_FAULT_COUNT=" + (box_ / "count").string());
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

  // Whoever comes next finds a store, and what nobody touched is whole.
  void ExpectUntouched(const std::string& undisturbed) const {
    // Gone, or on its way: a forgetting that has begun cannot be called back.
    if (Listing().find(c_) == std::string::npos || Do("stratalux-db deletions | grep $C").code == 0) {
      EXPECT_EQ(undisturbed.find(c_), std::string::npos) << "gone before it was to go";
      return;
    }
    const Outcome verify = Do("stratalux-db verify --deep $C");
    EXPECT_EQ(verify.code, 0) << verify.out << verify.err;
  }
  void ExpectEnd(const Verb& verb, const std::string& undisturbed) const {
    const std::string now = Listing();
    if (verb.ends == Ends::kAlike) {
      EXPECT_EQ(now, undisturbed);
      return;
    }
    // Of every run a session: those of the store as they were, the new ones whole, or said not to be.
    std::multiset<std::string> states;
    std::istringstream lines(now), wanted(undisturbed);
    for (std::string line; std::getline(lines, line);) {
      states.insert(line.substr(line.find(' ')));
      if (line.find(" complete ") == std::string::npos) continue;
      EXPECT_NE(undisturbed.find(line.substr(line.find(' ')) + "\n"), std::string::npos)
          << "complete, and short: " << line;
    }
    for (std::string line; std::getline(wanted, line);) {
      const auto found = states.find(line.substr(line.find(' ')));
      ASSERT_NE(found, states.end()) << line << "\nnow:\n" << now;
      states.erase(found);
    }
    EXPECT_LE(states.size(), 1U) << now;
  }

  std::string a_, b_, c_;
  fs::path box_;
};

TEST_P(KilledVerbs, EndWhereTheUndisturbedOnesDo) {
  if (kUnderAddressSanitizer) GTEST_SKIP() << "AddressSanitizer wants to be loaded before the fault layer";
  const Verb& verb = GetParam();
  Fresh(verb);
  const Outcome undisturbed = DoArmed(verb, int64_t{1} << 40);
  ASSERT_EQ(undisturbed.code, 0) << undisturbed.out << undisturbed.err;
  int64_t calls = 0;
  std::ifstream counts(box_ / "count");
  for (int64_t n = 0; counts >> n;) calls = std::max(calls, n);
  ASSERT_GT(calls, 3);
  const std::string listing = Listing();
  const Outcome witness = Do(verb.witness);
  ASSERT_EQ(witness.code, 0) << verb.witness << witness.err;

  const char* text = std::getenv("STRATALUX_SEED");
  std::mt19937_64 random(text == nullptr ? 7 : std::strtoull(text, nullptr, 10));
  const auto verbs = static_cast<int64_t>(std::size(kVerbs));
  const int64_t kills = std::max<int64_t>(1, (KillsInAll() + verbs - 1) / verbs);
  int64_t struck = 0, tried = 0;
  for (; tried < kills && !HasFailure(); ++tried) {
    Fresh(verb);
    // Drawn from each of as many stretches of the run as there are kills.
    const int64_t begin = calls * tried / kills, end = std::max(begin + 1, calls * (tried + 1) / kills);
    const int64_t at = begin + static_cast<int64_t>(random() % static_cast<uint64_t>(end - begin));
    SCOPED_TRACE("killed before call " + std::to_string(at) + " of " + std::to_string(calls));
    struck += DoArmed(verb, at).code == 0 ? 0 : 1;
    ExpectUntouched(listing);
    const Outcome again = Do(std::string("stratalux-db ") + verb.arguments);
    const bool already = std::ranges::find(verb.already, again.code) != verb.already.end();
    EXPECT_TRUE(again.code == 0 || already) << again.code << ": " << again.out << again.err;
    if (already) {
      EXPECT_EQ(Do("stratalux-db forget --resume").code, 0) << "where a forgetting began, it ends";
    }
    ExpectEnd(verb, listing);
    const Outcome told = Do(verb.witness);
    EXPECT_EQ(told.code, 0) << verb.witness << "\n" << told.err;
    EXPECT_EQ(told.out, witness.out) << verb.witness;
    const Outcome verify = Do("stratalux-db verify --deep");
    EXPECT_EQ(verify.code, 0) << verify.out << verify.err;
  }
  std::printf("%s: killed %lld times within %lld calls\n", verb.name, static_cast<long long>(struck),
              static_cast<long long>(calls));
  EXPECT_GT(struck, 0);
  Totals& totals = Totals::Get();
  ++totals.verbs;
  totals.kills += tried;
  totals.struck += struck;
}

INSTANTIATE_TEST_SUITE_P(Each, KilledVerbs, ::testing::ValuesIn(kVerbs), [](const auto& verb) {
  std::string name = verb.param.name;
  for (char& c : name) c = c == ' ' || c == '-' ? '_' : c;
  return name;
});

}  // namespace
}  // namespace stratalux::db
