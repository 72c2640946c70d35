// SPDX-License-Identifier: Apache-2.0
// The index, built again from segments, manifests, fits and tombstones (docs/file-formats.md, "Reindex").
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::db {

struct ReindexReport {
  int64_t sessions = 0;
  int64_t frames = 0;
  int64_t fits = 0;
  int64_t forgotten = 0;              // tombstones
  std::vector<std::string> notes;     // tails set aside, sessions that ended as failed
  std::vector<std::string> problems;  // damage, what is missing, folders that could not be listed; nothing was changed
  bool newer = false;                 // among them what a later version wrote
  std::filesystem::path kept;         // the old index
};

// No segment is written, whatever is found: what is whole is listed, also behind damage and where the old index knows a
// frame, the rest is named. A session that cannot be listed does not keep the others from it.
//
// The new index is built beside the old one and takes its place in one rename. Forgotten sessions stay out, whatever
// their folders hold. Access log, jobs and withdrawn consents are in no file: they are taken over from the old index
// where it can be read. kBusy, before anything is written, while a session is written or any program has the old index
// open. kNotFound: no store there. Whoever opens the old index meanwhile reads it, but cannot write what the new one
// would lack. `before_swap` is called when the new one is whole, for tests.
[[nodiscard]] Result<ReindexReport> Reindex(const std::filesystem::path& store, Logger& logger,
                                            const std::function<void()>& before_swap = {});

}  // namespace stratalux::db
