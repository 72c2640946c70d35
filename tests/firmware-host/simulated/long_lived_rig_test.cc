// SPDX-License-Identifier: Apache-2.0
// One rig for many visitors: it begins at once, a stop ends its preparations, subjects change, memory does not grow.
#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <malloc.h>
#include <unistd.h>

#include "firmware-host/simulated/simulated_rig.h"
#include "firmware-host/simulated/skin/subcutis_table.h"
#include "tests/firmware-host/simulated/plain_patterns.h"
#include "tests/support/sanitized.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

SimulatedRigOptions Small(const std::string& scene) {
  SimulatedRigOptions options;
  options.scene = scene;
  options.camera_width = 88;
  options.camera_height = 66;
  options.projector_width = 128;
  options.projector_height = 96;
  return options;
}

std::unique_ptr<SimulatedRig> Open(const SimulatedRigOptions& options, Logger& logger) {
  auto rig = SimulatedRig::Create(options, logger);
  EXPECT_TRUE(rig.ok()) << rig.status().message();
  EXPECT_TRUE((*rig)->camera().Start().ok());
  (*rig)->switches()[1]->Set(true);
  return std::move(*rig);
}

Result<std::optional<CapturedFrame>> Shoot(SimulatedRig& rig, const Pattern& pattern) {
  EXPECT_TRUE(rig.projectors()[1]->Load({pattern}).ok());
  EXPECT_TRUE(rig.lines().TriggerProjector(1).ok());
  EXPECT_TRUE((*rig.lines().WaitSync(std::chrono::milliseconds(50))).has_value());
  EXPECT_TRUE(rig.lines().TriggerCamera().ok());
  return rig.camera().Wait(std::chrono::seconds(1));
}

std::vector<uint16_t> PixelsOf(SimulatedRig& rig, const Pattern& pattern) {
  const auto frame = Shoot(rig, pattern);
  EXPECT_TRUE(frame.ok() && frame->has_value());
  return {(*frame)->pixels.pixels().begin(), (*frame)->pixels.pixels().end()};
}

class LongLivedRig : public ::testing::Test {
 protected:
  Logger logger_{LogLevel::kError};
};

// At the size of the real camera; its light takes minutes.
TEST_F(LongLivedRig, AStopEndsThePreparationWithinASecond) {
  SimulatedRigOptions options;
  StopToken stop;
  options.stop = &stop;
  const auto rig = Open(options, logger_);
  // In what the camera sees, in the projector's light, and after it began anew.
  for (const auto after : {std::chrono::milliseconds(200), std::chrono::milliseconds(8000)}) {
    std::clock_t stopped = 0;
    std::thread operator_thread([&] {
      std::this_thread::sleep_for(after);
      stopped = std::clock();
      stop.Request(StopReason::kOperator);
    });
    const auto frame = Shoot(*rig, kWhitePattern);
    const std::clock_t ended = std::clock();
    operator_thread.join();
    ASSERT_FALSE(frame.ok());
    EXPECT_EQ(frame.status().message(), stop.Check().message());
    // Of all threads' work: how long that takes is the machine's affair.
    EXPECT_LT(static_cast<double>(ended - stopped) / CLOCKS_PER_SEC, std::max(1U, std::thread::hardware_concurrency()));
    const auto truth = rig->Truth(*BuildPlan({}));
    EXPECT_FALSE(truth.ok());
    stop.Reset();
  }
}

TEST_F(LongLivedRig, AStopSpoilsNothing) {
  const SimulatedRigOptions options = Small("head");
  const auto undisturbed = PixelsOf(*Open(options, logger_), kWhitePattern);
  SimulatedRigOptions stoppable = options;
  StopToken stop;
  stoppable.stop = &stop;
  const auto rig = Open(stoppable, logger_);
  stop.Request(StopReason::kVisitorLeft);
  EXPECT_FALSE(Shoot(*rig, kWhitePattern).ok());
  stop.Reset();
  const auto later = PixelsOf(*rig, kWhitePattern);
  int most = 0;  // another frame's noise
  for (size_t i = 0; i < later.size(); ++i) most = std::max(most, std::abs(int(later[i]) - int(undisturbed[i])));
  EXPECT_LT(most, 500);
  SimulatedRigOptions silent = options, silent_stoppable = stoppable;
  silent.noise = silent_stoppable.noise = false;
  const auto quiet = Open(silent_stoppable, logger_);
  stop.Request(StopReason::kVisitorLeft);
  EXPECT_FALSE(Shoot(*quiet, kWhitePattern).ok());
  stop.Reset();
  EXPECT_EQ(PixelsOf(*quiet, kWhitePattern), PixelsOf(*Open(silent, logger_), kWhitePattern));
}

