// SPDX-License-Identifier: Apache-2.0
// Chosen sessions as an RO-Crate 1.3: a folder that other laboratories' programs understand, and that `import --crate`
// reads back bit for bit (docs/file-formats.md, "Crates").
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "db/interchange/export.h"
#include "shared/base/log.h"

namespace stratalux::db {

// The purpose for which visitors' sessions leave; it must be stated for them.
enum class CrateScope { kNotStated, kResearch, kPublication };
[[nodiscard]] const char* ToString(CrateScope scope);  // "research", "publication", ""

enum class CratePseudonyms {
  kFresh,  // one of this crate alone for each visitor: two crates cannot be joined by them
  kKept
};

struct CrateOptions {
  std::filesystem::path out;  // must not exist yet, or be empty
  ExportFormat frames = ExportFormat::kTiff;
  CrateScope scope = CrateScope::kNotStated;
  CratePseudonyms pseudonyms = CratePseudonyms::kFresh;
  std::string title;    // empty: made of the rigs' names
  std::string licence;  // identifier of the SPDX list; empty: none is granted beyond the consents

  [[nodiscard]] Status Validate() const;
};

struct CrateReport {
  std::vector<std::string> sessions;  // written
  struct Refusal {
    std::string session, reason;
  };
  std::vector<Refusal> refused;    // nothing of them was written
  std::vector<std::string> notes;  // files of fits that were left out, and why
  int64_t frames = 0, files = 0, bytes = 0;
};

// Written beside as OUT.partial and renamed when all of it is on the disk: whatever breaks off, no half crate bears the
// final name, and the next export to it begins anew. Logged and marked before the first byte, so that `forget` finds a
// crate and a broken-off one. Where every session is refused nothing is written (the report says so; kOk). kNotFound:
// a session that is not there; kUsage: options, an OUT that holds something; kBusy: another export writes it;
// kIntegrity: damaged frames.
[[nodiscard]] Result<CrateReport> ExportCrate(const SessionStore& store, const std::vector<SessionRow>& sessions,
                                              const CrateOptions& options, Logger& logger);

}  // namespace stratalux::db
