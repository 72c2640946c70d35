// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit run --frames N`: a fit of some of a visit's frames, as if the others had not been captured.
#include <algorithm>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/segment/segment.h"
#include "fitter/session/session_frames.h"
#include "shared/capture/thin_plan.h"
#include "tests/db/store_fixture.h"
#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

// Few profiles and stages: a thinned cycle takes more sweeps.
constexpr const char* kFewProfiles = "--pool 4 --prior 1000 --iterations 1 --layers 1 --offset off";
// Of 220: as many as a surface takes.
constexpr int kForSurface = 80;

class Frames : public SmallFit {
 protected:
  static std::string Options(const std::string& verb, int frames) {
    return verb + " latest " + kFewProfiles + " --frames " + std::to_string(frames);
  }
  static Json MetricsOf(const fs::path& store, const std::string& fit) {
    return Json::parse(ReadText(Session(store) / "fits" / fit / "metrics.json"));
  }
  // What --json printed; other lines are of the log.
  static Json Printed(const std::string& out) {
    const size_t begin = out.find("{\n"), end = out.rfind("}\n");
    if (begin == std::string::npos || end == std::string::npos) {
      ADD_FAILURE() << out;
      return {};
    }
    const auto json = Json::parse(out.substr(begin, end + 1 - begin), nullptr, false);
    EXPECT_TRUE(json.is_object()) << out;
    return json;
  }
};

// Spoils each frame that is not among `frames` of the plan: whoever reads one fails.
void SpoilTheRest(const fs::path& store, const fs::path& session, int frames) {
  const auto all = fit::SessionFrames::Open(store.string(), "latest");
  ASSERT_TRUE(all.ok()) << all.status().message();
  const auto plan = BuildPlan(*all->plan());
  ASSERT_TRUE(plan.ok());
  const auto thin = ThinTo(*plan, frames);
  ASSERT_TRUE(thin.ok()) << thin.status().message();
  size_t spoilt = 0;
  for (const db::FrameRow& row : all->rows()) {
    if (std::ranges::binary_search(thin->kept, row.record.step)) continue;
    db::FlipBits(session / "frames-0001.seg", static_cast<size_t>(row.offset) + sizeof(db::FrameHeader), 0x10);
    ++spoilt;
  }
  EXPECT_EQ(spoilt + thin->kept.size(), all->rows().size());
}

TEST_F(Frames, ThoseLeftOutAreNotRead) {
  const fs::path whole = Captured("whole"), spoilt = Captured("spoilt");
  SpoilTheRest(spoilt, Session(spoilt), kForSurface);
  const Outcome fitted = Fit(whole, Options("maps", kForSurface)), again = Fit(spoilt, Options("maps", kForSurface));
  ASSERT_EQ(fitted.code, 0) << fitted.out;
  ASSERT_EQ(again.code, 0) << again.out;
  const State made = StateOf(whole);
  EXPECT_GT(made.size(), 40U);
  EXPECT_EQ(StateOf(spoilt), made);
  EXPECT_NE(Fit(spoilt, std::string("maps latest ") + kFewProfiles).code, 0) << "nothing was spoilt";
}

TEST_F(Frames, NoArtifactIsAnotherNumbersAndTheSameNumberIsReused) {
  const fs::path store = Captured("store");
  const Outcome first = Fit(store, Options("run --json", kForSurface));
  ASSERT_EQ(first.code, 0) << first.out;
  const Json json = Printed(first.out);
  EXPECT_EQ(json["frames"]["kept"], kForSurface);
  EXPECT_EQ(json["frames"]["whole"], 220);
  EXPECT_EQ(MetricsOf(store, json["fit"])["options"]["frames"], kForSurface);
  EXPECT_EQ(Printed(Fit(store, Options("run --json", kForSurface)).out)["was_complete"], true);
  const State before = StateOf(store);
  const Json more = Printed(Fit(store, Options("run --json --dry-run", 150)).out);
  EXPECT_NE(more["fit"], json["fit"]);
  for (const Json& stage : more["stages"])
    EXPECT_TRUE(stage["runs"].get<bool>() || stage["label"] == "separate, all frames") << stage;
  EXPECT_EQ(StateOf(store), before);
}

