// SPDX-License-Identifier: Apache-2.0
// Filling the table of other subcutis. Photons run once per channel, scattering and depth of the subcutis, which
// scatters otherwise than the dermis; its absorption, like the skin's, re-weights them by their path lengths, exactly.
// What never came as deep as the least of the depths is the same light in all of them: it is pooled, so that its noise
// takes no part in what they differ by.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>

#include <nlohmann/json.hpp>

#include "firmware-host/simulated/skin/subcutis_table.h"
#include "shared/base/version.h"

namespace stratalux::rig {
namespace {

constexpr int kSkins = SkinGrid::kNodes, kTableRings = SkinGrid::kRadii;
constexpr size_t kSubcutisDepths = SubcutisGrid::kSkinMm.size();

// Powers of the cosines, from 0, that weigh the light; behind them the squares of the light's weights.
constexpr int kPowers = 4;
enum Quantity {
  kShallow = 0,         // light that stayed above the least depth
  kLit = kPowers,       // deeper light, the subcutis as in the skin table
  kDark = 2 * kPowers,  // the same light, where the subcutis absorbs more
  kShallowSquares = 3 * kPowers,
  kLitSquares,
  kDarkSquares,
  kLitTimesDark,
  kQuantities
};

// Sums over photons, by ring and skin.
class RingSums {
 public:
  RingSums() : sums_(size_t{kTableRings} * kQuantities * kSkins, 0.0) {}
  double* At(int ring, int quantity) { return sums_.data() + (size_t(ring) * kQuantities + quantity) * kSkins; }
  [[nodiscard]] double Of(int ring, int quantity, int skin) const {
    return sums_[(size_t(ring) * kQuantities + quantity) * kSkins + skin];
  }
  void Add(const RingSums& other) {
    for (size_t k = 0; k < sums_.size(); ++k) sums_[k] += other.sums_[k];
  }

 private:
  std::vector<double> sums_;
};

int RingOf(double r_mm) {
  if (r_mm < SkinGrid::kFirstRadiusMm) return 0;
  const double share =
      std::log(r_mm / SkinGrid::kFirstRadiusMm) / std::log(SkinGrid::kMaxRadiusMm / SkinGrid::kFirstRadiusMm);
  return std::min(1 + static_cast<int>(share * (kTableRings - 1)), kTableRings - 1);
}

// Photons of one channel and depth. The layers of their run: the skin between the thickness nodes, the dermis to the
// least depth, the rest of the dermis (where there is one), the subcutis.
class RingTally {
 public:
  RingTally(int channel, size_t depth) : subcutis_layer_(depth + 1 < kSubcutisDepths ? kDeepest + 1 : kDeepest) {
    for (size_t m = 0; m < kM; ++m)
      epidermis_[m] = SkinAbsorption(channel, {static_cast<float>(SkinGrid::kMelanin[m])})[0];
    for (size_t b = 0; b < kB; ++b)
      dermis_[b] = SkinAbsorption(channel, {0.0F, static_cast<float>(SkinGrid::kBlood[b])})[1];
    for (size_t a = 0; a < subcutis_.size(); ++a)
      subcutis_[a] =
          SkinAbsorption(channel, {.subcutis_absorption = static_cast<float>(SubcutisGrid::kAbsorption[a])})[2];
  }

  static Tissue Layers(int channel, double scattering, size_t depth) {
    std::vector<double> borders(SkinGrid::kEpidermisMm.begin(), SkinGrid::kEpidermisMm.end());
    if (depth + 1 < kSubcutisDepths) borders.push_back(SubcutisGrid::kSkinMm.back());
    return ClearSkin(channel, borders, scattering, SubcutisGrid::kSkinMm[depth]);
  }

