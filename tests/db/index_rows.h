// SPDX-License-Identifier: Apache-2.0
// An index full of made-up sessions, rows only: for questions to the index, which read no segment.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

struct IndexRowsOptions {
  int sessions = 100;
  int frames_per_session = 20;
  uint32_t seed = 1;
  WallNs now{1'800'000'000'000'000'000};              // the newest session starts shortly before
  enum class Fits { kFew, kReal } fits = Fits::kFew;  // figures of a fit: three, or as many as metrics.json holds
};

// What was written of a session, for oracles.
struct RowsOfSession {
  SessionRow row;
  std::string calibration;  // id, may be empty
  WallNs calibration_since;
  struct Fit {
    std::string id;
    WallNs created;
    double nrmse = 0.0, ssim = 0.0, divergence = 0.0;
  };
  std::vector<Fit> fits;
  std::vector<int> good_steps;
  std::vector<std::string> retake_causes;  // one a retake
};

// Of kind visitor or calibration, on three rigs, three a day back from `now`; nine of ten complete; one frame of a
// hundred shot again; four of five visitors' sessions fitted, some twice. The store in `folder` must be new. The plan
// of every session has PlannedStepsOfRows() steps; a degraded session lacks some, a failed one the second half.
std::vector<RowsOfSession> WriteIndexRows(const std::filesystem::path& folder, const IndexRowsOptions& options);
[[nodiscard]] int PlannedStepsOfRows();

}  // namespace stratalux::db
