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

}  // namespace stratalux::fit
