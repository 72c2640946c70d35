// SPDX-License-Identifier: Apache-2.0
// One light's part of a block of profiles: data, geometry and line response; and the work space of the EM
// kernels.
#pragma once

#include "fitter/mixture/em_kernel.h"
#include "fitter/mixture/em_lanes.h"
#include "fitter/mixture/scattering_model.h"
#include "fitter/mixture/srd_samples.h"

namespace stratalux::fit {

struct EmLight {
  EmGrid grid;
  int samples = 0;
  int cells_per_sample = 0;
  int pad_cells = 0;     // unobserved cells on either side of an open window
  int reach = 0;         // cells before and behind a sample's own that some lane's line response reaches
  int reach_limit = 0;   // the most that `reach` may be
  int halo_samples = 0;  // before and behind the light's own whose cells reach it
  LaneRows data;         // [sample] max(y + shift, 0)
  LaneRow shift;         // sigma_read^2 in counts over counts per unit (shifted Poisson)
  // Response of a sample to its own cells and `reach_limit` on either side: [tap], 0 beyond the lane's own reach.
  LaneRows response;
  LaneRows surface_response;  // [sample]: response to a delta at u = 0
  LaneRow surface_total;      // its sum
  LaneRows unseen;            // [cell]: full coverage minus B^T 1
  bool sees_all = true;       // so far, all of it is 0
  LaneRow s, gain, counts;    // shift coefficient, angular gain, photon counts per unit (relative); counts 0: absent
  LaneRow cell_mm, origin;    // cell size; cell coordinate of u = 0
  // Of the directional weights: sec_i + sec_o - 2, and what a layer without depth or width shows, less 1.
  LaneRow extra_path, phase_m1;
  LaneRow reflected;  // by the surface, reflectance; negative: unknown
  LaneRow coverage;   // sum over samples of the response, inside: mean over the cells
  // What the M step takes each cell to be seen by: of a thinned cycle, whose lines light some cells more than others,
  // the most that any is, and the white frames. `unseen` is what a cell's samples lack of it.
  LaneRow full_coverage;
  LaneRow white, white_variance;  // variance 0: none
  // Of a thinned cycle the white frames are one more sample, that sees all cells alike: its weight beside the others
  // (0: none), and what the E step gives back of it to each cell.
  LaneRow white_weight, white_back;

  LaneRows model;                    // [sample]
  LaneRow ratio_sum, surface_ratio;  // sums of the ratios, plain and weighted with the surface response

  [[nodiscard]] int taps() const { return 2 * reach_limit + cells_per_sample; }
  // Of the first of a sample's own cells.
  [[nodiscard]] const float* Response() const { return response.data() + size_t(reach_limit) * kEmLanes; }
};

// Work space of a sweep's E step, of one light after another: what all of them share stays in the nearest caches.
struct EmWork {
  LaneRows mass, ratio;  // with a light's reach_limit cells, its halo_samples, more on either side
  LaneRows q;            // [cell]
  LayerTiles tiles;

  void MakeRoomFor(const EmLight& light);
  [[nodiscard]] float* Mass(const EmLight& light) { return mass.data() + size_t(light.reach_limit) * kEmLanes; }
  [[nodiscard]] float* Ratio(const EmLight& light) { return ratio.data() + size_t(light.halo_samples) * kEmLanes; }
};

// Whether combs of the cycle are left out: its lines light some columns more often than others.
[[nodiscard]] bool IsThinned(const SrdBatch& batch, int64_t profile);

// No light in that lane.
void ClearLane(int lane, EmLight& light);
// `profile` of `batch` in that lane, which was clear.
void LoadLane(const ScatteringModel& model, const SrdBatch& batch, int64_t profile, int lane, EmLight& light);

}  // namespace stratalux::fit