TEST_F(Frames, AllOfThemAreTheFitWithoutTheOption) {
  const fs::path store = Fitted("store");
  const Json json = Printed(Fit(store, std::string("run latest --json --frames 220 ") + kSmallFitOptions).out);
  EXPECT_EQ(json["was_complete"], true);
  EXPECT_FALSE(json.contains("frames"));
  ExpectAsUndisturbed(store, "--frames 220");
}

TEST_F(Frames, WithoutCodesAFitStandsOnTheTruth) {
  const fs::path store = Captured("store");
  const Outcome none = Fit(store, Options("run", 24));
  EXPECT_EQ(none.code, 2);
  EXPECT_THAT(none.out, HasSubstr("--frames 24"));
  EXPECT_THAT(none.out, HasSubstr("80 frames, or --geometry truth"));
  const Outcome few = Fit(store, Options("run", 23));
  EXPECT_EQ(few.code, 2);
  EXPECT_THAT(few.out, HasSubstr("need at least 24 frames"));
  const Outcome dry = Fit(store, Options("run --geometry truth --dry-run", 24));
  EXPECT_THAT(dry.out, HasSubstr("combs: 12 of 16"));
  EXPECT_THAT(dry.out, Not(HasSubstr("decode")));
  const Outcome fitted = Fit(store, Options("run --json --geometry truth", 24));
  ASSERT_EQ(fitted.code, 0) << fitted.out;
  const Json metrics = MetricsOf(store, Printed(fitted.out)["fit"]);
  EXPECT_EQ(metrics["options"]["frames"], 24);
  EXPECT_EQ(metrics["truth"]["depth_rms_mm"], 0.0);
}

TEST_F(Frames, ReadingsThatNeedWholeCyclesAreRefused) {
  const fs::path store = Captured("store");
  for (const char* option :
       {" --reading scatter", " --distance surface", " --standard-errors", " --reading scatter --dry-run"}) {
    const Outcome outcome = Fit(store, Options("run", kForSurface) + option);
    EXPECT_EQ(outcome.code, 2) << outcome.out;
    EXPECT_THAT(outcome.out, HasSubstr("--frames"));
  }
}

// Of what the smallest rig captured, the share of its first two projectors, as if there were no others.
void StoreTwoProjectors(const fs::path& from, const fs::path& to) {
  auto frames = fit::SessionFrames::Open(from.string(), "latest");
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  PlanOptions plan = *frames->plan();
  RigCalibration record = *frames->record();
  plan.projectors = 2;
  record.projectors.resize(2);
  SessionInfo info = frames->info();
  info.plan_json = PlanOptionsToJson(plan);
  info.calibration_json = record.ToJson();
  ASSERT_TRUE(db::SessionStore::Create(to).ok());
  auto store = db::SessionStore::Open(to, db::AccessMode::kReadWrite);
  ASSERT_TRUE(store.ok()) << store.status().message();
  auto writer = store->BeginSession(info);
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  for (const db::FrameRow& row : frames->rows()) {
    if (row.record.projector >= 2) continue;
    const auto pixels = frames->ReadRaw(row);
    ASSERT_TRUE(pixels.ok()) << pixels.status().message();
    ASSERT_TRUE(writer->Append(row.record, pixels->view()).ok());
  }
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
}

// Normals of light alone take three lights; a rig of two has the surface's.
TEST_F(Frames, ARigOfTwoProjectorsIsFitted) {
  const fs::path two = folder_ / "two";
  ASSERT_NO_FATAL_FAILURE(StoreTwoProjectors(Captured("four"), two));
  const Outcome fitted = Fit(two, std::string("run latest --heldout 1 --json ") + kFewProfiles);
  ASSERT_EQ(fitted.code, 0) << fitted.out;
  const Json metrics = MetricsOf(two, Printed(fitted.out).at("fit").get<std::string>());
  EXPECT_EQ(metrics.at("prediction").at(0).at("projector"), 1);
  EXPECT_TRUE(metrics.at("prediction").at(0).at("nrmse").is_number());
  // Stages before the fit hold nothing out, so projector 3, which the default would, need not be there.
  const Outcome srds = Fit(two, "srd latest --dry-run");
  EXPECT_EQ(srds.code, 0) << srds.out;
  const Outcome whole = Fit(two, "run latest --dry-run");
  EXPECT_EQ(whole.code, 2);
  EXPECT_THAT(whole.out, HasSubstr("allowed: 0 .. 1"));
}

}  // namespace
}  // namespace stratalux
