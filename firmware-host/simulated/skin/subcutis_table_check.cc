// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin/subcutis_table_check.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "shared/base/check.h"
#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

constexpr size_t kSubcutisRings = kCheckRingsMm.size() - 1;
constexpr size_t kSums = kSubcutisRings + 1;  // the last: all light

std::vector<double> NodesOrMiddles(std::span<const double> nodes, SubcutisPlaces places) {
  return places == SubcutisPlaces::kNodes ? std::vector<double>(nodes.begin(), nodes.end()) : MiddlesOf(nodes);
}

// One skin in one subcutis: what the table says of it, and where its photons' paths count.
struct SubcutisSkin {
  SkinParameters parameters;
  size_t epidermis_layers = 0;
  std::array<double, 3> usual_absorption{}, absorption{};
  SubcutisTable::Rings level{}, slope{};  // over the cosines
};

// The table's ratio is a straight line of the cosines.
void AskTable(const SubcutisTable& table, int channel, SubcutisSkin& skin) {
  const auto normal = table.LogRatio(channel, skin.parameters, {0.0F, 0.0F, 0.0F});
  const auto steep = static_cast<float>(RadFromDeg(80.0));
  const auto oblique = table.LogRatio(channel, skin.parameters, {steep, steep, 0.0F});
  const double at_normal = SubcutisGrid::CosinesOf(0.0, 0.0), sin2 = std::pow(std::sin(steep), 2);
  const double at_oblique = SubcutisGrid::CosinesOf(sin2, sin2);
  for (size_t r = 0; r < normal.size(); ++r) {
    skin.slope[r] = static_cast<float>((normal[r] - oblique[r]) / (at_normal - at_oblique));
    skin.level[r] = static_cast<float>(normal[r] - at_normal * skin.slope[r]);
  }
}

// A share of the light as the table and as photons have it: each photon's parts of the two, summed.
struct Compared {
  double table = 0.0, photons = 0.0, table2 = 0.0, photons2 = 0.0, both = 0.0;
  void Add(double of_table, double of_photons) {
    table += of_table;
    photons += of_photons;
    table2 += of_table * of_table;
    photons2 += of_photons * of_photons;
    both += of_table * of_photons;
  }
  [[nodiscard]] InterpolationSample::Share Share(double count) const {
    const double variance = table2 / (table * table) + photons2 / (photons * photons) - 2.0 * both / (table * photons);
    return {table / count, photons / count, std::sqrt(std::max(0.0, variance)) * photons / count};
  }
};

class SubcutisComparison {
 public:
  SubcutisComparison(const SubcutisTable& table, const SubcutisCheckOptions& options)
      : table_(table), options_(options), epidermis_(NodesOrMiddles(SkinGrid::kEpidermisMm, options.places)) {
    const auto& s = table.scatterings();
    SLX_CHECK(s.size() >= 2);
    scattering_ = options.places == SubcutisPlaces::kNodes ? s[1] : std::sqrt(s[0] * s[1]);
  }

  // Photons that leave clear skin, in their order.
  [[nodiscard]] std::vector<EscapedPhoton> Trace(int channel, double theta_deg, double skin_mm) const {
    MonteCarloOptions run;
    run.photons = options_.photons;
    run.seed = options_.seed * 7919 + channel * 101 + std::lround(10.0 * theta_deg) + std::lround(1e6 * skin_mm);
    run.sin2_theta_low = run.sin2_theta_high = std::pow(std::sin(RadFromDeg(theta_deg)), 2);
    run.max_path_mm = 200.0;
    run.max_radius_mm = 40.0;
    run.threads = options_.threads;
    std::vector<std::vector<EscapedPhoton>> chunks(static_cast<size_t>(MonteCarloChunks(run)));
    TraceLayeredTissue(ClearSkin(channel, Borders(skin_mm), scattering_, skin_mm), run,
                       [&](int64_t chunk, std::span<const EscapedPhoton> list) {
                         chunks[static_cast<size_t>(chunk)].assign(list.begin(), list.end());
                       });
    std::vector<EscapedPhoton> photons;
    for (const auto& chunk : chunks) photons.insert(photons.end(), chunk.begin(), chunk.end());
    return photons;
  }

  // Adds the samples of one channel, incidence and depth in all absorptions. `usual_photons`: what Trace finds at
  // kSkinMm.
  void Add(int channel, double theta_deg, double skin_mm, const std::vector<double>& absorptions,
           const std::vector<EscapedPhoton>& usual_photons, std::vector<InterpolationSample>& samples) const {
    std::vector<SubcutisSkin> skins;
    for (const double absorption : absorptions)
      for (const SkinParameters& skin : Skins()) {
        SubcutisSkin s{skin, 0, SkinAbsorption(channel, skin), {}, {}, {}};
        s.parameters.skin_mm = skin_mm;
        s.parameters.subcutis_absorption = static_cast<float>(absorption);
        s.absorption = SkinAbsorption(channel, s.parameters);
        while (s.epidermis_layers < epidermis_.size() && epidermis_[s.epidermis_layers] < 1.001 * skin.epidermis_mm)
          ++s.epidermis_layers;
        AskTable(table_, channel, s);
        skins.push_back(s);
      }
    std::vector<std::array<Compared, kSums>> sums(skins.size());
    const bool same = skin_mm == kSkinMm;
    const auto add = [&](size_t s, const Seen& seen, double share, double of_table, double of_photons) {
      sums[s][kSubcutisRings].Add(share * of_table, share * of_photons);
      if (seen.ring < kSubcutisRings) sums[s][seen.ring].Add(share * of_table, share * of_photons);
    };
    See(usual_photons, kSkinMm, skins, [&](size_t s, const Seen& seen) {
      const double table = seen.usual * std::exp(seen.log_ratio);
      if (same) return add(s, seen, 1.0, table, seen.weight);
      seen.deep ? add(s, seen, 1.0, table, 0.0) : add(s, seen, 0.5, table, seen.usual);
    });
    if (!same)
      See(Trace(channel, theta_deg, skin_mm), skin_mm, skins, [&](size_t s, const Seen& seen) {
        seen.deep ? add(s, seen, 1.0, 0.0, seen.weight)
                  : add(s, seen, 0.5, seen.usual * std::exp(seen.log_ratio), seen.weight);
      });
    for (size_t s = 0; s < skins.size(); ++s) {
      InterpolationSample sample{channel, theta_deg, skins[s].parameters, {}, {}};
      const auto count = static_cast<double>(options_.photons);
      for (size_t k = 0; k < kSubcutisRings; ++k) sample.rings.push_back(sums[s][k].Share(count));
      sample.total = sums[s][kSubcutisRings].Share(count);
      samples.push_back(sample);
    }
  }

