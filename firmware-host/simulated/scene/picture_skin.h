// SPDX-License-Identifier: Apache-2.0
// Skin whose colour is that of a picture: melanin and blood of each colour, solved against the skin table.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "firmware-host/simulated/scene/skin_albedo.h"
#include "firmware-host/simulated/skin/skin_optics.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::rig {

struct SolvedSkin {
  SkinParameters skin;
  bool clamped = false;    // at an end of the table's melanin or blood
  float deviation = 0.0F;  // rms over the channels of log(the skin's albedo / the colour)
};

// Solves for the skin of an albedo by least squares over the logarithms of R, G and B, within the nodes of the table's
// melanin and blood.
class SkinOfAlbedo {
 public:
  // `like`: its thickness and scattering stay. Keeps references to both.
  SkinOfAlbedo(const SkinAlbedo& albedo, const SkinParameters& like);
  // `linear`: diffuse albedo of the three channels; what is darker than 1e-4 counts as that.
  [[nodiscard]] SolvedSkin operator()(const std::array<double, 3>& linear) const;

 private:
  struct Start {
    Eigen::Vector2d at;
    Eigen::Vector3d log_albedo;
  };
  [[nodiscard]] SkinParameters SkinAt(const Eigen::Vector2d& at) const;
  [[nodiscard]] Eigen::Vector3d LogAlbedo(const Eigen::Vector2d& at) const;

  const SkinAlbedo& albedo_;
  SkinParameters like_;
  std::vector<Start> starts_;  // a grid over melanin and blood
};

// A picture of a surface's colour by texture coordinates. sRGB, read as the diffuse albedo of the bands R, G, B: known
// truth, not a spectral model.
class PictureSkin {
 public:
  // `scale`: of the linear values. kUsage for what is no PNG picture of colours, naming the remedy.
  static Result<PictureSkin> Read(const std::filesystem::path& file, double scale, const SkinAlbedo& albedo,
                                  const SkinParameters& like);
  PictureSkin(const Image<uint16_t>& picture, int bit_depth, double scale, const SkinAlbedo& albedo,
              const SkinParameters& like);

  // Between the four texels around (u, v), v up; the picture repeats.
  [[nodiscard]] SkinParameters At(const Eigen::Vector2d& uv) const;
  // Of the texel that (u, v) lies in.
  [[nodiscard]] const SolvedSkin& TexelAt(const Eigen::Vector2d& uv) const;

 private:
  [[nodiscard]] const SolvedSkin& Texel(int64_t column, int64_t row) const;

  Image<uint32_t> colour_of_;        // into colours_
  std::vector<SolvedSkin> colours_;  // each that the picture has, once
};

}  // namespace stratalux::rig
