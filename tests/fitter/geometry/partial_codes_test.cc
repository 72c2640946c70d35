// SPDX-License-Identifier: Apache-2.0
// Codes of which noise, saturation, a missing frame or a missing axis takes a part: what can be kept is kept, with the
// sigma that it has, and what cannot is not.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "fitter/reconstruction/triangulate.h"
#include "fitter/structured_light/neighbour_plane.h"
#include "shared/pattern/pattern.h"
#include "tests/fitter/geometry/synthetic_rig.h"

namespace stratalux::fit {
namespace {

constexpr int kBitsAlone = 0;  // period: no sinusoids
constexpr double kGross_px = CodeWord::kNear + 0.5;

CodeWord WordOf(unsigned cell, int bits) {
  CodeWord word;
  for (int b = 0; b < bits; ++b) word.Push((GrayFromBinary(cell) >> (bits - 1 - b) & 1U) != 0 ? 1.0 : 0.0);
  return word;
}

// The word of `cell` with nothing known of the bits in `mask` (of the Gray code).
CodeWord DoubtfulWord(unsigned cell, int bits, unsigned mask) {
  CodeWord word;
  for (int b = 0; b < bits; ++b) {
    const unsigned bit = 1U << (bits - 1 - b);
    word.Push((mask & bit) != 0 ? 0.5 : (GrayFromBinary(cell) & bit) != 0 ? 1.0 : 0.0);
  }
  return word;
}

TEST(CodeWord, OfCertainBitsIsOneCell) {
  const CodeSpread spread = WordOf(700, 10).Spread();
  EXPECT_DOUBLE_EQ(spread.mean, 700.0);
  EXPECT_DOUBLE_EQ(spread.sigma, std::sqrt(1.0 / 12.0));
  EXPECT_EQ(spread.astray, 0.0);
  EXPECT_EQ(WordOf(700, 10).TrustedBits(1e-4), 10);
}

TEST(CodeWord, ProbabilitiesOfAllCellsAreOne) {
  CodeWord word;
  for (const double one : {0.9, 0.3, 0.55, 0.999, 0.02}) word.Push(one);
  double sum = 0.0;
  for (unsigned cell = 0; cell < 32; ++cell) sum += word.Probability(cell);
  EXPECT_NEAR(sum, 1.0, 1e-12);
}

constexpr ColumnCode kAnyCodes[] = {ColumnCode::kGray, ColumnCode::kXor2, ColumnCode::kXor4, ColumnCode::kMinStripe};
constexpr double kOnes[] = {0.9, 0.3, 0.55, 0.999, 0.02, 0.6};

TEST(CodeWord, OfAnyCodeHasTheProbabilitiesOfItsPlanes) {
  constexpr int kPlanes = 6;
  for (const ColumnCode code : kAnyCodes) {
    CodeWord word(code, kPlanes);
    for (const double one : kOnes) word.Push(one);
    double sum = 0.0, most = 0.0;
    unsigned best = 0;
    for (unsigned cell = 0; cell < 1U << kPlanes; ++cell) {
      double product = 1.0;
      for (int b = 0; b < kPlanes; ++b)
        product *= (WordOf(code, cell, kPlanes) >> (kPlanes - 1 - b) & 1U) != 0 ? kOnes[b] : 1.0 - kOnes[b];
      EXPECT_NEAR(word.Probability(cell), product, 1e-15) << ToString(code) << ", cell " << cell;
      sum += product;
      if (product > most) most = product, best = cell;
    }
    EXPECT_NEAR(sum, 1.0, 1e-12);
    EXPECT_EQ(word.MostProbable(), best) << ToString(code);
  }
}

// Of leading planes alone: what all columns of a cell have together when nothing is known of the other planes.
TEST(CodeWord, OfLeadingPlanesIsTheSumOverWhatTheBaseMayBe) {
  constexpr int kPlanes = 6;
  for (const ColumnCode code : {ColumnCode::kGray, ColumnCode::kXor2, ColumnCode::kXor4})
    for (int leading = 1; leading < kPlanes; ++leading) {
      CodeWord word(code, kPlanes), whole(code, kPlanes);
      const int base = BasePlane(code, kPlanes).value_or(-1);
      for (int b = 0; b < leading; ++b) word.Push(kOnes[b]);
      EXPECT_EQ(word.EndsBeforeBase(), base >= leading);
      if (word.EndsBeforeBase()) word.SetBase(kOnes[base]);
      for (int b = 0; b < kPlanes; ++b) whole.Push(b < leading || b == base ? kOnes[b] : 0.5);
      double most = 0.0;
      unsigned best = 0;
      for (unsigned cell = 0; cell < 1U << leading; ++cell) {
        double sum = 0.0;
        const unsigned columns = 1U << (kPlanes - leading);
        for (unsigned c = 0; c < columns; ++c) sum += whole.Probability(cell * columns + c);
        EXPECT_NEAR(word.Probability(cell), sum, 1e-12) << ToString(code) << ", " << leading << " planes";
        if (sum > most) most = sum, best = cell;
      }
      EXPECT_EQ(word.MostProbable(), best) << ToString(code) << ", " << leading << " planes";
    }
}

TEST(CodeWord, ADoubtfulBaseSendsACertainWordAstray) {
  // Eight leading planes of ten, all certain, and a base of which nothing is known: of two cells, either may be it.
  CodeWord word(ColumnCode::kXor4, 10);
  for (int b = 0; b < 8; ++b) word.Push((GrayFromBinary(100) >> (7 - b) & 1U) != 0 ? 1.0 : 0.0);
  EXPECT_NEAR(word.Spread().astray, 0.5, 1e-12);
  EXPECT_EQ(word.TrustedBits(1e-4), 1);  // two cells, which adjoin
  word.SetBase(0.0);
  EXPECT_EQ(word.MostProbable(), 100U);
  EXPECT_NEAR(word.Spread().astray, 0.0, 1e-12);
  EXPECT_EQ(word.TrustedBits(1e-4), 8);
}

TEST(CodeWord, ADoubtfulBitOnItsOwnEdgeLeavesTwoNeighbours) {
  for (const unsigned cell : {511U, 255U, 703U, 7U}) {  // the bit that changes to the next cell
    const unsigned changing = GrayFromBinary(cell) ^ GrayFromBinary(cell + 1);
    const CodeWord word = DoubtfulWord(cell, 10, changing);
    const CodeSpread spread = word.Spread();
    EXPECT_NEAR(spread.mean, cell + 0.5, 1e-9);
    EXPECT_NEAR(spread.sigma, std::sqrt(0.25 + 1.0 / 12.0), 1e-9);
    EXPECT_NEAR(spread.astray, 0.0, 1e-12);
    EXPECT_EQ(word.TrustedBits(1e-4), 10);
  }
}

TEST(CodeWord, ADoubtfulCoarseBitElsewhereSendsItAstray) {
  const CodeWord word = DoubtfulWord(400, 10, 1U << 8);
  EXPECT_NEAR(word.Spread().astray, 0.5, 1e-12);
  EXPECT_EQ(word.TrustedBits(1e-4), 2);  // the place to within a quarter of the code
}

TEST(CodeWord, TwoUnknownFinestBitsMayBeKeptAndThreeNot) {
  const DecodeOptions options;
  const CodeSpread two = DoubtfulWord(402, 10, 3U).Spread(), three = DoubtfulWord(402, 10, 7U).Spread();
  EXPECT_NEAR(two.sigma, 4.0 / std::sqrt(12.0), 1e-9);
  EXPECT_LT(two.sigma, options.max_sigma_px);
  EXPECT_TRUE(three.sigma > options.max_sigma_px || three.astray > options.max_astray);
}

// A plane that was quantised, at all slopes: the sigma must hold also where no site's column differs from the next.
TEST(NeighbourPlane, KnowsHowFarQuantisationLeavesIt) {
  for (const double slope : {0.0, 0.05, 0.2, 0.58, 0.7, 1.0, 1.5}) {
    double z2 = 0.0;
    constexpr int kTrials = 400;
    for (int trial = 0; trial < kTrials; ++trial) {
      const double true_px = 300.0 + std::fmod(trial * 0.6180339887, 1.0);
      Image<float> value(5, 5), sigma(5, 5, 1, static_cast<float>(std::sqrt(1.0 / 12.0)));
      for (int y = 0; y < 5; ++y)
        for (int x = 0; x < 5; ++x)
          value(x, y) = static_cast<float>(std::round(true_px + slope * (x - 2) + 0.02 * (y - 2)));
      const auto plane = PredictFromNeighbours(value, sigma, 2, 2, value(2, 2));
      ASSERT_TRUE(plane.has_value()) << slope;
      z2 += std::pow((plane->value_px - true_px) / plane->sigma_px, 2);
    }
    EXPECT_LT(std::sqrt(z2 / kTrials), 1.6) << "columns a site: " << slope;
  }
}

TEST(NeighbourPlane, DoesNotCrossAnEdgeInDepth) {
  Image<float> value(5, 5), sigma(5, 5, 1, 0.29F);
  for (int y = 0; y < 5; ++y)
    for (int x = 0; x < 5; ++x) value(x, y) = x < 2 ? 300.0F : 340.0F;
  const auto behind = PredictFromNeighbours(value, sigma, 2, 2, 340.0);
  ASSERT_TRUE(behind.has_value());
  EXPECT_NEAR(behind->value_px, 340.0, 0.01);
  for (int y = 0; y < 5; ++y)
    for (int x = 0; x < 5; ++x) value(x, y) = x < 2 ? 300.0F : 303.0F;  // too low a step for the slope to tell
  EXPECT_FALSE(PredictFromNeighbours(value, sigma, 2, 2, 303.0).has_value());
}

struct Outcome {
  int64_t lit = 0, kept = 0, gross = 0;
  double rms_z = 0.0, median_px = 0.0, largest_px = 0.0;
  [[nodiscard]] double Share() const { return static_cast<double>(kept) / static_cast<double>(lit); }
};

class PartialCodes : public testing::Test {
 protected:
  [[nodiscard]] DecodeReport Decode(const DecodeInput& input) const {
    auto report = DecodeGray(input, SensorNoise::From(rig_.camera));
    EXPECT_TRUE(report.ok()) << report.status().message();
    return std::move(report).value();
  }
  [[nodiscard]] DecodeInput WithoutInverses(const Frames& frames, int period) const {
    DecodeInput input = frames.Decode(rig_.projectors[0], period);
    for (AxisCode* axis : {&input.columns, &input.rows})
      for (CodedBit& bit : axis->bits) bit.inverse = {};
    return input;
  }
  // Of the axes that were captured.
  static Outcome Judge(const DecodedMap& map, const Frames& frames) {
    Outcome outcome;
    double z2 = 0.0;
    std::vector<double> errors;
    for (size_t s = 0; s < map.reason.size(); ++s) {
      if (std::isnan(frames.true_column.data()[s]) || map.reason.data()[s] == 1) continue;
      ++outcome.lit;
      if (map.reason.data()[s] != 0) continue;
      ++outcome.kept;
      const std::array<double, 2> error = {map.column.data()[s] - frames.true_column.data()[s],
                                           map.row.data()[s] - frames.true_row.data()[s]};
      const std::array<float, 2> sigma = {map.column_sigma.data()[s], map.row_sigma.data()[s]};
      for (int k = 0; k < 2; ++k) {
        if (std::isnan(error[k])) continue;
        outcome.gross += std::abs(error[k]) > kGross_px;
        z2 += error[k] * error[k] / (sigma[k] * sigma[k]);
        errors.push_back(std::abs(error[k]));
      }
    }
    if (errors.empty()) return outcome;
    std::sort(errors.begin(), errors.end());
    outcome.rms_z = std::sqrt(z2 / static_cast<double>(errors.size()));
    outcome.median_px = errors[errors.size() / 2];
    outcome.largest_px = errors.back();
    return outcome;
  }
  RigCalibration rig_ = SyntheticRig();
};

TEST_F(PartialCodes, NoiseTakesSitesButLetsNoWrongOnesIn) {
  for (const int period : {kPeriodPx, kBitsAlone}) {
    double before = 1.0;
    for (const double read_noise : {2.0, 10.0, 20.0, 40.0, 80.0}) {
      rig_.camera.read_noise_dn = read_noise;
      const Frames frames = Shoot(rig_, 0, kBall, {.albedo = 0.4, .noise = true});
      const Outcome outcome = Judge(Decode(frames.Decode(rig_.projectors[0], period)).map, frames);
      // Of the same light throughout: what is too dark at more noise counts as lost.
      const double share = static_cast<double>(outcome.kept) / (rig_.camera.model.width * rig_.camera.model.height);
      std::printf("period %d, noise %.0f dn: %.3f of lit kept, %.3f of all; error/sigma %.2f, median %.3f px\n", period,
                  read_noise, outcome.Share(), share, outcome.rms_z, outcome.median_px);
      EXPECT_LE(share, before + 0.002) << read_noise;
      EXPECT_EQ(outcome.gross, 0) << read_noise;
      if (outcome.kept > 500) {
        EXPECT_GT(outcome.rms_z, 0.35) << read_noise;
        EXPECT_LT(outcome.rms_z, 1.25) << read_noise;
      }
      before = share;
    }
  }
}

TEST_F(PartialCodes, BlurredFineStripesWidenTheSigmaAndLoseNoSite) {
  const Frames sharp = Shoot(rig_, 0, kBall, {.blur_px = 0.5, .noise = true});
  const Frames blurred = Shoot(rig_, 0, kBall, {.blur_px = 1.6, .noise = true});
  const Outcome a = Judge(Decode(sharp.Decode(rig_.projectors[0], kBitsAlone)).map, sharp);
  const Outcome b = Judge(Decode(blurred.Decode(rig_.projectors[0], kBitsAlone)).map, blurred);
  EXPECT_GT(a.Share(), 0.99);
  EXPECT_GT(b.Share(), 0.98);
  EXPECT_LT(a.median_px, 0.12);
  EXPECT_LT(b.median_px, 0.15);
  EXPECT_EQ(a.gross + b.gross, 0);
  EXPECT_LT(b.rms_z, 1.2);
}

// A weak sinusoid's site falls back on its bits.
TEST_F(PartialCodes, DarkSkinIsDecodedWhereItIsLit) {
  const Frames frames = Shoot(rig_, 0, kBall, {.albedo = 0.06, .noise = true});
  const Outcome outcome = Judge(Decode(frames.Decode(rig_.projectors[0], kPeriodPx)).map, frames);
  EXPECT_GT(outcome.Share(), 0.93);
  EXPECT_EQ(outcome.gross, 0);
  EXPECT_NEAR(outcome.rms_z, 1.0, 0.2);
}

TEST_F(PartialCodes, ASaturatedWhiteLosesNoSite) {
  for (const int period : {kPeriodPx, kBitsAlone}) {
    const Frames frames = Shoot(rig_, 0, kBall, {.white_dn = 10000.0, .noise = true});
    const Outcome outcome = Judge(Decode(frames.Decode(rig_.projectors[0], period)).map, frames);
    EXPECT_GT(outcome.Share(), 0.98);
    EXPECT_EQ(outcome.gross, 0);
    EXPECT_LT(outcome.median_px, 0.15);
  }
}

TEST_F(PartialCodes, WhiteAndBlackStandForMissingInverses) {
  for (const int period : {kPeriodPx, kBitsAlone}) {
    const Frames frames = Shoot(rig_, 0, kBall, {.noise = true});
    const Outcome outcome = Judge(Decode(WithoutInverses(frames, period)).map, frames);
    EXPECT_GT(outcome.Share(), 0.97);
    EXPECT_EQ(outcome.gross, 0);
    EXPECT_LT(outcome.rms_z, 1.25);
  }
}

// The threshold's own noise counts, and the positive's twice.
TEST_F(PartialCodes, WithoutInversesNoiseTakesSitesButLetsNoWrongOnesIn) {
  const Frames frames = Shoot(rig_, 0, kBall, {.albedo = 0.08, .noise = true});
  const Outcome outcome = Judge(Decode(WithoutInverses(frames, kBitsAlone)).map, frames);
  const Outcome with = Judge(Decode(frames.Decode(rig_.projectors[0], kBitsAlone)).map, frames);
  std::printf("with inverses %.3f kept, without %.3f\n", with.Share(), outcome.Share());
  EXPECT_GT(outcome.kept, 1000);
  EXPECT_LT(outcome.Share(), 0.9 * with.Share());  // three times the variance
  EXPECT_EQ(outcome.gross, 0);
  EXPECT_LT(outcome.rms_z, 1.0);
}

// Half of 4095 lies below what global light alone gives here.
TEST_F(PartialCodes, ASaturatedWhiteIsNoThreshold) {
  const Frames frames = Shoot(rig_, 0, kBall, {.global = 0.5, .white_dn = 20000.0, .noise = true});
  EXPECT_EQ(Judge(Decode(WithoutInverses(frames, kBitsAlone)).map, frames).gross, 0);
}

// Beyond what the record calls saturated the camera is not linear, though its samples may still differ.
TEST_F(PartialCodes, APairOfSaturatedFramesTellsNothing) {
  rig_.camera.saturation_dn = 500.0;
  const Frames frames = Shoot(rig_, 0, kBall, {.global = 2.0, .white_dn = 3000.0, .noise = true});
  const DecodeReport report = Decode(frames.Decode(rig_.projectors[0], kBitsAlone));
  EXPECT_LT(Judge(report.map, frames).Share(), 0.3);  // grazing light
  EXPECT_GT(report.counts[static_cast<int>(DecodeReason::kSaturated)], 1000);
}

TEST_F(PartialCodes, WavesNeedNoInversesAndASaturatedFrameTakesItsPlaneAlone) {
  for (const int period : {kPeriodPx, kBitsAlone}) {
    const Frames whole = Shoot(rig_, 0, kBall, {.noise = true, .code = ColumnCode::kMicroPhase});
    const Outcome outcome = Judge(Decode(WithoutInverses(whole, period)).map, whole);
    EXPECT_GT(outcome.Share(), 0.95);
    EXPECT_EQ(outcome.gross, 0);
    DecodeInput input = whole.Decode(rig_.projectors[0], period);
    const Image<uint16_t> saturated(whole.black.width(), whole.black.height(), 1, uint16_t{4095});
    input.columns.bits[4].inverse = saturated;
    const Outcome but_one = Judge(Decode(input).map, whole);
    EXPECT_GT(but_one.Share(), 0.95);
    EXPECT_EQ(but_one.gross, 0);
    for (CodedBit& bit : input.columns.bits) bit.positive = saturated;
    const DecodeReport none = Decode(input);
    EXPECT_EQ(none.counts[0], 0);
    EXPECT_GT(none.counts[static_cast<int>(DecodeReason::kSaturated)], 1000);
  }
}

TEST_F(PartialCodes, WavesOfFewerColumnsThanTheyTellAreOutsideBeyondTheLast) {
  const Frames frames = Shoot(rig_, 0, kBall, {.code = ColumnCode::kMicroPhase});
  DecodeInput input = frames.Decode(rig_.projectors[0], kBitsAlone);
  input.columns.count = 257;  // of the 512 that are there; nine planes as before
  const DecodeReport report = Decode(input);
  EXPECT_GT(report.counts[0], 1000);
  EXPECT_GT(report.counts[static_cast<int>(DecodeReason::kOutside)] +
                report.counts[static_cast<int>(DecodeReason::kAmbiguous)],
            1000);
  for (size_t s = 0; s < report.map.reason.size(); ++s) {
    if (report.map.reason.data()[s] != 0) continue;
    ASSERT_NEAR(report.map.column.data()[s], frames.true_column.data()[s], 0.3);
  }
}

TEST_F(PartialCodes, OneAxisIsEnoughForTheDepth) {
  std::vector<DecodedMap> maps;
  for (int p = 0; p < 4; ++p) {
    const Frames frames = Shoot(rig_, p, kBall, {.noise = true});
    DecodeInput input = frames.Decode(rig_.projectors[p], kPeriodPx);
    (p % 2 == 0 ? input.rows : input.columns) = {};
    DecodeReport report = Decode(input);
    EXPECT_GT(Judge(report.map, frames).Share(), 0.97);
    const Image<float>& absent = p % 2 == 0 ? report.map.row : report.map.column;
    EXPECT_TRUE(std::ranges::all_of(absent.pixels(), [](float v) { return std::isnan(v); }));
    maps.push_back(std::move(report.map));
  }
  const auto depth = Triangulate(maps, rig_);
  ASSERT_TRUE(depth.ok());
  const SurfaceMap truth = TrueSurface(rig_, kBall);
  double squares = 0.0;
  int count = 0;
  for (int y = 0; y < truth.height(); ++y)
    for (int x = 0; x < truth.width(); ++x) {
      if (depth->surface.mask(x, y) == 0 || truth.mask(x, y) == 0) continue;
      squares += std::pow(depth->surface.point_mm(x, y, 2) - truth.point_mm(x, y, 2), 2);
      ++count;
    }
  EXPECT_GT(count, 5000);
  EXPECT_LT(std::sqrt(squares / count), 0.1);
}

TEST_F(PartialCodes, RefusesACaptureOfNoAxis) {
  const Frames frames = Shoot(rig_, 0, kBall, {});
  DecodeInput input = frames.Decode(rig_.projectors[0], kPeriodPx);
  input.rows = input.columns = {};
  EXPECT_EQ(DecodeGray(input, SensorNoise::From(rig_.camera)).status().code(), StatusCode::kUsage);
}

// A frame that was shot twice: its pair tells nothing.
TEST_F(PartialCodes, APairOfTheSameFrameIsCaught) {
  const Frames frames = Shoot(rig_, 0, kBall, {.noise = true});
  for (const int period : {kPeriodPx, kBitsAlone}) {
    DecodeInput input = frames.Decode(rig_.projectors[0], period);
    input.columns.bits[2].inverse = input.columns.bits[2].positive;
    const DecodeReport report = Decode(input);
    const Outcome outcome = Judge(report.map, frames);
    EXPECT_LT(outcome.Share(), 0.1);  // those on the edges of the bit's own stripes
    EXPECT_EQ(outcome.gross, 0);
    // Two bits, and a third that says nothing: the place is one of two cells that adjoin; near the middle of those, the
    // fourth agrees.
    EXPECT_GT(static_cast<double>(report.column_bit_counts[3] + report.column_bit_counts[4]),
              0.7 * static_cast<double>(outcome.lit));
  }
}

TEST_F(PartialCodes, TheFinestPairMayBeMissing) {
  const Frames frames = Shoot(rig_, 0, kBall, {.noise = true});
  DecodeInput input = frames.Decode(rig_.projectors[0], kBitsAlone);
  for (AxisCode* axis : {&input.columns, &input.rows}) axis->bits.back().inverse = axis->bits.back().positive;
  const Outcome outcome = Judge(Decode(input).map, frames);
  EXPECT_GT(outcome.Share(), 0.97);
  EXPECT_EQ(outcome.gross, 0);
  EXPECT_LT(outcome.rms_z, 1.3);
}

TEST_F(PartialCodes, NeighboursBeyondAnEdgeInDepthDoNotCount) {
  for (const double step_mm : {2.0, 5.0, 20.0, 80.0}) {
    const Surface stairs = [&](const Eigen::Vector3d& ray) -> std::optional<Hit> {
      const double z = ray.x() / ray.z() < 0.013 ? 680.0 : 680.0 - step_mm;
      return Hit{ray * (z / ray.z()), {0.0, 0.0, -1.0}};
    };
    const Frames frames = Shoot(rig_, 0, stairs, {.albedo = 0.3, .blur_px = 1.0, .noise = true});
    const Outcome outcome = Judge(Decode(frames.Decode(rig_.projectors[0], kBitsAlone)).map, frames);
    EXPECT_GT(outcome.Share(), 0.97) << step_mm;
    EXPECT_LT(outcome.largest_px, 1.5) << step_mm;
  }
}

}  // namespace
}  // namespace stratalux::fit
