// SPDX-License-Identifier: Apache-2.0
// What may become a fit of the store, and what is left where it may not.
#include "db/catalogue/fit_store.h"

#include <atomic>
#include <csignal>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "db/base/own_hash.h"
#include "db/base/sqlite.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/job_store.h"
#include "db/ledger/ledger.h"
#include "db/privacy/forget.h"
#include "shared/base/read_file.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr const char* kVisitor = "v-5f3a91c2";

class FitStoreTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"2026-03", "de", true, true, false, {}}).ok());
    session_ = Visit();
  }
  std::string Visit() {
    SessionStore store = OpenStore();
    SessionInfo info;
    info.visitor = kVisitor;
    auto writer = store.BeginSession(info, {});
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return writer->info().id;
  }
  static void WriteFiles(const fs::path& folder) {
    fs::create_directories(folder / "report");
    WriteText(folder / "position.exr", std::string(5000, 'p'));
    WriteText(folder / "report" / "index.html", "<h1>fit</h1>");
    WriteText(folder / "metrics.json", "{}");
  }
  [[nodiscard]] fs::path Folder(const std::string& fit) const { return Session() / "fits" / fit; }
  [[nodiscard]] fs::path Session() const { return folder_ / "sessions" / session_; }
  [[nodiscard]] FitRow Row(const std::string& fit) const { return {fit, session_, R"({"eta":1.4})", "{}", {7}}; }
  [[nodiscard]] std::vector<FitRow> Fits() const { return *OpenStore(AccessMode::kReadOnly).ListFits(session_); }
  void Forget() const {
    Logger quiet(LogLevel::kError);
    const auto report = stratalux::db::Forget(folder_, {{session_}, {}, ForgetReason::kForget, {}}, quiet);
    ASSERT_TRUE(report.ok()) << report.status().message();
    ASSERT_THAT(report->leftovers, IsEmpty());
  }
  // A whole fit of elsewhere, beside the sessions.
  [[nodiscard]] fs::path MadeElsewhere(const std::string& fit) {
    WriteFiles(Folder(fit));
    EXPECT_TRUE(RegisterFit(folder_, Row(fit)).ok());
    const fs::path place = folder_ / "incoming" / "fits" / fit;
    fs::create_directories(place.parent_path());
    fs::rename(Folder(fit), place);
    auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
    EXPECT_TRUE(connection->Execute("PRAGMA foreign_keys = ON; DELETE FROM fits").ok());
    return place;
  }

  std::string session_;
};

TEST_F(FitStoreTest, ARegisteredFitNamesItsFilesAndTheirHashes) {
  WriteFiles(Folder("f1"));
  ASSERT_TRUE(RegisterFit(folder_, Row("f1")).ok());
  ASSERT_THAT(Fits(), SizeIs(1));
  const std::string record = *ReadFile(Folder("f1") / "fit.json");
  EXPECT_THAT(record, HasSubstr(R"("name": "report/index.html")"));
  EXPECT_THAT(record, HasSubstr(R"("bytes": 5000)"));
  EXPECT_THAT(record, HasSubstr("xxh3_128"));
}

TEST_F(FitStoreTest, ASessionForgottenWhileItIsFittedIsSaidToBeAndDoesNotComeBack) {
  WriteFiles(Folder("f1.partial"));
  Forget();
  WriteFiles(Folder("f1"));  // a stage that makes its folders anew
  const Status status = RegisterFit(folder_, Row("f1"));
  EXPECT_EQ(status.code(), StatusCode::kNotFound);
  EXPECT_THAT(status.message(), HasSubstr("session " + session_ + " was forgotten while it was being fitted"));
  EXPECT_FALSE(fs::exists(Session()));
}

