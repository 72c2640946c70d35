// SPDX-License-Identifier: Apache-2.0
// stratalux-rig: the controller's command line.
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <CLI/CLI.hpp>

#include "db/catalogue/consent.h"
#include "firmware-host/apps/capture_command.h"
#include "firmware-host/apps/devices_command.h"
#include "firmware-host/apps/examples.h"
#include "firmware-host/apps/guided_capture.h"
#include "firmware-host/apps/kiosk_command.h"
#include "firmware-host/apps/plan_command.h"
#include "firmware-host/apps/preview_command.h"
#include "firmware-host/apps/selftest_command.h"
#include "firmware-host/apps/simulation_flags.h"
#include "firmware-host/apps/timing_flags.h"
#include "firmware-host/calibration/instructions.h"
#include "firmware-host/config/rig_config.h"
#include "firmware-host/kiosk/selfcheck_keeper.h"
#include "firmware-host/safety/last_resort.h"
#include "firmware-host/session/last_lights.h"
#include "firmware-host/session/learnt_deadlines.h"
#include "firmware-host/session/open_rig.h"
#include "firmware-host/simulated/simulation_file.h"
#include "shared/base/finite_options.h"
#include "shared/base/mistyped_command.h"
#include "shared/base/printable.h"
#include "shared/base/standard_output.h"
#include "shared/base/version.h"
#include "shared/manual/manual.h"

