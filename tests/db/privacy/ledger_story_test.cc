// SPDX-License-Identifier: Apache-2.0
// A withdrawal and a forgetting hold whatever happens to the index, and wherever the power fails.
#include <csignal>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "db/base/sqlite.h"
#include "db/care/reindex.h"
#include "db/care/verify.h"
#include "db/catalogue/consent.h"
#include "db/keys/key_store.h"
#include "db/ledger/ledger.h"
#include "db/ledger/ledger_line.h"
#include "db/privacy/forget.h"
#include "db/privacy/retention.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr const char* kVisitor = "v-5f3a91c2";

class LedgerStoryTest : public StoreTest {
 protected:
  void Consent() const { ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"2026-03", "de", true, true, false, {}}).ok()); }
  Result<SessionWriter> Begin(const SessionInfo& info) const { return OpenStore().BeginSession(info, Groups(4)); }
  static SessionInfo Visitor() {
    SessionInfo info;
    info.visitor = kVisitor;
    return info;
  }
  std::string Visit() const {
    auto writer = Begin(Visitor());
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    EXPECT_TRUE(AppendTo(*writer, 1).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return writer->info().id;
  }
  void LoseIndex() const {
    for (const char* name : {"index.sqlite", "index.sqlite-wal", "index.sqlite-shm"}) fs::remove(folder_ / name);
  }
  void Rebuild() const {
    Logger quiet(LogLevel::kError);
    const auto report = Reindex(folder_, quiet);
    ASSERT_TRUE(report.ok()) << report.status().message();
    EXPECT_THAT(report->problems, IsEmpty());
  }
  [[nodiscard]] Ledger ReadLedger() const { return *Ledger::Read(folder_); }
  [[nodiscard]] bool IsDue(const std::string& id) const {
    const auto all_due = DueSessions(folder_, {}, WallNow());
    for (const DueSession& due : *all_due)
      if (due.id == id) return true;
    return false;
  }
  void ForgetNow(const std::string& id) const {
    Logger quiet(LogLevel::kError);
    ForgetRequest request;
    request.sessions = {id};
    ASSERT_TRUE(Forget(folder_, request, quiet).ok());
  }
};

TEST_F(LedgerStoryTest, AStoreHasItsIdFromTheBeginning) { EXPECT_EQ(StoreId(folder_)->size(), 32U); }

TEST_F(LedgerStoryTest, OfADamagedCertificateTheForgettingBindsAndTheIndexKeepsTheWords) {
  Consent();
  const std::string id = Visit();
  ForgetNow(id);
  const std::string certificate = ReadLedger().forgotten().at(id);
  const auto in_index = [&] {
    auto db = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadOnly);
    auto select = db->Prepare("SELECT certificate_json FROM deletions");
    return select->Step().ok() ? select->Text(0) : std::string();
  };
  ASSERT_EQ(in_index(), certificate);
  const fs::path chain = folder_ / "ledger" / (*StoreId(folder_) + ".jsonl");
  const std::string key = "\"frames\":";
  FlipBits(chain, ReadText(chain).rfind(key) + key.size(), 4);
  EXPECT_TRUE(ReadLedger().IsForgotten(id));
  EXPECT_EQ(ReadLedger().forgotten().at(id), "") << "a certificate that nobody made";
  const auto said = [&] { return VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems; };
  EXPECT_THAT(said(), ElementsAre(HasSubstr("damaged, it does not match its hash")));
  Logger quiet(LogLevel::kError);
  ASSERT_TRUE(Reindex(folder_, quiet).ok());
  EXPECT_EQ(in_index(), certificate);
  EXPECT_THAT(said(), ElementsAre(HasSubstr("damaged, it does not match its hash")));
}