TEST_F(FitStoreTest, AForgettingThatHasBegunRefusesTheFitThoughTheRowsAreThere) {
  WriteFiles(Folder("f1"));
  WriteFiles(Folder("other"));
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kForgetting, {1}, {session_}, "", ""}).ok());
  EXPECT_THAT(RegisterFit(folder_, Row("f1")).message(), HasSubstr("was forgotten"));
  EXPECT_FALSE(fs::exists(Folder("f1")));
  EXPECT_TRUE(fs::exists(Folder("other"))) << "removes nothing of others";
  EXPECT_TRUE(fs::exists(Segment(session_))) << "that is the forgetting's own work";
}

TEST_F(FitStoreTest, RegistrationsAgainstAForgettingLeaveNothing) {
  // Whenever the forgetting comes, no folder and no row remains of the session.
  for (int round = 0; round < 12; ++round) {
    if (round > 0) {  // the visitor went with the last session
      ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"2026-03", "de", true, true, false, {}}).ok());
      session_ = Visit();
    }
    std::atomic<bool> stop = false;
    std::thread fitter([&] {
      for (int i = 0; !stop; ++i) {
        const std::string fit = "f" + std::to_string(i % 5);
        std::error_code error;
        fs::create_directories(Folder(fit) / "report", error);
        const Status status = RegisterFit(folder_, Row(fit), {.patience = std::chrono::seconds(20)});
        if (status.code() == StatusCode::kNotFound) return;
      }
    });
    std::this_thread::sleep_for(std::chrono::milliseconds(5 * round));
    Logger quiet(LogLevel::kError);
    // A fit's folder may appear while its parent is being removed, or hold the index: then one forgets again.
    for (int attempt = 0; attempt < 100; ++attempt) {
      const auto report = stratalux::db::Forget(folder_, {{session_}, {}, ForgetReason::kForget, {}}, quiet);
      if (report.ok()) break;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    stop = true;
    fitter.join();
    EXPECT_TRUE(*IsForgotten(folder_, session_));
    if (fs::exists(Session())) {  // the fitter's own folder, made after the last look: its registration says so
      EXPECT_EQ(RegisterFit(folder_, Row("f0")).code(), StatusCode::kNotFound);
      for (int i = 0; i < 5; ++i) (void)DiscardFit(folder_, session_, Folder("f" + std::to_string(i))).ok();
    }
    EXPECT_FALSE(fs::exists(Session())) << "round " << round;
    EXPECT_EQ(OpenStore(AccessMode::kReadOnly).FindSession(session_).status().code(), StatusCode::kNotFound);
  }
}

TEST_F(FitStoreTest, AWithdrawnConsentRefusesTheFit) {
  WriteFiles(Folder("f1"));
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  const Status status = RegisterFit(folder_, Row("f1"));
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_THAT(status.message(), HasSubstr("withdrawn"));
  EXPECT_FALSE(fs::exists(Folder("f1"))) << "reindex would list it";
  EXPECT_TRUE(fs::exists(Segment(session_)));
  EXPECT_THAT(Fits(), IsEmpty());
  // A new consent is for new sessions.
  ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"2026-04", "de", true, false, false, {}}).ok());
  EXPECT_EQ(RegisterFit(folder_, Row("f1")).code(), StatusCode::kUsage);
}

TEST_F(FitStoreTest, AWithdrawalThatTheLedgerAloneKnowsRefusesTheFit) {
  WriteFiles(Folder("f1"));
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kWithdrawal, {1}, {session_}, std::string(64, 'a'), ""}).ok());
  const Status status = RegisterFit(folder_, Row("f1"));
  EXPECT_EQ(status.code(), StatusCode::kUsage);
  EXPECT_THAT(status.message(), HasSubstr("withdrawn"));
}

TEST_F(FitStoreTest, AListedFitStaysWhereANewerOneOfItsIdIsRefused) {
  WriteFiles(Folder("f1"));
  ASSERT_TRUE(RegisterFit(folder_, Row("f1")).ok());
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  EXPECT_EQ(RegisterFit(folder_, Row("f1")).code(), StatusCode::kUsage);
  EXPECT_TRUE(fs::exists(Folder("f1") / "position.exr"));
  EXPECT_THAT(Fits(), SizeIs(1));
}

