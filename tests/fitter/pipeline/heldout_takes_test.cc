// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/heldout_takes.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <functional>
#include <iostream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "firmware-host/sequence/sequencer.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/decode.h"
#include "fitter/stages/normals.h"
#include "fitter/stages/separate.h"
#include "fitter/stages/shape.h"
#include "fitter/stages/srd.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

struct Frame {
  FrameRecord record;
  Image<uint16_t> pixels;
};

class KeepingSink : public rig::FrameSink {
 public:
  Status Put(FrameRecord record, Image<uint16_t> pixels) override {
    frames.push_back({std::move(record), std::move(pixels)});
    return Status::Ok();
  }
  std::vector<Frame> frames;
};

PlanOptions QuarterPlan() {
  PlanOptions plan;
  plan.projector_width = 256;
  plan.projector_height = 192;
  plan.comb_period = 32;
  plan.spot_pitch = 40;
  plan.spot_radius = 3;
  return plan;
}

// A simulated visit with the camera's noise, captured once and stored as each case wants it.
class HeldOutTakes : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = fs::temp_directory_path() / ("stratalux_takes_" + std::to_string(getpid()));
    const auto rig = rig::SimulatedRig::Create(RigOptions(), logger_);
    ASSERT_TRUE(rig.ok()) << rig.status().message();
    calibration_ = (*rig)->calibration().ToJson();
    rig::SequencerOptions sequencer;
    sequencer.shooter.wait = [&](std::chrono::nanoseconds time) { (*rig)->Sleep(time); };
    rig::StopToken stop;
    const auto light = rig::GuardLight(**rig, stop);
    ASSERT_TRUE(light.ok()) << light.status().message();
    KeepingSink sink;
    const auto report =
        rig::Sequencer({**light, (*rig)->lines(), (*rig)->camera(), (*rig)->projectors()}, sequencer, logger_)
            .Run(*BuildPlan(QuarterPlan()), sink);
    ASSERT_TRUE(report.ok()) << report.status().message();
    ASSERT_EQ(report->status, SessionStatus::kComplete) << report->FaultSummary();
    frames_ = std::move(sink.frames);
  }
  static void TearDownTestSuite() {
    fs::remove_all(folder_);
    frames_.clear();
  }

  static rig::SimulatedRigOptions RigOptions() {
    rig::SimulatedRigOptions options;
    options.camera_width = 348;
    options.camera_height = 260;
    options.projector_width = QuarterPlan().projector_width;
    options.projector_height = QuarterPlan().projector_height;
    options.scattering = false;
    return options;
  }
  // What a perfect camera sees of the same visitor.
  static Image<uint16_t> WithoutNoise(int projector, const Pattern& pattern) {
    rig::SimulatedRigOptions options = RigOptions();
    options.noise = false;
    const auto rig = rig::SimulatedRig::Create(options, logger_);
    EXPECT_TRUE(rig.ok()) << rig.status().message();
    (*rig)->switches()[projector]->Set(true);
    EXPECT_TRUE((*rig)->projectors()[projector]->Load({pattern}).ok());
    EXPECT_TRUE((*rig)->camera().Start().ok());
    EXPECT_TRUE((*rig)->camera().SetExposure(QuarterPlan().exposure_ms, 1.0).ok());
    EXPECT_TRUE((*rig)->lines().TriggerProjector(projector).ok());
    (*rig)->Sleep(std::chrono::milliseconds(100));
    EXPECT_TRUE((*rig)->lines().TriggerCamera().ok());
    auto frame = (*rig)->camera().Wait(std::chrono::seconds(1));
    EXPECT_TRUE(frame.ok() && frame->has_value());
    return std::move((*frame)->pixels);
  }
  // The visit as `change` leaves each frame; frames of which it says false are not stored.
  static SessionFrames Session(const std::string& name, const PlanOptions& plan,
                               const std::function<bool(Frame&)>& change) {
    const std::string store_folder = (folder_ / name).string();
    EXPECT_TRUE(db::SessionStore::Create(store_folder).ok());
    {
      auto store = db::SessionStore::Open(store_folder, db::AccessMode::kReadWrite);
      SessionInfo info;
      info.simulated = true;
      info.plan_json = PlanOptionsToJson(plan);
      info.calibration_json = calibration_;
      auto writer = store->BeginSession(info);
      EXPECT_TRUE(writer.ok()) << writer.status().message();
      for (const Frame& frame : frames_) {
        Frame changed = frame;
        if (!change(changed)) continue;
        EXPECT_TRUE(writer->Append(changed.record, changed.pixels.view()).ok());
      }
      EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    }
    auto session = SessionFrames::Open(store_folder, "latest");
    EXPECT_TRUE(session.ok()) << session.status().message();
    return *std::move(session);
  }
  static SessionFrames AsCaptured(const std::string& name) {
    return Session(name, QuarterPlan(), [](Frame&) { return true; });
  }

  static inline Logger logger_{LogLevel::kError};
  static inline fs::path folder_;
  static inline std::string calibration_;
  static inline std::vector<Frame> frames_;
};

