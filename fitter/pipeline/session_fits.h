// SPDX-License-Identifier: Apache-2.0
// What a session has of fits, and of artifacts that none of them names.
#pragma once

#include <filesystem>
#include <string>

#include "fitter/pipeline/artifact_store.h"
#include "shared/base/log.h"

namespace stratalux::fit {

// Artifacts of a session that no fit of it points to.
[[nodiscard]] Result<CleanReport> CleanArtifacts(const std::string& store, const std::string& session,
                                                 const CleanOptions& options, Logger& logger);

// Folder of the session's newest fit; kNotFound when there is none. `session`: also "latest", the newest session that
// has one.
[[nodiscard]] Result<std::filesystem::path> NewestFit(const std::string& store, const std::string& session,
                                                      Logger& logger);

}  // namespace stratalux::fit
