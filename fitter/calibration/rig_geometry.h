// SPDX-License-Identifier: Apache-2.0
// The geometric part of a rig's calibration, and how well it explains corners.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "fitter/calibration/observations.h"
#include "shared/capture/rig_calibration.h"
#include "shared/geometry/pinhole.h"

namespace stratalux::fit {

struct ProjectorGeometry {
  Pinhole model;
  Rigid3 camera_from_projector;  // in the board's unit of length, mm
};

struct RigGeometry {
  Pinhole camera;
  std::vector<ProjectorGeometry> projectors;

  [[nodiscard]] static RigGeometry From(const RigCalibration& calibration);
};

// "camera" for device 0, "projector p" for device 1 + p.
[[nodiscard]] std::string DeviceName(size_t device);

// A device's parameters in the order of ParameterName (bundle_adjustment.h): 9, projectors 15.
[[nodiscard]] std::vector<double> DeviceParameters(const RigGeometry& rig, size_t device);

// Root mean square distances, px, over the corners of some poses; index 0 the camera, 1 + p projector p. Squares and
// counts, so that poses add up.
struct DeviceErrors {
  std::vector<double> squares;
  std::vector<int> counts;

  explicit DeviceErrors(size_t devices = 0) : squares(devices, 0.0), counts(devices, 0) {}
  void Add(const DeviceErrors& other);
  [[nodiscard]] double Rms(size_t device) const;  // NaN without corners
  [[nodiscard]] double JointRms() const;          // over the corners of all devices
};

// Where device `device` (0 the camera, 1 + p projector p) has corner `corner` of the board; nullopt behind it.
[[nodiscard]] std::optional<Eigen::Vector2d> ProjectCorner(const RigGeometry& rig, size_t device,
                                                           const BoardDescription& board,
                                                           const Rigid3& camera_from_board, int corner);

// Corners of the board at `camera_from_board` projected into every device, less where they were seen.
[[nodiscard]] DeviceErrors ReprojectionErrors(const RigGeometry& rig, const BoardDescription& board,
                                              const Rigid3& camera_from_board, const PoseObservation& pose);

// Distance, px, of a corner's projector point from the epipolar line of its camera pixel, both undistorted; blind to
// the board. `errors` index as above (0 stays empty).
[[nodiscard]] DeviceErrors EpipolarErrors(const RigGeometry& rig, const PoseObservation& pose);

}  // namespace stratalux::fit