struct Powers {
  double seen = 0.0, modelled = 0.0;
};

// Of the target's noise: as the takes tell it, and as the camera's noise model has it.
Powers NoiseOf(const SessionFrames& frames, const HeldOutTarget& held_out, const Image<uint16_t>& raw) {
  const Image<float> variance = QuadVariance(raw, frames.calibration()->camera);
  Powers sum;
  for (size_t i = 0; i < variance.size(); ++i) {
    const double noise = held_out.noise.pixels()[i];
    if (!std::isfinite(noise)) continue;
    sum.seen += noise * noise;
    sum.modelled += double{variance.pixels()[i]} / held_out.takes;
  }
  return sum;
}

TEST_F(HeldOutTakes, TellTheNoiseThatTheCamerasModelHas) {
  const SessionFrames frames = AsCaptured("noise");
  for (int p = 0; p < 4; ++p)
    for (const std::string light : {"stripe", "spot", "white"}) {
      const auto held_out = ReadHeldOutTarget(frames, p, light);
      ASSERT_TRUE(held_out.ok()) << held_out.status().message();
      EXPECT_EQ(held_out->takes, light == "white" ? 4 : 2);
      const auto raw = frames.Read(p, HeldOutPhase(light), HeldOutPattern(light, *frames.plan()));
      ASSERT_TRUE(raw.ok()) << raw.status().message();
      const Powers noise = NoiseOf(frames, *held_out, *raw);
      const double ratio = std::sqrt(noise.seen / noise.modelled);
      std::cout << "projector " << p << ", " << light << ": noise told over modelled " << ratio << "\n";
      EXPECT_NEAR(ratio, 1.0, 0.02) << light << " " << p;
    }
}

// An estimate that is the light itself has no error left, and one that is 5 % too bright that of 5 %: though the target
// that both are held against is noisy.
TEST_F(HeldOutTakes, TheErrorLessTheNoiseIsThatAgainstTheLightItself) {
  const SessionFrames frames = AsCaptured("error");
  const int p = 2;
  for (const std::string light : {"stripe", "spot"}) {
    const auto held_out = ReadHeldOutTarget(frames, p, light);
    ASSERT_TRUE(held_out.ok()) << held_out.status().message();
    // Less the black frame that the target is less, too: its noise is in no take.
    const Image<float> truth = QuadSignal(WithoutNoise(p, HeldOutPattern(light, *frames.plan())), *frames.MeanBlack(p),
                                          frames.calibration()->camera);
    double exact = 0.0, bright = 0.0, noise = 0.0, power = 0.0;
    for (size_t i = 0; i < truth.size(); ++i) {
      const double t = truth.pixels()[i], y = held_out->target.pixels()[i], e = held_out->noise.pixels()[i];
      if (!std::isfinite(t) || !std::isfinite(y)) continue;
      exact += (t - y) * (t - y);
      bright += (1.05 * t - y) * (1.05 * t - y);
      noise += e * e;
      power += t * t;
    }
    // The frame without noise is rounded as all are, which adds 2 % where there is little light.
    EXPECT_NEAR(exact / noise, 1.0, 0.08) << light;
    EXPECT_NEAR(std::sqrt((bright - noise) / power), 0.05, 0.005) << light;
  }
}

