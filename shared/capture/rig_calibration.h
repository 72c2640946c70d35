// SPDX-License-Identifier: Apache-2.0
// The calibration record of a rig: one camera and N projectors, geometry and light. Written by the fitter's calibration
// (or, exactly, by the simulated rig), kept by the store, read by every stage.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/geometry/pinhole.h"
#include "shared/image/pixel_format.h"

namespace stratalux {

struct CameraCalibration {
  Pinhole model;  // full-resolution mosaic pixels; camera frame = rig frame
  Cfa cfa = Cfa::kRggb;
  double black_level_dn = 0.0;
  double saturation_dn = 4095.0;
  double gain_e_per_dn = 1.0;  // photo-electrons per digital number
  double read_noise_dn = 0.0;  // standard deviation
  double line_blur_px = 0.0;   // standard deviation of the optics' blur, camera pixels (the pixel box comes on top)
  // Linear light of raw levels: entry k of n belongs to the raw level k / (n - 1) of the way from black to saturation;
  // both above black, as shares of saturation less black. Rising from 0; the slope at black is 1, so that
  // gain_e_per_dn holds there. Empty: linear.
  std::vector<double> response;
  // Sensitivity relative to the optical axis: 1 + vignetting[0] r^2 + vignetting[1] r^4, r = distance from the
  // principal point over half the diagonal of the image.
  std::array<double, 2> vignetting{};
  // Of fx fy cx cy k1 k2 p1 p2 k3: upper triangle, row by row (45); empty: exact, or not known.
  std::vector<double> geometry_covariance;

  // Digital numbers above black that a linear camera would read, of a raw level above black; below black unchanged.
  [[nodiscard]] double LinearDn(double above_black_dn) const;
  [[nodiscard]] double Vignetting(double x_px, double y_px) const;
};

struct ProjectorCalibration {
  std::string name;
  Pinhole model;                 // projector pixels (columns, rows)
  Rigid3 camera_from_projector;  // mm
  double line_blur_px = 0.0;     // standard deviation of the optics' blur, projector pixels
  double black_level = 0.0;      // measured black / white
  // Fall-off relative to the optical axis: 1 + falloff[0] r^2 + falloff[1] r^4, r = distance from the principal point
  // over half the diagonal of the projector's image.
  std::array<double, 2> falloff{};
  // Light of grey levels: entry k of n belongs to level k / (n - 1) of white; light above the projector's black, as a
  // share of white's. Rises from 0 to 1. Empty: linear.
  std::vector<double> response;
  // White-target scale per colour channel: a perfect white Lambertian target at distance d (mm) from the projector, its
  // normal at angle theta to the light, reads  (white_dn_mm2 * falloff * cos(theta) / d^2) digital numbers above black
  // per ms of exposure.
  std::array<double, 3> white_dn_mm2_per_ms{};
  // As the camera's, then of the angle-axis vector (rad) and translation (mm) of camera_from_projector (120).
  std::vector<double> geometry_covariance;

  // Position of the projector's centre in the camera frame, mm.
  [[nodiscard]] Eigen::Vector3d CentreInCamera() const { return camera_from_projector.translation_mm; }
  // (column, row) of a point in the camera frame; nullopt behind the projector.
  [[nodiscard]] std::optional<Eigen::Vector2d> ProjectFromCamera(const Eigen::Vector3d& x_in_camera) const;
  [[nodiscard]] double Falloff(const Eigen::Vector2d& column_row) const;
  // Light of grey level `grey` in 0 .. 1, as `response` has it.
  [[nodiscard]] double Response(double grey) const;
  // Fourier coefficient of cos in Response(0.5 + 0.5 cos): 1/2 for a linear projector.
  [[nodiscard]] double SinusoidAmplitude() const;
  // Digital numbers above black of a perfect white Lambertian target at the point, all columns on; 0 where it faces
  // away.
  [[nodiscard]] double WhiteTargetDn(const Eigen::Vector3d& x_in_camera, const Eigen::Vector3d& normal, int channel,
                                     double exposure_ms) const;
};

struct RigCalibration {
  std::string id;      // content hash or a name; filled by the store
  std::string source;  // "simulation (exact)", "calibration session <id>"
  CameraCalibration camera;
  std::vector<ProjectorCalibration> projectors;

  [[nodiscard]] Status Validate() const;
  // JSON text (schema 1, docs/file-formats.md) and back.
  [[nodiscard]] std::string ToJson() const;
  [[nodiscard]] static Result<RigCalibration> FromJson(const std::string& text);
};

}  // namespace stratalux
