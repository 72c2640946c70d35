// SPDX-License-Identifier: Apache-2.0
// Putting a new index in the place of the old one. Internal to db/.
#pragma once

#include <filesystem>
#include <memory>

#include "shared/base/result.h"

namespace stratalux::db {

// What names of indexes that were swapped out begin with, and of their logs.
inline constexpr const char* kKeptIndex = "index-before-reindex-";

// Folds the old index's log into it, so that its file stands alone, and keeps every program from writing it as long as
// what is returned lives: let go of it behind SwapIndex. Whoever waited to write meanwhile is refused then (kBusy), as
// SQLite sees that the file was moved. kBusy while any program has it open. A damaged or missing one is no failure
// (null, nothing is held): its log is kept beside it by SwapIndex.
[[nodiscard]] Result<std::shared_ptr<void>> ReleaseIndex(const std::filesystem::path& store);

// Undoes ReleaseIndex where the old index stays; nobody holds it any more.
Status ResumeIndex(const std::filesystem::path& store);

// `fresh` becomes STORE/index.sqlite in one rename, synced before and after; the old index stays as
// index-before-reindex-N.sqlite (returned; empty where there was none).
[[nodiscard]] Result<std::filesystem::path> SwapIndex(const std::filesystem::path& store,
                                                      const std::filesystem::path& fresh);

}  // namespace stratalux::db
