// SPDX-License-Identifier: Apache-2.0
// `latest` of each verb, in stores whose newest session serves another one.
#include "fitter/session/choose_session.h"

#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/db/store_fixture.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;

class ChooseSessionTest : public db::StoreTest {
 protected:
  std::string Session(SessionKind kind, SessionStatus status, int frames = 1) const {
    db::SessionStore store = OpenStore();
    SessionInfo info = db::SimulatedVisit();
    info.kind = kind;
    info.rig = "bench";
    auto writer = store.BeginSession(info);
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < frames; ++i) EXPECT_TRUE(db::AppendTo(*writer, i).ok());
    EXPECT_TRUE(writer->Finish(status).ok());
    return writer->info().id;
  }
  void Fit(const std::string& session) const {
    db::SessionStore store = OpenStore();
    const auto folder = store.FitFolder(session, "f1");
    std::filesystem::create_directories(folder);
    db::WriteText(folder / "map.exr", "map");
    ASSERT_TRUE(store.RegisterFit({"f1", session, "{}", "{}", {}, {}}).ok());
  }
  Result<std::string> Latest(SessionUse use) { return ChooseSession(folder_.string(), "latest", use, logger_); }

  Logger logger_;
};

TEST_F(ChooseSessionTest, LatestIsTheNewestThatTheVerbCanUse) {
  const std::string fitted = Session(SessionKind::kVisitor, SessionStatus::kComplete);
  Fit(fitted);
  const std::string board = Session(SessionKind::kCalibration, SessionStatus::kDegraded);
  const std::string visitor = Session(SessionKind::kVisitor, SessionStatus::kDegraded);
  const std::string failed = Session(SessionKind::kVisitor, SessionStatus::kFailed);
  Session(SessionKind::kCalibration, SessionStatus::kFailed, 0);
  EXPECT_EQ(*Latest(SessionUse::kFit), fitted);
  EXPECT_EQ(*Latest(SessionUse::kCalibration), board);
  EXPECT_EQ(*Latest(SessionUse::kVisitor), visitor);
  EXPECT_EQ(*Latest(SessionUse::kFrames), failed) << "its frames are there";
}

TEST_F(ChooseSessionTest, OtherSelectorsStayAsTheyAre) {
  EXPECT_EQ(*ChooseSession(folder_.string(), "s0000", SessionUse::kFit, logger_), "s0000");
}

TEST_F(ChooseSessionTest, SaysWhatTheStoreLacks) {
  Session(SessionKind::kVisitor, SessionStatus::kFailed);
  const auto visitor = Latest(SessionUse::kVisitor);
  EXPECT_EQ(visitor.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(visitor.status().message(), HasSubstr("stratalux-rig capture"));
  EXPECT_THAT(Latest(SessionUse::kFit).status().message(), HasSubstr("stratalux-fit run"));
  EXPECT_THAT(Latest(SessionUse::kCalibration).status().message(), HasSubstr("--kind calibration"));
}

}  // namespace
}  // namespace stratalux::fit
