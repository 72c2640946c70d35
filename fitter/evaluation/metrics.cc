// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/metrics.h"

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include "fitter/evaluation/metrics_json.h"
#include "fitter/stages/reflection_json.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

nlohmann::ordered_json JsonOf(const SurfaceError& error) {
  nlohmann::ordered_json json = {{"depth_rms_mm", error.depth_rms_mm},
                                 {"depth_bias_mm", error.depth_bias_mm},
                                 {"normal_median_deg", error.normal_median_deg},
                                 {"pixels", error.pixels},
                                 {"columns", nlohmann::ordered_json::array()}};
  for (const ColumnError& c : error.columns)
    json["columns"].push_back(
        {{"projector", c.projector}, {"mean_px", c.mean_px}, {"rms_px", c.rms_px}, {"quads", c.quads}});
  return json;
}

nlohmann::ordered_json JsonOf(const AngleError& error) {
  return {{"median_deg", error.median_deg}, {"rms_deg", error.rms_deg}, {"quads", error.quads}};
}

nlohmann::ordered_json JsonOf(const NormalFigures& normals) {
  nlohmann::ordered_json json = {{"specular", JsonOf(normals.specular)},
                                 {"surface", JsonOf(normals.surface)},
                                 {"photometric", JsonOf(normals.photometric)},
                                 {"diffuse", nlohmann::ordered_json::array()}};
  for (const NormalFigures::Diffuse& d : normals.diffuse)
    json["diffuse"].push_back({{"colour", d.colour},
                               {"filtered", JsonOf(d.filtered)},
                               {"unfiltered", JsonOf(d.unfiltered)},
                               {"width_mm", d.width_mm},
                               {"true_width_mm", d.true_width_mm}});
  return json;
}

nlohmann::ordered_json JsonOf(const SkinFigure& skin) {
  nlohmann::ordered_json json = {{"surface", skin.surface},
                                 {"skin", skin.skin},
                                 {"told", skin.told},
                                 {"surface_by_reason", skin.surface_by_reason}};
  if (skin.truth)
    json["truth"] = {{"iou", skin.truth->IntersectionOverUnion()},
                     {"skin_in_both", skin.truth->both},
                     {"skin_in_mask_alone", skin.truth->only_estimate},
                     {"skin_in_truth_alone", skin.truth->only_reference}};
  return json;
}

nlohmann::ordered_json JsonOf(const IntervalFigures& intervals) {
  nlohmann::ordered_json json = {{"schema", kIntervalsSchema},
                                 {"learnt_from", intervals.learnt_from},
                                 {"colours", nlohmann::ordered_json::array()},
                                 {"covered", nlohmann::ordered_json::array()}};
  for (const PredictionError& e : intervals.colours) json["colours"].push_back(e);
  for (const IntervalFigures::Covered& c : intervals.covered)
    json["covered"].push_back({{"projector", c.projector},
                               {"light", c.light},
                               {"share", c.share},
                               {"half_width", c.half_width},
                               {"samples", c.samples}});
  return json;
}

double FigureOf(const nlohmann::json& json) { return json.is_null() ? std::nan("") : json.get<double>(); }

}  // namespace

double HeldOutFigure::WithoutNoise() const {
  const double left = error.nrmse * error.nrmse - noise_nrmse * noise_nrmse;
  return left < 0.0 ? 0.0 : std::sqrt(left);  // NaN stays
}

void to_json(nlohmann::ordered_json& json, const HeldOutFigure& f) {
  json = {{"projector", f.projector},
          {"light", f.light},
          {"model", f.model},
          {"part", f.part},
          {"direct", f.direct},
          {"geometry", f.geometry},
          {"pool", f.pool},
          {"takes", f.takes},
          {"nrmse", f.error.nrmse},
          {"noise_nrmse", f.noise_nrmse},
          {"camera_noise_nrmse", f.camera_noise_nrmse},
          {"nrmse_without_noise", f.WithoutNoise()},
          {"bias", f.error.bias},
          {"nrmse_rgb", f.error.nrmse_channel},
          {"psnr_db", f.error.psnr_db},
          {"ssim", f.error.ssim},
          {"pixels", f.error.pixels}};
}

void from_json(const nlohmann::json& json, HeldOutFigure& f) {
  json.at("projector").get_to(f.projector);
  json.at("light").get_to(f.light);
  json.at("model").get_to(f.model);
  json.at("part").get_to(f.part);
  json.at("direct").get_to(f.direct);
  json.at("geometry").get_to(f.geometry);
  json.at("pool").get_to(f.pool);
  json.at("takes").get_to(f.takes);
  f.error.nrmse = FigureOf(json.at("nrmse"));
  f.noise_nrmse = FigureOf(json.at("noise_nrmse"));
  f.camera_noise_nrmse = FigureOf(json.at("camera_noise_nrmse"));
  f.error.bias = FigureOf(json.at("bias"));
  for (size_t c = 0; c < f.error.nrmse_channel.size(); ++c)
    f.error.nrmse_channel[c] = FigureOf(json.at("nrmse_rgb").at(c));
  f.error.psnr_db = FigureOf(json.at("psnr_db"));
  f.error.ssim = FigureOf(json.at("ssim"));
  json.at("pixels").get_to(f.error.pixels);
}