TEST_F(LedgerStoryTest, TheConsentIsInTheLedgerBeforeTheFirstFrameCounts) {
  Consent();
  auto writer = Begin(Visitor());
  ASSERT_TRUE(writer.ok());
  EXPECT_THAT(ReadLedger().entries(), IsEmpty()) << "a session without a frame shows nobody";
  ASSERT_TRUE(AppendTo(*writer, 1).ok());
  ASSERT_EQ(writer->acknowledged_frames(), 0);
  ASSERT_TRUE(writer->Flush().ok());
  const auto entries = ReadLedger().entries();
  ASSERT_THAT(entries, SizeIs(1));
  EXPECT_EQ(entries[0].kind, LedgerKind::kConsent);
  EXPECT_THAT(entries[0].sessions, ElementsAre(writer->info().id));
  EXPECT_EQ(entries[0].visitor_hmac, *FindVisitorName(folder_, kVisitor));
  const auto detail = nlohmann::json::parse(entries[0].detail_json);
  EXPECT_EQ(detail["text_version"], "2026-03");
  EXPECT_THAT(entries[0].detail_json, Not(HasSubstr(kVisitor)));
  ASSERT_TRUE(AppendTo(*writer, 2).ok());
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  EXPECT_THAT(ReadLedger().entries(), SizeIs(1)) << "once a session";
}

TEST_F(LedgerStoryTest, AFrameDoesNotCountWithoutItsConsentOnTheDisk) {
  Consent();
  auto writer = Begin(Visitor());
  ASSERT_TRUE(AppendTo(*writer, 1).ok());
  const fs::path chain = folder_ / "ledger" / (*StoreId(folder_) + ".jsonl");
  fs::create_directory(chain);  // stands for a disk that refuses it
  EXPECT_FALSE(writer->Flush().ok());
  EXPECT_EQ(writer->acknowledged_frames(), 0);
  fs::remove(chain);
  EXPECT_THAT(*OpenStore(AccessMode::kReadOnly).ListFrames(writer->info().id), IsEmpty());
}

TEST_F(LedgerStoryTest, SimulatedVisitorsStandInItTooOthersDoNot) {
  StoreSession(1);  // shows nobody, or a simulated visitor
  const size_t before = ReadLedger().entries().size();
  {  // a writer holds the store's lock as long as it lives
    auto simulated = Begin(SimulatedVisit());
    ASSERT_TRUE(simulated.ok()) << simulated.status().message();
    ASSERT_TRUE(AppendTo(*simulated, 1).ok());
    ASSERT_TRUE(simulated->Finish(SessionStatus::kComplete).ok());
  }
  EXPECT_THAT(ReadLedger().entries(), SizeIs(before + 1));
  SessionInfo dark;
  dark.kind = SessionKind::kDark;
  auto writer = Begin(dark);
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  ASSERT_TRUE(AppendTo(*writer, 1).ok());
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  EXPECT_THAT(ReadLedger().entries(), SizeIs(before + 1));
}

TEST_F(LedgerStoryTest, WithdrawnStaysWithdrawnWithoutItsIndex) {
  Consent();
  const std::string id = Visit();
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  const WallNs at = *ListConsents(folder_, kVisitor)->front().withdrawn;
  EXPECT_EQ(ReadLedger().WithdrawnAt(id), at);
  LoseIndex();
  Rebuild();
  EXPECT_EQ(ListConsents(folder_, kVisitor)->front().withdrawn, at);
  EXPECT_THAT(Begin(Visitor()).status().message(), HasSubstr("withdrawn"));
  EXPECT_TRUE(IsDue(id));
  Consent();  // given anew it holds, for what comes
  const std::string next = Visit();
  LoseIndex();
  Rebuild();
  EXPECT_FALSE(ListConsents(folder_, kVisitor)->back().withdrawn);
  EXPECT_TRUE(Begin(Visitor()).ok());
  EXPECT_FALSE(ReadLedger().WithdrawnAt(next));
}

TEST_F(LedgerStoryTest, AWithdrawalThatSomebodyTookOutOfTheIndexIsFoundAndComesBack) {
  Consent();
  const std::string id = Visit();
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  { const SessionStore followed = OpenStore(); }
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("UPDATE consents SET withdrawn_wall_ns = NULL")
                  .ok());
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems,
              Contains(HasSubstr(id + ": its visitor has withdrawn consent")));
  Rebuild();
  EXPECT_TRUE(ListConsents(folder_, kVisitor)->front().withdrawn);
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems, IsEmpty());
}

