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
  bool sealed = false;             // its files: the session is encrypted
  bool was_complete = false;       // nothing had to be done; of a dry run: has to be
  std::vector<PlannedStage> plan;  // of a dry run
  int64_t sites = 0;               // of the camera's mosaic
  std::optional<ThinPlan> thin;    // what of the visit's frames the fit reads; none: all
  Status readable = {};            // of a dry run: kNotFound without the key of an encrypted session
};

// Goes on where an earlier run ended; shares what another run makes at the same time.
Result<RunOutcome> RunSession(const RunOptions& options, Logger& logger);

}  // namespace stratalux::fit
