// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/layer_maps.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "fitter/export/exr_file.h"
#include "fitter/mixture/fit_mixture.h"
#include "fitter/mixture/standard_errors.h"
#include "shared/base/parallel_each.h"
#include "shared/image/box_sums.h"

namespace stratalux::fit {
namespace {

constexpr const char *kTotalWeightFile = "total_weight.exr", *kMeanDepthFile = "mean_depth_mm.exr";

// Each of EffectiveMaps, and whether its errors go with its size.
constexpr std::array<std::pair<Image<float> EffectiveMaps::*, bool>, 3> kQuantities = {
    {{&EffectiveMaps::total_weight, true},
     {&EffectiveMaps::mean_depth_mm, false},
     {&EffectiveMaps::effective_width_mm, true}}};

bool DepthKnown(const MixtureMap& map, int64_t profile) {
  return static_cast<FitReason>(map.reason[profile]) == FitReason::kFitted;
}

// Width up to which the share `fraction` of the light comes back, from a histogram of weights.
double WidthOfShare(const std::vector<double>& weights, double cell_mm, double fraction) {
  double all = 0.0, below = 0.0;
  for (double w : weights) all += w;
  for (size_t i = 0; i < weights.size(); ++i) {
    if (below + weights[i] >= fraction * all && weights[i] > 0.0)
      return cell_mm * (static_cast<double>(i) + (fraction * all - below) / weights[i]);
    below += weights[i];
  }
  return cell_mm * static_cast<double>(weights.size());
}

DepthBands FindBands(const MixtureMap& map) {
  constexpr double kCellMm = 0.01;
  std::vector<double> weights(2000, 0.0);
  for (int64_t i = 0; i < map.profiles(); ++i) {
    if (!map.Fitted(i)) continue;
    for (int64_t at = i * map.layers; at < (i + 1) * map.layers; ++at) {
      const double cell = std::min(map.sigma_mm[at] / kCellMm, static_cast<double>(weights.size() - 1));
      weights[static_cast<size_t>(cell)] += map.weight[at];
    }
  }
  return {WidthOfShare(weights, kCellMm, 1.0 / 3.0), WidthOfShare(weights, kCellMm, 2.0 / 3.0)};
}

std::vector<std::string> Names(const std::string& prefix, int channels) {
  std::vector<std::string> names;
  for (const char* colour : channels == 1 ? std::vector<const char*>{"Y"} : std::vector<const char*>{"R", "G", "B"})
    names.push_back(prefix + colour);
  return names;
}

// Maps of equal size as channels of one file, each with its prefix.
Status WriteTogether(const std::filesystem::path& file,
                     const std::vector<std::pair<const char*, const Image<float>*>>& maps) {
  const Image<float>& any = *maps.front().second;
  const int colours = any.channels(), all = static_cast<int>(maps.size()) * colours;
  Image<float> together(any.width(), any.height(), all);
  std::vector<std::string> names;
  for (size_t m = 0; m < maps.size(); ++m) {
    for (const std::string& name : Names(maps[m].first, colours)) names.push_back(name);
    for (size_t i = 0; i < any.size(); ++i) {
      const size_t pixel = i / static_cast<size_t>(colours), colour = i % static_cast<size_t>(colours);
      together.pixels()[pixel * static_cast<size_t>(all) + m * static_cast<size_t>(colours) + colour] =
          maps[m].second->pixels()[i];
    }
  }
  return WriteExr(file, together, names);
}

}  // namespace

LayerMaps SummariseLayers(const MixtureMap& map) {
  const Image<float> unknown(map.width, map.height, map.channels, std::nanf(""));
  LayerMaps maps{unknown, unknown, unknown, unknown, unknown, unknown, unknown, FindBands(map)};
  ParallelFor(map.profiles(), 4096, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (!map.Fitted(i)) continue;
      double total = 0.0, depth = 0.0, width2 = 0.0;
      std::array<double, 3> band{};
      for (int64_t at = i * map.layers; at < (i + 1) * map.layers; ++at) {
        const double w = map.weight[at], sigma = map.sigma_mm[at];
        total += w;
        depth += w * map.depth_mm[at];
        width2 += w * sigma * sigma;
        band[sigma < maps.bands.shallow_mm ? 0 : sigma < maps.bands.deep_mm ? 1 : 2] += w;
      }
      maps.total_weight.pixels()[i] = static_cast<float>(total);
      maps.absorption.pixels()[i] = static_cast<float>(1.0 - total);
      if (!(total > 0.0)) continue;
      maps.effective_width_mm.pixels()[i] = static_cast<float>(std::sqrt(width2 / total));
      if (DepthKnown(map, i)) maps.mean_depth_mm.pixels()[i] = static_cast<float>(depth / total);
      maps.shallow.pixels()[i] = static_cast<float>(band[0]);
      maps.middle.pixels()[i] = static_cast<float>(band[1]);
      maps.deep.pixels()[i] = static_cast<float>(band[2]);
    }
  });
  return maps;
}

Image<float> SignalToNoise(const MixtureMap& map, std::span<const SrdBatch* const> lights) {
  Image<float> ratio(map.width, map.height, map.channels);
  ParallelFor(map.profiles(), 4096, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      double sum = 0.0, variance = 0.0;
      for (const SrdBatch* batch : lights) {
        if (batch->valid[i] == 0) continue;
        for (const float y : batch->Samples(i)) sum += y;
        variance += batch->VarianceOfSum(i);
      }
      ratio.pixels()[i] = variance > 0.0 ? static_cast<float>(std::max(sum, 0.0) / std::sqrt(variance)) : 0.0F;
    }
  });
  return ratio;
}