// Before the first session nothing leads from a withdrawal to its visitor but the moment of the consent.
TEST_F(LedgerStoryTest, AWithdrawalOfWhoWasNeverCapturedHoldsInAnOlderIndexToo) {
  constexpr const char* kOther = "v-00000002";
  Consent();
  ASSERT_TRUE(GiveConsent(folder_, kOther, {"2026-03", "de", true, false, false, {}}).ok());
  { const SessionStore followed = OpenStore(); }
  const fs::path older = folder_.string() + ".older";
  fs::copy(folder_ / "index.sqlite", older);
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  const WallNs at = *ListConsents(folder_, kVisitor)->front().withdrawn;
  ASSERT_THAT(ReadLedger().entries(), SizeIs(1));
  EXPECT_THAT(ReadLedger().entries()[0].sessions, IsEmpty());
  EXPECT_THAT(ReadLedger().entries()[0].detail_json, Not(HasSubstr(kVisitor)));
  LoseIndex();
  fs::rename(older, folder_ / "index.sqlite");
  EXPECT_THAT(Begin(Visitor()).status().message(), HasSubstr("withdrawn")) << "the opening follows the ledger";
  EXPECT_EQ(ListConsents(folder_, kVisitor)->front().withdrawn, at);
  EXPECT_FALSE(ListConsents(folder_, kOther)->front().withdrawn);
  Consent();  // given anew it holds
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("DELETE FROM ledger_heads WHERE chain <> ''")
                  .ok());
  EXPECT_TRUE(Begin(Visitor()).ok());
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("UPDATE consents SET withdrawn_wall_ns = NULL")
                  .ok());
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems,
              Contains(HasSubstr("is withdrawn, which the index does not know")));
}

// The index of a backup is older than the visit: the session that the withdrawal names is not in it.
TEST_F(LedgerStoryTest, AWithdrawalAfterAVisitHoldsInAnIndexOfBeforeIt) {
  Consent();
  { const SessionStore followed = OpenStore(); }
  const fs::path older = folder_.string() + ".older";
  fs::copy(folder_ / "index.sqlite", older);
  Visit();
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  LoseIndex();
  fs::rename(older, folder_ / "index.sqlite");
  { const SessionStore followed = OpenStore(); }
  EXPECT_TRUE(ListConsents(folder_, kVisitor)->front().withdrawn);
}

// An index of before the first session, of a backup: without the ledger's word the pseudonym would come back with it.
TEST_F(LedgerStoryTest, AForgottenVisitorDoesNotComeBackWithAnIndexOfBeforeTheFirstVisit) {
  constexpr const char* kOther = "v-00000002";
  for (const bool captured : {false, true}) {
    SCOPED_TRACE(captured ? "captured since" : "never captured");
    Consent();
    Consent();
    ASSERT_TRUE(GiveConsent(folder_, kOther, {"2026-03", "de", true, false, false, {}}).ok());
    { const SessionStore followed = OpenStore(); }
    const fs::path older = folder_.string() + ".older";
    fs::copy(folder_ / "index.sqlite", older);
    ForgetRequest request;
    request.visitors = {kVisitor};
    if (captured) request.sessions = {Visit()};
    Logger quiet(LogLevel::kError);
    ASSERT_TRUE(Forget(folder_, request, quiet).ok());
    const auto entries = ReadLedger().entries();
    EXPECT_EQ(std::ranges::count_if(entries, [](const auto& e) { return ConsentsForgottenBy(e).size() == 2; }),
              captured ? 2 : 1);
    for (const LedgerEntry& entry : entries) EXPECT_THAT(entry.detail_json, Not(HasSubstr(kVisitor)));
    LoseIndex();
    fs::rename(older, folder_ / "index.sqlite");
    ASSERT_THAT(*ListConsents(folder_, kVisitor), SizeIs(2)) << "the copy is one that tells";
    { const SessionStore followed = OpenStore(); }
    EXPECT_THAT(*ListConsents(folder_, kVisitor), IsEmpty());
    EXPECT_EQ(ReadText(folder_ / "index.sqlite").find(kVisitor), std::string::npos) << "nor in a freed page";
    EXPECT_FALSE(ListConsents(folder_, kOther)->front().withdrawn);
  }
}

