// SPDX-License-Identifier: Apache-2.0
// Fitted scattering layers of every pixel and channel: the parameters theta of [M 6].
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "fitter/mixture/layer_set.h"
#include "fitter/mixture/scattering_model.h"

namespace stratalux::fit {

// Why a profile has no (or doubtful) parameters. Counted in metrics.json by name.
enum class FitReason : uint8_t {
  kFitted = 0,
  kOutsideMask = 1,
  kNoProjector = 2,        // no training projector lights it
  kTooDark = 3,            // no signal above the noise
  kNotFinite = 4,          // NaN or infinite samples
  kDepthNotEstimable = 5,  // fitted, but every shift coefficient is about zero: depths are meaningless
};
inline constexpr int kFitReasons = 6;
[[nodiscard]] const char* ToString(FitReason reason);

// Profile i of a W x H map with C channels is (y * W + x) * C + c. Layer arrays are [profile][layer].
struct MixtureMap {
  int width = 0, height = 0, channels = 0;
  int layers = 0;
  ScatteringModel scattering;
  double prior_photons = 0.0;  // N0 of the prior; 0: none
  // Above 0: the prior is centred on neighbours' layers, and so many photons of the session's mean hold profiles that
  // have none near, or stand apart (FitAmongNeighbours).
  double session_photons = 0.0;
  std::vector<int> training_projectors;
  std::vector<float> weight, depth_mm, sigma_mm;
  std::vector<float> surface;        // [profile][training projector]
  std::vector<float> background;     // [profile][training projector], per sample
  std::vector<float> divergence;     // [profile] Kullback-Leibler, final
  std::vector<float> prior_share;    // [profile] N0 / (N0 + the profile's photons); empty where N0 = 0
  std::vector<uint16_t> iterations;  // [profile]
  std::vector<uint8_t> reason;       // [profile] FitReason
  std::vector<int64_t> place;        // [profile] as SrdBatch::place, of profiles that were carried to other pixels

  // N0 of the session's mean layers, whatever the prior is centred on.
  [[nodiscard]] double SessionPhotons() const { return session_photons > 0.0 ? session_photons : prior_photons; }
  [[nodiscard]] int64_t profiles() const { return int64_t{width} * height * channels; }
  [[nodiscard]] int64_t PlaceOf(int64_t profile) const {
    return place.empty() ? profile : place[static_cast<size_t>(profile)];
  }
  [[nodiscard]] int64_t ProfileIndex(int x, int y, int c) const { return (int64_t{y} * width + x) * channels + c; }
  // Of a quad of the surface, where `pool` x `pool` quads share a profile; -1: the map ends before it.
  [[nodiscard]] int64_t ProfileOfQuad(int i, int j, int c, int pool) const {
    const int x = i / pool, y = j / pool;
    return x < width && y < height ? ProfileIndex(x, y, c) : -1;
  }
  [[nodiscard]] bool Fitted(int64_t profile) const {
    const auto r = static_cast<FitReason>(reason[profile]);
    return r == FitReason::kFitted || r == FitReason::kDepthNotEstimable;
  }
};

// The same pixels with other profiles: `which` one of `map`'s each takes; -1: none, outside the mask.
[[nodiscard]] MixtureMap ProfilesOf(const MixtureMap& map, std::span<const int64_t> which);

[[nodiscard]] LayerSet LayersOf(const MixtureMap& map, int64_t profile);

// What no layer holds of a profile's light: its surface and floor, means over the lights that it was fitted to (a light
// without either was none of them).
struct UnlayeredLight {
  float surface = 0.0F, background = 0.0F;
};
[[nodiscard]] UnlayeredLight MeanOfLights(const MixtureMap& map, int64_t profile);

}  // namespace stratalux::fit
