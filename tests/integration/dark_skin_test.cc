// SPDX-License-Identifier: Apache-2.0
// Light and dark skin, captured with the exposure that the pre-scan chooses: of the skin lit by two projectors and
// more, how much comes out of the fit.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "db/segment/truth_segment.h"
#include "fitter/export/exr_file.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr int kProjectors = 4;

// Volume fractions of melanin; at night the whole range.
std::vector<double> Melanins() {
  const char* text = std::getenv("STRATALUX_MELANINS");
  std::istringstream in(text != nullptr ? text : "0.2");
  std::vector<double> values;
  for (std::string value; std::getline(in, value, ',');) values.push_back(std::stod(value));
  return values;
}

std::string Seed() {
  const char* seed = std::getenv("STRATALUX_SEED");
  return seed != nullptr ? seed : "5";
}

struct Coverage {
  int64_t lit = 0;     // quads of skin lit by two projectors and more
  int64_t fitted = 0;  // of them in one colour and more
  std::array<int64_t, 3> of_colour{};
  std::vector<float> signal_to_noise;                  // of green and blue, where fitted
  double depth_bias_mm = 0.0, unplaced_bias_mm = 0.0;  // of the surface, placed and as the codes have it
  [[nodiscard]] double Share(int64_t quads) const { return static_cast<double>(quads) / static_cast<double>(lit); }
  [[nodiscard]] double share() const { return Share(fitted); }
  [[nodiscard]] double MedianSignalToNoise() const {
    std::vector<float> values = signal_to_noise;
    const auto middle = values.begin() + std::ssize(values) / 2;
    std::nth_element(values.begin(), middle, values.end());
    return values.empty() ? 0.0 : *middle;
  }
  [[nodiscard]] double ShareOfColours() const { return Share(of_colour[0] + of_colour[1] + of_colour[2]) / 3.0; }
};

class DarkSkin : public ScratchFolderTest {
 protected:
  void SetUp() override {
    ScratchFolderTest::SetUp();
    ASSERT_EQ(Execute("stratalux-db init --store " + store()).code, 0);
  }
  [[nodiscard]] std::string store() const { return (folder_ / "store").string(); }

  // A projector lights a quad whose white has a tenth of the brightest tenth's, in the light itself: without noise, and
  // whatever the camera was exposed.
  static std::vector<int> LightsOf(const db::TruthSegment& truth) {
    std::vector<int> lights;
    for (int p = 0; p < kProjectors; ++p) {
      const auto inside = truth.Read("subsurface white " + std::to_string(p));
      const auto direct = truth.Read("direct white " + std::to_string(p));
      EXPECT_TRUE(inside.ok() && direct.ok());
      std::vector<double> sums, sorted;
      for (int y = 0; y < inside->height(); ++y)
        for (int x = 0; x < inside->width(); ++x) {
          double sum = 0.0;
          for (int c = 0; c < inside->channels(); ++c) sum += (*inside)(x, y, c) + (*direct)(x, y, c);
          sums.push_back(std::isfinite(sum) ? sum : 0.0);
        }
      std::copy_if(sums.begin(), sums.end(), std::back_inserter(sorted), [](double v) { return v > 0.0; });
      std::sort(sorted.begin(), sorted.end());
      const double least = 0.1 * sorted[sorted.size() * 9 / 10];
      lights.resize(sums.size());
      for (size_t i = 0; i < sums.size(); ++i) lights[i] += sums[i] >= least;
    }
    return lights;
  }