EffectiveMaps FindStandardErrors(const MixtureMap& map, std::span<const SrdBatch* const> lights, EmOptions options,
                                 const std::function<void(int64_t)>& progress) {
  const Image<float> unknown(map.width, map.height, map.channels, std::nanf(""));
  EffectiveMaps maps{unknown, unknown, unknown};
  options.scattering = map.scattering;
  ParallelFor(map.profiles(), 64, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      if (!map.Fitted(i)) continue;
      const EffectiveParameters errors = EffectiveParametersOf(map, i, lights, options);
      maps.total_weight.pixels()[i] = static_cast<float>(errors.total_weight.standard_error);
      if (DepthKnown(map, i)) maps.mean_depth_mm.pixels()[i] = static_cast<float>(errors.mean_depth_mm.standard_error);
      maps.effective_width_mm.pixels()[i] = static_cast<float>(errors.effective_width_mm.standard_error);
    }
    progress(end - begin);
  });
  return maps;
}

EffectiveMaps WithDisagreement(const EffectiveMaps& noise, const EffectiveMaps& fit,
                               std::span<const EffectiveMaps> left_out, int radius) {
  EffectiveMaps errors = noise;
  for (const auto& [quantity, relative] : kQuantities) {
    const Image<float>& value = fit.*quantity;
    const int colours = value.channels();
    const auto at = [&](size_t p, int x, int y, int c) { return double{(left_out[p].*quantity)(x, y, c)}; };
    // Weighted by certainty: one profile full of noise must not hide what its neighbours disagree by.
    Image<double> squares(value.width(), value.height(), 3 * colours);  // beyond noise, weights, profiles
    for (int y = 0; y < value.height(); ++y)
      for (int x = 0; x < value.width(); ++x)
        for (int c = 0; c < colours; ++c) {
          double mean = 0.0, square = 0.0;
          for (size_t p = 0; p < left_out.size(); ++p) mean += at(p, x, y, c) / static_cast<double>(left_out.size());
          for (size_t p = 0; p < left_out.size(); ++p) square += std::pow(at(p, x, y, c) - mean, 2);
          double by_noise = std::pow((noise.*quantity)(x, y, c), 2);
          if (relative) {
            square /= mean * mean;
            by_noise /= std::pow(value(x, y, c), 2);
            if (square > 1.0) continue;  // lights that differ by more than the value itself
          }
          if (!std::isfinite(square) || !std::isfinite(by_noise) || !(by_noise > 0.0)) continue;
          squares(x, y, c) = square / by_noise - 1.0;
          squares(x, y, colours + c) = 1.0 / by_noise;
          squares(x, y, 2 * colours + c) = 1.0;
        }
    const Image<double> sums = BoxSums(squares, radius);
    for (int y = 0; y < value.height(); ++y)
      for (int x = 0; x < value.width(); ++x)
        for (int c = 0; c < colours; ++c) {
          float& error = (errors.*quantity)(x, y, c);
          if (!std::isfinite(error) || sums(x, y, 2 * colours + c) < 0.5) continue;
          const double beyond_noise = std::sqrt(std::max(sums(x, y, c), 0.0) / sums(x, y, colours + c));
          error = std::hypot(error, static_cast<float>(beyond_noise * (relative ? value(x, y, c) : 1.0)));
        }
  }
  return errors;
}

Status WriteStandardErrors(const std::filesystem::path& folder, const EffectiveMaps& maps, const EffectiveMaps& noise) {
  return WriteTogether(folder / "standard_errors.exr", {{"total_weight.", &maps.total_weight},
                                                        {"mean_depth_mm.", &maps.mean_depth_mm},
                                                        {"effective_width_mm.", &maps.effective_width_mm},
                                                        {"noise_total_weight.", &noise.total_weight},
                                                        {"noise_mean_depth_mm.", &noise.mean_depth_mm},
                                                        {"noise_effective_width_mm.", &noise.effective_width_mm}});
}

Result<EffectiveMaps> LoadEffectiveMaps(const std::filesystem::path& folder, int channels) {
  EffectiveMaps maps;
  SLX_ASSIGN_OR_RETURN(maps.total_weight, ReadExr(folder / kTotalWeightFile, Names("", channels)));
  SLX_ASSIGN_OR_RETURN(maps.mean_depth_mm, ReadExr(folder / kMeanDepthFile, Names("", channels)));
  SLX_ASSIGN_OR_RETURN(maps.effective_width_mm, ReadExr(folder / kEffectiveWidthFile, Names("", channels)));
  return maps;
}

Status WriteLayerMaps(const std::filesystem::path& folder, const LayerMaps& maps) {
  const int channels = maps.total_weight.channels();
  const std::array<std::pair<const char*, const Image<float>*>, 4> each = {
      {{kTotalWeightFile, &maps.total_weight},
       {"absorption.exr", &maps.absorption},
       {kMeanDepthFile, &maps.mean_depth_mm},
       {kEffectiveWidthFile, &maps.effective_width_mm}}};
  return ParallelTry(each.size() + 1, [&](size_t k) {
    if (k < each.size()) return WriteExr(folder / each[k].first, *each[k].second, Names("", channels));
    return WriteTogether(folder / "depth_bands.exr",
                         {{"shallow.", &maps.shallow}, {"middle.", &maps.middle}, {"deep.", &maps.deep}});
  });
}

}  // namespace stratalux::fit