  void Add(const EscapedPhoton& e, RingSums& sums) const {
    const double sin2_out = std::max(0.0, 1.0 - double(e.uz) * e.uz);
    const double r = std::hypot(e.x_mm, e.y_mm);
    if (sin2_out >= SkinGrid::Sin2Edge(SkinGrid::kThetas) || r >= SkinGrid::kMaxRadiusMm) return;
    const std::array<double, kSkins> skin = SkinWeights(e);
    const int ring = RingOf(r);
    const double cosines = SubcutisGrid::CosinesOf(e.sin2_theta_in, sin2_out);
    const auto add = [&](int quantity, double factor) {
      double* to = sums.At(ring, quantity);
      for (size_t n = 0; n < skin.size(); ++n) to[n] += factor * skin[n];
    };
    const auto add_product = [&](int quantity, double factor) {
      double* to = sums.At(ring, quantity);
      for (size_t n = 0; n < skin.size(); ++n) to[n] += factor * skin[n] * skin[n];
    };
    if (!(e.path_mm[kDeepest] > 0.0F || e.path_mm[kDeepest + 1] > 0.0F)) {
      for (int k = 0; k < kPowers; ++k) add(kShallow + k, std::pow(cosines, k));
      return add_product(kShallowSquares, 1.0);
    }
    const double path = e.path_mm[subcutis_layer_];
    const double lit = std::exp(-subcutis_[0] * path), dark = std::exp(-subcutis_[1] * path);
    for (int k = 0; k < kPowers; ++k) add(kLit + k, lit * std::pow(cosines, k));
    for (int k = 0; k < kPowers; ++k) add(kDark + k, dark * std::pow(cosines, k));
    add_product(kLitSquares, lit * lit);
    add_product(kDarkSquares, dark * dark);
    add_product(kLitTimesDark, lit * dark);
  }

 private:
  static constexpr size_t kM = SkinGrid::kMelanin.size(), kB = SkinGrid::kBlood.size(),
                          kE = SkinGrid::kEpidermisMm.size();
  static constexpr size_t kDeepest = kE + 1;  // the first layer below the least depth

  // By the paths in epidermis and dermis, each node of the skin.
  [[nodiscard]] std::array<double, kSkins> SkinWeights(const EscapedPhoton& e) const {
    std::array<double, kSkins> weights{};
    double skin = 0.0, above = 0.0;
    for (size_t l = 0; l < subcutis_layer_; ++l) skin += e.path_mm[l];
    for (size_t k = 0; k < kE; ++k) {
      above += e.path_mm[k];
      std::array<double, kB> dermis{};
      for (size_t b = 0; b < kB; ++b) dermis[b] = e.weight * std::exp(-dermis_[b] * (skin - above));
      for (size_t m = 0; m < kM; ++m) {
        const double epidermis = std::exp(-epidermis_[m] * above);
        for (size_t b = 0; b < kB; ++b) weights[(m * kB + b) * kE + k] = epidermis * dermis[b];
      }
    }
    return weights;
  }

