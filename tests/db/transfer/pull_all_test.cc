// SPDX-License-Identifier: Apache-2.0
// Pull from several rigs: side by side, each at its own risk.
#include <atomic>

#include <nlohmann/json.hpp>

#include "db/care/incoming.h"
#include "shared/base/read_file.h"
#include "shared/capture/rig_calibration.h"
#include "tests/db/transfer/transfer_fixture.h"

namespace stratalux::db {
namespace {

using std::chrono::seconds;
using std::chrono::steady_clock;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::UnorderedElementsAre;

// As `stratalux-fit calibrate` leaves one.
std::string Calibration() {
  RigCalibration record;
  record.source = "calibration session";
  record.camera.model = {64, 48, 100, 100, 31.5, 23.5, {}};
  record.projectors.emplace_back();
  record.projectors[0].name = "projector 0";
  record.projectors[0].model = {32, 24, 90, 90, 15.5, 11.5, {}};
  record.projectors[0].white_dn_mm2_per_ms = {1, 1, 1};
  record.made_wall.ns = 5;
  record.valid_until_wall.ns = 86'400'000'000'000;
  return record.ToJson() + "\n";
}

class PullAllTest : public TransferTest {
 protected:
  void SetUp() override {
    TransferTest::SetUp();
    ASSERT_TRUE(SessionStore::Create(other_).ok());
  }
  // A rig of its own; its path.
  std::string Rig(const std::string& name) const {
    EXPECT_TRUE(SessionStore::Create(far_ / name).ok());
    return far_ / name;
  }
  static std::string Visit(const std::string& rig, int frames = 1) {
    SessionStore store = *SessionStore::Open(rig, AccessMode::kReadWrite);
    auto writer = store.BeginSession(SimulatedVisit());
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < frames; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return writer->info().id;
  }
  // ssh HOST COMMAND...: host `gone` has nobody at home, `hangs` never says a word, `stops` says no more from its
  // second session on; others answer.
  void MakeSsh() {
    std::filesystem::create_directories(far_ / "bin");
    const std::string log = (far_ / "ssh.log").string();
    WriteText(far_ / "bin" / "ssh",
              "#!/bin/sh\ncase \"$*\" in\n*\" gone \"*) exit 255;;\n*\" hangs \"*) exec sleep 100;;\n"
              "*\" stops \"*) echo x >> " +
                  log + "; [ $(wc -l < " + log +
                  ") -lt 4 ] || exec sleep 100;;\nesac\n"
                  "while [ \"$1\" != rsync ]; do shift; done\nexec \"$@\"\n");
    ASSERT_EQ(chmod((far_ / "bin" / "ssh").c_str(), 0755), 0);
    path_ = std::getenv("PATH");
    setenv("PATH", ((far_ / "bin").string() + ":" + path_).c_str(), 1);
  }
  void TearDown() override {
    if (!path_.empty()) setenv("PATH", path_.c_str(), 1);
    TransferTest::TearDown();
  }
  std::vector<SourcePull> All(const std::vector<std::string>& from, const PullOptions& options = {}) {
    auto pulls = PullAll(other_, from, options, quiet_);
    EXPECT_TRUE(pulls.ok()) << pulls.status().message();
    return pulls.ok() ? *pulls : std::vector<SourcePull>();
  }

