// SPDX-License-Identifier: Apache-2.0
// SRDs as an artifact: of each sweep the profiles that are valid, and nothing of the others.
#pragma once

#include <filesystem>
#include <vector>

#include "fitter/stages/srd.h"

namespace stratalux::fit {

struct ExtractedSrds {
  SrdSet set;
  std::vector<SweepFigure> figures;  // one a sweep
};

// srds.json, and for each sweep, columns_<p> or rows_<p>: profile.npy (index (y * width + x) * channels + c) and one
// array for each member of SrdBatch, a row a profile. Values of profiles that are not valid do not come back.
Status SaveSrds(const std::filesystem::path& folder, const ExtractedSrds& srds);
[[nodiscard]] Result<ExtractedSrds> LoadSrds(const std::filesystem::path& folder);

// The figures, and of the column sweeps that profile alone, as ProfilesOf() picks it: reads no other's samples.
struct ProfileSrds {
  std::vector<SweepFigure> figures;
  std::vector<SrdBatch> batches;  // by projector; none where `profile` is negative
};
[[nodiscard]] Result<ProfileSrds> LoadProfileSrds(const std::filesystem::path& folder, int64_t profile);

}  // namespace stratalux::fit
