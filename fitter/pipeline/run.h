// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit run` and the stages by name.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "fitter/pipeline/publish.h"
#include "fitter/pipeline/run_options.h"
#include "shared/base/log.h"

namespace stratalux::fit {

struct RunOutcome {
  std::string session, fit;
  std::filesystem::path folder;    // of the fit, STORE/sessions/<id>/fits/<fit>, or of the stage's artifact
  bool was_complete = false;       // nothing had to be done
  std::vector<PlannedStage> plan;  // of a dry run
};

// Goes on where an earlier run ended; shares what another run makes at the same time.
Result<RunOutcome> RunSession(const RunOptions& options, Logger& logger);

// Artifacts of a session that no fit of it points to.
[[nodiscard]] Result<CleanReport> CleanArtifacts(const std::string& store, const std::string& session,
                                                 const CleanOptions& options, Logger& logger);

// Folder of the session's newest fit; kNotFound when there is none. `session`: also "latest", the newest session that
// has one.
[[nodiscard]] Result<std::filesystem::path> NewestFit(const std::string& store, const std::string& session,
                                                      Logger& logger);

}  // namespace stratalux::fit