// A sweep whose first exposure is not the nominal one: as if it were.
TEST_F(HeldOutTakes, OfAnotherExposureThanTheNominalOneAreAsIfOfThat) {
  PlanOptions longer = QuarterPlan();
  longer.brackets = {2.0};
  const SessionFrames as_captured = AsCaptured("nominal");
  const double level = as_captured.calibration()->camera.black_level_dn,
               top = as_captured.calibration()->camera.saturation_dn;
  const SessionFrames frames = Session("longer", longer, [&](Frame& frame) {
    const FrameRecord& r = frame.record;
    const bool stripe =
        r.phase == CapturePhase::kSweep || (r.phase == CapturePhase::kRepeat && r.pattern.kind == PatternKind::kComb);
    if (stripe)
      for (uint16_t& v : frame.pixels.pixels())
        v = static_cast<uint16_t>(std::clamp(std::lround(level + 2.0 * (v - level)), 0L, 4095L));
    return true;
  });
  for (const std::string light : {"stripe", "spot"}) {
    const auto nominal = ReadHeldOutTarget(as_captured, 1, light), of_longer = ReadHeldOutTarget(frames, 1, light);
    ASSERT_TRUE(nominal.ok() && of_longer.ok());
    int compared = 0;
    for (size_t i = 0; i < nominal->target.size(); ++i) {
      const float one = nominal->target.pixels()[i], other = of_longer->target.pixels()[i];
      if (!std::isfinite(one) || !std::isfinite(other) || 2.0 * one > 0.9 * top) continue;
      ASSERT_NEAR(other, one, 0.5) << light;
      ASSERT_NEAR(of_longer->noise.pixels()[i], nominal->noise.pixels()[i], 0.5) << light;
      ++compared;
    }
    EXPECT_GT(compared, 10000) << light;
  }
}

// Of sinusoids one of which is lost the phases would be those of other steps.
TEST_F(HeldOutTakes, ALostSinusoidLeavesTheBitsOfItsAxisAlone) {
  const SessionFrames frames = Session("shift", QuarterPlan(), [](Frame& frame) {
    const Pattern& shown = frame.record.pattern;
    return shown.kind != PatternKind::kSinusoid || shown.axis != PatternAxis::kColumns || shown.shift != 3;
  });
  const SensorNoise noise = SensorNoise::From(frames.calibration()->camera);
  const PlanOptions plan = QuarterPlan();
  const auto read = [&](CodeReading reading) {
    return DecodeProjector(frames, 0, -1, plan.projector_width, plan.projector_height, noise, reading);
  };
  const auto left = read(CodeReading::kWithSinusoids), bits = read(CodeReading::kBitsAlone);
  ASSERT_TRUE(left.ok() && bits.ok());
  int known = 0;
  for (size_t i = 0; i < bits->map.column.size(); ++i) {
    const float column = left->map.column.pixels()[i], by_bits = bits->map.column.pixels()[i];
    if (std::isnan(by_bits) || std::isnan(column)) continue;
    ASSERT_EQ(column, by_bits);
    ++known;
  }
  EXPECT_GT(known, 10000);
}

TEST_F(HeldOutTakes, ALostTakeLeavesTheOther) {
  const SessionFrames frames = Session("one_take", QuarterPlan(), [](const Frame& frame) {
    return frame.record.projector != 1 || frame.record.phase != CapturePhase::kSweep ||
           frame.record.pattern != HeldOutPattern("stripe", QuarterPlan());
  });
  EXPECT_EQ(HeldOutTakesOf(frames, 1, "stripe").size(), 1U);
  EXPECT_EQ(HeldOutTakesOf(frames, 0, "stripe").size(), 2U);
}

