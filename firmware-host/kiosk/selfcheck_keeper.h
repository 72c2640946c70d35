// SPDX-License-Identifier: Apache-2.0
// The self-checks of a kiosk on the disk, in the state folder (state_file.h; docs/file-formats.md, "Kept by the
// kiosk").
#pragma once

#include <filesystem>

#include "firmware-host/kiosk/selfcheck_trend.h"
#include "firmware-host/sequence/rig_check.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// `folder`/selfchecks.json; of the simulated rig selfchecks-simulated.json.
[[nodiscard]] std::filesystem::path SelfchecksFile(const std::filesystem::path& folder, bool simulated);
// Fails as ReadState.
[[nodiscard]] Result<SelfcheckBook> ReadSelfchecks(const std::filesystem::path& file);

// The figures of a check that lit at least one projector; nullopt of any other.
[[nodiscard]] std::optional<Selfcheck> SelfcheckOf(const RigCheckReport& report, double exposure_ms);

// Thread-bound.
class SelfcheckKeeper {
 public:
  // What is there and cannot be used is set aside and logged. `file` empty: nothing is kept beyond the program's end.
  // `logger` outlives it.
  SelfcheckKeeper(std::filesystem::path file, Logger& logger);

  // On the disk when it returns, or logged and named in the trend's note why not; a later one writes it, too.
  void Add(Selfcheck check);
  [[nodiscard]] SelfcheckTrend trend() const;

 private:
  std::filesystem::path file_;
  Logger& logger_;
  SelfcheckBook book_;
  std::string note_;
};

}  // namespace stratalux::rig