 private:
  // A photon in one skin: its weight with the skin table's subcutis, and with the skin's own absorption below.
  struct Seen {
    size_t ring = 0;  // kSubcutisRings: further out, in all light alone
    bool deep = false;
    double usual = 0.0, weight = 0.0, log_ratio = 0.0;
  };

  [[nodiscard]] std::vector<SkinParameters> Skins() const {
    std::vector<SkinParameters> skins;
    for (const double m : NodesOrMiddles(SkinGrid::kMelanin, options_.places))
      for (const double b : NodesOrMiddles(SkinGrid::kBlood, options_.places))
        for (const double e : epidermis_)
          skins.push_back(
              {static_cast<float>(m), static_cast<float>(b), static_cast<float>(e), static_cast<float>(scattering_)});
    return skins;
  }

  [[nodiscard]] std::vector<double> Borders(double skin_mm) const {
    std::vector<double> borders = epidermis_;
    const double least = SubcutisGrid::kSkinMm.back();
    if (skin_mm > least) borders.push_back(least);
    return borders;
  }

  // visit(skin, seen) of each photon and skin.
  template <typename Visit>
  void See(const std::vector<EscapedPhoton>& photons, double skin_mm, const std::vector<SubcutisSkin>& skins,
           const Visit& visit) const {
    const size_t deepest = epidermis_.size() + 1, subcutis = Borders(skin_mm).size() + 1;
    for (const EscapedPhoton& e : photons) {
      const double r = std::hypot(e.x_mm, e.y_mm), sin2_out = std::max(0.0, 1.0 - double(e.uz) * e.uz);
      if (sin2_out >= SkinGrid::Sin2Edge(SkinGrid::kThetas) || r >= SkinGrid::kMaxRadiusMm) continue;
      size_t of_table = 0;
      while (of_table + 1 < SkinGrid::kRadii && r >= SkinGrid::RadiusEdgeMm(static_cast<int>(of_table) + 1)) ++of_table;
      const double cosines = SubcutisGrid::CosinesOf(e.sin2_theta_in, sin2_out);
      Seen seen;
      seen.ring = std::upper_bound(kCheckRingsMm.begin(), kCheckRingsMm.end(), r) - kCheckRingsMm.begin() - 1;
      seen.deep = e.path_mm[deepest] > 0.0F || e.path_mm[subcutis] > 0.0F;
      for (size_t s = 0; s < skins.size(); ++s) {
        double above = 0.0, below = 0.0;
        for (size_t l = 0; l < subcutis; ++l) (l < skins[s].epidermis_layers ? above : below) += e.path_mm[l];
        const auto &u = skins[s].usual_absorption, &a = skins[s].absorption;
        const double skin = e.weight * std::exp(-a[0] * above - a[1] * below);
        seen.usual = skin * std::exp(-u[2] * e.path_mm[subcutis]);
        seen.weight = skin * std::exp(-a[2] * e.path_mm[subcutis]);
        seen.log_ratio = skins[s].level[of_table] + cosines * skins[s].slope[of_table];
        visit(s, seen);
      }
    }
  }

  const SubcutisTable& table_;
  const SubcutisCheckOptions& options_;
  std::vector<double> epidermis_;
  double scattering_ = 1.0;
};

}  // namespace

std::vector<InterpolationSample> CheckSubcutis(const SubcutisTable& table, const SubcutisCheckOptions& options) {
  const auto& depths = SubcutisGrid::kSkinMm;
  const auto& absorptions = SubcutisGrid::kAbsorption;
  const SubcutisComparison comparison(table, options);
  std::vector<InterpolationSample> samples;
  for (const int channel : options.channels)
    for (const double theta : options.theta_in_deg) {
      const std::vector<EscapedPhoton> usual = comparison.Trace(channel, theta, kSkinMm);
      if (options.places == SubcutisPlaces::kNodes) {
        comparison.Add(channel, theta, depths[0], {absorptions[1]}, usual, samples);
        for (const double depth : {depths[1], depths[2]})
          comparison.Add(channel, theta, depth, {absorptions[0], absorptions[1]}, usual, samples);
      } else {
        const double middle = std::sqrt(absorptions[0] * absorptions[1]);
        comparison.Add(channel, theta, depths[0], {middle}, usual, samples);
        for (size_t d = 0; d + 1 < depths.size(); ++d)
          comparison.Add(channel, theta, 0.5 * (depths[d] + depths[d + 1]), {absorptions[0], middle}, usual, samples);
      }
    }
  return samples;
}

}  // namespace stratalux::rig
