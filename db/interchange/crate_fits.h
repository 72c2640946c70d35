// SPDX-License-Identifier: Apache-2.0
// The fits of a session as files of a crate. Internal to db/interchange.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

// A visitor's name in the store and in the crate; equal where it stays.
struct PseudonymChange {
  std::string from, to;
  [[nodiscard]] bool none() const { return from == to; }
};

// Ordinary files below a registered fit's folder, relative to it, sorted; what a running fit makes is left out, and so
// are links.
[[nodiscard]] std::vector<std::filesystem::path> FitFiles(const std::filesystem::path& fit_folder);

enum class CopiedFit { kCopied, kLeftOut };
// Bit for bit, but for the pseudonym: texts get the new one; a file in which it cannot be replaced is left out. What is
// a text says the name of `to`: `from` may be a file in memory.
[[nodiscard]] Result<CopiedFit> CopyFitFile(const std::filesystem::path& from, const std::filesystem::path& to,
                                            const PseudonymChange& change);

// fits.csv and metrics.csv.
[[nodiscard]] std::string FitsCsv(const std::vector<FitRow>& fits);
[[nodiscard]] std::string MetricsCsv(const std::vector<FitRow>& fits);

}  // namespace stratalux::db