// Shape, light and lit skin of a visit of which one projector's frames are missing by the kind: what can be done
// without them is done, and nothing is made up of the rest.
TEST_F(HeldOutTakes, ShapeAndLightDoWithoutFramesThatAreMissing) {
  const auto decoded_of = [&](const SessionFrames& frames) { return *DecodeFace(frames, logger_); };
  const auto valid = [](const DecodedMap& map) {
    return std::ranges::count(map.reason.pixels(), static_cast<uint8_t>(DecodeReason::kValid));
  };
  const SessionFrames whole = AsCaptured("nothing_missing");
  const DecodedFace all = decoded_of(whole);
  const auto all_light = SeparateFace(whole, logger_);
  ASSERT_TRUE(all_light.ok());

  const SessionFrames dark =
      Session("no_projector", QuarterPlan(), [](const Frame& frame) { return frame.record.projector != 2; });
  const DecodedFace without = decoded_of(dark);
  EXPECT_EQ(valid(without.maps[2]), 0);
  EXPECT_EQ(valid(without.maps[1]), valid(all.maps[1]));
  const auto light = SeparateFace(dark, logger_);
  ASSERT_TRUE(light.ok()) << light.status().message();
  EXPECT_EQ(std::ranges::count((*light)[2].reason.pixels(), static_cast<uint8_t>(SeparationReason::kNotTold)),
            std::ssize((*light)[2].reason.pixels()));
  const auto face = ReconstructShape(without.maps, *light, *dark.calibration(), *dark.record());
  const auto full_face = ReconstructShape(all.maps, *all_light, *whole.calibration(), *whole.record());
  ASSERT_TRUE(face.ok() && full_face.ok());
  EXPECT_EQ(std::ranges::count(face->lit[2].pixels(), 1), 0) << "lit by a projector of which nothing is known";
  EXPECT_GT(std::ranges::count(full_face->lit[2].pixels(), 1), 1000);
  std::vector<SweepFigure> figures;
  const auto srds = ExtractSrds(dark, *face, {}, logger_, figures);
  ASSERT_TRUE(srds.ok()) << srds.status().message();
  for (int p = 0; p < 4; ++p) EXPECT_EQ(figures[p].profiles_by_reason.contains("valid"), p != 2) << p;
  EXPECT_GT(static_cast<double>(std::ranges::count(face->surface.mask.pixels(), 1)),
            0.9 * static_cast<double>(std::ranges::count(full_face->surface.mask.pixels(), 1)));

  // The reference white: any other one shows the same. One sinusoid: the other axis tells by itself.
  const SessionFrames fewer = Session("no_white", QuarterPlan(), [](const Frame& frame) {
    const FrameRecord& r = frame.record;
    const bool white = r.pattern.kind == PatternKind::kWhite && r.phase == CapturePhase::kReference,
               sinusoid = r.pattern.kind == PatternKind::kSinusoid && r.pattern.axis == PatternAxis::kRows &&
                          r.pattern.shift == 1;
    return r.projector != 2 || (!white && !sinusoid);
  });
  const auto fewer_light = SeparateFace(fewer, logger_);
  ASSERT_TRUE(fewer_light.ok()) << fewer_light.status().message();
  double ratio = 0.0;
  int quads = 0;
  for (size_t i = 0; i < (*fewer_light)[2].direct.size(); ++i) {
    const double one = (*fewer_light)[2].direct.pixels()[i], both = (*all_light)[2].direct.pixels()[i];
    if (!std::isfinite(one) || !(both > 30.0)) continue;
    ratio += one / both;
    ++quads;
  }
  ASSERT_GT(quads, 3000);
  EXPECT_NEAR(ratio / quads, 1.0, 0.1);
  EXPECT_GT(static_cast<double>(valid(decoded_of(fewer).maps[2])), 0.95 * static_cast<double>(valid(all.maps[2])));
}

TEST_F(HeldOutTakes, ALostTakeIsToldByName) {
  const SessionFrames frames = Session("lost", QuarterPlan(), [](Frame& frame) {
    return frame.record.phase != CapturePhase::kRepeat || frame.record.projector != 1 ||
           frame.record.pattern.kind != PatternKind::kSpots;
  });
  EXPECT_TRUE(ReadHeldOutTarget(frames, 1, "stripe").ok());
  EXPECT_TRUE(ReadHeldOutTarget(frames, 0, "spot").ok());
  const Status lost = ReadHeldOutTarget(frames, 1, "spot").status();
  EXPECT_EQ(lost.code(), StatusCode::kNotFound);
  EXPECT_NE(lost.message().find("spot light of projector 1"), std::string::npos) << lost.message();
}

// All that the layers are fitted on.
struct Training {
  FaceShape face;
  std::vector<SeparationMap> separation;
  FaceNormals normals;
  SrdSet srds;
  std::vector<Image<float>> black, white;
};

