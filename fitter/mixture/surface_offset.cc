// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/surface_offset.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include "fitter/mixture/choose_prior.h"
#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/left_out_lights.h"
#include "fitter/mixture/mean_layers.h"

namespace stratalux::fit {
namespace {

// Of the search, mm of code depth: several times what scattering makes of it.
constexpr double kFarthest = 0.8, kStep = 0.2;
// About what it finds, mm: where the cost is still a parabola, and yet differs by more than EM leaves open.
constexpr double kNear = 0.12;
// Enough to find a tenth of a millimetre.
constexpr int64_t kPixelsOfSearch = 512;
// Enough for a hundredth.
constexpr int64_t kPixels = 2048;
constexpr int64_t kLeastPixels = 100;
// Parts of the face that are taken to err independently, mm across.
constexpr double kPart = 20.0;
// Something smaller than that many parts is divided into that many.
constexpr double kLeastPartsAcross = 4.0;

// Pixels that at least two projectors light, every so many of the image's rows and columns.
std::vector<int64_t> PixelsOf(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int width,
                              int channels, int64_t most) {
  const auto lit = [&](int64_t pixel) {
    int first = -1;
    for (size_t p = 0; p < lights.size(); ++p)
      for (int c = 0; c < channels; ++c) {
        if (!lights[p]->Shares(pixel * channels + c) || projectors[p] == first) continue;
        if (first >= 0) return true;
        first = projectors[p];
      }
    return false;
  };
  std::vector<int64_t> usable;
  for (int64_t i = 0; i < lights[0]->profiles() / channels; ++i)
    if (lit(i)) usable.push_back(i);
  const double density = static_cast<double>(usable.size()) / static_cast<double>(most);
  const int every = std::max(1, static_cast<int>(std::ceil(std::sqrt(density))));
  std::erase_if(usable, [=](int64_t i) { return i % width % every != 0 || i / width % every != 0; });
  return usable;
}

// Some pixels of all lights, to be fitted on displaced surfaces.
class Trials {
 public:
  Trials(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors, int channels,
         std::span<const float> displacement, const EmOptions& options, const std::vector<int64_t>& pixels)
      : projectors_(projectors), channels_(channels), options_(options), pixels_(pixels.size()) {
    if (!(options_.prior.photons > 0.0)) options_.prior.photons = kUsualPriorPhotons;
    options_.scattering.mode = FitMode::kTied;
    std::vector<int64_t> profiles;
    for (const int64_t pixel : pixels)
      for (int c = 0; c < channels; ++c) profiles.push_back(pixel * channels + c);
    for (const SrdBatch* light : lights) batches_.push_back(ProfilesOf(*light, profiles));
    for (const int64_t pixel : pixels) displacement_.push_back(displacement[static_cast<size_t>(pixel)]);
  }

  // Mean layers of all trials start from those at `depth_mm`, themselves started from those of `other`: EM, which does
  // not end at its optimum, then ends about as far from it at depths on either side.
  Status BeginAt(double depth_mm, const std::vector<LayerSet>& other = {}) {
    const std::vector<SrdBatch> moved = On(depth_mm);
    SLX_ASSIGN_OR_RETURN(near_, MeanLayers(PointersTo(moved), channels_, options_, kPixelsOfSearch, other));
    return Status::Ok();
  }
  [[nodiscard]] const std::vector<LayerSet>& near() const { return near_; }

  // [pixel] Negative log posterior of each pixel's layers, all colours together, on the surface that codes at
  // `depth_mm` leave, with the mean layers of some of these pixels there; NaN where a colour could not be fitted.
  [[nodiscard]] Result<std::vector<double>> CostsAt(double depth_mm) const {
    const std::vector<SrdBatch> moved = On(depth_mm);
    const std::vector<const SrdBatch*> lights = PointersTo(moved);
    SLX_ASSIGN_OR_RETURN(const auto mean, MeanLayers(lights, channels_, options_, kPixelsOfSearch, near_));
    SLX_ASSIGN_OR_RETURN(const auto fit,
                         FitTraced(lights, projectors_, static_cast<int>(pixels_), 1, channels_, options_, mean));
    std::vector<double> costs(pixels_, 0.0);
    for (size_t i = 0; i < fit.cost.size(); ++i) costs[i / static_cast<size_t>(channels_)] += fit.cost[i];
    return costs;
  }

 private:
  [[nodiscard]] std::vector<SrdBatch> On(double depth_mm) const {
    std::vector<SrdBatch> moved = batches_;
    for (SrdBatch& batch : moved) MoveSurface(batch, channels_, displacement_, -depth_mm);
    return moved;
  }

