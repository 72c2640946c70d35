// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/neighbour_layers.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>

#include "fitter/mixture/srd_samples.h"
#include "shared/base/check.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

double TotalOf(const std::vector<float>& weight, int layers, int64_t profile) {
  const auto first = weight.begin() + profile * layers;
  return std::accumulate(first, first + layers, 0.0);
}

// Sums on a grid over place and logarithm of the total weight, of one colour (a bilateral grid; Chen, Paris & Durand
// 2007); of its cells those that somebody is in. Profiles are added to the eight cells around them and read back from
// these.
class Cells {
 public:
  explicit Cells(int values) : values_(values) {}

  // add(sums of a cell, share): of the eight cells around.
  template <typename Add>
  void Around(double x_mm, double y_mm, double log_total, const Add& add) {
    const At x(x_mm / kNeighbourCellMm), y(y_mm / kNeighbourCellMm), t(log_total / std::log(kNeighbourCellRatio));
    for (int k = 0; k < 2; ++k)
      for (int j = 0; j < 2; ++j)
        for (int i = 0; i < 2; ++i)
          if (const double share = x.share[i] * y.share[j] * t.share[k]; share > 0.0)
            add(Sums({x.first + i, y.first + j, t.first + k}), share);
  }

 private:
  struct At {
    int64_t first;
    std::array<double, 2> share;
    explicit At(double at)
        : first(static_cast<int64_t>(std::floor(at))), share{1.0 - (at - std::floor(at)), at - std::floor(at)} {}
  };
  double* Sums(const std::array<int64_t, 3>& cell) {
    const auto [at, is_new] = places_.try_emplace(cell, sums_.size());
    if (is_new) sums_.resize(sums_.size() + static_cast<size_t>(values_), 0.0);
    return sums_.data() + at->second;
  }

  int values_;
  std::map<std::array<int64_t, 3>, size_t> places_;
  std::vector<double> sums_;
};

// A cell holds of each layer the sums of weight, weight times depth, weight times width.
constexpr size_t kSums = 3;
// Of what a profile adds to its cells: left of the sums when that is taken out again.
constexpr double kRounding = 1e-9;

double TotalOf(const LayerSet& layers) { return std::accumulate(layers.weight.begin(), layers.weight.end(), 0.0); }

// The session's beside what the cells around say of the neighbours, of the same total weight as the profile itself.
void MeanOfCells(std::span<const double> sums, const LayerSet& mean, double total, ProfileLayers& field, size_t row) {
  const size_t layers = mean.weight.size();
  const double session = kSessionsMembers * total / std::max(TotalOf(mean), 1e-9);
  double all = 0.0;
  for (size_t l = 0; l < layers; ++l) all += std::max(sums[kSums * l], 0.0) + session * mean.weight[l];
  for (size_t l = 0; l < layers; ++l) {
    const double own = session * mean.weight[l], near = sums[kSums * l] > 0.0 ? sums[kSums * l] : 0.0, w = near + own;
    const size_t at = row * layers + l;
    const auto of = [&](size_t moment, double known) {
      return static_cast<float>(((near > 0.0 ? sums[kSums * l + moment] : 0.0) + own * known) / w);
    };
    field.weight[at] = all > 0.0 ? static_cast<float>(w / all * total) : 0.0F;
    field.depth_mm[at] = w > 0.0 ? of(1, mean.depth_mm[l]) : 0.0F;
    field.sigma_mm[at] = w > 0.0 ? of(2, mean.sigma_mm[l]) : 1.0F;
  }
}

