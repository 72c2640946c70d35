// SPDX-License-Identifier: Apache-2.0
// No session of a visitor without a consent that holds.
#include "db/catalogue/consent.h"

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "db/catalogue/manifest.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

Consent ConsentTo(const std::string& scope) {
  Consent consent;
  consent.text_version = "2026-03";
  consent.language = "de";
  EXPECT_TRUE(SetScope(scope, consent).ok());
  return consent;
}

SessionInfo VisitOf(const std::string& visitor) {
  SessionInfo info;
  info.visitor = visitor;
  return info;
}

using ConsentTest = StoreTest;

TEST_F(ConsentTest, IsAskedOfEveryVisitorAndNamesTheRemedy) {
  SessionStore store = OpenStore();
  const Status status = store.BeginSession(VisitOf("it's me")).status();
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_THAT(status.message(), HasSubstr("stratalux-db consent give --store '" + folder_.string() +
                                          "' --visitor 'it'\\''s me' --text-version"));
  EXPECT_EQ(store.BeginSession(VisitOf("")).status().code(), StatusCode::kUsage) << "nobody cannot have consented";
  EXPECT_TRUE(store.ListSessions()->empty()) << "a refused session leaves no trace";
}

TEST_F(ConsentTest, GoesIntoTheSessionAndItsManifest) {
  ASSERT_TRUE(GiveConsent(folder_, "v-1", ConsentTo("fit,publication")).ok());
  SessionStore store = OpenStore();
  SessionInfo lying = VisitOf("v-1");
  lying.consent = ConsentTo("research");
  auto writer = store.BeginSession(lying);
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  const Consent given = ListConsents(folder_, "v-1")->front().consent;
  EXPECT_GT(given.given_wall.ns, 0);
  EXPECT_EQ(ScopeText(given), "fit,publication");
  EXPECT_EQ(store.FindSession(writer->info().id)->info.consent, given);
  EXPECT_EQ(ReadManifest(store.SessionFolder(writer->info().id))->consent, given);
}

TEST_F(ConsentTest, TheNewestCountsAndMustCoverFit) {
  SessionStore store = OpenStore();
  ASSERT_TRUE(GiveConsent(folder_, "v-1", ConsentTo("research")).ok());
  EXPECT_THAT(store.BeginSession(VisitOf("v-1")).status().message(), HasSubstr("research only, not to fit"));
  ASSERT_TRUE(GiveConsent(folder_, "v-1", ConsentTo("fit")).ok());
  EXPECT_TRUE(store.BeginSession(VisitOf("v-1")).ok());
  EXPECT_FALSE(store.BeginSession(VisitOf("v-2")).ok()) << "one visitor cannot consent for another";
}

TEST_F(ConsentTest, AWithdrawalHoldsUntilANewConsent) {
  SessionStore store = OpenStore();
  EXPECT_EQ(WithdrawConsent(folder_, "v-1").code(), StatusCode::kNotFound);
  ASSERT_TRUE(GiveConsent(folder_, "v-1", ConsentTo("fit")).ok());
  ASSERT_TRUE(WithdrawConsent(folder_, "v-1").ok());
  EXPECT_EQ(WithdrawConsent(folder_, "v-1").code(), StatusCode::kNotFound);
  const Status refused = store.BeginSession(VisitOf("v-1")).status();
  EXPECT_EQ(refused.code(), StatusCode::kUsage);
  EXPECT_THAT(refused.message(), HasSubstr("withdrawn"));
  ASSERT_TRUE(GiveConsent(folder_, "v-1", ConsentTo("fit")).ok());
  EXPECT_TRUE(store.BeginSession(VisitOf("v-1")).ok());
  const auto rows = ListConsents(folder_, "v-1");
  ASSERT_EQ(rows->size(), 2U);
  EXPECT_TRUE((*rows)[0].withdrawn.has_value()) << "what was withdrawn stays so";
  EXPECT_FALSE((*rows)[1].withdrawn.has_value());
}