void to_json(nlohmann::ordered_json& json, const Coverage& c) {
  json = {{"projector", c.projector},
          {"geometry", c.geometry},
          {"lit_skin", c.lit_skin},
          {"judged", c.judged},
          {"no_surface", c.no_surface},
          {"unlit", c.unlit},
          {"not_fitted", c.not_fitted},
          {"not_skin", c.not_skin},
          {"in_shadow", c.in_shadow},
          {"not_separated", c.not_separated},
          {"left_out_nrmse", c.left_out_nrmse},
          {"skin_by", c.skin_by}};
}

void from_json(const nlohmann::json& json, Coverage& c) {
  json.at("projector").get_to(c.projector);
  json.at("geometry").get_to(c.geometry);
  json.at("lit_skin").get_to(c.lit_skin);
  json.at("judged").get_to(c.judged);
  json.at("no_surface").get_to(c.no_surface);
  json.at("unlit").get_to(c.unlit);
  json.at("not_fitted").get_to(c.not_fitted);
  json.at("not_skin").get_to(c.not_skin);
  json.at("in_shadow").get_to(c.in_shadow);
  c.not_separated = json.value("not_separated", int64_t{0});
  for (const auto& [light, error] : json.at("left_out_nrmse").items()) c.left_out_nrmse[light] = FigureOf(error);
  json.at("skin_by").get_to(c.skin_by);
}

void to_json(nlohmann::ordered_json& json, const PredictionError& e) {
  json = {{"albedo", e.albedo},
          {"normal_rad", e.normal_rad},
          {"placement_quads", e.placement_quads},
          {"spread", e.spread},
          {"most_tan_incidence", e.most_tan_incidence},
          {"samples", e.samples}};
}

void from_json(const nlohmann::json& json, PredictionError& e) {
  json.at("albedo").get_to(e.albedo);
  json.at("normal_rad").get_to(e.normal_rad);
  json.at("placement_quads").get_to(e.placement_quads);
  json.at("spread").get_to(e.spread);
  json.at("most_tan_incidence").get_to(e.most_tan_incidence);
  json.at("samples").get_to(e.samples);
}

std::string Metrics::ToJson() const {
  using Json = nlohmann::ordered_json;
  Json json = {{"schema", 2},
               {"session", session},
               {"fit_id", fit},
               {"program_version", program_version},
               {"evaluation", evaluation},
               {"evaluation_key", evaluation_key}};
  json["options"] = options_json.empty() ? Json::object() : Json::parse(options_json);
  json["artifacts"] = artifacts;
  json["prediction"] = heldout;
  json["ablations"] = ablations;
  json["coverage"] = coverage;
  json["intervals"] = JsonOf(intervals);
  json["srd_centroid"] = Json::array();
  for (const CentroidFigure& c : centroids)
    json["srd_centroid"].push_back({{"projector", c.projector},
                                    {"geometry", c.geometry},
                                    {"measured_mm_per_shift", c.error.measured_mm},
                                    {"predicted_mm_per_shift", c.error.predicted_mm},
                                    {"rms_mm", c.error.rms_mm},
                                    {"profiles", c.error.profiles}});
  json["fit"] = {{"divergence", summary.divergence},
                 {"iterations_median", summary.iterations_median},
                 {"tau", summary.tau},
                 {"surface", ReflectionJson(summary.reflection)},
                 {"wide_weight_fraction", summary.wide_weight_fraction},
                 {"pixels", summary.pixels},
                 {"prior_photons", summary.prior_photons},
                 {"weak_pixels", summary.weak_pixels},
                 {"masked_by_reason", summary.masked_by_reason}};
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
  json["motion"] = {{"known", !motion.poses.empty()},
                    {"moved", motion.moved},
                    {"largest_mm", motion.largest_mm},
                    {"sigma_mm", motion.sigma_mm},
                    {"detail_before", motion.detail_before},
                    {"detail_after", motion.detail_after},
                    {"poses", Json::array()}};
  for (const HeadPose& pose : motion.poses) {
    const Eigen::Vector3d &shift = pose.motion.shift_mm, &turn = pose.motion.turn_rad;
    json["motion"]["poses"].push_back(
        {{"seconds", pose.seconds},
         {"shift_mm", {shift.x(), shift.y(), shift.z()}},
         {"turn_deg", {DegFromRad(turn.x()), DegFromRad(turn.y()), DegFromRad(turn.z())}}});
  }
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
  json["offsets"] = Json::array();
  for (const OffsetFigure& o : offsets) {
    json["offsets"].push_back({{"heldout", o.heldout ? Json(*o.heldout) : Json()},
                               {"model", o.model},
                               {"found", o.offset.IsFound()},
                               {"code_depth_mm", o.offset.IsFound() ? Json(o.offset.code_depth_mm) : Json()},
                               {"sigma_mm", o.offset.IsFound() ? Json(o.offset.sigma_mm) : Json()},
                               {"pixels", o.offset.pixels}});
    if (o.truth) json["offsets"].back()["truth"] = JsonOf(*o.truth);
  }
  json["skin"] = JsonOf(skin);
  if (truth) json["truth"] = JsonOf(*truth);
  if (normals) json["normals"] = JsonOf(*normals);
  if (unplaced) json["unplaced"] = JsonOf(*unplaced);
  return json.dump(1) + "\n";
}

}  // namespace stratalux::fit