  // Captures and fits; the newest session of the store is the one.
  Coverage Run(double melanin, const std::string& exposure) {
    const fs::path scene = folder_ / "head.toml";
    WriteText(scene, "[subject]\nshape = \"head\"\n[skin]\nmelanin = " + std::to_string(melanin) + "\n");
    const Outcome captured = Execute("stratalux-rig capture --simulate=" + scene.string() + " --store " + store() +
                                     " --seed " + Seed() + " --size 464x348 " + exposure);
    EXPECT_EQ(captured.code, 0) << captured.out;
    // Where a profile is fitted does not depend on how many layers it gets, nor on maps.
    const Outcome fitted =
        Execute("stratalux-fit run latest --maps off --layers 4 --store " + store() + " --json", Show::kStdout);
    EXPECT_EQ(fitted.code, 0);
    const fs::path fit = Json::parse(fitted.out)["folder"].get<std::string>();
    const auto truth = db::TruthSegment::Open(fit.parent_path().parent_path() / "truth.seg");
    EXPECT_TRUE(truth.ok()) << truth.status().message();
    const auto quality = fit::ReadExr(fit / "quality.exr", {"reason.R", "reason.G", "reason.B", "signal_to_noise.R",
                                                            "signal_to_noise.G", "signal_to_noise.B"});
    EXPECT_TRUE(quality.ok()) << quality.status().message();
    const auto material = truth->Read("material");
    EXPECT_TRUE(material.ok());
    EXPECT_EQ(quality->width(), material->width());
    const std::vector<int> lights = LightsOf(*truth);
    Coverage coverage;
    const Json metrics = Json::parse(ReadText(fit / "metrics.json"));
    for (const Json& offset : metrics.at("offsets"))
      coverage.depth_bias_mm =
          std::max(coverage.depth_bias_mm, std::abs(offset["truth"]["depth_bias_mm"].get<double>()));
    coverage.unplaced_bias_mm = metrics.at("unplaced").at("depth_bias_mm");
    for (int y = 0; y < material->height(); ++y)
      for (int x = 0; x < material->width(); ++x) {
        constexpr float kSkin = 1.0F;
        if ((*material)(x, y, 0) != kSkin || lights[static_cast<size_t>(y) * material->width() + x] < 2) continue;
        ++coverage.lit;
        bool any = false;
        for (int c = 0; c < 3; ++c) {
          const float reason = (*quality)(x, y, c);
          const bool fits = reason == 0.0F || reason == 5.0F;  // FitReason kFitted, kDepthNotEstimable
          coverage.of_colour[c] += fits;
          any |= fits;
          if (fits && c > 0) coverage.signal_to_noise.push_back((*quality)(x, y, 3 + c));
        }
        coverage.fitted += any;
      }
    std::printf(
        "melanin %4.1f %%, %-15s: %6lld quads of skin lit by two and more, %5.1f %% of them fitted (red %.1f, green "
        "%.1f, blue %.1f %%), signal over noise of green and blue %.1f\n",
        100.0 * melanin, exposure.c_str(), static_cast<long long>(coverage.lit), 100.0 * coverage.share(),
        100.0 * coverage.Share(coverage.of_colour[0]), 100.0 * coverage.Share(coverage.of_colour[1]),
        100.0 * coverage.Share(coverage.of_colour[2]), coverage.MedianSignalToNoise());
    std::fflush(stdout);
    return coverage;
  }
};

TEST_F(DarkSkin, IsFittedWhereItIsLit) {
  for (const double melanin : Melanins()) {
    const Coverage coverage = Run(melanin, "--exposure auto");
    EXPECT_GT(coverage.lit, 5000) << melanin;
    EXPECT_GE(coverage.share(), 0.9) << melanin;
    EXPECT_GE(coverage.ShareOfColours(), 0.9) << melanin;
    // Half of dark skin's light comes from its surface, whose codes lie where they are seen.
    EXPECT_LT(coverage.depth_bias_mm, 0.4 * coverage.unplaced_bias_mm) << melanin;
    // What the choice is for: the plan's exposure is as wide, and far dimmer.
    if (melanin == 0.2) {
      EXPECT_LT(Run(melanin, "--exposure 16").MedianSignalToNoise(), 0.85 * coverage.MedianSignalToNoise());
    }
  }
}

}  // namespace
}  // namespace stratalux
