// SPDX-License-Identifier: Apache-2.0
// Cuts the power after every call of a log, in several ways each, and checks each store that remains.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "tests/db/crash/disk_model.h"
#include "tests/db/crash/store_check.h"

namespace stratalux::db::crash {

struct EnumerationReport {
  int64_t points = 0;   // calls that change or sync something, after which the power was cut
  int64_t cuts = 0;     // points x ways of cutting
  CheckCounts checked;  // distinct states of a disk, each with what was promised by then
  int64_t violations = 0;
  std::vector<std::string> first_violations;
};

struct EnumerationOptions {
  int random_cuts = 3;  // of each kind that draws
  bool until_first_violation = false;
  size_t from_call = 0;  // earlier ones are made, but not cut after
  int stride = 1;        // cuts after every stride-th call of each kind, from a drawn one on; of each kind at least one
};

// What is broken in the store that a power cut left in `folder`, for people; `mark` is the last that was recorded by
// then (0 before the first). Empty: nothing is.
using CheckFunction =
    std::function<std::vector<std::string>(const std::filesystem::path& folder, int64_t mark, CheckCounts& counts)>;

// `folder` is used for one store after the other.
EnumerationReport Enumerate(const DiskLog& log, const CheckFunction& check, const std::filesystem::path& folder,
                            const EnumerationOptions& options = {});
// The promises of a workload, by marks.
EnumerationReport Enumerate(const DiskLog& log, const std::vector<Promise>& promises,
                            const std::filesystem::path& folder, const EnumerationOptions& options = {});
// STRATALUX_CRASH_STRIDE: one call of so many; 2 at night, a sample without it.
[[nodiscard]] int SampledStride();
// Below `stride`, by STRATALUX_SEED.
[[nodiscard]] int64_t SampledStart(int64_t stride);
void Add(const EnumerationReport& more, EnumerationReport& sum);
// Also counts for the line at the end of the program.
void Print(const std::string& title, const EnumerationReport& report);

}  // namespace stratalux::db::crash
