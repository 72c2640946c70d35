// SPDX-License-Identifier: Apache-2.0
// What a session has of fits, and of artifacts that none of them names.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "fitter/pipeline/artifact_store.h"
#include "fitter/session/session_frames.h"
#include "shared/base/log.h"

namespace stratalux::fit {

// Artifacts of a session that no fit of it points to. Fits that an older program left plain in an encrypted session are
// sealed.
[[nodiscard]] Result<CleanReport> CleanArtifacts(const std::string& store, const std::string& session,
                                                 const CleanOptions& options, Logger& logger);

// The sessions of which stages have left anything, oldest first.
[[nodiscard]] Result<std::vector<std::string>> SessionsWithArtifacts(const std::string& store);

struct StoredFit {
  std::string session, id;
  std::filesystem::path folder;
  db::FileSeal seal;
};

// The session's newest fit; kNotFound when there is none. `session`: also "latest", the newest session that has one.
[[nodiscard]] Result<StoredFit> NewestFit(const std::string& store, const std::string& session, Logger& logger);
// The one of that name; kNotFound when the session has no such fit.
[[nodiscard]] Result<StoredFit> NamedFit(const std::string& store, const std::string& session, const std::string& fit,
                                         Logger& logger);
// Holds its files against its record, then lets `read` find them, plain, in the folder it is given. kNotFound without
// the key of an encrypted session.
Status ReadFit(const StoredFit& fit, const UseOfFolder& read);
// A plain copy of its files in `out`, logged and marked as an export of that action.
Status CopyFit(const std::string& store, const StoredFit& fit, const std::string& action,
               const std::filesystem::path& out);

}  // namespace stratalux::fit
