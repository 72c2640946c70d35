// SPDX-License-Identifier: Apache-2.0
// The offset stage: how far the reconstructed surface lies from the true one, by the SRDs of the training lights; and
// surface and SRDs put right by it.
#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "fitter/mixture/surface_offset.h"
#include "fitter/stages/layers.h"
#include "fitter/stages/shape.h"
#include "fitter/stages/srd.h"

namespace stratalux::fit {

inline constexpr int kOffsetVersion = 15, kPlacedShapeVersion = 7;

struct FaceOffset {
  SurfaceOffset found;
  Image<float> displacement;  // on quads: CodeDisplacement

  // By how much the true surface lies deeper than the reconstructed one, along the normal: above it is negative.
  [[nodiscard]] float DeeperMm(int i, int j) const {
    return static_cast<float>(-found.code_depth_mm) * displacement(i, j);
  }
  // Mean over the pool x pool quads that share profile (x, y): what its SRDs are moved by (PlacedSrds).
  [[nodiscard]] float DeeperMm(int x, int y, int pool) const;
};

// By all lights but those of `heldout` (kNoneHeldOut: by all), of the surface that `srds` were read on; the codes that
// it was made of are those of all projectors. What the pixels share is chosen as FitLayers does, by what
// FindSharedLight found on these lights. kUsage where no light is left.
[[nodiscard]] Result<FaceOffset> FindOffset(const SrdSet& srds, const FaceShape& shape, int heldout,
                                            const FitOptions& options, const SharedLight& shared, Logger& logger,
                                            const std::string& label);

// All sweeps of a session, as read on the reconstructed surface or on one that an offset places.
class PlacedSrds {
 public:
  explicit PlacedSrds(SrdSet as_read);
  // Whatever they were moved to before; nullptr gives them as they were read.
  void MoveTo(const FaceOffset* offset);
  [[nodiscard]] const SrdSet& set() const { return set_; }
  [[nodiscard]] SrdSet Take() { return std::move(set_); }

 private:
  SrdSet set_;
  std::vector<std::vector<float>> first_u_mm_;  // as read: of all batches, those of rows last
};

// The surface moved along its normals, each point along its view, and its standard deviation with the offset's error.
[[nodiscard]] FaceShape PlacedShape(FaceShape shape, const FaceOffset& offset);

// offset.exr, offset.json.
Status SaveOffset(const std::filesystem::path& folder, const FaceOffset& offset);
[[nodiscard]] Result<FaceOffset> LoadOffset(const std::filesystem::path& folder);

}  // namespace stratalux::fit
