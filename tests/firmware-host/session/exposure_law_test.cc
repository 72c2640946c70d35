// SPDX-License-Identifier: Apache-2.0
// The exposure that a pre-scan chooses, on heads of light to dark skin at an eighth of the camera's size, held against
// the same heads before a camera without noise.
#include <algorithm>
#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "firmware-host/session/capture_station.h"
#include "tests/firmware-host/session/small_station.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

class ExposureLawTest : public ScratchFolderTest {
 protected:
  static constexpr int kProjectors = 4;
  [[nodiscard]] StationOptions OptionsFor(double melanin, uint64_t seed, bool noise) const {
    StationOptions options;
    RigConfig& config = options.config;
    config.store.folder = (folder_ / "store").string();
    config.camera.width = 174;
    config.camera.height = 130;
    config.plan.projector_width = 256;
    config.plan.projector_height = 192;
    const auto scene = folder_ / "head.toml";
    // Of the surface's light, which is the same whatever the skin, as little as a mannequin gives.
    WriteText(scene,
              "[head]\nbald = true\n[surface]\nform = \"ggx\"\noiliness = 0\nfuzz = 0\n[skin]\nregions = "
              "0\nepidermis_mm = 0.08\n"
              "scattering = 1\nmelanin = " +
                  std::to_string(melanin) + "\n");
    Simulate(options, scene.string());
    options.simulated->seed = seed;
    options.simulated->noise = noise;
    return options;
  }
  std::unique_ptr<CaptureStation> Open(const StationOptions& options) {
    auto station = CaptureStation::Open(options, stop_, logger_);
    EXPECT_TRUE(station.ok()) << station.status().message();
    return std::move(*station);
  }
  // Signal of each quad under the projector, DN.
  static std::vector<double> Quads(CaptureStation& station, int projector, double exposure_ms) {
    const auto white = station.SnapPattern(projector, {.kind = PatternKind::kWhite}, exposure_ms);
    const auto black = station.SnapPattern(projector, {.kind = PatternKind::kBlack}, exposure_ms);
    EXPECT_TRUE(white.ok() && black.ok());
    std::vector<double> quads;
    for (int y = 0; y + 1 < white->pixels.height(); y += 2)
      for (int x = 0; x + 1 < white->pixels.width(); x += 2) {
        double sum = 0.0;
        for (int site = 0; site < 4; ++site)
          sum += double(white->pixels(x + site % 2, y + site / 2)) - double(black->pixels(x + site % 2, y + site / 2));
        quads.push_back(sum);
      }
    return quads;
  }
  // Share of the quads lit by two projectors and more that have the ratio in two and more.
  static double ShareThatReaches(CaptureStation& exact, double exposure_ms, const ExposureRule& rule) {
    std::vector<int> lit, good;
    for (int p = 0; p < kProjectors; ++p) {
      const std::vector<double> quads = Quads(exact, p, exposure_ms);
      std::vector<double> sorted;
      std::copy_if(quads.begin(), quads.end(), std::back_inserter(sorted), [](double s) { return s > 2.0; });
      std::sort(sorted.begin(), sorted.end());
      const double least = 0.1 * sorted[sorted.size() * 9 / 10];
      lit.resize(quads.size());
      good.resize(quads.size());
      for (size_t i = 0; i < quads.size(); ++i) {
        if (quads[i] < least) continue;
        const double electrons = quads[i] * rule.gain_e_per_dn, read = rule.read_noise_dn * rule.gain_e_per_dn;
        ++lit[i];
        good[i] += electrons / std::sqrt(electrons + 8.0 * read * read) >= rule.wanted_snr;
      }
    }
    int all = 0, reached = 0;
    for (size_t i = 0; i < lit.size(); ++i) {
      all += lit[i] >= 2;
      reached += lit[i] >= 2 && good[i] >= 2;
    }
    return static_cast<double>(reached) / all;
  }

  StopToken stop_;
  Logger logger_{LogLevel::kError};
};

TEST_F(ExposureLawTest, LightAndDarkSkinReachTheRatioWithinTwentySeconds) {
  VisitTiming timing;
  timing.camera.read_out = ReadOut::kOverlapped;
  timing.camera.min_frame_period = std::chrono::nanoseconds(1'000'000'000 / 60);
  timing.transfer = std::chrono::milliseconds(8);
  double before_ms = 0.0;
  for (const double melanin : {0.01, 0.05, 0.10, 0.20}) {
    const StationOptions options = OptionsFor(melanin, 31, true);
    const auto station = Open(options);
    const auto choice = station->ChooseExposure(options.config.plan, timing, std::chrono::seconds(20));
    ASSERT_TRUE(choice.ok()) << choice.status().message();
    PlanOptions plan = options.config.plan;
    plan.exposure_ms = choice->exposure_ms;
    const double visit_s = 1e-9 * static_cast<double>(VisitTime(*BuildPlan(plan), timing).count());
    const auto exact = Open(OptionsFor(melanin, 31, false));
    const double reached = ShareThatReaches(*exact, choice->exposure_ms, ExposureRule());
    const double fixed = ShareThatReaches(*exact, options.config.plan.exposure_ms, ExposureRule());
    std::printf(
        "melanin %4.1f %%: exposure %5.1f ms, visit %4.1f s, %5.1f %% of the skin reach the ratio (at 16 ms %5.1f "
        "%%)\n",
        100.0 * melanin, choice->exposure_ms, visit_s, 100.0 * reached, 100.0 * fixed);
    EXPECT_GE(reached, 0.95) << melanin;
    EXPECT_LE(choice->saturated, 0.005) << melanin;
    EXPECT_LE(visit_s, 20.0) << melanin;
    EXPECT_GE(choice->exposure_ms, before_ms) << "darker skin gets no less light";
    before_ms = choice->exposure_ms;
    // What the rule is for.
    if (melanin == 0.20) {
      EXPECT_LT(fixed, 0.95);
    }
  }
}

}  // namespace
}  // namespace stratalux::rig
