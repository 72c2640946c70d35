// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/fit_summary.h"

#include <algorithm>

#include "fitter/stages/reflection_json.h"
#include "fitter/stages/stage_json.h"

namespace stratalux::fit {
namespace {

// Share of the fitted weight in layers wider than one line: what scattering, not the surface, contributes.
double WideWeightFraction(const MixtureMap& map, double line_mm) {
  double wide = 0.0, all = 0.0;
  for (int64_t i = 0; i < map.profiles(); ++i) {
    if (!map.Fitted(i)) continue;
    for (int l = 0; l < map.layers; ++l) {
      const double w = map.weight[i * map.layers + l];
      all += w;
      if (map.sigma_mm[i * map.layers + l] > line_mm) wide += w;
    }
    all += MeanOfLights(map, i).surface;
  }
  return all > 0.0 ? wide / all : 0.0;
}

double MeanLineWidth(const SrdSet& srds) {
  double sum = 0.0, count = 0.0;
  for (const SrdBatch& b : srds.batches)
    for (int64_t i = 0; i < b.profiles(); ++i)
      if (b.valid[i] != 0) {
        sum += b.line_width_mm[i];
        count += 1.0;
      }
  return count > 0.0 ? sum / count : 0.6;
}

template <typename T>
T Median(std::vector<T>& values) {
  const auto middle = values.begin() + static_cast<int64_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Of fewer photons than those of the session's mean that would count beside them.
bool IsWeak(const MixtureMap& map, int64_t profile, bool apart) {
  if (map.prior_share.empty()) return false;
  const double share = map.prior_share[profile];
  const double session = map.SessionPhotons();
  return (apart ? session : map.prior_photons) * (1.0 - share) < session * share;
}

}  // namespace

double MedianDivergence(const MixtureMap& map) {
  std::vector<float> divergence;
  for (int64_t i = 0; i < map.profiles(); ++i)
    if (map.Fitted(i)) divergence.push_back(map.divergence[i]);
  return divergence.empty() ? 0.0 : Median(divergence);
}

std::map<std::string, int64_t> MaskedByReason(const MixtureMap& map) {
  std::map<std::string, int64_t> masked;
  for (int64_t i = 0; i < map.profiles(); ++i)
    if (const auto reason = static_cast<FitReason>(map.reason[i]); reason != FitReason::kFitted)
      ++masked[ToString(reason)];
  return masked;
}

FitSummary Summarise(const MixtureMap& map, const SrdSet& srds, int heldout) {
  FitSummary summary;
  std::vector<int> iterations;
  for (int64_t i = 0; i < map.profiles(); ++i) {
    if (!map.Fitted(i)) continue;
    iterations.push_back(map.iterations[i]);
    summary.weak_pixels += IsWeak(map, i, srds.batches[heldout].IsApart(i)) ? 1 : 0;
  }
  summary.masked_by_reason = MaskedByReason(map);
  summary.pixels = static_cast<int64_t>(iterations.size());
  summary.tau = map.scattering.tau;
  summary.prior_photons = map.prior_photons;
  summary.reflection = map.scattering.reflection;
  summary.wide_weight_fraction = WideWeightFraction(map, MeanLineWidth(srds));
  summary.centroid = CompareCentroids(map, srds.batches[heldout], heldout);
  summary.divergence = MedianDivergence(map);
  if (iterations.empty()) return summary;
  summary.iterations_median = Median(iterations);
  return summary;
}

Status SaveSummary(const std::filesystem::path& folder, const FitSummary& s) {
  return WriteJson(folder / "summary.json",
                   {{"divergence", s.divergence},
                    {"iterations_median", s.iterations_median},
                    {"tau", s.tau},
                    {"surface", ReflectionJson(s.reflection)},
                    {"wide_weight_fraction", s.wide_weight_fraction},
                    {"pixels", s.pixels},
                    {"prior_photons", s.prior_photons},
                    {"weak_pixels", s.weak_pixels},
                    {"masked_by_reason", s.masked_by_reason},
                    {"centroid", {s.centroid.measured_mm, s.centroid.predicted_mm, s.centroid.rms_mm}},
                    {"centroid_profiles", s.centroid.profiles}});
}

Result<FitSummary> LoadSummary(const std::filesystem::path& folder) {
  FitSummary s;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "summary.json", [&](const nlohmann::json& json) {
    json.at("divergence").get_to(s.divergence);
    json.at("iterations_median").get_to(s.iterations_median);
    json.at("tau").get_to(s.tau);
    s.reflection = ReflectionFrom(json.at("surface"));
    json.at("wide_weight_fraction").get_to(s.wide_weight_fraction);
    json.at("pixels").get_to(s.pixels);
    json.at("prior_photons").get_to(s.prior_photons);
    json.at("weak_pixels").get_to(s.weak_pixels);
    json.at("masked_by_reason").get_to(s.masked_by_reason);
    const auto& centroid = json.at("centroid");
    s.centroid = {centroid.at(0), centroid.at(1), centroid.at(2), json.at("centroid_profiles")};
  }));
  return s;
}

}  // namespace stratalux::fit