  size_t subcutis_layer_;
  std::array<double, kM> epidermis_{};
  std::array<double, kB> dermis_{};
  std::array<double, SubcutisGrid::kAbsorption.size()> subcutis_{};
};

RingSums RunSubcutis(const SkinTableRun& run, int channel, double scattering, size_t depth) {
  MonteCarloOptions options;
  options.photons = run.photons;
  options.seed = run.seed * 1000003 + 5003 + channel * 101 + depth;  // none of the skin table's
  options.sin2_theta_low = 0.0;
  options.sin2_theta_high = SkinGrid::Sin2Edge(SkinGrid::kThetas);
  options.max_path_mm = 200.0;  // as the skin table's
  options.max_radius_mm = 40.0;
  options.threads = run.threads;
  const RingTally tally(channel, depth);
  // Chunks are added in their order, whichever thread brings them first: the sum's last bits follow from it.
  RingSums sums;
  std::map<int64_t, RingSums> waiting;
  int64_t next = 0;
  std::mutex mutex;
  TraceLayeredTissue(RingTally::Layers(channel, scattering, depth), options,
                     [&](int64_t chunk, std::span<const EscapedPhoton> list) {
                       RingSums part;
                       for (const EscapedPhoton& e : list) tally.Add(e, part);
                       const std::lock_guard lock(mutex);
                       waiting.emplace(chunk, std::move(part));
                       for (auto first = waiting.begin(); first != waiting.end() && first->first == next; ++next) {
                         sums.Add(first->second);
                         first = waiting.erase(first);
                       }
                     });
  return sums;
}

// A ring's logarithm of the ratio as level + slope * cosines, and the variance of each; infinite where no light says.
struct RingFit {
  double level = 0.0, slope = 0.0;
  double level_variance = std::numeric_limits<double>::infinity(), slope_variance = level_variance;
};

// From moments of the light by the cosines' powers: `usual` and the first two of `other`, whose light is the usual
// one's times exp(level + slope * cosines), to second order of the slope.
RingFit FitRing(const std::array<double, kPowers>& usual, const std::array<double, 2>& other, double variance) {
  if (!(usual[0] > 0.0) || !(other[0] > 0.0)) return {};
  const auto& u = usual;
  constexpr double kSteepest = 4.0;
  const double mean = other[1] / other[0];
  RingFit fit;
  for (int round = 0; round < 8; ++round) {
    const double s = fit.slope;
    const double miss = u[1] + s * u[2] + 0.5 * s * s * u[3] - mean * (u[0] + s * u[1] + 0.5 * s * s * u[2]);
    const double rise = u[2] + s * u[3] - mean * (u[1] + s * u[2]);
    if (!(rise > 0.0)) break;
    fit.slope = std::clamp(s - miss / rise, -kSteepest, kSteepest);
  }
  fit.level = std::log(other[0] / (u[0] + fit.slope * u[1] + 0.5 * fit.slope * fit.slope * u[2]));
  const double spread = u[2] / u[0] - std::pow(u[1] / u[0], 2);
  fit.level_variance = variance;
  if (spread > 0.0) fit.slope_variance = variance / spread;
  return fit;
}

// Noise is smoothed away where it is more than what a smooth curve over the rings' logarithm can be: the most likely
// values where second differences are normal, with standard deviation `bend`.
std::array<double, kTableRings> SmoothOverRings(const std::array<double, kTableRings>& values,
                                                const std::array<double, kTableRings>& variances, double bend) {
  constexpr double kLeast = 1e-3;  // standard deviation; no smaller one is worth having
  Eigen::Matrix<double, kTableRings, kTableRings> normal = Eigen::Matrix<double, kTableRings, kTableRings>::Zero();
  Eigen::Vector<double, kTableRings> right = Eigen::Vector<double, kTableRings>::Zero();
  for (int r = 0; r + 2 < kTableRings; ++r) {
    const Eigen::Vector3d second(1.0, -2.0, 1.0);
    normal.block<3, 3>(r, r) += second * second.transpose() / (bend * bend);
  }
  for (int r = 0; r < kTableRings; ++r) {
    const double weight = 1.0 / (variances[r] + kLeast * kLeast);
    normal(r, r) += weight;
    right[r] += weight * values[r];
  }
  const Eigen::Vector<double, kTableRings> smooth = normal.ldlt().solve(right);
  std::array<double, kTableRings> result{};
  std::copy_n(smooth.data(), kTableRings, result.begin());
  return result;
}

// What a kind of subcutis does to one skin, from the sums of all depths.
std::array<RingFit, kTableRings> FitKind(const std::array<RingSums, kSubcutisDepths>& sums, int kind, int skin) {
  const size_t depth = (kind + 1) / SubcutisGrid::kAbsorption.size();
  const bool dark = (kind + 1) % SubcutisGrid::kAbsorption.size() != 0;
  std::array<RingFit, kTableRings> fits{};
  for (int r = 0; r < kTableRings; ++r) {
    const auto of = [&](size_t d, int quantity) { return sums[d].Of(r, quantity, skin); };
    const auto shallow = [&](int quantity) {
      double sum = 0.0;
      for (size_t d = 0; d < kSubcutisDepths; ++d) sum += of(d, quantity);
      return sum / kSubcutisDepths;
    };
    std::array<double, kPowers> usual{};
    std::array<double, 2> other{};
    for (int k = 0; k < kPowers; ++k) usual[k] = shallow(kShallow + k) + of(0, kLit + k);
    for (int k = 0; k < 2; ++k) other[k] = shallow(kShallow + k) + of(depth, (dark ? kDark : kLit) + k);
    const double u = 1.0 / usual[0], o = 1.0 / other[0];
    double variance = shallow(kShallowSquares) / kSubcutisDepths * (o - u) * (o - u) + of(0, kLitSquares) * u * u +
                      of(depth, dark ? kDarkSquares : kLitSquares) * o * o;
    if (depth == 0) variance -= 2.0 * of(0, kLitTimesDark) * u * o;  // the very same photons
    fits[r] = FitRing(usual, other, std::max(0.0, variance));
  }
  return fits;
}

// Level and slope of every ring. Beyond the last ring that photons tell anything of, that ring's: next to no light.
void StoreKind(const std::array<RingFit, kTableRings>& fits, float codes_per_unit, int16_t* codes) {
  constexpr double kLevelBend = 0.05, kSlopeBend = 0.03;  // measured: mostly 0.01 to 0.1 a ring, slopes half of it
  constexpr double kKnown = 0.25;                         // standard deviation
  std::array<double, kTableRings> levels{}, slopes{}, level_variances{}, slope_variances{};
  int last = 0;
  for (int r = 0; r < kTableRings; ++r) {
    levels[r] = fits[r].level;
    slopes[r] = fits[r].slope;
    level_variances[r] = fits[r].level_variance;
    slope_variances[r] = fits[r].slope_variance;
    if (level_variances[r] < kKnown * kKnown) last = r;
  }
  levels = SmoothOverRings(levels, level_variances, kLevelBend);
  slopes = SmoothOverRings(slopes, slope_variances, kSlopeBend);
  constexpr double kMost = 32000.0;
  for (int r = 0; r < kTableRings; ++r) {
    const auto code = [&](double value) {
      return static_cast<int16_t>(std::lround(std::clamp(value * codes_per_unit, -kMost, kMost)));
    };
    codes[r] = code(levels[std::min(r, last)]);
    codes[kTableRings + r] = code(slopes[std::min(r, last)]);
  }
}

}  // namespace

Result<SubcutisTable> GenerateSubcutisTable(const SkinTableRun& run, std::vector<double> scatterings, Logger& logger) {
  constexpr int64_t kFewest = 1000, kMost = 10'000'000;
  if (run.photons < kFewest || run.photons > kMost)
    return Status::Usage("table of other subcutis: photons = " + std::to_string(run.photons) +
                         ", allowed: " + std::to_string(kFewest) + " .. " + std::to_string(kMost));
  SLX_RETURN_IF_ERROR(CheckScatterings(scatterings));
  auto contents = std::make_shared<SubcutisTable::Contents>();
  constexpr size_t kNodeCodes = size_t{SubcutisGrid::kKinds} * SubcutisGrid::kKindCodes;
  contents->codes.resize(kSkinChannels * scatterings.size() * kSkins * kNodeCodes);
  Progress progress(logger, "other subcutis",
                    std::ssize(scatterings) * kSkinChannels * std::ssize(SubcutisGrid::kSkinMm));
  int16_t* codes = contents->codes.data();
  for (int c = 0; c < kSkinChannels; ++c)
    for (const double scattering : scatterings) {
      std::array<RingSums, kSubcutisDepths> sums;
      for (size_t depth = 0; depth < kSubcutisDepths; ++depth) {
        sums[depth] = RunSubcutis(run, c, scattering, depth);
        progress.Advance();
      }
      for (int skin = 0; skin < kSkins; ++skin)
        for (int kind = 0; kind < SubcutisGrid::kKinds; ++kind, codes += SubcutisGrid::kKindCodes)
          StoreKind(FitKind(sums, kind, skin), SubcutisTable::kCodesPerUnit, codes);
    }
  contents->manifest = nlohmann::ordered_json{
      {"table", "stratalux other subcutis"},
      {"version", 1},
      {"program", kVersion},
      {"photons_per_run", run.photons},
      {"runs", kSkinChannels * scatterings.size() * kSubcutisDepths},
      {"skin_mm", SubcutisGrid::kSkinMm},
      {"absorption", SubcutisGrid::kAbsorption},
      {"scatterings", scatterings},
      {"seed", run.seed}}.dump();
  contents->scatterings = std::move(scatterings);
  return SubcutisTable(std::move(contents));
}

}  // namespace stratalux::rig