// Nobody else's rows go for it: not who gave theirs at the same moment, not who has consented anew or has a session.
TEST_F(LedgerStoryTest, OnlyWhoIsNamedInAllConsentsAndHasNoSessionIsForgottenByTheLedger) {
  constexpr const char *kTwin = "v-00000002", *kAnew = "v-00000003", *kAlone = "v-00000004";
  const auto give = [this](const char* visitor, int64_t at) {
    ASSERT_TRUE(GiveConsent(folder_, visitor, {"2026-03", "de", true, false, false, {at}}).ok());
  };
  give(kTwin, 1'000);
  give("v-00000005", 1'000);
  give(kAnew, 2'000);
  give(kAnew, 2'001);
  give(kAlone, 3'000);
  give(kVisitor, 4'000);
  const std::string id = Visit();
  ASSERT_TRUE(
      AppendToLedger(
          folder_, {LedgerKind::kNote, WallNow(), {}, "", VisitorForgottenDetail({{1'000}, {2'000}, {3'000}, {4'000}})})
          .ok());
  { const SessionStore followed = OpenStore(); }
  EXPECT_THAT(*ListConsents(folder_, kTwin), SizeIs(1));
  EXPECT_THAT(*ListConsents(folder_, kAnew), SizeIs(2));
  EXPECT_THAT(*ListConsents(folder_, kAlone), IsEmpty());
  EXPECT_FALSE(ListConsents(folder_, kVisitor)->at(0).withdrawn) << "another store's forgetting withdraws nothing here";
  EXPECT_THAT(*OpenStore(AccessMode::kReadOnly).ListSessions(), SizeIs(1));
  EXPECT_FALSE(IsDue(id));
  ForgetNow(id);
  EXPECT_THAT(*ListConsents(folder_, kVisitor), IsEmpty()) << "with the last session";
}

// Killed behind the ledger and before the index, behind both, and before either.
TEST_F(LedgerStoryTest, AWithdrawalHoldsWhereverItStops) {
  for (const WithdrawStep stop : {WithdrawStep::kLedger, WithdrawStep::kIndex}) {
    Consent();
    const std::string id = Visit();
    const pid_t child = fork();
    if (child == 0) {
      const Status done = WithdrawConsent(folder_, kVisitor, [stop](WithdrawStep step) {
        if (step == stop) kill(getpid(), SIGKILL);
      });
      _exit(done.ok() ? 1 : 2);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status));
    EXPECT_TRUE(ReadLedger().WithdrawnAt(id));
    EXPECT_THAT(Begin(Visitor()).status().message(), HasSubstr("withdrawn")) << "the opening follows the ledger";
    EXPECT_TRUE(IsDue(id));
  }
}

TEST_F(LedgerStoryTest, ForgottenStaysForgottenWithoutItsIndex) {
  Consent();
  const std::string gone = Visit(), kept = Visit();
  fs::copy(folder_ / "sessions" / gone, folder_ / "by-hand", fs::copy_options::recursive);
  ForgetNow(gone);
  LoseIndex();
  fs::rename(folder_ / "by-hand", folder_ / "sessions" / gone);
  Rebuild();
  const auto sessions = *OpenStore(AccessMode::kReadOnly).ListSessions();
  ASSERT_THAT(sessions, SizeIs(1));
  EXPECT_EQ(sessions[0].info.id, kept);
  EXPECT_TRUE(ReadLedger().IsForgotten(gone));
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  EXPECT_THAT(VerifyStore(store, {})->problems, ElementsAre(HasSubstr("to a session that was forgotten")));
}

TEST_F(LedgerStoryTest, VerifyFindsAChainThatWasCutOrTakenAway) {
  Consent();
  const std::string id = Visit();
  ForgetNow(id);
  { const SessionStore followed = OpenStore(); }
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems, IsEmpty());
  const fs::path chain = folder_ / "ledger" / (*StoreId(folder_) + ".jsonl");
  const auto bytes = ReadBytes(chain);
  const auto first = std::find(bytes.begin(), bytes.end(), '\n') + 1;  // a whole chain, and a shorter one
  WriteBytes(chain, {bytes.begin(), first});
  const auto problems = VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems;
  EXPECT_THAT(problems, Contains(HasSubstr("bytes long")));
  EXPECT_THAT(problems, Contains(HasSubstr("deletions has the row session_id '" + id)));
  fs::remove(chain);
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems, Contains(HasSubstr("is gone")));
}

// A store of schema 4: tombstones in files, withdrawals in the index alone.
TEST_F(LedgerStoryTest, TheFirstOpeningTakesOverWhatAnOlderStoreKnew) {
  Consent();
  const std::string id = Visit();
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  const WallNs at = *ListConsents(folder_, kVisitor)->front().withdrawn;
  fs::remove_all(folder_ / "ledger");
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("DELETE FROM ledger_heads")
                  .ok());
  fs::create_directory(folder_ / "deletions");
  WriteText(folder_ / "deletions" / "s000009-0badcafe.json", R"({"session": "s000009-0badcafe", "reason": "purge"})");
  for (int opening = 0; opening < 2; ++opening) {
    { const SessionStore store = OpenStore(); }
    EXPECT_THAT(ReadLedger().entries(), SizeIs(2)) << "opening " << opening;
    EXPECT_EQ(ReadLedger().WithdrawnAt(id), at);
    EXPECT_TRUE(ReadLedger().IsForgotten("s000009-0badcafe"));
    EXPECT_FALSE(fs::exists(folder_ / "deletions"));
  }
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems, IsEmpty());
}

TEST_F(LedgerStoryTest, ALedgerOfALaterVersionIsNotWrittenTo) {
  StoreSession(1);
  const std::string other(32, 'a');
  std::string body = R"({"schema":2,"n":1,"prev":")" + ChainStart(other) + R"(","what":"unknown"})";
  const std::string hash = LedgerHash(body);
  body.pop_back();
  const std::string line = body + R"(,"hash":")" + hash + "\"}\n";
  WriteText(folder_ / "ledger" / (other + ".jsonl"), line);
  EXPECT_EQ(SessionStore::Open(folder_, AccessMode::kReadWrite).status().code(), StatusCode::kNewerSchema);
  Logger quiet(LogLevel::kError);
  EXPECT_EQ(Reindex(folder_, quiet).status().code(), StatusCode::kNewerSchema);
  EXPECT_EQ(OpenStore(AccessMode::kReadOnly).ListSessions()->size(), 1U) << "reading goes on";
  FlipBits(folder_ / "ledger" / (other + ".jsonl"), 20, 1);
  EXPECT_TRUE(SessionStore::Open(folder_, AccessMode::kReadWrite).ok()) << "damage is no later version";
}

