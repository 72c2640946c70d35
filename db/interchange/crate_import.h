// SPDX-License-Identifier: Apache-2.0
// The sessions of a crate as sessions of this store: the same pixels, the same rows (docs/file-formats.md, "Crates").
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "shared/base/log.h"

namespace stratalux::db {

struct CrateImportReport {
  std::vector<std::string> sessions;   // taken in
  std::vector<std::string> present;    // here already; left as they are
  std::vector<std::string> forgotten;  // forgotten here; they do not come back
  int64_t frames = 0, fits = 0;
};

// Every checksum is verified and every session read through before the first byte is written; then session by session
// is written beside, verified, moved into place and listed, each whole or not at all. A session keeps its id. One that
// is here already is left as it is: the id is its identity. Frames are stored without encryption.
// kNotFound: no crate there. kIntegrity naming the file: changed, missing, surplus, outside the crate, or not what a
// writer of ours makes. kNewerSchema: a crate of a later version. kBusy: another import, pull or restore runs.
[[nodiscard]] Result<CrateImportReport> ImportCrate(const SessionStore& store, const std::filesystem::path& crate,
                                                    Logger& logger);

}  // namespace stratalux::db
