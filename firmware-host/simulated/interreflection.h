// SPDX-License-Identifier: Apache-2.0
// Light from one part of the subject to another, one bounce: nose to cheek, socket to brow. Smooth, hence computed from
// patches of 16 x 16 projector pixels to a coarse grid of camera pixels. Units: digital numbers above black per ms of a
// white target, like LightTransport's.
#pragma once

#include <array>
#include <vector>

#include "firmware-host/simulated/light_transport.h"

namespace stratalux::rig {

class Interreflection {
 public:
  // Useless when `watch` says afterwards that it was stopped. `gamma`: of the projector.
  Interreflection(const Scene& scene, const SkinAlbedo& albedo, const RigCalibration& rig, int projector, double gamma,
                  const std::vector<SubjectPixel>& pixels, WorkWatch* watch = nullptr);

  // Adds, for every subject pixel, the light of `pattern` that reached it by one bounce and left it diffusely.
  void Render(const Pattern& pattern, std::vector<float>& indirect) const;
  // Irradiance by one bounce at subject pixel i under full white, in its colour: what Render reflects.
  [[nodiscard]] float WhiteIrradiance(size_t i) const;

 private:
  // What a block of projector pixels lights.
  struct Patch {
    int column = 0, row = 0;  // of the block
    int rays = 0;
    Eigen::Vector3d point = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();  // means
    double area_mm2 = 0.0;
    std::array<float, 3> leaving{};  // flux reflected, in the unit of WhiteTargetDn times mm^2
  };
  struct Link {
    int patch;
    float factor;  // irradiance here per flux leaving there, 1 / mm^2
  };
  struct Receiver {
    bool valid = false;
    double depth_mm = 0.0;
    std::vector<Link> links;
  };

  void CastPatches(const Scene& scene, const SkinAlbedo& albedo, WorkWatch* watch);
  void CastBlock(const Scene& scene, const SkinAlbedo& albedo, int column, int row, std::vector<Patch>& patches) const;
  void PlaceReceivers(const Scene& scene, WorkWatch* watch);
  void WeighPixels();
  // Irradiance at every receiver when block (column, row) shows `level`.
  template <typename Level>
  [[nodiscard]] std::vector<std::array<float, 3>> Irradiance(const Level& level) const;
  [[nodiscard]] float At(size_t pixel, const std::vector<std::array<float, 3>>& irradiance) const;

  const RigCalibration& rig_;
  const ProjectorCalibration& projector_;
  double gamma_;
  const std::vector<SubjectPixel>& pixels_;
  std::vector<Patch> patches_;
  int grid_width_ = 0, grid_height_ = 0;
  std::vector<Receiver> receivers_;
  std::vector<float> albedo_;  // of each pixel in its colour
  // Receivers around each pixel and their shares.
  struct Neighbours {
    std::array<int, 4> receiver{};
    std::array<float, 4> weight{};
  };
  std::vector<Neighbours> neighbours_;
};

}  // namespace stratalux::rig