TEST_F(FitStoreTest, AConsentThatDoesNotCoverFittingRefusesIt) {
  auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(connection->Execute("UPDATE sessions SET consent_json = replace(consent_json, '\"fit\",', '')").ok());
  WriteFiles(Folder("f1"));
  EXPECT_THAT(RegisterFit(folder_, Row("f1")).message(), HasSubstr("does not cover"));
}

TEST_F(FitStoreTest, AnUnknownSessionGivesNothingAndLosesNothing) {
  FitRow row = Row("f1");
  row.session = "s000099-00000000";
  WriteFiles(folder_ / "sessions" / row.session / "fits" / "f1");
  EXPECT_EQ(RegisterFit(folder_, row).code(), StatusCode::kNotFound);
  EXPECT_TRUE(fs::exists(folder_ / "sessions" / row.session / "fits" / "f1" / "metrics.json"))
      << "a reindex may know it";
  for (const char* bad : {"", "..", "a/b", ".hidden"}) {
    EXPECT_EQ(RegisterFit(folder_, Row(bad)).code(), StatusCode::kUsage) << bad;
  }
}

TEST_F(FitStoreTest, OnlyTheHolderOfTheJobRegisters) {
  JobStore jobs = *JobStore::Open(folder_);
  ASSERT_TRUE(jobs.Enqueue({"fit", "fit", session_}).ok());
  const auto late = *jobs.Lease({"slow", {}, std::chrono::milliseconds(1)});
  std::this_thread::sleep_for(std::chrono::milliseconds(5));
  const auto current = *jobs.Lease({"quick", {}, std::chrono::minutes(1)});
  ASSERT_TRUE(late && current);
  WriteFiles(Folder("f1"));
  const Status refused = RegisterFit(folder_, Row("f1"), {.job_token = late->token});
  EXPECT_EQ(refused.code(), StatusCode::kFailed);
  EXPECT_THAT(refused.message(), HasSubstr("outdated"));
  EXPECT_FALSE(fs::exists(Folder("f1") / "fit.json"));
  EXPECT_TRUE(fs::exists(Folder("f1") / "position.exr")) << "that is the other worker's folder now";
  EXPECT_THAT(Fits(), IsEmpty());
  ASSERT_TRUE(RegisterFit(folder_, Row("f1"), {.job_token = current->token}).ok());
  EXPECT_THAT(Fits(), SizeIs(1));
}

TEST_F(FitStoreTest, WaitsForAnotherWriterAndSaysSoWhenItStaysTooLong) {
  WriteFiles(Folder("f1"));
  auto other = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(other->Execute("BEGIN IMMEDIATE").ok());
  const Status late = RegisterFit(folder_, Row("f1"), {.patience = std::chrono::milliseconds(10)});
  EXPECT_EQ(late.code(), StatusCode::kBusy) << late.message();
  EXPECT_TRUE(fs::exists(Folder("f1") / "position.exr")) << "hours of work";
  std::thread release([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(5500));  // longer than SQLite itself waits
    EXPECT_TRUE(other->Execute("ROLLBACK").ok());
  });
  const Status status = RegisterFit(folder_, Row("f1"));
  release.join();
  EXPECT_TRUE(status.ok()) << status.message();
  EXPECT_THAT(Fits(), SizeIs(1));
}

