// SPDX-License-Identifier: Apache-2.0
// What one simulated projector's light does to every camera pixel, precomputed: for each mosaic pixel the response to
// each projector column and to each row (through skin transport and at the surface), so that frames of one-dimensional
// patterns cost a short dot product a pixel. Units: digital numbers above black per ms of exposure at full white.
#pragma once

#include <array>
#include <limits>
#include <vector>

#include "firmware-host/simulated/device_options.h"
#include "firmware-host/simulated/light_cache.h"
#include "firmware-host/simulated/near_field.h"
#include "firmware-host/simulated/projected_light.h"
#include "firmware-host/simulated/scene/scene.h"
#include "firmware-host/simulated/scene/skin_albedo.h"
#include "firmware-host/simulated/skin/skin_table.h"
#include "firmware-host/simulated/work_watch.h"
#include "shared/capture/rig_calibration.h"
#include "shared/image/image.h"
#include "shared/pattern/pattern.h"

namespace stratalux::rig {

// A camera pixel that sees the subject.
struct SubjectPixel {
  int x = 0, y = 0;               // mosaic
  Eigen::Vector3d point, normal;  // rig frame, mm
  Material material;
};

// Projector image at three resolutions: full, 4 x 4 and 16 x 16 blocks.
inline constexpr int kLevels = 3;
inline constexpr std::array<int, kLevels> kBlock = {1, 4, 16};
// Blocks per axis that a pixel gathers from, at each level: 20 px, then 5 x 4 and 13 / 5 x 16 px around it.
inline constexpr std::array<int, kLevels> kWindow = {kNearWindow, 20, 13};
inline constexpr int kResponses = 20 + 20 + 13;

struct LightTransportOptions {
  bool scattering = true;
  ProjectorOptics optics = {};  // response and defocus; blur in focus, fall-off and black level are the calibration's
  LightCache* cache = nullptr;  // keeps what takes long to compute; null: nothing does
};

class LightTransport {
 public:
  // Keeps references to all but `scene` and `watch`. Useless when `watch` says afterwards that it was stopped.
  LightTransport(const Scene& scene, const SkinTable& table, const SkinAlbedo& albedo, const RigCalibration& rig,
                 int projector, const std::vector<SubjectPixel>& pixels, const LightTransportOptions& options,
                 WorkWatch* watch = nullptr);

  // Adds, for every subject pixel i, the light of `pattern` to subsurface[i] and direct[i]; of some alone where `watch`
  // was stopped. Patterns of two dimensions take nearly as long as the making.
  void Render(const Pattern& pattern, std::vector<float>& subsurface, std::vector<float>& direct,
              WorkWatch* watch = nullptr) const;
  // Exact (column, row) of pixel i; NaN where the projector does not reach it.
  [[nodiscard]] Eigen::Vector2f ColumnRow(size_t i) const { return at_[i].lit ? at_[i].column_row : kNowhere; }

 private:
  static inline const Eigen::Vector2f kNowhere{std::numeric_limits<float>::quiet_NaN(),
                                               std::numeric_limits<float>::quiet_NaN()};

  // Light arriving at one block of projector pixels: flux in the unit of WhiteTargetDn times mm^2.
  struct Block {
    Eigen::Vector3f position = Eigen::Vector3f::Zero();
    std::array<float, 3> flux{};  // times sqrt(albedo) of the entry point, per colour
  };
  // What the gather needs to know of a camera pixel.
  struct PixelLight {
    Eigen::Vector2f column_row{0, 0};
    bool lit = false;
    float blur_node = 0.0F;  // position among blur_px_
    float direct = 0.0F;     // surface reflection under full white
    PixelSides sides;
  };

  void CastProjector(const Scene& scene, WorkWatch* watch);
  void ChooseBlurNodes();
  void BuildPyramid();
  void PreparePixel(const Scene& scene, size_t i);
  void GatherResponses(WorkWatch* watch);
  // Key of what follows from the light at every point: all that ForEachBlock reads.
  [[nodiscard]] CacheKey KeyOfLight() const;
  void AddSubcutis(CacheKey& key) const;
  [[nodiscard]] bool LoadResponses(const LightCache::Digest& columns, const LightCache::Digest& rows);
  // False where light or view graze the surface: no tangent plane describes the pixel then.
  [[nodiscard]] bool StepsOnTangentPlane(const SubjectPixel& pixel, const PixelLight& light, const Eigen::Vector3d& tx,
                                         const Eigen::Vector3d& ty, TangentSteps& steps) const;
  void DescribeNearSurface(const Eigen::Vector3f& point, const Eigen::Vector3f& tx, const Eigen::Vector3f& ty,
                           const Eigen::Vector2f& column_row, int first_column, int first_row,
                           const TangentSteps& steps, NearSurface& surface) const;
  // Calls visit(level, block column, block row, response) for every block that reaches pixel i.
  template <typename Visit>
  void ForEachBlock(size_t i, SkinKernel& kernel, const Visit& visit) const;
  // Light along the pattern's axis at one blur: where it falls, and what each pixel holds, padded by kPad on both
  // sides; and its means over blocks.
  struct Profiles {
    LightAlongAxis on_surface;
    std::array<std::vector<float>, kLevels> levels;
  };
  [[nodiscard]] Profiles ProfilesOf(const Pattern& pattern, double blur_px) const;
  struct Split {
    float direct = 0.0F, subsurface = 0.0F;
  };
  [[nodiscard]] Split LightOf(size_t i, int axis, const Profiles& profiles) const;
  void RenderOneDimensional(const Pattern& pattern, std::vector<float>& subsurface, std::vector<float>& direct) const;
  void RenderTwoDimensional(const Pattern& pattern, std::vector<float>& subsurface, std::vector<float>& direct,
                            WorkWatch* watch) const;
  void AddDirect(const Image<float>& shown, double blur_px, std::vector<float>& direct) const;
  // Subsurface light of every pixel under an image, given at each level; empty where stopped.
  [[nodiscard]] std::vector<float> GatherImage(const std::array<Image<float>, kLevels>& levels, WorkWatch* watch) const;

  const SkinTable& table_;
  const SkinAlbedo& albedo_;
  const RigCalibration& rig_;
  const ProjectorCalibration& projector_;
  const std::vector<SubjectPixel>& pixels_;
  LightTransportOptions options_;
  std::array<Image<Block>, kLevels> pyramid_;
  std::vector<PixelLight> at_;
  std::vector<double> blur_px_;     // where the blur differs over the subject: a few values between its ends
  LightCache::Digest light_key_{};  // with a cache
  std::vector<float> column_response_, row_response_;  // [pixel][kResponses]; empty: nothing scatters
};

}  // namespace stratalux::rig
