// SPDX-License-Identifier: Apache-2.0
// fits/<fit>/fit.json: what the index keeps of a fit, beside the fit itself, for `reindex`.
#pragma once

#include <filesystem>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

// Makes the folder where it is missing.
Status WriteFitRecord(const std::filesystem::path& fit_folder, const FitRow& fit);
// A fit of an older program, without fit.json: its row out of metrics.json, dated by that file. kNotFound where neither
// is there: the fit was never registered.
[[nodiscard]] Result<FitRow> ReadFitRecord(const std::filesystem::path& fit_folder, const std::string& session_id);

}  // namespace stratalux::db