TEST_F(LongLivedRig, ANewVisitorIsWhomANewRigWouldSee) {
  SimulatedRigOptions options = Small("head");
  options.noise = false;
  options.seed = 1;
  const auto rig = Open(options, logger_);
  const auto calibration = rig->calibration().ToJson();
  FrameSource* camera = &rig->camera();
  PixelsOf(*rig, kWhitePattern);
  MonotonicNs before = rig->clock().Now();
  for (const SubjectOptions& visitor : std::vector<SubjectOptions>{{.scene = "head", .seed = 2},
                                                                   {.scene = "plane", .seed = 5},
                                                                   {.scene = "slab"},
                                                                   {.scene = "head", .seed = 1}}) {
    ASSERT_TRUE(rig->SetSubject(visitor).ok());
    SimulatedRigOptions fresh = options;
    fresh.scene = visitor.scene;
    fresh.seed = visitor.seed;
    EXPECT_EQ(PixelsOf(*rig, kWhitePattern), PixelsOf(*Open(fresh, logger_), kWhitePattern))
        << visitor.scene << visitor.seed;
    EXPECT_GT(rig->clock().Now(), before) << "its clock goes on";
    before = rig->clock().Now();
  }
  EXPECT_EQ(&rig->camera(), camera);
  EXPECT_EQ(rig->calibration().ToJson(), calibration);
  const Status nobody = rig->SetSubject({.scene = "ghost"});
  EXPECT_EQ(nobody.code(), StatusCode::kUsage);
  EXPECT_TRUE(Shoot(*rig, kWhitePattern).ok()) << "who sat there still sits";
}

TEST_F(LongLivedRig, AVisitorsFaultsOfPlaceAreOverWhenTheNextSits) {
  SimulatedRigOptions options = Small("plane");
  options.faults.script = {{FaultKind::kSubjectMoved, 1}};
  const auto rig = Open(options, logger_);
  PixelsOf(*rig, kWhitePattern);
  PixelsOf(*rig, kWhitePattern);
  EXPECT_GT(rig->ShownOf(1).push_mm.norm(), 1.0);
  ASSERT_TRUE(rig->SetSubject({.scene = "plane"}).ok());
  PixelsOf(*rig, kWhitePattern);
  EXPECT_EQ(rig->ShownOf(2).push_mm.norm(), 0.0);
}

TEST_F(LongLivedRig, TheTruthOfACaptureIsForgottenWhenTheNextBegins) {
  SimulatedRigOptions options = Small("plane");
  options.lens_covered = true;
  const auto rig = Open(options, logger_);
  for (int k = 0; k < 3; ++k) ASSERT_TRUE(Shoot(*rig, kWhitePattern).ok());
  ASSERT_TRUE(rig->camera().Stop().ok());
  EXPECT_EQ(rig->ShownOf(0).exposure, 0);
  EXPECT_EQ(rig->ShownOf(2).exposure, 2);
  ASSERT_TRUE(rig->camera().Start().ok());
  EXPECT_EQ(rig->ShownOf(2).exposure, -1);
  ASSERT_TRUE(Shoot(*rig, kWhitePattern).ok());
  EXPECT_EQ(rig->ShownOf(3).exposure, 3);
}

