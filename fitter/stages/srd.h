// SPDX-License-Identifier: Apache-2.0
// The srd stage: the frames of each projector's sweep, streamed from the store into batches of samples.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "fitter/mixture/gloss_field.h"
#include "fitter/mixture/srd_samples.h"
#include "fitter/session/session_frames.h"
#include "fitter/srd/srd_extractor.h"
#include "fitter/stages/shape.h"
#include "shared/base/log.h"

namespace stratalux::fit {

inline constexpr int kSrdVersion = 11;

// What became of one projector's sweep along one axis.
struct SweepFigure {
  int projector = 0;
  std::string axis;  // columns | rows
  std::map<std::string, int64_t> profiles_by_reason;
  int missing_frames = 0;
  // Cycle sum over w / q whites, where both are known: median, and the 95th percentile of its distance from 1.
  int64_t energy_profiles = 0;
  double energy_median = 1.0;
  double energy_p95_error = 0.0;
};

// SRDs of every projector on profiles of `pool` x `pool` quads.
struct SrdSet {
  int pool = 1;
  int width = 0, height = 0, channels = 0;
  std::vector<SrdBatch> batches;      // by projector: of its columns
  std::vector<SrdBatch> row_batches;  // by projector: of its rows; empty without a row sweep
  double spacing_mm = 0.0;            // between neighbouring profiles on the skin; 0: unknown
  [[nodiscard]] ProfileGrid Grid() const { return {width, height, channels, spacing_mm}; }
};

// All sweeps of a session. Frames that the capture lost: one of a cycle is made up for by the white frames, with more
// the projector is left out (no profile valid), both with a warning; kFailed when no projector is left. Of a head that
// moved each quad's geometry is that of the moment at which a line passed over it, and profiles are those of the
// shape's quads. `figures`: one a sweep.
[[nodiscard]] Result<SrdSet> ExtractSrds(const SessionFrames& frames, const FaceShape& shape, const SrdOptions& options,
                                         Logger& logger, std::vector<SweepFigure>& figures);

// Whether samples can be read so from combs of lines `width` columns wide that move by `step`: kUsage for 'scatter' and
// 'surface', which read between samples, where lines then stand further apart than they are wide.
[[nodiscard]] Status CheckReading(int width, int step, const SrdOptions& options);

}  // namespace stratalux::fit
