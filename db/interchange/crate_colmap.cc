// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_colmap.h"

#include <cctype>

#include "db/interchange/crate_frames.h"

namespace stratalux::db {
namespace {

constexpr double kColmapPixelCentre = 0.5;

std::string CameraLine(int id, const Pinhole& m) {
  const auto& [k1, k2, p1, p2, k3] = m.distortion;
  std::string line = std::to_string(id) + " FULL_OPENCV " + std::to_string(m.width) + " " + std::to_string(m.height);
  for (const double value :
       {m.fx, m.fy, m.cx + kColmapPixelCentre, m.cy + kColmapPixelCentre, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0})
    line += " " + ShortestText(value);
  return line + "\n";
}

// The second line, of an image's points, is empty.
std::string ImageLines(int id, const Rigid3& camera_from_world, const std::string& name) {
  const Eigen::Quaterniond q = camera_from_world.rotation.normalized();
  const Eigen::Vector3d& t = camera_from_world.translation_mm;
  std::string line = std::to_string(id);
  for (const double value : {q.w(), q.x(), q.y(), q.z(), t.x(), t.y(), t.z()}) line += " " + ShortestText(value);
  return line + " " + std::to_string(id) + " " + name + "\n\n";
}

// COLMAP separates by blanks.
std::string OneWord(const std::string& name) {
  std::string word;
  for (const char c : name) word += std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '.' ? c : '-';
  return word;
}

}  // namespace

ColmapText ColmapTextOf(const RigCalibration& calibration, const std::string& camera_image) {
  ColmapText text;
  text.cameras =
      "# Camera list with one line of data per camera:\n"
      "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
      "# FULL_OPENCV: fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6. Pixel centres lie at 0.5 (in calibration.json: at 0).\n"
      "# Camera 1 is the camera, the others are the projectors as inverse cameras.\n"
      "# Number of cameras: " +
      std::to_string(1 + calibration.projectors.size()) + "\n" + CameraLine(1, calibration.camera.model);
  text.images =
      "# Image list with two lines of data per image:\n"
      "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
      "#   POINTS2D[] as (X, Y, POINT3D_ID)\n"
      "# World to camera; the world is the camera's frame, lengths in mm. Projectors have a name and no image.\n"
      "# Number of images: " +
      std::to_string(1 + calibration.projectors.size()) + ", mean observations per image: 0\n" +
      ImageLines(1, Rigid3{}, camera_image);
  text.points =
      "# 3D point list with one line of data per point:\n"
      "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
      "# Number of points: 0, mean track length: 0\n";
  for (size_t k = 0; k < calibration.projectors.size(); ++k) {
    const ProjectorCalibration& projector = calibration.projectors[k];
    const int id = static_cast<int>(k) + 2;
    text.cameras += CameraLine(id, projector.model);
    text.images += ImageLines(id, projector.camera_from_projector.Inverse(),
                              "projector-" + std::to_string(k) + "-" + OneWord(projector.name));
  }
  return text;
}

}  // namespace stratalux::db
