// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/calibration_record.h"

#include <array>
#include <cmath>

#include <nlohmann/json.hpp>

#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;

std::vector<double> UpperTriangle(const Eigen::MatrixXd& m) {
  std::vector<double> values;
  for (Eigen::Index i = 0; i < m.rows(); ++i)
    for (Eigen::Index j = i; j < m.cols(); ++j) values.push_back(m(i, j));
  return values;
}

// JSON has no NaN and no infinity.
Json Number(double value) { return std::isfinite(value) ? Json(value) : Json(); }

Json DeviceJson(const GeometryReport& report, size_t d) {
  Json parameters = Json::object();
  const std::vector<double> values = DeviceParameters(report.bundle.rig, d);
  for (size_t i = 0; i < values.size(); ++i) {
    const auto k = static_cast<Eigen::Index>(i);
    const double sd = report.covariances.empty() ? NAN : std::sqrt(report.covariances[d](k, k));
    parameters[ParameterName(static_cast<int>(i))] = {values[i], Number(sd)};
  }
  Json device = {{"name", DeviceName(d)},
                 {"rms_px", Number(report.training_total.Rms(d))},
                 {"held_out_px", Number(report.held_out_total.Rms(d))},
                 {"sigma_px", report.sigma_px[d]}};
  if (d > 0) device["epipolar_px"] = Number(report.epipolar.Rms(d));
  device["parameters"] = parameters;
  device["coverage"] = report.coverage[d];
  device["coverage_map"] = report.coverage_map[d];
  return device;
}

}  // namespace

void AdoptSaturation(double saturation_dn, CameraCalibration& camera) {
  if (saturation_dn > camera.black_level_dn && camera.response.empty()) camera.saturation_dn = saturation_dn;
}

RigCalibration ToRecord(const GeometryReport& report, const std::optional<RigCalibration>& earlier,
                        const std::string& source, double saturation_dn) {
  const RigGeometry& rig = report.bundle.rig;
  RigCalibration record = earlier.value_or(RigCalibration{});
  record.id.clear();
  record.source = source;
  record.camera.model = rig.camera;
  record.camera.geometry_covariance.clear();
  AdoptSaturation(saturation_dn, record.camera);
  record.projectors.resize(rig.projectors.size());
  for (size_t p = 0; p < rig.projectors.size(); ++p) {
    ProjectorCalibration& projector = record.projectors[p];
    if (projector.name.empty()) projector.name = "projector " + std::to_string(p);
    if (!(projector.white_dn_mm2_per_ms[0] > 0.0)) projector.white_dn_mm2_per_ms = {1.0, 1.0, 1.0};
    projector.model = rig.projectors[p].model;
    projector.camera_from_projector = rig.projectors[p].camera_from_projector;
    projector.geometry_covariance.clear();
    if (!report.covariances.empty()) projector.geometry_covariance = UpperTriangle(report.covariances[1 + p]);
  }
  if (!report.covariances.empty()) record.camera.geometry_covariance = UpperTriangle(report.covariances[0]);
  return record;
}

const char* VerdictOf(const std::vector<Finding>& findings) { return IsRefused(findings) ? "refused" : "accepted"; }

std::string FindingsJson(const std::vector<Finding>& findings) {
  Json json = Json::array();
  for (const Finding& f : findings)
    json.push_back({{"severity", f.severity == Severity::kRefusal ? "refusal" : "warning"},
                    {"what", f.what},
                    {"remedy", f.remedy}});
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string ReportJson(const GeometryReport& report, const std::vector<Finding>& findings,
                       const std::vector<std::string>& left_out) {
  Json json = {{"schema", 1}, {"verdict", VerdictOf(findings)}, {"findings", Json::parse(FindingsJson(findings))}};
  json["left_out"] = left_out;
  json["distortion"] = ToString(report.distortion);
  json["trials"] = Json::array();
  for (const ModelTrial& trial : report.trials)
    json["trials"].push_back({{"model", ToString(trial.model)},
                              {"held_out_sigmas", Number(trial.held_out_sigmas)},
                              {"held_out_px", Number(trial.held_out_px)}});
  json["joint_rms_px"] = Number(report.training_total.JointRms());
  json["held_out_joint_px"] = Number(report.held_out_total.JointRms());
  json["corners"] = report.corners;
  json["rejected"] = Json::array();
  for (const RejectedCorner& r : report.rejected)
    json["rejected"].push_back({{"pose", r.pose}, {"corner", r.corner}, {"sigmas", Number(r.sigmas)}});
  json["devices"] = Json::array();
  for (size_t d = 0; d < report.sigma_px.size(); ++d) json["devices"].push_back(DeviceJson(report, d));
  json["poses"] = Json::array();
  for (size_t k = 0; k < report.training.size(); ++k)
    json["poses"].push_back({{"name", report.used.poses[k].name},
                             {"tilt_deg", report.tilt_deg[k]},
                             {"rms_px", Number(report.training[k].JointRms())},
                             {"held_out_px", Number(report.held_out[k].errors.JointRms())}});
  return json.dump(1, ' ', false, Json::error_handler_t::replace);
}

std::string ReportText(const GeometryReport& report) {
  std::string text;
  text += Formatted("%zu poses, %d corners, %zu rejected; distortion %s; RMS %.3f px, held-out poses %.3f px\n",
                    report.training.size(), report.corners, report.rejected.size(), ToString(report.distortion),
                    report.training_total.JointRms(), report.held_out_total.JointRms());
  for (size_t d = 0; d < report.sigma_px.size(); ++d) {
    const std::vector<double> v = DeviceParameters(report.bundle.rig, d);
    auto sd = [&](Eigen::Index i) { return report.covariances.empty() ? NAN : std::sqrt(report.covariances[d](i, i)); };
    text += Formatted(
        "  %-12s RMS %.3f, held-out %.3f px; fx %.2f +- %.2f, fy %.2f +- %.2f, cx %.2f +- %.2f, cy %.2f +- %.2f",
        DeviceName(d).c_str(), report.training_total.Rms(d), report.held_out_total.Rms(d), v[0], sd(0), v[1], sd(1),
        v[2], sd(2), v[3], sd(3));
    if (d > 0)
      text += Formatted("; %.2f mm from the camera, epipolar %.3f px",
                        report.bundle.rig.projectors[d - 1].camera_from_projector.translation_mm.norm(),
                        report.epipolar.Rms(d));
    text += "\n";
  }
  for (size_t k = 0; k < report.training.size(); ++k)
    text += Formatted("  %s: tilt %.1f degrees, RMS %.3f, held out %.3f px\n", report.used.poses[k].name.c_str(),
                      report.tilt_deg[k], report.training[k].JointRms(), report.held_out[k].errors.JointRms());
  return text;
}

std::string FindingsText(const std::vector<Finding>& findings) {
  std::string text;
  for (const Finding& f : findings)
    text +=
        std::string(f.severity == Severity::kRefusal ? "  REFUSED: " : "  warning: ") + f.what + "; " + f.remedy + "\n";
  text += IsRefused(findings) ? "calibration refused\n" : "calibration accepted\n";
  return text;
}

}  // namespace stratalux::fit
