// SPDX-License-Identifier: Apache-2.0
// EM over one block of sixteen profiles and their training lights. Internal to fitter/mixture.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "fitter/mixture/em_kernel.h"
#include "fitter/mixture/em_options.h"
#include "fitter/mixture/mixture_map.h"
#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

// One light's part of a block. Arrays are [index][lane].
struct EmLight {
  EmGrid grid;
  int samples = 0;
  int cells_per_sample = 0;
  int pad_cells = 0;                    // unobserved cells on either side of an open window
  int taps = 0;                         // of the line response, odd
  std::vector<float> y, shift;          // data and sigma_read^2 in counts over counts per unit (shifted Poisson)
  std::vector<float> response;          // [tap][lane]
  std::vector<float> surface_response;  // [sample][lane]: response to a delta at u = 0
  std::vector<float> unseen;            // [cell][lane]: full coverage minus B^T 1
  std::vector<float> mass, model, q;    // work
  std::array<float, kLanes> s{}, gain{},
      counts{};  // shift coefficient, angular gain, photon counts per unit (relative); 0 = absent
  std::array<float, kLanes> cell_mm{}, origin{};  // cell size; cell coordinate of u = 0
  std::array<float, kLanes> coverage{};           // sum over samples of the response, inside
  std::array<float, kLanes> surface{}, background{};
  std::array<float, kLanes> white{}, white_variance{};  // variance 0: none
};

class EmBlock {
 public:
  // `members`: at most kLanes profile indices; usable[light][profile] says which lights count for a profile.
  EmBlock(std::span<const SrdBatch* const> lights, std::span<const std::vector<uint8_t>> usable,
          std::span<const int64_t> members, const EmOptions& options, std::span<const LayerSet> start = {});

  // Sweeps until the divergence settles; returns the sweeps done.
  int Run();

  [[nodiscard]] float Weight(int layer, int lane) const { return weight_[layer * kLanes + lane]; }
  [[nodiscard]] float DepthMm(int layer, int lane) const { return depth_[layer * kLanes + lane]; }
  [[nodiscard]] float SigmaMm(int layer, int lane) const { return sigma_[layer * kLanes + lane]; }
  [[nodiscard]] const EmLight& Light(int light) const { return lights_[light]; }
  // Kullback-Leibler divergence of data and model over the data's sum, per lane.
  [[nodiscard]] std::array<double, kLanes> Divergence() const;
  // Mean over the lights of a lane of the floor over a whole cycle, in units of reflectance.
  [[nodiscard]] float MeanBackground(int lane) const;
  // Largest |s| over the lights of a lane.
  [[nodiscard]] float LargestShift(int lane) const;

 private:
  void LoadLight(const SrdBatch& batch, std::span<const uint8_t> usable, EmLight& light) const;
  void BuildResponse(const SrdBatch& batch, EmLight& light) const;
  void Initialise(std::span<const LayerSet> start);
  void SpreadLayers(int lane, double total, double widest_mm);
  void StartFrom(const LayerSet& layers, int lane, double total);
  void Predict(EmLight& light);
  void BackProject(EmLight& light);
  void Sweep();
  void UpdateFloor(EmLight& light);
  void ShareBackground();
  void ScaleToWhite();

  EmOptions options_;
  int sweeps_ = 0;  // at most
  std::span<const int64_t> members_;
  std::vector<EmLight> lights_;
  std::vector<float> weight_, depth_, sigma_;                          // [layer][lane], mm
  std::vector<float> cell_weight_, cell_mean_, cell_sigma_, moments_;  // of the light at hand, in cells
  std::array<float, kLanes> sigma_floor_{};
};

}  // namespace stratalux::fit