  Logger quiet_{LogLevel::kError};
  std::string path_;
};

TEST_F(PullAllTest, TakesFromEachAndSaysOfEach) {
  const std::string one = Rig("rig-1"), two = Rig("rig-2"), none = Rig("rig-3");
  const std::string a = Visit(one), b = Visit(one, 2), c = Visit(two, 3);
  const auto pulls = All({one, two + "/", none});
  ASSERT_THAT(pulls, SizeIs(3));
  for (const SourcePull& pull : pulls) {
    EXPECT_EQ(pull.status.message(), "");
    EXPECT_THAT(pull.report.problems, IsEmpty());
    EXPECT_THAT(pull.report.notes, IsEmpty());
  }
  EXPECT_EQ(pulls[1].from, two);
  EXPECT_THAT(pulls[0].report.sessions, ElementsAre(a, b)) << "of each in its order";
  EXPECT_THAT(pulls[1].report.sessions, ElementsAre(c));
  EXPECT_THAT(pulls[2].report.sessions, IsEmpty());
  EXPECT_EQ(pulls[0].report.frames, 3);
  EXPECT_THAT(Ids(other_), UnorderedElementsAre(a, b, c)) << "each verified";
  for (const SourcePull& pull : All({one, two, none})) EXPECT_THAT(pull.report.sessions, IsEmpty()) << "once";
  EXPECT_THAT(ListIncoming(other_), IsEmpty());
}

TEST_F(PullAllTest, ManyAtOnceLoseNothing) {
  std::vector<std::string> rigs, all;
  for (int i = 0; i < 6; ++i) {
    rigs.push_back(Rig("rig-" + std::to_string(i)));
    for (int visit = 0; visit < 4; ++visit) all.push_back(Visit(rigs.back(), 1 + visit));
  }
  for (const SourcePull& pull : All(rigs)) {
    EXPECT_EQ(pull.status.message(), "") << pull.from;
    EXPECT_THAT(pull.report.problems, IsEmpty()) << pull.from;
  }
  EXPECT_THAT(Ids(other_), ::testing::UnorderedElementsAreArray(all));
}

// The others' sessions are here while it is still waited for.
TEST_F(PullAllTest, ARigThatIsAwayOrHangsDelaysOnlyItself) {
  MakeSsh();
  const std::string here = Rig("rig-1"), later = Rig("rig-2");
  const std::string a = Visit(here), b = Visit(later);
  std::atomic<bool> ended = false;
  std::vector<SourcePull> pulls;
  const auto begun = steady_clock::now();
  std::thread pulling([&] {
    pulls = All({"kiosk@hangs:/store", "kiosk@gone:/store", here, "kiosk@rig-2:" + later},
                {.timeout = seconds(600), .limit = seconds(8)});
    ended = true;
  });
  size_t seen = 0;
  while (!ended && seen < 2) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    seen = SessionStore::Open(other_, AccessMode::kReadOnly)->ListSessions()->size();
  }
  EXPECT_FALSE(ended) << "whoever answers waited for whoever does not";
  pulling.join();
  EXPECT_GE(steady_clock::now() - begun, seconds(8));
  EXPECT_LT(steady_clock::now() - begun, seconds(90)) << "the limit ended nothing";
  ASSERT_THAT(pulls, SizeIs(4));
  EXPECT_EQ(pulls[0].status.code(), StatusCode::kTryAgain);
  EXPECT_THAT(pulls[0].status.message(), HasSubstr("the limit of 8 s is over"));
  EXPECT_EQ(pulls[1].status.code(), StatusCode::kFailed);
  EXPECT_THAT(pulls[1].status.message(), HasSubstr("kiosk@gone:/store"));
  EXPECT_THAT(pulls[2].report.sessions, ElementsAre(a));
  EXPECT_THAT(pulls[3].report.sessions, ElementsAre(b));
  EXPECT_THAT(Ids(other_), UnorderedElementsAre(a, b));
}

TEST_F(PullAllTest, WhatCameWithinTheLimitIsHereAndTheNextPullGoesOn) {
  MakeSsh();
  const std::string rig = Rig("rig-1");
  const std::string a = Visit(rig), b = Visit(rig);
  const auto pulls = All({"kiosk@stops:" + rig}, {.timeout = seconds(600), .limit = seconds(8)});
  ASSERT_THAT(pulls, SizeIs(1));
  EXPECT_EQ(pulls[0].status.code(), StatusCode::kTryAgain);
  EXPECT_THAT(pulls[0].status.message(), HasSubstr("1 of 2 sessions are here, the next pull continues"));
  EXPECT_THAT(pulls[0].report.sessions, ElementsAre(a));
  EXPECT_THAT(Ids(other_), ElementsAre(a));
  EXPECT_THAT(All({"kiosk@rig-1:" + rig})[0].report.sessions, ElementsAre(b));
  EXPECT_THAT(Ids(other_), SizeIs(2));
}

TEST_F(PullAllTest, ADamagedRigIsItsOwnTrouble) {
  const std::string good = Rig("rig-1"), bad = Rig("rig-2");
  const std::string a = Visit(good), b = Visit(bad), c = Visit(bad);
  FlipBits(std::filesystem::path(bad) / "sessions" / b / "frames-0001.seg", 400, 1);
  const auto pulls = All({bad, good});
  EXPECT_THAT(pulls[0].report.problems, ElementsAre(HasSubstr("session " + b + " was not fetched")));
  EXPECT_THAT(pulls[0].report.sessions, ElementsAre(c));
  EXPECT_THAT(pulls[1].report.problems, IsEmpty());
  EXPECT_THAT(Ids(other_), UnorderedElementsAre(a, c));
}

// A rig and a workstation that has pulled from it.
TEST_F(PullAllTest, ASessionThatTwoHaveComesOnce) {
  const std::string rig = Rig("rig-1"), copy = Rig("copy");
  std::vector<std::string> ids;
  for (int i = 0; i < 5; ++i) ids.push_back(Visit(rig));
  ASSERT_TRUE(Pull(copy, rig, {}, quiet_).ok());
  const auto pulls = All({rig, copy});
  std::vector<std::string> came;
  for (const SourcePull& pull : pulls) {
    EXPECT_EQ(pull.status.message(), "");
    EXPECT_THAT(pull.report.problems, IsEmpty());
    came.insert(came.end(), pull.report.sessions.begin(), pull.report.sessions.end());
  }
  EXPECT_THAT(came, ::testing::UnorderedElementsAreArray(ids));
  EXPECT_THAT(Ids(other_), SizeIs(5));
}

// Made after the visit had come: of each rig its own.
TEST_F(PullAllTest, CalibrationsMadeAfterTheVisitComeAlong) {
  const std::vector<std::string> rigs = {Rig("rig-1"), Rig("rig-2")};
  std::vector<std::string> ids;
  for (const std::string& rig : rigs) ids.push_back(Visit(rig));
  All(rigs);
  for (size_t i = 0; i < rigs.size(); ++i) {
    SessionStore store = *SessionStore::Open(rigs[i], AccessMode::kReadWrite);
    std::filesystem::create_directories(store.FitFolder(ids[i], "c1"));
    WriteText(store.FitFolder(ids[i], "c1") / "calibration.json", Calibration());
    const Status accepted = store.RegisterFit({"c1", ids[i], R"({"stage":"calibrate"})", "{}", {5}, ""});
    ASSERT_TRUE(accepted.ok()) << accepted.message();
  }
  const auto pulls = All(rigs);
  for (size_t i = 0; i < rigs.size(); ++i) {
    EXPECT_THAT(pulls[i].report.problems, IsEmpty());
    EXPECT_THAT(pulls[i].report.fits, ElementsAre(ids[i] + "/c1"));
    EXPECT_EQ(*ReadFile(other_ / "sessions" / ids[i] / "fits" / "c1" / "calibration.json"), Calibration());
  }
}

TEST_F(PullAllTest, WhatOneRigForgotIsTakenFromNobodyElse) {
  const std::string rig = Rig("rig-1"), copy = Rig("copy");
  const std::string gone = Visit(rig), stays = Visit(rig);
  ASSERT_TRUE(Pull(copy, rig, {}, quiet_).ok());
  ASSERT_EQ(Db("forget " + gone + " --yes --store " + rig).code, 0);
  EXPECT_THAT(All({rig})[0].report.sessions, ElementsAre(stays));
  for (const SourcePull& pull : All({copy, rig})) EXPECT_THAT(pull.report.sessions, IsEmpty()) << pull.from;
  EXPECT_THAT(Ids(other_), ElementsAre(stays));
}

TEST_F(PullAllTest, AsItsUserRunsIt) {
  MakeSsh();
  const std::string one = Rig("rig-1"), two = Rig("rig-2");
  const std::string a = Visit(one), b = Visit(two);
  const auto pull = [&](const std::string& from) {
    return Db("pull --json --store " + other_.string() + " --from " + from);
  };
  const Outcome outcome =
      Shell(std::string(STRATALUX_BIN_DIR) + "/stratalux-db pull --json --store " + other_.string() +
            " --limit 5 --from " + one + " kiosk@gone:/store " + two + " 2>/dev/null");
  EXPECT_EQ(outcome.code, 3) << "a part";
  const auto json = nlohmann::json::parse(outcome.out);
  ASSERT_EQ(json["sources"].size(), 3U);
  EXPECT_EQ(json["sources"][0]["code"], 0);
  EXPECT_EQ(json["sources"][0]["sessions"], nlohmann::json({a}));
  EXPECT_EQ(json["sources"][1]["from"], "kiosk@gone:/store");
  EXPECT_EQ(json["sources"][1]["code"], 1);
  EXPECT_THAT(json["sources"][1]["error"].get<std::string>(), HasSubstr("ssh must connect without asking anything"));
  EXPECT_EQ(json["sources"][2]["sessions"], nlohmann::json({b}));
  EXPECT_EQ(pull("kiosk@gone:/store kiosk@gone:/other").code, 1) << "nobody";
  EXPECT_EQ(pull(one + " " + two).code, 0);
  EXPECT_EQ(pull(one + " " + one + "/").code, 2) << "the same twice";
  const Outcome text = Db("pull --store " + other_.string() + " --from " + one + " kiosk@gone:/store");
  EXPECT_THAT(text.out, HasSubstr(one + ": 0 sessions pulled"));
  EXPECT_THAT(text.out, HasSubstr("kiosk@gone:/store: stopped: "));
  const auto lock = IncomingLock::Take(other_);
  ASSERT_TRUE(lock.ok());
  EXPECT_EQ(pull(one + " " + two).code, 5) << "another pull is at work";
}

}  // namespace
}  // namespace stratalux::db