namespace stratalux::rig {
namespace {

constexpr const char* kSystemConfig = "/etc/stratalux/rig.toml";
struct Flags {
  std::string config;
  std::optional<std::string> store, kind, sync_mode, code, calibration;  // unset: as the configuration says
  std::optional<std::string> exposure;
  TimingFlags timing;
  SimulationFlags simulation;
  std::string visitor, visit;
  int attempt = 0;
  std::string consent_scope, consent_text, consent_language;
  std::string retention = "standard";
  std::string out;
  int board_pose = -1, poses = 0;
  bool yes = false;
  bool on_start = false;
  bool encrypt = false;
  bool sign = false;
  bool json = false;
  bool verbose = false;
  bool trend = false;
  bool page = false;
  int port = 0;
};

int Report(const Status& status) {
  Say(LogLevel::kError, "stratalux-rig: " + status.message() + "\n");
  return status.exit_code();
}

int Print(const std::string& text) {
  const Status written = WriteStdout(text);
  return written.ok() ? 0 : Report(written);
}

// The whole of `text` as a number.
bool ParseMs(std::string_view text, double& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

bool ChoosesExposure(const Flags& flags) { return flags.exposure == "auto"; }

// Defaults < /etc/stratalux/rig.toml or --config < flags.
Result<RigConfig> ConfigFrom(const Flags& flags) {
  RigConfig config;
  std::error_code ignored;
  if (!flags.config.empty()) {
    SLX_ASSIGN_OR_RETURN(config, LoadRigConfig(flags.config));
  } else if (std::filesystem::exists(kSystemConfig, ignored)) {
    SLX_ASSIGN_OR_RETURN(config, LoadRigConfig(kSystemConfig));
  }
  if (flags.kind) {
    SLX_ASSIGN_OR_RETURN(config.plan.kind, ParseSessionKind(*flags.kind));
  }
  if (flags.sync_mode) {
    SLX_ASSIGN_OR_RETURN(config.plan.sync_mode, ParseSyncMode(*flags.sync_mode));
  }
  if (flags.code) {
    SLX_ASSIGN_OR_RETURN(config.plan.code, ParseColumnCode(*flags.code));
  }
  config.calibration = flags.calibration.value_or(config.calibration);
  if (flags.exposure && !ChoosesExposure(flags) && !ParseMs(*flags.exposure, config.plan.exposure_ms))
    return Status::Usage("--exposure '" + *flags.exposure + "': expected ms, or auto");
  SLX_RETURN_IF_ERROR(ApplyTimingFlags(flags.timing, config));
  if (const char* store = std::getenv("STRATALUX_STORE")) config.store.folder = store;
  config.store.folder = flags.store.value_or(config.store.folder);
  SLX_RETURN_IF_ERROR(ApplySize(flags.simulation, config));
  return config;
}

// Nothing given: the store must hold a consent already.
Status ReadConsent(const Flags& flags, std::optional<Consent>& consent) {
  if (flags.consent_scope.empty() && flags.consent_text.empty() && flags.consent_language.empty()) return Status::Ok();
  if (flags.consent_scope.empty() || flags.consent_text.empty() || flags.consent_language.empty())
    return Status::Usage(
        "--consent-scope, --consent-text and --consent-language go together: what the visitor agreed to");
  consent.emplace();
  consent->text_version = flags.consent_text;
  consent->language = flags.consent_language;
  return db::SetScope(flags.consent_scope, *consent).WithContext("--consent-scope");
}

Result<CaptureJob> CaptureFrom(const Flags& flags) {
  CaptureJob job;
  RigConfig& config = job.station.config;
  CaptureRequest& request = job.request;
  SLX_ASSIGN_OR_RETURN(config, ConfigFrom(flags));
  if (config.store.folder.empty())
    return Status::Usage(
        "no store given; use --store DIR, set STRATALUX_STORE or write [rig] store in the configuration");
  request.plan = config.plan;
  job.choose_exposure = ChoosesExposure(flags);
  job.on_start = flags.on_start;
  if (job.choose_exposure && config.plan.kind != SessionKind::kVisitor)
    return Status::Usage("--exposure auto: only a visitor's exposure can be chosen automatically; give it in ms");
  request.calibration = config.calibration;
  request.visitor = flags.visitor;
  request.visit = flags.visit;
  request.attempt = flags.attempt;
  request.board_pose = flags.board_pose;
  SLX_RETURN_IF_ERROR(ReadConsent(flags, request.consent));
  SLX_ASSIGN_OR_RETURN(request.retention, ParseRetention(flags.retention).WithContext("--retention"));
  if (flags.encrypt) config.store.encrypt = true;
  if (flags.sign) config.store.sign = true;
  SLX_ASSIGN_OR_RETURN(job.station.simulated, SimulationFrom(flags.simulation, flags.board_pose, config));
  SLX_ASSIGN_OR_RETURN(const TimingInUse timing, ChooseTiming(flags.timing, config, job.station.simulated));
  job.timing = timing.visit;
  return job;
}

// START is a line of the rig, or comes from outside.
Status CheckOnStart(const Flags& flags, const CaptureJob& job) {
  if (!flags.on_start) return Status::Ok();
  if (job.request.plan.kind == SessionKind::kCalibration)
    return Status::Usage("--on-start: not for --kind calibration, whose poses are asked for on the terminal");
  if (job.station.simulated && flags.simulation.events.empty())
    return Status::Usage("--on-start: the simulated rig has no button; --simulate-events PATH takes `start`");
  if (!job.station.simulated && !job.station.config.gpio.start)
    return Status::Usage("--on-start: no START is wired; name its line as [gpio] start");
  return Status::Ok();
}

// The poses of a series; nullopt: a single capture. A simulated board has the poses that its scene lists.
Result<std::optional<SeriesOptions>> SeriesFrom(const Flags& flags, const CaptureJob& job) {
  if (job.request.plan.kind != SessionKind::kCalibration) {
    if (flags.poses > 0)
      return Status::Usage("--poses is the number of the board's poses; only --kind calibration has them");
    return std::optional<SeriesOptions>();
  }
  if (flags.poses == 0 && flags.board_pose >= 0) return std::optional<SeriesOptions>();
  if (!flags.simulation.events.empty())
    return Status::Usage("--simulate-events: each pose of a series runs on its own rig; give --pose for a single pose");
  SeriesOptions series;
  series.first = std::max(0, flags.board_pose);
  series.poses = flags.poses > 0 ? flags.poses : kAdvisedPoses;
  if (const auto& simulated = job.station.simulated) {
    SLX_ASSIGN_OR_RETURN(const Simulation simulation, LoadSimulation(simulated->scene));
    const int listed = static_cast<int>(simulation.scene.poses.size());
    if (listed == 0 && flags.poses == 0) return std::optional<SeriesOptions>();
    if (flags.poses > listed)
      return Status::Usage("--poses " + std::to_string(flags.poses) + ": the scene lists " + std::to_string(listed) +
                           " poses ([[pose]])");
    if (flags.poses == 0) series.poses = listed;
  }
  if (series.first >= series.poses)
    return Status::Usage("--pose " + std::to_string(series.first) + " is beyond the last of --poses " +
                         std::to_string(series.poses) + ", which count from 0");
  return std::optional(series);
}

int RunSeries(const Flags& flags, const CaptureJob& job, const SeriesOptions& series, const AskOperator& ask,
              Logger& logger) {
  const Result<SeriesOutcome> outcome = CaptureSeries(job, series, ask, StopOfProcess(), logger);
  if (!outcome.ok()) return Report(outcome.status());
  const int printed =
      Print(flags.json ? SeriesAsJson(*outcome) : SeriesAsText(*outcome, job.station.config.store.folder));
  const int captured = ExitCode(*outcome);
  return captured != 0 ? captured : printed;
}

int RunCapture(const Flags& flags) {
  const Result<CaptureJob> job = CaptureFrom(flags);
  if (!job.ok()) return Report(job.status());
  if (const Status start = CheckOnStart(flags, *job); !start.ok()) return Report(start);
  Logger logger(flags.verbose ? LogLevel::kDebug : LogLevel::kInfo);
  const Result<std::optional<SeriesOptions>> series = SeriesFrom(flags, *job);
  if (!series.ok()) return Report(series.status());
  // A simulated board needs nobody's hands.
  AskOperator ask;
  if (!flags.yes && !job->station.simulated) ask = AskOnTerminal(StopOfProcess(), series->has_value());
  if (*series) return RunSeries(flags, *job, **series, ask, logger);
  const Result<CaptureOutcome> outcome = CaptureOne(*job, ask, StopOfProcess(), logger);
  if (!outcome.ok()) return Report(outcome.status());
  const int printed = Print((flags.json ? OutcomeAsJson : OutcomeAsText)(*outcome));
  const int captured = ExitCode(*outcome);
  return captured != 0 ? captured : printed;
}

int RunKioskCommand(const Flags& flags) {
  Result<CaptureJob> job = CaptureFrom(flags);
  if (!job.ok()) return Report(job.status());
  std::optional<KioskPageConfig>& page = job->station.config.kiosk.page;
  if (flags.page && !page) page.emplace();
  Logger logger(flags.verbose ? LogLevel::kDebug : LogLevel::kInfo);
  const Result<KioskReport> report = KioskUntilStopped(*job, StopOfProcess(), logger);
  if (!report.ok()) return Report(report.status());
  const int printed = Print(KioskReportAsJson(*report));
  return report->owed ? static_cast<int>(StatusCode::kDegraded) : printed;
}

int RunPreviewCommand(const Flags& flags) {
  const Result<RigConfig> config = ConfigFrom(flags);
  if (!config.ok()) return Report(config.status());
  const Result<std::optional<SimulatedRigOptions>> simulated =
      SimulationFrom(flags.simulation, flags.board_pose, *config);
  if (!simulated.ok()) return Report(simulated.status());
  Logger logger(flags.verbose ? LogLevel::kDebug : LogLevel::kInfo);
  const Status ended = PreviewUntilStopped(*config, *simulated, flags.port, StopOfProcess(), logger);
  return ended.ok() ? 0 : Report(ended);
}

// What the kiosk's self-checks kept: no device is looked at.
int RunSelftestTrend(const Flags& flags) {
  const Result<SelfcheckBook> book = ReadSelfchecks(SelfchecksFile(StateFolder(), !flags.simulation.scene.empty()));
  if (book.status().code() == StatusCode::kNotFound)
    return Report(
        Status::NotFound(book.status().message() + "; the kiosk keeps its self-checks there (docs/kiosk.md)"));
  if (!book.ok()) return Report(book.status());
  return Print((flags.json ? TrendAsJson : TrendAsText)(TrendOf(*book)));
}

int RunSelftestCommand(const Flags& flags) {
  if (flags.trend) return RunSelftestTrend(flags);
  const Result<RigConfig> config = ConfigFrom(flags);
  if (!config.ok()) return Report(config.status());
  const Result<std::optional<SimulatedRigOptions>> simulated =
      SimulationFrom(flags.simulation, flags.board_pose, *config);
  if (!simulated.ok()) return Report(simulated.status());
  Logger logger(flags.verbose ? LogLevel::kDebug : LogLevel::kInfo);
  const Result<SelftestReport> report = SelftestOf(*config, *simulated, StopOfProcess(), logger);
  if (!report.ok()) return Report(report.status());
  const int printed = Print((flags.json ? SelftestAsJson : SelftestAsText)(*report));
  return report->passed() ? printed : static_cast<int>(StatusCode::kFailed);
}

int RunPlan(const Flags& flags, const CLI::App& render) {
  const Result<RigConfig> config = ConfigFrom(flags);
  if (!config.ok()) return Report(config.status());
  const Result<CapturePlan> plan = BuildPlan(config->plan);
  const Result<MemoryLayout> layout = LayOutMemories(config->plan, config->memory);
  if (!plan.ok() || !layout.ok()) return Report(plan.ok() ? layout.status() : plan.status());
  const Result<std::optional<SimulatedRigOptions>> simulated =
      SimulationFrom(flags.simulation, flags.board_pose, *config);
  if (!simulated.ok()) return Report(simulated.status());
  const Result<TimingInUse> timing = ChooseTiming(flags.timing, *config, *simulated);
  if (!timing.ok()) return Report(timing.status());
  if (render.parsed()) {
    const Status status = RenderPlan(*plan, timing->visit, *layout, flags.out);
    return status.ok() ? 0 : Report(status);
  }
  return Print((flags.json ? PlanAsJson : PlanAsText)(*plan, timing->visit, *layout, timing->deadlines));
}

// It must work when all else is broken: the lights of the last rig that was opened go off, and those of the
// configuration, where that can be read.
int RunSafe(const Flags& flags) {
  const Result<RigConfig> config = LoadRigConfig(flags.config.empty() ? kSystemConfig : flags.config);
  const Result<RigLights> last = ReadLights(StateFolder());
  if (!config.ok() && !last.ok()) {
    Report(last.status());
    return Report(config.status());
  }
  Status off;
  if (last.ok()) off = TakeLights(*last);
  if (!config.ok()) Report(config.status().WithContext("not checked"));
  if (!last.ok() && last.status().code() != StatusCode::kNotFound) Report(last.status().WithContext("not checked"));
  if (config.ok() && !(last.ok() && *last == LightsOf(*config))) {
    const Status wired = TakeLights(LightsOf(*config));
    // A configuration without lights says nothing against those that were taken, nor the other way round.
    if (off.ok() ? !(last.ok() && wired.code() == StatusCode::kUsage) : off.code() == StatusCode::kUsage) off = wired;
  }
  return off.ok() ? 0 : Report(off);
}

int RunDevices(const Flags& flags) {
  std::error_code none;
  const bool installed = flags.config.empty() && std::filesystem::exists(kSystemConfig, none);
  const Result<DeviceList> list = DevicesBeside(installed ? kSystemConfig : flags.config,
                                                installed ? ConfigurationFrom::kInstalled : ConfigurationFrom::kAsked);
  return list.ok() ? Print((flags.json ? DevicesAsJson : DevicesAsText)(*list)) : Report(list.status());
}

void AddPlanFlags(CLI::App& command, Flags& flags) {
  command.add_option("--config", flags.config, "TOML file (default: " + std::string(kSystemConfig) + ", if there)");
  command.add_option("--kind", flags.kind, "visitor (default), calibration, dark, flat or response");
  command.add_option("--sync-mode", flags.sync_mode,
                     "triggered (default) or free_running: the camera exposes on our trigger, or streams by itself");
  command.add_option(
      "--code", flags.code,
      "code of a visitor's columns: gray (default), xor-2, xor-4, min-stripe or micro-phase (docs/capture-plan.md)");
  command.add_option(
      "--exposure", flags.exposure,
      "exposure, ms (default: 16); to capture a visitor also auto: chosen so that the darkest skin is seen well");
}

CLI::App* AddCapture(CLI::App& app, Flags& flags) {
  CLI::App* capture = app.add_subcommand("capture", "Run a capture plan and store a session");
  capture->add_option("--store", flags.store,
                      "folder of the store (default: $STRATALUX_STORE, then the configuration); created when new");
  AddSimulationFlags(*capture, flags.simulation);
  capture->add_option(
      "--visitor", flags.visitor,
      "pseudonym kept with the session; needs a consent (`stratalux-db consent give`, or the --consent options)");
  capture->add_option("--visit", flags.visit, "name of the visit, shared by its attempts; must not name a person");
  capture->add_option("--attempt", flags.attempt, "number of the attempt within the visit, from 1")
      ->check(CLI::Range(1, 999));
  capture->add_option("--consent-scope", flags.consent_scope,
                      "what the visitor agrees to now: fit, research, publication, joined by commas");
  capture->add_option("--consent-text", flags.consent_text, "version of the text that was shown");
  capture->add_option("--consent-language", flags.consent_language, "language in which it was shown, such as de");
  capture->add_option("--retention", flags.retention, "how long it is kept: short, standard, long, keep")
      ->capture_default_str();
  capture->add_flag("--sign", flags.sign,
                    "sign with the rig's key, `stratalux-db key sign-init` (default: [store] sign)");
  capture->add_flag("--encrypt", flags.encrypt, "encrypt with a key of its own (default: [store] encrypt, else off)");
  AddPlanFlags(*capture, flags);
  AddTimingFlags(*capture, flags.timing);
  capture
      ->add_option("--pose", flags.board_pose,
                   "calibration, flat: number of the pose, from 0, kept with the session; only this one unless --poses "
                   "is given; simulation: which [[pose]] of the scene")
      ->check(CLI::Range(0, 999));
  capture
      ->add_option(
          "--poses", flags.poses,
          "calibration: capture the poses from --pose (else 0) up to, not including, this number (default: 12; "
          "simulation: as many as the scene lists)")
      ->check(CLI::Range(1, 999));
  capture->add_flag("--yes", flags.yes, "calibration, dark, flat, response: do not wait for Enter before a capture");
  capture->add_flag("--on-start", flags.on_start,
                    "wait in the dark until START is pressed ([gpio] start; simulation: --simulate-events)");
  capture->add_option(
      "--calibration", flags.calibration,
      "calibration that the session names: latest, an id or a FILE.json; none; exact (simulation). Default: the "
      "rig's newest; in a simulation, exact");
  capture->add_flag("--json", flags.json, "print one JSON object");
  capture->add_flag("--verbose", flags.verbose, "more on stderr");
  return capture;
}

CLI::App* AddKiosk(CLI::App& app, Flags& flags) {
  CLI::App* kiosk = app.add_subcommand("kiosk", "Capture one visitor after another, until stopped");
  kiosk->footer(kKioskExamples);
  kiosk->add_option("--store", flags.store, "folder of the store (default: as for capture); created when new");
  AddSimulationFlags(*kiosk, flags.simulation);
  kiosk->add_option("--config", flags.config, "TOML file (default: " + std::string(kSystemConfig) + ", if there)");
  kiosk->add_option("--calibration", flags.calibration, "calibration that sessions name, as for capture");
  AddTimingFlags(*kiosk, flags.timing);
  kiosk->add_flag("--page", flags.page,
                  "show the kiosk in a browser, at 127.0.0.1:8080 unless [kiosk.page] says otherwise");
  kiosk->add_flag("--verbose", flags.verbose, "more on stderr: each step of the machine");
  return kiosk;
}

CLI::App* AddPreview(CLI::App& app, Flags& flags) {
  CLI::App* preview = app.add_subcommand("preview", "The live picture in a browser, for focusing and aiming");
  preview->footer(kPreviewExamples);
  AddSimulationFlags(*preview, flags.simulation);
  AddPlanFlags(*preview, flags);
  AddTimingFlags(*preview, flags.timing);
  preview->add_option("--port", flags.port, "port of the page at 127.0.0.1 (default: any free one)")
      ->check(CLI::Range(0, 65535));
  preview->add_flag("--verbose", flags.verbose, "more on stderr");
  return preview;
}

CLI::App* AddDevices(CLI::App& app, Flags& flags) {
  CLI::App* devices = app.add_subcommand("devices", "List cameras, lines and displays, and what they can do");
  devices->footer(kDevicesExamples);
  devices->add_option("--config", flags.config,
                      "TOML file whose devices are looked for (default: " + std::string(kSystemConfig) + ", if there)");
  devices->add_flag("--json", flags.json, "print one JSON object");
  return devices;
}

int Main(int argc, char** argv) {
  Flags flags;
  CLI::App app("Stratalux's controller: steps the projectors, grabs and proves frames, writes sessions");
  app.footer(kExamples);
  app.set_version_flag("--version", std::string("stratalux-rig ") + kVersion);
  app.require_subcommand(1);
  CLI::App* capture = AddCapture(app, flags);
  capture->footer(kCaptureExamples);
  CLI::App* selftest = app.add_subcommand("selftest", "Check devices, wiring, light, timing, disk and codec");
  selftest->footer(kSelftestExamples);
  AddPlanFlags(*selftest, flags);
  AddTimingFlags(*selftest, flags.timing);
  AddSimulationFlags(*selftest, flags.simulation);
  selftest->add_option("--store", flags.store, "folder whose disk is measured (default: as for capture)");
  selftest->add_flag("--trend", flags.trend,
                     "check no device: print what the kiosk's self-checks on the white card measured over the days");
  selftest->add_flag("--json", flags.json, "print one JSON object");
  selftest->add_flag("--verbose", flags.verbose, "more on stderr");
  CLI::App* kiosk = AddKiosk(app, flags);
  CLI::App* preview = AddPreview(app, flags);
  CLI::App* devices = AddDevices(app, flags);
  CLI::App* plan = app.add_subcommand("plan", "The capture plan: which projector shows what, when");
  plan->require_subcommand(1);
  plan->footer(kPlanExamples);
  CLI::App* show = plan->add_subcommand("show", "List the steps");
  AddPlanFlags(*show, flags);
  AddSimulate(*show, flags.simulation, "use the timing of the simulated rig, not of the configuration's devices");
  show->add_flag("--json", flags.json, "print JSON");
  AddTimingFlags(*show, flags.timing);
  CLI::App* render = plan->add_subcommand("render", "Write the patterns as PNG files with plan.json");
  AddPlanFlags(*render, flags);
  render->add_option("--out", flags.out, "folder")->required();
  CLI::App* safe = app.add_subcommand(
      "safe", "Switch every light off: ENABLE lines off, displays black; a unit's ExecStopPost runs it");
  safe->footer(kSafeExamples);
  safe->add_option("--config", flags.config, "TOML file (default: " + std::string(kSystemConfig) + ")");
  RangesTakeFiniteNumbers(app);
  if (const auto manual = AskedManual(app, "stratalux-rig", argc, argv)) return Print(*manual);
  if (const std::string mistyped = MistypedCommand(app, argc, argv); !mistyped.empty())
    return Report(Status::Usage(mistyped));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    // CLI11's own codes are not ours: any wrong flag is a usage error.
    return app.exit(error) == 0 ? 0 : static_cast<int>(StatusCode::kUsage);
  }
  if (safe->parsed()) return RunSafe(flags);
  if (devices->parsed()) return RunDevices(flags);
  for (const CLI::App* command : {capture, selftest, kiosk, preview})
    if (const Status simulation = CheckSimulationFlags(*command); !simulation.ok()) return Report(simulation);
  if (ChoosesExposure(flags) && !capture->parsed())
    return Report(Status::Usage("--exposure auto: only capture looks at who is there; give it in ms"));
  if (capture->parsed()) return RunCapture(flags);
  if (kiosk->parsed()) return RunKioskCommand(flags);
  if (preview->parsed()) return RunPreviewCommand(flags);
  if (selftest->parsed()) return RunSelftestCommand(flags);
  return RunPlan(flags, *render);
}

}  // namespace
}  // namespace stratalux::rig

int main(int argc, char** argv) { return stratalux::rig::Main(argc, argv); }
