// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/preview_command.h"

#include <nlohmann/json.hpp>

#include "firmware-host/preview/live_preview.h"
#include "shared/base/standard_output.h"

namespace stratalux::rig {

Status PreviewUntilStopped(const RigConfig& config, const std::optional<SimulatedRigOptions>& simulated, int port,
                           StopToken& stop, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto station, CaptureStation::Open({config, simulated}, stop, logger));
  PreviewPageOptions options = PreviewOptionsOf(*station, config);
  options.port = port;
  SLX_ASSIGN_OR_RETURN(const auto page, PreviewPage::Start(options, logger));
  const nlohmann::ordered_json where = {{"page", page->url() + "/"}};
  SLX_RETURN_IF_ERROR(WriteStdout(where.dump() + "\n"));
  return RunPreview(*station, config, *page, stop, logger);
}

}  // namespace stratalux::rig
