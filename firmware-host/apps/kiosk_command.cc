// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/kiosk_command.h"

#include <nlohmann/json.hpp>
#include <unistd.h>

#include "firmware-host/kiosk/plain_front.h"

namespace stratalux::rig {

Result<KioskReport> KioskUntilStopped(const CaptureJob& job, StopToken& stop, Logger& logger) {
  KioskOptions options;
  options.station = job.station;
  options.timing = job.timing;
  bool& encrypt = options.station.config.store.encrypt.emplace(job.station.config.store.encrypt.value_or(true));
  if (!encrypt) logger.Warning("[store] encrypt = false: what is forgotten may stay on the disk's free blocks");
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(const auto station, CaptureStation::Open(options.station, stop, logger));
  PlainFront front(STDIN_FILENO, STDOUT_FILENO, options.station.config.kiosk, logger);
  return RunKiosk(*station, options, front, stop, logger);
}

std::string KioskReportAsJson(const KioskReport& report) {
  nlohmann::ordered_json ended = nlohmann::ordered_json::object();
  for (int i = 0; i < kWords; ++i)
    if (const int64_t visits = report.ended[static_cast<size_t>(i)]; visits > 0)
      ended[ToString(static_cast<Word>(i))] = visits;
  const nlohmann::ordered_json json = {{"visits", report.begun},           {"captures", report.captures},
                                       {"tickets", report.tickets},        {"discarded", report.discarded},
                                       {"left_nothing", std::move(ended)}, {"not_forgotten", report.owed}};
  return json.dump() + "\n";
}

}  // namespace stratalux::rig