void AddColour(const MixtureMap& fit, const LayerSet& mean, double spacing_mm, int colour, ProfileLayers& field) {
  const size_t layers = static_cast<size_t>(fit.layers);
  Cells cells(static_cast<int>(kSums * layers));
  const auto around = [&](int64_t i, double total, const auto& add) {
    const int64_t pixel = i / fit.channels;
    cells.Around(static_cast<double>(pixel % fit.width) * spacing_mm,
                 static_cast<double>(pixel / fit.width) * spacing_mm, std::log(total), add);
  };
  const auto each = [&](const auto& visit) {
    for (int64_t i = colour; i < fit.profiles(); i += fit.channels)
      if (field.Has(i)) visit(i, TotalOf(fit.weight, fit.layers, i));
  };
  const auto own = [&](int64_t i, double share, const auto& take) {
    for (size_t l = 0; l < layers; ++l) {
      const size_t at = static_cast<size_t>(i) * layers + l;
      const double w = share * double{fit.weight[at]};
      take(kSums * l, w);
      take(kSums * l + 1, w * double{fit.depth_mm[at]});
      take(kSums * l + 2, w * double{fit.sigma_mm[at]});
    }
  };
  each([&](int64_t i, double total) {
    around(i, total, [&](double* sums, double share) { own(i, share, [&](size_t v, double x) { sums[v] += x; }); });
  });
  std::vector<double> near(kSums * layers);
  each([&](int64_t i, double total) {
    std::fill(near.begin(), near.end(), 0.0);
    double itself = 0.0;
    around(i, total, [&](const double* sums, double share) {
      for (size_t v = 0; v < near.size(); ++v) near[v] += share * sums[v];
      itself += share * share;
    });
    own(i, itself, [&](size_t v, double x) {
      near[v] -= x;
      if (near[v] < kRounding * x) near[v] = 0.0;  // nobody else
    });
    MeanOfCells(near, mean, total, field, static_cast<size_t>(field.row[static_cast<size_t>(i)]));
  });
}

}  // namespace

ProfileLayers NeighbourLayers(const MixtureMap& fit, std::span<const uint8_t> apart, std::span<const LayerSet> mean,
                              double spacing_mm) {
  SLX_CHECK(spacing_mm > 0.0 && std::ssize(mean) == fit.channels);
  ProfileLayers field{.layers = fit.layers, .row = {}, .weight = {}, .depth_mm = {}, .sigma_mm = {}};
  field.row.assign(static_cast<size_t>(fit.profiles()), -1);
  int32_t rows = 0;
  for (int64_t i = 0; i < fit.profiles(); ++i)
    if (fit.Fitted(i) && !IsApart(apart, i) && !mean[static_cast<size_t>(i % fit.channels)].weight.empty() &&
        TotalOf(fit.weight, fit.layers, i) > 0.0)
      field.row[static_cast<size_t>(i)] = rows++;
  for (auto* values : {&field.weight, &field.depth_mm, &field.sigma_mm})
    values->assign(static_cast<size_t>(rows) * static_cast<size_t>(fit.layers), 0.0F);
  ParallelEach(mean.size(),
               [&](size_t colour) { AddColour(fit, mean[colour], spacing_mm, static_cast<int>(colour), field); });
  return field;
}

ProfileLayers ProfilesOf(const ProfileLayers& field, std::span<const int64_t> which) {
  ProfileLayers part{.layers = field.layers, .row = {}, .weight = {}, .depth_mm = {}, .sigma_mm = {}};
  int32_t rows = 0;
  for (const int64_t i : which) {
    part.row.push_back(field.Has(i) ? rows++ : -1);
    if (!field.Has(i)) continue;
    for (const auto values : {&ProfileLayers::weight, &ProfileLayers::depth_mm, &ProfileLayers::sigma_mm}) {
      const auto from = (field.*values).begin() + int64_t{field.row[static_cast<size_t>(i)]} * field.layers;
      (part.*values).insert((part.*values).end(), from, from + field.layers);
    }
  }
  return part;
}

LayerSet StartLayers::Of(int64_t profile) const {
  if (mean.empty()) return {};
  LayerSet layers = mean[static_cast<size_t>(profile) % mean.size()];
  if (near == nullptr || layers.weight.empty() || !near->Has(profile)) return layers;
  const double of_mean = TotalOf(layers);
  double total = 0.0;
  for (size_t l = 0; l < layers.weight.size(); ++l) {
    const size_t at = static_cast<size_t>(near->row[static_cast<size_t>(profile)]) * layers.weight.size() + l;
    total += near->weight[at];
    layers.weight[l] = near->weight[at];
    layers.depth_mm[l] = near->depth_mm[at];
    layers.sigma_mm[l] = near->sigma_mm[at];
  }
  layers.background *= total / std::max(of_mean, 1e-9);
  return layers;
}

}  // namespace stratalux::fit