TEST_F(LedgerStoryTest, KeysOfSchema1GetTheTableOfVisitors) {
  const auto key = CreateKey(folder_);
  ASSERT_TRUE(key.ok());
  ASSERT_TRUE(Connection::Open(KeyFile(folder_), Connection::Mode::kReadWrite)
                  ->Execute("DROP TABLE visitor_keys; PRAGMA user_version = 1")
                  .ok());
  EXPECT_EQ(FindVisitorName(folder_, kVisitor).status().code(), StatusCode::kNotFound);
  const auto name = NameVisitor(folder_, kVisitor);
  ASSERT_TRUE(name.ok()) << name.status().message();
  EXPECT_EQ(name->size(), 64U);
  EXPECT_EQ(*NameVisitor(folder_, kVisitor), *name) << "the same for ever";
  EXPECT_NE(*NameVisitor(folder_, "v-other-1"), *name);
  EXPECT_EQ(FindKey(folder_, key->id)->key->bytes, key->key->bytes) << "nothing of schema 1 is lost";
  ASSERT_TRUE(DestroyVisitorKey(folder_, kVisitor).ok());
  EXPECT_EQ(FindVisitorName(folder_, kVisitor).status().code(), StatusCode::kNotFound);
  ASSERT_TRUE(
      Connection::Open(KeyFile(folder_), Connection::Mode::kReadWrite)->Execute("PRAGMA user_version = 3").ok());
  EXPECT_EQ(NameVisitor(folder_, kVisitor).status().code(), StatusCode::kNewerSchema);
}

}  // namespace
}  // namespace stratalux::db
