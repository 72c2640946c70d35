// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/rig_calibration.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <nlohmann/json.hpp>

#include "shared/base/json_number.h"

namespace stratalux {
namespace {

using Json = nlohmann::ordered_json;

Json PinholeJson(const Pinhole& m) {
  return {{"width", m.width},
          {"height", m.height},
          {"fx", m.fx},
          {"fy", m.fy},
          {"cx", m.cx},
          {"cy", m.cy},
          {"distortion_k1_k2_p1_p2_k3", m.distortion}};
}

Pinhole PinholeFrom(const Json& j) {
  Pinhole m;
  m.width = WholeAt<int>(j, "width");
  m.height = WholeAt<int>(j, "height");
  j.at("fx").get_to(m.fx);
  j.at("fy").get_to(m.fy);
  j.at("cx").get_to(m.cx);
  j.at("cy").get_to(m.cy);
  j.at("distortion_k1_k2_p1_p2_k3").get_to(m.distortion);
  return m;
}

// Of a curve given at equally spaced places in 0 .. 1; beyond 1 with its last slope.
double Interpolate(const std::vector<double>& curve, double at) {
  const double place = at * static_cast<double>(curve.size() - 1);
  const auto k = static_cast<size_t>(std::clamp(place, 0.0, static_cast<double>(curve.size() - 2)));
  return curve[k] + (place - static_cast<double>(k)) * (curve[k + 1] - curve[k]);
}

// Fall-off of either kind, about a device's principal point.
double RadialFalloff(const Pinhole& model, const std::array<double, 2>& coefficients, const Eigen::Vector2d& at) {
  const double half_diagonal2 = 0.25 * (double(model.width) * model.width + double(model.height) * model.height);
  const double r2 = (at - Eigen::Vector2d(model.cx, model.cy)).squaredNorm() / half_diagonal2;
  return 1.0 + r2 * (coefficients[0] + r2 * coefficients[1]);
}

// Half the diagonal is r = 1; the corners lie a little further out.
bool IsPositive(const std::array<double, 2>& coefficients) {
  for (int k = 0; k <= 12; ++k) {
    const double r2 = 0.1 * k;
    if (!(1.0 + r2 * (coefficients[0] + r2 * coefficients[1]) > 0.0)) return false;
  }
  return true;
}

Status CheckResponse(const std::vector<double>& response) {
  if (response.empty()) return Status::Ok();
  bool rising = response.size() >= 2 && response.front() == 0.0 && std::isfinite(response.back());
  for (size_t k = 1; k < response.size(); ++k) rising = rising && response[k] >= response[k - 1];
  return rising && response.back() > 0.0 ? Status::Ok()
                                         : Status::Usage("response must rise from 0; calibrate the light again");
}

constexpr const char* kCovariance = "geometry_covariance";
constexpr const char* kResponse = "response";
constexpr const char* kVignetting = "vignetting";

void AddCovariance(const std::vector<double>& covariance, Json& json) {
  if (!covariance.empty()) json[kCovariance] = covariance;
}

void GetCovariance(const Json& json, std::vector<double>& covariance) {
  if (json.contains(kCovariance)) json.at(kCovariance).get_to(covariance);
}

Status CheckCovariance(const std::vector<double>& covariance, size_t parameters) {
  const size_t wanted = parameters * (parameters + 1) / 2;
  if (covariance.empty() || covariance.size() == wanted) return Status::Ok();
  return Status::Usage(std::string(kCovariance) + " has " + std::to_string(covariance.size()) + " numbers, not " +
                       std::to_string(wanted));
}

Json ProjectorJson(const ProjectorCalibration& p) {
  const Eigen::Quaterniond& q = p.camera_from_projector.rotation;
  const Eigen::Vector3d& t = p.camera_from_projector.translation_mm;
  Json json = {{"name", p.name},
               {"model", PinholeJson(p.model)},
               {"camera_from_projector",
                {{"quaternion_wxyz", {q.w(), q.x(), q.y(), q.z()}}, {"translation_mm", {t.x(), t.y(), t.z()}}}},
               {"line_blur_px", p.line_blur_px},
               {"black_level", p.black_level},
               {"falloff", p.falloff},
               {"white_dn_mm2_per_ms", p.white_dn_mm2_per_ms}};
  if (!p.response.empty()) json[kResponse] = p.response;
  AddCovariance(p.geometry_covariance, json);
  return json;
}

// Brought to length 1, of which whoever writes a record by hand may round a little away; a turn that is none is damage.
Result<Eigen::Quaterniond> RotationFrom(const std::array<double, 4>& wxyz) {
  constexpr double kRounding = 1e-3;
  const Eigen::Quaterniond q(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
  if (std::abs(q.norm() - 1.0) <= kRounding) return q.normalized();
  return Status::Usage("quaternion_wxyz has length " + std::to_string(q.norm()) + ", not 1; calibrate again");
}

Result<ProjectorCalibration> ProjectorFrom(const Json& j) {
  ProjectorCalibration p;
  j.at("name").get_to(p.name);
  p.model = PinholeFrom(j.at("model"));
  const Json& pose = j.at("camera_from_projector");
  const auto q = pose.at("quaternion_wxyz").get<std::array<double, 4>>();
  const auto t = pose.at("translation_mm").get<std::array<double, 3>>();
  SLX_ASSIGN_OR_RETURN(const auto rotation, RotationFrom(q).WithContext("calibration: projector " + p.name));
  p.camera_from_projector = {rotation, {t[0], t[1], t[2]}};
  j.at("line_blur_px").get_to(p.line_blur_px);
  j.at("black_level").get_to(p.black_level);
  j.at("falloff").get_to(p.falloff);
  j.at("white_dn_mm2_per_ms").get_to(p.white_dn_mm2_per_ms);
  if (j.contains(kResponse)) j.at(kResponse).get_to(p.response);
  GetCovariance(j, p.geometry_covariance);
  return p;
}

}  // namespace

std::optional<Eigen::Vector2d> ProjectorCalibration::ProjectFromCamera(const Eigen::Vector3d& x_in_camera) const {
  return model.Project(camera_from_projector.rotation.conjugate() *
                       (x_in_camera - camera_from_projector.translation_mm));
}

double CameraCalibration::LinearDn(double above_black_dn) const {
  const double range_dn = saturation_dn - black_level_dn;
  return response.empty() || above_black_dn <= 0.0 ? above_black_dn
                                                   : range_dn * Interpolate(response, above_black_dn / range_dn);
}

double CameraCalibration::Vignetting(double x_px, double y_px) const {
  return RadialFalloff(model, vignetting, {x_px, y_px});
}

double ProjectorCalibration::Falloff(const Eigen::Vector2d& column_row) const {
  return RadialFalloff(model, falloff, column_row);
}

double ProjectorCalibration::Response(double grey) const {
  const double level = std::clamp(grey, 0.0, 1.0);
  return response.empty() ? level : Interpolate(response, level);
}

double ProjectorCalibration::SinusoidAmplitude() const {
  constexpr int kSamples = 256;  // of a period; the curve's kinks are that fine
  double sum = 0.0;
  for (int k = 0; k < kSamples; ++k) {
    const double cosine = std::cos(2.0 * std::numbers::pi * (k + 0.5) / kSamples);
    sum += Response(0.5 + 0.5 * cosine) * cosine;
  }
  return 2.0 * sum / kSamples;
}

double ProjectorCalibration::WhiteTargetDn(const Eigen::Vector3d& x_in_camera, const Eigen::Vector3d& normal,
                                           int channel, double exposure_ms) const {
  const Eigen::Vector3d to_light = CentreInCamera() - x_in_camera;
  const double distance2 = to_light.squaredNorm();
  const double cosine = normal.dot(to_light) / std::sqrt(distance2);
  const auto pixel = ProjectFromCamera(x_in_camera);
  if (!(cosine > 0.0) || !pixel || !model.Contains(*pixel)) return 0.0;
  return white_dn_mm2_per_ms[channel] * exposure_ms * Falloff(*pixel) * cosine / distance2;
}

Status RigCalibration::Validate() const {
  if (made_wall.ns < 0 || (valid_until_wall.ns != 0 && valid_until_wall < made_wall))
    return Status::Usage("calibration: valid until " + ToIso8601(valid_until_wall) + ", but made " +
                         ToIso8601(made_wall));
  SLX_RETURN_IF_ERROR(camera.model.Validate().WithContext("calibration: camera"));
  if (!(camera.gain_e_per_dn > 0.0)) return Status::Usage("calibration: camera: gain_e_per_dn must be positive");
  if (!(camera.saturation_dn > camera.black_level_dn))
    return Status::Usage("calibration: camera: saturation must lie above the black level");
  SLX_RETURN_IF_ERROR(CheckCovariance(camera.geometry_covariance, 9).WithContext("calibration: camera"));
  SLX_RETURN_IF_ERROR(CheckResponse(camera.response).WithContext("calibration: camera"));
  if (!IsPositive(camera.vignetting))
    return Status::Usage("calibration: camera: vignetting reaches 0 within the picture; calibrate the light again");
  if (projectors.empty()) return Status::Usage("calibration: no projector");
  for (const ProjectorCalibration& p : projectors) {
    SLX_RETURN_IF_ERROR(p.model.Validate().WithContext("calibration: projector " + p.name));
    for (double v : p.white_dn_mm2_per_ms)
      if (!(v > 0.0) || !std::isfinite(v))
        return Status::Usage("calibration: projector " + p.name + ": white_dn_mm2_per_ms must be positive");
    if (!IsPositive(p.falloff))
      return Status::Usage("calibration: projector " + p.name +
                           ": falloff reaches 0 within the picture; calibrate the light again");
    SLX_RETURN_IF_ERROR(CheckResponse(p.response).WithContext("calibration: projector " + p.name));
    SLX_RETURN_IF_ERROR(CheckCovariance(p.geometry_covariance, 15).WithContext("calibration: projector " + p.name));
    if (!p.camera_from_projector.translation_mm.allFinite())
      return Status::Usage("calibration: projector " + p.name + ": pose is not finite");
  }
  return Status::Ok();
}

std::string RigCalibration::ToJson() const {
  Json json = {{"schema", 1},
               {"id", id},
               {"source", source},
               {"camera",
                {{"model", PinholeJson(camera.model)},
                 {"cfa", static_cast<int>(camera.cfa)},
                 {"black_level_dn", camera.black_level_dn},
                 {"saturation_dn", camera.saturation_dn},
                 {"gain_e_per_dn", camera.gain_e_per_dn},
                 {"read_noise_dn", camera.read_noise_dn},
                 {"line_blur_px", camera.line_blur_px}}},
               {"projectors", Json::array()}};
  if (made_wall.ns != 0) json["made_wall_ns"] = made_wall.ns;
  if (valid_until_wall.ns != 0) json["valid_until_wall_ns"] = valid_until_wall.ns;
  if (!camera.response.empty()) json["camera"][kResponse] = camera.response;
  if (camera.vignetting != std::array<double, 2>{}) json["camera"][kVignetting] = camera.vignetting;
  AddCovariance(camera.geometry_covariance, json["camera"]);
  for (const ProjectorCalibration& p : projectors) json["projectors"].push_back(ProjectorJson(p));
  return json.dump();
}

Result<RigCalibration> RigCalibration::FromJson(const std::string& text) {
  try {
    const Json json = Json::parse(text);
    if (WholeAt<int64_t>(json, "schema") > 1)
      return Status(StatusCode::kNewerSchema,
                    "calibration: schema " + json.at("schema").dump() + " is newer than this program (1)");
    RigCalibration c;
    json.at("id").get_to(c.id);
    json.at("source").get_to(c.source);
    c.made_wall.ns = WholeOr<int64_t>(json, "made_wall_ns", 0);
    c.valid_until_wall.ns = WholeOr<int64_t>(json, "valid_until_wall_ns", 0);
    const Json& camera = json.at("camera");
    c.camera.model = PinholeFrom(camera.at("model"));
    const int cfa = WholeAt<int>(camera, "cfa");
    if (cfa < 0 || cfa > 4) return Status::Usage("calibration: cfa " + std::to_string(cfa) + " is unknown (0..4)");
    c.camera.cfa = static_cast<Cfa>(cfa);
    camera.at("black_level_dn").get_to(c.camera.black_level_dn);
    camera.at("saturation_dn").get_to(c.camera.saturation_dn);
    camera.at("gain_e_per_dn").get_to(c.camera.gain_e_per_dn);
    camera.at("read_noise_dn").get_to(c.camera.read_noise_dn);
    camera.at("line_blur_px").get_to(c.camera.line_blur_px);
    if (camera.contains(kResponse)) camera.at(kResponse).get_to(c.camera.response);
    if (camera.contains(kVignetting)) camera.at(kVignetting).get_to(c.camera.vignetting);
    GetCovariance(camera, c.camera.geometry_covariance);
    for (const Json& p : json.at("projectors")) {
      SLX_ASSIGN_OR_RETURN(c.projectors.emplace_back(), ProjectorFrom(p));
    }
    SLX_RETURN_IF_ERROR(c.Validate());
    return c;
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(std::string("calibration JSON: ") + error.what());
  }
}

}  // namespace stratalux