  const std::vector<int>& projectors_;
  int channels_;
  EmOptions options_;
  size_t pixels_;
  std::vector<LayerSet> near_;
  std::vector<SrdBatch> batches_;
  std::vector<float> displacement_;  // [pixel]
};

double Sum(const std::vector<double>& costs) {
  double sum = 0.0;
  for (const double cost : costs) sum += std::isnan(cost) ? 0.0 : cost;
  return sum;
}

struct Found {
  double depth_mm = 0.0;
  bool at_bound = false;
};

// Down the hill from 0, by kStep.
Result<Found> Search(const Trials& trials) {
  constexpr int kEnd = static_cast<int>(kFarthest / kStep + 0.5);
  std::array<std::optional<double>, 2 * kEnd + 1> known;
  const auto at = [&](int k) -> Result<double> {
    auto& cost = known[static_cast<size_t>(k + kEnd)];
    if (!cost) {
      SLX_ASSIGN_OR_RETURN(const auto costs, trials.CostsAt(k * kStep));
      cost = Sum(costs);
    }
    return *cost;
  };
  for (int k = 0;;) {
    if (std::abs(k) == kEnd) return Found{k * kStep, true};
    SLX_ASSIGN_OR_RETURN(const double before, at(k - 1));
    SLX_ASSIGN_OR_RETURN(const double here, at(k));
    SLX_ASSIGN_OR_RETURN(const double after, at(k + 1));
    if (here <= before && here <= after) {
      const double bend = before - 2.0 * here + after;
      return Found{(k + (bend > 0.0 ? 0.5 * (before - after) / bend : 0.0)) * kStep, false};
    }
    k += before < after ? -1 : 1;
  }
}

// Pixels across a part.
int64_t PartOf(const std::vector<int64_t>& pixels, int width, double mm_per_pixel) {
  const auto [left, right] = std::ranges::minmax(pixels, {}, [&](int64_t pixel) { return pixel % width; });
  const auto extent =
      static_cast<double>(std::max(right % width - left % width, (pixels.back() - pixels.front()) / width) + 1);
  return static_cast<int64_t>(std::max(1.0, std::min(kPart / mm_per_pixel, extent / kLeastPartsAcross)));
}

// What pixels say about a depth: their cost is, but for a constant, slope d + bend d^2 / 2.
struct Witness {
  double slope = 0.0, bend = 0.0;
};

}  // namespace

void MoveSurface(SrdBatch& batch, int channels, std::span<const float> displacement, double deeper_mm) {
  const auto per_displacement = static_cast<float>(deeper_mm);
  for (int64_t i = 0; i < batch.profiles(); ++i)
    batch.first_u_mm[i] -=
        per_displacement * displacement[static_cast<size_t>(i / channels)] * (batch.slope_in[i] - batch.slope_out[i]);
}

Result<SurfaceOffset> EstimateOffset(std::span<const SrdBatch* const> lights, const std::vector<int>& projectors,
                                     int width, int channels, double mm_per_pixel, std::span<const float> displacement,
                                     const EmOptions& options) {
  const auto few = PixelsOf(lights, projectors, width, channels, kPixelsOfSearch);
  const auto pixels = PixelsOf(lights, projectors, width, channels, kPixels);
  if (std::ssize(pixels) < kLeastPixels) return SurfaceOffset{};
  Trials coarse(lights, projectors, channels, displacement, options, std::ssize(few) < kLeastPixels ? pixels : few);
  SLX_RETURN_IF_ERROR(coarse.BeginAt(0.0));
  SLX_ASSIGN_OR_RETURN(const Found found, Search(coarse));
  if (found.at_bound) return SurfaceOffset{.at_bound = true};
  Trials trials(lights, projectors, channels, displacement, options, pixels);
  SLX_RETURN_IF_ERROR(trials.BeginAt(found.depth_mm, coarse.near()));
  SLX_ASSIGN_OR_RETURN(const auto before, trials.CostsAt(found.depth_mm - kNear));
  SLX_ASSIGN_OR_RETURN(const auto here, trials.CostsAt(found.depth_mm));
  SLX_ASSIGN_OR_RETURN(const auto after, trials.CostsAt(found.depth_mm + kNear));

  const int64_t part = PartOf(pixels, width, mm_per_pixel);
  std::map<std::pair<int64_t, int64_t>, Witness> parts;
  Witness all;
  SurfaceOffset offset;
  for (size_t i = 0; i < pixels.size(); ++i) {
    if (std::isnan(before[i] + here[i] + after[i])) continue;
    const Witness says = {(after[i] - before[i]) / (2.0 * kNear),
                          (before[i] - 2.0 * here[i] + after[i]) / (kNear * kNear)};
    for (Witness* sum : {&all, &parts[{pixels[i] % width / part, pixels[i] / width / part}]}) {
      sum->slope += says.slope;
      sum->bend += says.bend;
    }
    ++offset.pixels;
  }
  if (offset.pixels < kLeastPixels || parts.size() < 2) return SurfaceOffset{};
  if (!(all.bend > 0.0)) return SurfaceOffset{.at_bound = true};
  const double further = std::clamp(-all.slope / all.bend, -kStep, kStep);
  double squares = 0.0;
  for (const auto& [place, says] : parts) squares += std::pow(says.slope + says.bend * further, 2);
  const auto count = static_cast<double>(parts.size());
  offset.code_depth_mm = found.depth_mm + further;
  offset.sigma_mm = std::sqrt(squares * count / (count - 1.0)) / all.bend;
  return offset;
}

}  // namespace stratalux::fit
