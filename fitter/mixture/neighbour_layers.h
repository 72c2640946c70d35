// SPDX-License-Identifier: Apache-2.0
// Layers of a pixel's neighbourhood. Skin of one kind lies together (a lip, a cheek, a scar), and neighbours that
// return as much light have layers alike: the mean of some fifty of them knows the shape of a line's spread far better
// than one pixel's photons do, and nearer than the mean of the whole face (docs/math/em.md, "Neighbours").
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "fitter/mixture/layer_set.h"
#include "fitter/mixture/mixture_map.h"

namespace stratalux::fit {

// Layers of some of a map's profiles.
struct ProfileLayers {
  int layers = 0;
  std::vector<int32_t> row;                       // [profile] its row, -1: it has none
  std::vector<float> weight, depth_mm, sigma_mm;  // [row][layer]

  [[nodiscard]] bool Has(int64_t profile) const { return row[static_cast<size_t>(profile)] >= 0; }
};

// How far neighbours count, and how much light alike they return: a trilinear kernel of cells of so many mm and of that
// ratio of total weights, a standard deviation of 2.3 mm and of 11 %.
inline constexpr double kNeighbourCellMm = 4.0, kNeighbourCellRatio = 1.2;
// So many profiles of the session's mean layers count beside them; where nobody is near they are all there is.
inline constexpr double kSessionsMembers = 0.5;

// Of every fitted profile that is not `apart` (SrdBatch::apart): the mean of its neighbours' layers, each by its
// weight, of the same colour, `fit` by `fit`'s own layer numbers, scaled to its own total; itself it does not count.
// `mean`: the session's, by channel, that the fit started from; `spacing_mm` (> 0): between neighbouring profiles on
// the skin. The same bits for any number of threads.
[[nodiscard]] ProfileLayers NeighbourLayers(const MixtureMap& fit, std::span<const uint8_t> apart,
                                            std::span<const LayerSet> mean, double spacing_mm);

// Those of `which`, in that order.
[[nodiscard]] ProfileLayers ProfilesOf(const ProfileLayers& field, std::span<const int64_t> which);

// Where EM starts, and what its prior is centred on.
struct StartLayers {
  std::span<const LayerSet> mean;       // by channel (MeanLayers); empty: widths spread over all scales, no prior
  const ProfileLayers* near = nullptr;  // of profiles that it has, in the place of their channel's mean
  double mean_photons = 0.0;            // of the prior of profiles that `near` has not

  StartLayers() = default;
  StartLayers(std::span<const LayerSet> session)  // NOLINT: every start is one
      : mean(session) {}
  StartLayers(const std::vector<LayerSet>& session) : mean(session) {}  // NOLINT
  StartLayers(std::span<const LayerSet> session, const ProfileLayers* neighbours, double photons_of_mean)
      : mean(session), near(neighbours), mean_photons(photons_of_mean) {}

  [[nodiscard]] bool empty() const { return mean.empty(); }
  // Of a profile; empty weights: none.
  [[nodiscard]] LayerSet Of(int64_t profile) const;
  // What becomes of a prior of so many photons.
  [[nodiscard]] double Photons(int64_t profile, double photons) const {
    return near == nullptr || near->Has(profile) ? photons : mean_photons;
  }
};

}  // namespace stratalux::fit
