// SPDX-License-Identifier: Apache-2.0
// fits/<fit>/fit.json: what the index keeps of a fit, beside the fit itself, for `reindex`, and the size and hash of
// each of its files, for those that copy it.
#pragma once

#include <filesystem>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

inline constexpr const char* kFitRecordFile = "fit.json";

// Its text for the files that are in the folder now.
[[nodiscard]] Result<std::string> FitRecordOf(const std::filesystem::path& fit_folder, const FitRow& fit);
// A fit of an older program, without fit.json: its row out of metrics.json, dated by that file. kNotFound where neither
// is there: the fit was never registered.
[[nodiscard]] Result<FitRow> ReadFitRecord(const std::filesystem::path& fit_folder, const std::string& session_id);
// Holds the folder against its fit.json: kIntegrity names the file that is missing, another, or a link. Files that it
// does not name are no fault, nor is a record of an older program, which names none.
Status CheckFitFiles(const std::filesystem::path& fit_folder);

}  // namespace stratalux::db