TEST_F(ConsentTest, OfASimulatedVisitorRecordsItselfAndIsMarked) {
  SessionStore store = OpenStore();
  for (int i = 0; i < 2; ++i) {
    const auto writer = store.BeginSession(SimulatedVisit());
    ASSERT_TRUE(writer.ok()) << writer.status().message();
    EXPECT_EQ(writer->info().visitor, kSimulatedVisitor);
    EXPECT_EQ(writer->info().consent.text_version, kSimulatedConsentText);
  }
  EXPECT_EQ(ListConsents(folder_, "")->size(), 1U) << "once is enough";
  SessionInfo named = SimulatedVisit();
  named.visitor = "v-1";
  EXPECT_FALSE(store.BeginSession(named).ok()) << "a pseudonym that may be a person's needs its consent";
  SessionInfo real = VisitOf(kSimulatedVisitor);
  ASSERT_TRUE(WithdrawConsent(folder_, kSimulatedVisitor).ok());
  EXPECT_FALSE(store.BeginSession(real).ok()) << "a real capture must not hide behind the simulation's consent";
}

TEST_F(ConsentTest, SessionsThatShowNobodyNeedNone) {
  SessionStore store = OpenStore();
  for (const SessionKind kind : {SessionKind::kCalibration, SessionKind::kDark, SessionKind::kFlat}) {
    SessionInfo info;
    info.kind = kind;
    EXPECT_TRUE(store.BeginSession(info).ok()) << ToString(kind);
  }
}

TEST_F(ConsentTest, RefusesPseudonymsThatTellWhoItIs) {
  const std::pair<const char*, const char*> telling[] = {{"Anna", "a name"},
                                                         {"anna", "a name"},
                                                         {"anna.schmidt", "a name"},
                                                         {"Anna Schmidt", "a name"},
                                                         {"Müller", "a name"},
                                                         {"O'Neill-Schmidt", "a name"},
                                                         {"Anna 2", "a name"},
                                                         {"anna@example.org", "an e-mail address"},
                                                         {"v-7@x", "an e-mail address"},
                                                         {"+49 30 1234567", "a telephone number"},
                                                         {"0301234567", "a telephone number"},
                                                         {"1987-05-12", "a date"},
                                                         {"12.5.1987", "a date"},
                                                         {"12/05/87", "a date"}};
  for (const auto& [name, like] : telling) {
    const Status refused = GiveConsent(folder_, name, ConsentTo("fit"));
    EXPECT_EQ(refused.code(), StatusCode::kUsage) << name;
    EXPECT_THAT(refused.message(), AllOf(HasSubstr(like), ::testing::ContainsRegex("such as v-[0-9a-f]{8}"))) << name;
  }
  for (const char* good : {"v-5f3a91c2", "v-1", "p-0417", "loop-1", "visitor 17", "simulated", "2026-11-kiosk-3"})
    EXPECT_TRUE(GiveConsent(folder_, good, ConsentTo("fit")).ok()) << good;
}

TEST_F(ConsentTest, AStoreThatHasSuchANameAlreadyStillOpens) {
  ASSERT_TRUE(GiveConsent(folder_, "v-1", ConsentTo("fit")).ok());
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("INSERT INTO visitors VALUES ('Anna', 1); UPDATE consents SET visitor = 'Anna'")
                  .ok());
  EXPECT_TRUE(OpenStore().BeginSession(VisitOf("Anna")).ok());
  EXPECT_TRUE(WithdrawConsent(folder_, "Anna").ok());
}

TEST_F(ConsentTest, RefusesWhatIsNoConsent) {
  EXPECT_EQ(GiveConsent(folder_, "", ConsentTo("fit")).code(), StatusCode::kUsage);
  EXPECT_EQ(GiveConsent(folder_, "\xff", ConsentTo("fit")).code(), StatusCode::kUsage);
  EXPECT_EQ(GiveConsent(folder_, "two\nlines", ConsentTo("fit")).code(), StatusCode::kUsage);
  Consent consent = ConsentTo("fit");
  consent.language = "";
  EXPECT_EQ(GiveConsent(folder_, "v-1", consent).code(), StatusCode::kUsage);
  EXPECT_EQ(SetScope("", consent).code(), StatusCode::kUsage);
  EXPECT_EQ(SetScope("fit,everything", consent).code(), StatusCode::kUsage);
  EXPECT_TRUE(ListConsents(folder_, "")->empty());
}

}  // namespace
}  // namespace stratalux::db