Training TrainingOf(const SessionFrames& frames, Logger& logger) {
  Training training;
  const auto decoded = DecodeFace(frames, logger);
  EXPECT_TRUE(decoded.ok()) << decoded.status().message();
  auto separation = SeparateFace(frames, logger);
  EXPECT_TRUE(separation.ok()) << separation.status().message();
  training.separation = *std::move(separation);
  auto face = ReconstructShape(decoded->maps, training.separation, *frames.calibration(), *frames.record());
  EXPECT_TRUE(face.ok()) << face.status().message();
  training.face = *std::move(face);
  auto normals = EstimateFaceNormals(training.separation, training.face.surface, *frames.calibration(),
                                     frames.plan()->exposure_ms);
  EXPECT_TRUE(normals.ok()) << normals.status().message();
  training.normals = *std::move(normals);
  std::vector<SweepFigure> figures;
  auto srds = ExtractSrds(frames, training.face, {}, logger, figures);
  EXPECT_TRUE(srds.ok()) << srds.status().message();
  training.srds = *std::move(srds);
  for (int p = 0; p < 4; ++p) {
    int whites = 0;
    training.black.push_back(*frames.MeanBlack(p));
    training.white.push_back(*frames.MeanWhite(p, whites));
    EXPECT_EQ(whites, 5);
  }
  return training;
}

template <typename T>
bool Same(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

bool Same(const Image<float>& a, const Image<float>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}

void ExpectSame(const Training& a, const Training& b) {
  EXPECT_TRUE(Same(a.face.surface.point_mm, b.face.surface.point_mm));
  EXPECT_TRUE(Same(a.normals.fused, b.normals.fused));
  ASSERT_EQ(a.srds.batches.size(), b.srds.batches.size());
  for (size_t p = 0; p < a.srds.batches.size(); ++p) {
    const SrdBatch &x = a.srds.batches[p], &y = b.srds.batches[p];
    EXPECT_GT(std::count(x.valid.begin(), x.valid.end(), 1), 1000) << "too little to say anything";
    EXPECT_TRUE(Same(x.valid, y.valid)) << p;
    EXPECT_TRUE(Same(x.y, y.y)) << p;
    EXPECT_TRUE(Same(x.noise_floor, y.noise_floor)) << p;
    EXPECT_TRUE(Same(x.noise_slope, y.noise_slope)) << p;
    EXPECT_TRUE(Same(x.white, y.white)) << p;
    EXPECT_TRUE(Same(a.separation[p].direct, b.separation[p].direct)) << p;
    EXPECT_TRUE(Same(a.black[p], b.black[p])) << p;
    EXPECT_TRUE(Same(a.white[p], b.white[p])) << p;
  }
}

TEST_F(HeldOutTakes, SecondTakesTrainNothing) {
  const Training as_captured = TrainingOf(AsCaptured("training"), logger_);
  int spoilt = 0;
  const SessionFrames garbage = Session("garbage", QuarterPlan(), [&](Frame& frame) {
    if (frame.record.phase != CapturePhase::kRepeat) return true;
    for (size_t i = 0; i < frame.pixels.size(); ++i) frame.pixels.data()[i] = static_cast<uint16_t>(i * 7919 % 4000);
    ++spoilt;
    return true;
  });
  EXPECT_EQ(spoilt, 8);
  ExpectSame(as_captured, TrainingOf(garbage, logger_));
}

TEST_F(HeldOutTakes, SessionsFromBeforeSecondTakesFitAsTheyDid) {
  PlanOptions older = QuarterPlan();
  older.second_takes = false;
  const SessionFrames frames =
      Session("older", older, [](Frame& frame) { return frame.record.phase != CapturePhase::kRepeat; });
  EXPECT_FALSE(frames.plan()->second_takes);
  EXPECT_EQ(ReadHeldOutTarget(frames, 0, "stripe").status().code(), StatusCode::kNotFound);
  EXPECT_TRUE(ReadHeldOutTarget(frames, 0, "white").ok());
  ExpectSame(TrainingOf(AsCaptured("newer"), logger_), TrainingOf(frames, logger_));
}

}  // namespace
}  // namespace stratalux::fit