TEST_F(FitStoreTest, AdoptsAFitOfElsewhereOnce) {
  const fs::path made = MadeElsewhere("f1");
  const auto first = AdoptFit(folder_, session_, made);
  ASSERT_TRUE(first.ok()) << first.status().message();
  EXPECT_TRUE(*first);
  EXPECT_FALSE(fs::exists(made));
  ASSERT_THAT(Fits(), SizeIs(1));
  EXPECT_EQ(Fits()[0].options_json, R"({"eta":1.4})");
  EXPECT_EQ(Fits()[0].created_wall.ns, 7);
  EXPECT_EQ(ReadFile(Folder("f1") / "report" / "index.html")->substr(0, 4), "<h1>");
  const auto again = AdoptFit(folder_, session_, made);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_FALSE(*again);
  // Also with a copy in hand, which is left to whoever made it.
  fs::copy(Folder("f1"), made, fs::copy_options::recursive);
  EXPECT_FALSE(*AdoptFit(folder_, session_, made));
  EXPECT_TRUE(fs::exists(made / "fit.json"));
  EXPECT_THAT(Fits(), SizeIs(1));
}

TEST_F(FitStoreTest, ContinuesABrokenOffAdoption) {
  const fs::path made = MadeElsewhere("f1");
  fs::create_directories(Folder("f1").parent_path());
  fs::rename(made, Folder("f1"));  // the power failed behind the move
  const auto adopted = AdoptFit(folder_, session_, made);
  ASSERT_TRUE(adopted.ok()) << adopted.status().message();
  EXPECT_TRUE(*adopted);
  EXPECT_THAT(Fits(), SizeIs(1));
}

TEST_F(FitStoreTest, AWholeFitTakesThePlaceOfAnUnfinishedOne) {
  const fs::path made = MadeElsewhere("f1");
  fs::create_directories(Folder("f1"));
  WriteText(Folder("f1") / "srd.bin", "a stage that was run alone");
  ASSERT_TRUE(AdoptFit(folder_, session_, made).ok());
  EXPECT_FALSE(fs::exists(Folder("f1") / "srd.bin"));
  EXPECT_TRUE(fs::exists(Folder("f1") / "position.exr"));
  EXPECT_EQ(std::distance(fs::directory_iterator(Session() / "fits"), fs::directory_iterator()), 1);
}

TEST_F(FitStoreTest, AFitThatIsNotWhatItSaysIsNotAdopted) {
  const fs::path made = MadeElsewhere("f1");
  const std::string record = *ReadFile(made / "fit.json");
  const auto refused = [&](StatusCode code, const std::string& part) {
    const auto adopted = AdoptFit(folder_, session_, made);
    EXPECT_EQ(adopted.status().code(), code) << part;
    EXPECT_THAT(adopted.status().message(), HasSubstr(part));
    EXPECT_FALSE(fs::exists(Folder("f1"))) << part;
    EXPECT_TRUE(fs::exists(made)) << part;
    EXPECT_THAT(Fits(), IsEmpty());
  };
  FlipBits(made / "position.exr", 77, 1);
  refused(StatusCode::kIntegrity, "position.exr is not the file");
  FlipBits(made / "position.exr", 77, 1);
  WriteText(made / "metrics.json", "{ }");
  refused(StatusCode::kIntegrity, "metrics.json has 3 bytes");
  fs::remove(made / "metrics.json");
  refused(StatusCode::kIntegrity, "metrics.json is missing");
  fs::create_symlink("/etc/hostname", made / "metrics.json");
  refused(StatusCode::kIntegrity, "is a link");
  fs::remove(made / "metrics.json");
  WriteText(made / "metrics.json", "{}");
  const auto edited = [&](const std::string& from, const std::string& to) {
    std::string text = record;
    text.replace(text.find(from), from.size(), to);
    auto json = nlohmann::ordered_json::parse(text);
    json.erase("hash");
    WriteText(made / "fit.json", WithOwnHash(json.dump(1)));
  };
  FlipBits(made / "fit.json", record.find("5000"), 1);
  refused(StatusCode::kIntegrity, "its own hash");
  edited("\"metrics.json\"", "\"../../x\"");
  refused(StatusCode::kIntegrity, "not a file of its folder");
  edited("\"fit\": \"f1\"", "\"fit\": \"f2\"");
  refused(StatusCode::kIntegrity, "is of fit f2");
  edited(session_, "s000099-00000000");
  refused(StatusCode::kIntegrity, "of session s000099-00000000");
  edited("\"schema\": 2", "\"schema\": 3");
  refused(StatusCode::kNewerSchema, "newer");
  auto stripped = nlohmann::ordered_json::parse(record);
  stripped.erase("hash");
  WriteText(made / "fit.json", stripped.dump(1) + "\n");
  refused(StatusCode::kIntegrity, "lost its own hash");
  stripped.erase("files");
  WriteText(made / "fit.json", WithOwnHash(stripped.dump(1)));
  refused(StatusCode::kIntegrity, "fit.json");
  for (const auto& none : {nlohmann::ordered_json::object(), nlohmann::ordered_json::array()}) {
    stripped["files"] = none;
    WriteText(made / "fit.json", WithOwnHash(stripped.dump(1)));
    refused(StatusCode::kIntegrity, none.is_array() ? "names no file" : "fit.json");
  }
  edited("5000", "-1");
  refused(StatusCode::kIntegrity, "position.exr");
  for (const std::string& text : {std::string("{"), std::string("[]"), std::string(R"({"files": [7]})")}) {
    WriteText(made / "fit.json", text);
    refused(StatusCode::kIntegrity, "fit.json");
  }
  fs::remove(made / "fit.json");
  refused(StatusCode::kIntegrity, "no fit.json");
  WriteText(made / "fit.json", record);
  EXPECT_TRUE(*AdoptFit(folder_, session_, made));
}

