// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/metrics.h"

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

namespace stratalux::fit {

double HeldOutFigure::AboveNoise() const {
  return std::sqrt(std::max(0.0, error.nrmse * error.nrmse - noise_nrmse * noise_nrmse));
}

std::string Metrics::ToJson() const {
  using Json = nlohmann::ordered_json;
  Json json = {{"schema", 1}, {"session", session}, {"fit_id", fit}, {"program_version", program_version}};
  json["options"] = options_json.empty() ? Json::object() : Json::parse(options_json);
  json["heldout"] = Json::array();
  for (const HeldOutFigure& f : heldout)
    json["heldout"].push_back({{"projector", f.projector},
                               {"light", f.light},
                               {"model", f.model},
                               {"part", f.part},
                               {"direct", f.direct},
                               {"geometry", f.geometry},
                               {"pool", f.pool},
                               {"nrmse", f.error.nrmse},
                               {"noise_nrmse", f.noise_nrmse},
                               {"nrmse_above_noise", f.AboveNoise()},
                               {"bias", f.error.bias},
                               {"nrmse_rgb", f.error.nrmse_channel},
                               {"psnr_db", f.error.psnr_db},
                               {"ssim", f.error.ssim},
                               {"pixels", f.error.pixels}});
  json["ablations"] = Json::array();
  for (const AblationFigure& a : ablations)
    json["ablations"].push_back({{"name", a.name},
                                 {"projector", a.projector},
                                 {"light", a.light},
                                 {"part", a.part},
                                 {"nrmse", a.nrmse},
                                 {"baseline_nrmse", a.baseline_nrmse}});
  json["srd_centroid"] = Json::array();
  for (const CentroidFigure& c : centroids)
    json["srd_centroid"].push_back({{"projector", c.projector},
                                    {"geometry", c.geometry},
                                    {"measured_mm_per_shift", c.error.measured_mm},
                                    {"predicted_mm_per_shift", c.error.predicted_mm},
                                    {"rms_mm", c.error.rms_mm},
                                    {"profiles", c.error.profiles}});
  json["fit"] = {
      {"divergence", divergence},
      {"iterations_median", iterations_median},
      {"tau", tau},
      {"surface",
       reflection.Known() ? Json{{"strength", reflection.strength}, {"roughness", reflection.roughness}} : Json()},
      {"wide_weight_fraction", wide_weight_fraction},
      {"pixels", pixels},
      {"prior_photons", prior_photons},
      {"weak_pixels", weak_pixels},
      {"masked_by_reason", masked_by_reason}};
  json["sweeps"] = Json::array();
  for (const SweepFigure& s : sweeps)
    json["sweeps"].push_back(
        {{"projector", s.projector},
         {"axis", s.axis},
         {"profiles_by_reason", s.profiles_by_reason},
         {"missing_frames", s.missing_frames},
         {"energy",
          {{"profiles", s.energy_profiles}, {"median_ratio", s.energy_median}, {"p95_error", s.energy_p95_error}}}});
  json["stages"] = Json::array();
  for (const StageFigure& s : stages)
    json["stages"].push_back({{"name", s.name},
                              {"seconds", s.seconds},
                              {"cpu_seconds", s.cpu_seconds},
                              {"peak_rss_bytes", s.peak_rss_bytes}});
  json["drift"] = {{"warning", drift.warning}, {"projectors", Json::array()}};
  for (const ProjectorDrift& d : drift.projectors)
    json["drift"]["projectors"].push_back({{"projector", d.projector},
                                           {"points", d.points},
                                           {"shift_columns", d.shift_columns},
                                           {"shift_rows", d.shift_rows},
                                           {"shift_px", d.shift_px},
                                           {"turned_deg", d.turned_deg},
                                           {"spread_px", d.spread_px},
                                           {"expected_px", d.expected_px},
                                           {"moved", d.moved}});
  if (truth)
    json["truth"] = {{"depth_rms_mm", truth->depth_rms_mm},
                     {"depth_bias_mm", truth->depth_bias_mm},
                     {"normal_median_deg", truth->normal_median_deg},
                     {"pixels", truth->pixels}};
  return json.dump(1) + "\n";
}

}  // namespace stratalux::fit
