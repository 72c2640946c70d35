// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/kiosk_command.h"

#include <nlohmann/json.hpp>
#include <unistd.h>

#include "firmware-host/kiosk/page_front.h"
#include "firmware-host/kiosk/plain_front.h"
#include "firmware-host/session/state_file.h"
#include "shared/base/formatted.h"
#include "shared/base/standard_output.h"
#include "shared/http/access.h"

namespace stratalux::rig {
namespace {

Result<std::string> TokenOf(const std::string& file) {
  return file.empty() ? Result<std::string>(std::string()) : http::ReadTokenFile(file);
}

Result<KioskPageOptions> PageOptionsOf(const StationOptions& station) {
  const KioskConfig& kiosk = station.config.kiosk;
  const KioskPageConfig& page = *kiosk.page;
  KioskPageOptions options;
  SLX_ASSIGN_OR_RETURN(options.token, TokenOf(page.token_file));
  SLX_ASSIGN_OR_RETURN(options.operator_token, TokenOf(page.operator_token_file));
  options.address = page.address;
  options.port = page.port;
  options.host_names = page.host_names;
  options.page_folder = page.page_folder;
  options.language_folder = page.language_folder;
  options.ticket_text = page.ticket_text;
  options.languages = kiosk.languages;
  if (kiosk.hours) options.opens = Formatted("%02d:%02d", kiosk.hours->opens / 60, kiosk.hours->opens % 60);
  options.store = station.config.store.folder;
  options.rig = station.config.store.rig;
  options.simulated = station.simulated.has_value();
  options.state = StateFolder();
  return options;
}

Result<KioskReport> RunWithPage(CaptureStation& station, const KioskOptions& options, StopToken& stop, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const KioskPageOptions page, PageOptionsOf(options.station));
  SLX_ASSIGN_OR_RETURN(const auto front, PageFront::Start(page, logger));
  if (page.operator_token.empty())
    logger.Warning("[kiosk.page] names no operator_token_file: nobody can sign in as operator");
  const nlohmann::ordered_json where = {{"page", front->page().url() + "/"}};
  SLX_RETURN_IF_ERROR(WriteStdout(where.dump() + "\n"));
  return RunKiosk(station, options, *front, stop, logger);
}

}  // namespace

Result<KioskReport> KioskUntilStopped(const CaptureJob& job, StopToken& stop, Logger& logger) {
  KioskOptions options;
  options.station = job.station;
  // Who looks at the screen is told; the next visitor is served once it has come.
  options.station.camera_at_start = CameraAtStart::kMayComeLater;
  options.timing = job.timing;
  options.state = StateFolder();
  bool& encrypt = options.station.config.store.encrypt.emplace(job.station.config.store.encrypt.value_or(true));
  if (!encrypt) logger.Warning("[store] encrypt = false: what is forgotten may stay on the disk's free blocks");
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(const auto station, CaptureStation::Open(options.station, stop, logger));
  if (options.station.config.kiosk.page) return RunWithPage(*station, options, stop, logger);
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