TEST_F(FitStoreTest, AFitOfAForgottenSessionIsNotAdopted) {
  const fs::path made = MadeElsewhere("f1");
  // The forgetting would look into `incoming`, too; this one comes later.
  const fs::path kept = fs::path(folder_.string() + "-kept") / "f1";
  fs::create_directories(kept.parent_path());
  fs::rename(made, kept);
  Forget();
  const auto adopted = AdoptFit(folder_, session_, kept);
  EXPECT_EQ(adopted.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(adopted.status().message(), HasSubstr("was forgotten"));
  EXPECT_FALSE(fs::exists(Session()));
  EXPECT_TRUE(fs::exists(kept)) << "not ours";
  fs::remove_all(kept.parent_path());
}

TEST_F(FitStoreTest, AdoptionsThatAreKilledAnywhereEndWhole) {
  for (int round = 0; round < 30; ++round) {
    const fs::path made = MadeElsewhere("f1");
    const pid_t child = fork();
    if (child == 0) {
      (void)AdoptFit(folder_, session_, made).ok();
      _exit(0);
    }
    usleep(static_cast<useconds_t>(round * 400));
    kill(child, SIGKILL);
    waitpid(child, nullptr, 0);
    const auto adopted = AdoptFit(folder_, session_, made);
    ASSERT_TRUE(adopted.ok()) << adopted.status().message();
    ASSERT_THAT(Fits(), SizeIs(1)) << "round " << round;
    EXPECT_EQ(fs::file_size(Folder("f1") / "position.exr"), 5000U);
    fs::remove_all(made);
  }
}

TEST_F(FitStoreTest, DiscardsOnlyFoldersOfFits) {
  for (const fs::path& other : {Session(), folder_, Session() / "fits", fs::path("/tmp"), Folder("..")})
    EXPECT_EQ(DiscardFit(folder_, session_, other).code(), StatusCode::kUsage) << other;
  EXPECT_TRUE(fs::exists(Segment(session_)));
  WriteFiles(Folder("f1.partial"));
  EXPECT_TRUE(DiscardFit(folder_, session_, Folder("f1.partial")).ok());
  EXPECT_FALSE(fs::exists(Folder("f1.partial")));
}

}  // namespace
}  // namespace stratalux::db
