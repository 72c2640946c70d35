// SPDX-License-Identifier: Apache-2.0
// EM over profiles and their training lights, sixteen at a time: a lane that is done takes the next profile, so that
// profiles that settle early cost nothing. Internal to fitter/mixture.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <utility>
#include <vector>

#include "fitter/mixture/em_light.h"
#include "fitter/mixture/em_options.h"
#include "fitter/mixture/em_pace.h"
#include "fitter/mixture/em_prior.h"
#include "fitter/mixture/em_update.h"
#include "fitter/mixture/layer_set.h"
#include "fitter/mixture/mixture_map.h"
#include "fitter/mixture/neighbour_layers.h"
#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

class EmBlock {
 public:
  // usable[light][profile] says which lights count for a profile; cells_per_sample[light]: of each profile of the block
  // (CellsPerSample).
  EmBlock(std::span<const SrdBatch* const> lights, std::span<const std::vector<uint8_t>> usable,
          std::span<const int> cells_per_sample, const EmOptions& options, const StartLayers& start);

  // Sweeps each of `profiles` until its divergence settles, with a prior of each of `photons` (at least one, 0: none;
  // in the place of options.prior's): loaded once, it is fitted as often. done(lane, profile, trial) finds the results
  // in that lane. They depend on nothing but the profile's own data and photons[trial].
  void Fit(std::span<const int64_t> profiles, std::span<const double> photons,
           const std::function<void(int lane, int64_t profile, size_t trial)>& done);

  // Fit then also says what Cost would be if a sweep were the last, of the first `sweeps` of each profile.
  void TraceCosts(int sweeps, std::function<void(int64_t profile, int sweep, double cost)> traced) {
    traced_sweeps_ = sweeps;
    traced_ = std::move(traced);
  }

  // Profiles (a lane each) that are fitted by layers in common (MeanLayers). They begin where Fit would, and stay.
  void Hold(std::span<const int64_t> profiles);
  [[nodiscard]] std::span<const int64_t> held() const { return held_; }
  // What it starts from, as Fit would.
  [[nodiscard]] LayerSet StartOf(int lane) const;
  // The E step of those held: lane i by layers[i] in its own brightness, which takes its M step then, as do its surface
  // and its floor. The sums of the layers' M step are the caller's to make: HeldSum. Cost is what it was before.
  void Expect(std::span<const LayerSet* const> layers);
  // Of one layer of one profile held, as if it had the layers' own brightness.
  struct LayerSums {
    double photons = 0.0, moved = 0.0, leverage = 0.0, spread = 0.0, exposure = 0.0;  // MomentSums
  };
  [[nodiscard]] LayerSums HeldSum(int layer, int lane) const;
  // Sum of its layers' weights, of those held.
  [[nodiscard]] double Brightness(int lane) const { return lanes_[lane].brightness; }
  // Of the profile's light.
  [[nodiscard]] double OwnPhotons(int lane) const { return lanes_[lane].own; }

  // Divergence in photons of each of `profiles` from what the layers of each of `fits`, maps of the same profiles
  // fitted to other lights, say of these lights: the surface as its reflection is known, else, like the floor, as the
  // mean of the fit's own lights. Nothing is swept or scaled.
  void CompareWith(std::span<const int64_t> profiles, std::span<const MixtureMap> fits,
                   const std::function<void(int64_t profile, size_t fit, double photons)>& done);

  [[nodiscard]] float Weight(int layer, int lane) const { return At(rows_.weight(layer), lane); }
  [[nodiscard]] float DepthMm(int layer, int lane) const { return At(rows_.depth(layer), lane); }
  [[nodiscard]] float SigmaMm(int layer, int lane) const { return At(rows_.sigma(layer), lane); }
  [[nodiscard]] float Surface(int light, int lane) const { return At(rows_.surface(light), lane); }
  [[nodiscard]] float Background(int light, int lane) const { return At(rows_.background(light), lane); }
  // Kullback-Leibler divergence of data and model over the data's sum; worked out when asked.
  [[nodiscard]] double Divergence(int lane) const;
  // What the sweeps lower, in photons: that divergence, before the scale of the white frames, and the prior's cost; a
  // negative log posterior but for a constant.
  [[nodiscard]] double Cost(int lane) const { return divergence_[lane]; }
  // Share of the prior's photons in those that the layers were fitted to.
  [[nodiscard]] double PriorShare(int lane) const;
  [[nodiscard]] int Sweeps(int lane) const { return lanes_[lane].pace.sweeps; }
  // Mean over the lights of a lane of the floor over a whole cycle, in units of reflectance.
  [[nodiscard]] float MeanBackground(int lane) const;
  // Largest |s| over the lights of a lane.
  [[nodiscard]] float LargestShift(int lane) const;
  // Profiles x cells x layers x sweeps so far: the whole grid, and what was evaluated of it.
  [[nodiscard]] int64_t GridComponents() const { return grid_components_; }
  [[nodiscard]] int64_t EvaluatedComponents() const { return evaluated_components_; }

 private:
  struct Lane {
    int64_t profile = -1;  // -1: idle
    size_t trial = 0;
    double total = 0.0;       // photons of data
    double own = 0.0;         // of them, the profile's light
    EmPace pace = {};         // its last sweep made, the layers are final: only their divergence is missing
    double brightness = 0.0;  // of the layers of those held
    double scale = 1.0;       // of the model to the white frames
  };

  void Load(int lane, int64_t profile);
  void Clear(int lane);
  void ClearLayers(int lane);
  void Begin(int lane, size_t trial, double photons);
  void Start(int lane, double photons);
  [[nodiscard]] EmPrior PriorFor(std::span<const double> photons) const;
  void Take(const MixtureMap& fit, int lane);
  void SpreadLayers(int lane, double total, double widest_mm);
  void StartFrom(const LayerSet& layers, int lane, double total);
  void Sweep(bool update);
  void AddWhite(int light);
  void UpdateFloor(int light);
  void ShareBackground(float* parameters) const;
  void UpdateParameters();
  void Judge();
  void TellCosts();
  void Finish(int lane);
  [[nodiscard]] double ScaleToWhite(int lane) const;
  [[nodiscard]] double HeldSurface(const EmLight& light, int p, int k, int lane) const;
  [[nodiscard]] float& At(int row, int lane) { return at_[size_t(row) * kEmLanes + lane]; }
  [[nodiscard]] float At(int row, int lane) const { return at_[size_t(row) * kEmLanes + lane]; }

  EmOptions options_;
  int most_sweeps_ = 0, traced_sweeps_ = 0;
  std::function<void(int64_t profile, int sweep, double cost)> traced_;
  std::span<const SrdBatch* const> batches_;
  std::span<const std::vector<uint8_t>> usable_;
  StartLayers start_;
  bool accelerated_ = false;
  std::vector<EmLight> lights_;
  ParameterRows rows_;
  LayerBounds bounds_;
  LaneRows at_, image_, last_;  // parameters: of this sweep, what it makes of them, what the last one made
  std::array<Lane, kEmLanes> lanes_{};
  std::vector<int64_t> held_;
  EmPrior prior_;
  LaneRow divergence_;  // and, with a prior, its cost
  alignas(64) std::array<int, kEmLanes> step_{};
  LaneRow momentum_;
  LaneRows cell_weight_, cell_mean_, cell_sigma_, moments_, factor_;  // of the light at hand
  MomentSums sums_;
  int64_t grid_components_ = 0, evaluated_components_ = 0;
};

}  // namespace stratalux::fit