TEST_F(LongLivedRig, AMissingSkinTableIsNamedWithAllPlaces) {
  EXPECT_EQ(
      SkinTable::DefaultPath(),
      (std::filesystem::path(STRATALUX_BIN_DIR) / "../share/stratalux/skin_table.bin").lexically_normal().string())
      << "beside the program, not in the sources";
  setenv("STRATALUX_SKIN_TABLE", "/nowhere/mine.bin", 1);
  const auto skin = SimulatedRig::Create(Small("head"), logger_), wax = SimulatedRig::Create(Small("slab"), logger_);
  unsetenv("STRATALUX_SKIN_TABLE");
  ASSERT_FALSE(skin.ok() || wax.ok());
  EXPECT_EQ(skin.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(skin.status().message(), ::testing::HasSubstr("looked for /nowhere/mine.bin"));
  EXPECT_THAT(wax.status().message(), ::testing::HasSubstr("looked for /nowhere/wax_table.bin"));
  const auto places = SkinTable::DefaultPlaces(SkinTable::kSkinFile);
  ASSERT_EQ(places.size(), 2U);
  EXPECT_THAT(places[1], ::testing::EndsWith("/share/stratalux/skin_table.bin"));
}

TEST_F(LongLivedRig, AnotherSubcutisWithoutItsTableIsRefused) {
  const ScratchFolder folder;
  const std::string table = (folder / "skin.bin").string(), beside = (folder / SubcutisTable::kFile).string(),
                    scene = (folder / "thin.toml").string();
  std::filesystem::create_symlink(SkinTable::DefaultPath(), table);
  const std::string shipped = SubcutisTable::DefaultPath();
  std::ofstream(scene) << "[skin]\nsubcutis_absorption = 2\nskin_mm = 1.2\n";
  setenv("STRATALUX_SKIN_TABLE", table.c_str(), 1);
  const Status lost = SimulatedRig::Create(Small(scene), logger_).status();
  const auto rig = SimulatedRig::Create(Small("head"), logger_);
  EXPECT_TRUE(rig.ok()) << "who has the usual one needs no table of others";
  const Status later = (*rig)->SetSubject({.scene = scene});
  std::ofstream(beside) << "SLXSUBC";
  const Status damaged = (*rig)->SetSubject({.scene = scene});
  std::filesystem::remove(beside);
  std::filesystem::create_symlink(shipped, beside);
  const Status known = (*rig)->SetSubject({.scene = scene}), back = (*rig)->SetSubject({.scene = "head"});
  const auto other = SimulatedRig::Create(Small(scene), logger_);
  std::filesystem::remove(beside);
  const Status again = (*rig)->SetSubject({.scene = scene});
  unsetenv("STRATALUX_SKIN_TABLE");
  for (const Status& refused : {lost, later}) {
    EXPECT_EQ(refused.code(), StatusCode::kNotFound);
    EXPECT_THAT(refused.message(), ::testing::HasSubstr("[skin] subcutis_absorption = 2, skin_mm = 1.2"));
    EXPECT_THAT(refused.message(), ::testing::HasSubstr("looked for " + beside));
    EXPECT_THAT(refused.message(), ::testing::HasSubstr("generate --subcutis"));
  }
  EXPECT_EQ(damaged.code(), StatusCode::kIntegrity);
  EXPECT_TRUE(known.ok()) << known.message();
  EXPECT_TRUE(back.ok()) << back.message();
  EXPECT_TRUE(other.ok()) << other.status().message();
  EXPECT_TRUE(again.ok()) << "it was read: " << again.message();
}

int64_t ResidentBytes() {
  malloc_trim(0);
  std::ifstream in("/proc/self/statm");
  int64_t size = 0, resident = 0;
  in >> size >> resident;
  return resident * ::sysconf(_SC_PAGESIZE);
}

// A visitor's capture of `frames` combs, and of one picture of two dimensions.
void Capture(SimulatedRig& rig, const std::string& scene, int visitor, int frames) {
  ASSERT_TRUE(rig.SetSubject({.scene = scene, .seed = static_cast<uint64_t>(visitor)}).ok());
  ASSERT_TRUE(rig.camera().Start().ok());
  for (int k = 0; k <= frames; ++k) {
    const Pattern comb = {.kind = PatternKind::kComb, .period = 32, .width = 2, .shift = k % 16 * 2};
    ASSERT_TRUE(Shoot(rig, k < frames ? comb : Pattern{.kind = PatternKind::kSpots, .period = 16, .width = 2}).ok());
    while ((*rig.camera().Wait({})).has_value()) {
    }
  }
}

// What the process holds after `captures` further visitors, over what it held when the first `warm` had left.
double Growth(SimulatedRig& rig, const std::string& scene, int warm, int captures, int frames) {
  int64_t early = 0;
  for (int visitor = 0; visitor < warm + captures; ++visitor) {
    Capture(rig, scene, visitor, frames);
    if (visitor == warm - 1) early = ResidentBytes();
  }
  return static_cast<double>(ResidentBytes()) / static_cast<double>(early);
}

TEST_F(LongLivedRig, MemoryIsFlatOver200Captures) {
  if (kUnderAddressSanitizer) GTEST_SKIP() << "AddressSanitizer keeps what was freed";
  SimulatedRigOptions options = Small("plane");
  options.scattering = false;
  options.camera_width = 64;
  options.camera_height = 48;
  options.projector_width = 64;
  options.projector_height = 48;
  options.faults.rate = 0.02;
  options.faults.kinds = {FaultKind::kFrameLost, FaultKind::kFrameDoubled, FaultKind::kEdgeDoubled};
  const auto rig = Open(options, logger_);
  EXPECT_LT(Growth(*rig, "plane", 10, 190, 150), 1.05);
}

TEST_F(LongLivedRig, MemoryIsFlatOver10FacesOfSkin) {
  if (kUnderAddressSanitizer) GTEST_SKIP() << "AddressSanitizer keeps what was freed";
  const auto rig = Open(Small("head"), logger_);
  EXPECT_LT(Growth(*rig, "head", 2, 10, 16), 1.05);
}

}  // namespace
}  // namespace stratalux::rig
