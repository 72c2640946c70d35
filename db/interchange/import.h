// SPDX-License-Identifier: Apache-2.0
// Captures of other rigs as sessions of the store, so that they run through every stage.
#pragma once

#include <cstdint>
#include <string>

#include "db/catalogue/session_store.h"
#include "db/interchange/import_manifest.h"
#include "shared/base/log.h"

namespace stratalux::db {

struct ImportReport {
  std::string session;
  int64_t frames = 0;
};

// Stores the manifest's files as one `complete` session with an empty plan, frames not level-checked. Each file is read
// twice, once to be checked before anything is written, so that memory stays at one image whatever the number of files.
// kUsage naming the manifest's line and the file: files that are missing or not PNG, colour images, a bit depth or a
// size that is not the stated one, samples above the bit depth. Nothing is written then. Progress goes to `logger`.
[[nodiscard]] Result<ImportReport> ImportSession(SessionStore& store, const ImportOptions& options, Logger& logger);

}  // namespace stratalux::db
