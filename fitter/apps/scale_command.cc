// SPDX-License-Identifier: Apache-2.0
#include "fitter/apps/scale_command.h"

#include <array>
#include <cmath>
#include <memory>
#include <string>
#include <utility>

#include <nlohmann/json.hpp>

#include "fitter/apps/batch_flags.h"
#include "fitter/batch/fleet.h"
#include "shared/base/formatted.h"
#include "shared/base/median.h"
#include "shared/base/read_file.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kGb = 1e9, kTb = 1e12;  // as disks are sold

struct ScaleFlags {
  std::string store, figures;
  FleetOptions fleet;
  bool json = false;
};

Result<VisitFigures> FiguresOf(const ScaleFlags& flags) {
  if (!flags.figures.empty()) {
    SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(flags.figures));
    auto figures = ParseVisitFigures(text);
    if (!figures.ok()) return Status(figures.status().code(), flags.figures + ": " + figures.status().message());
    return figures;
  }
  if (flags.store.empty())
    return Status::Usage("what does a visitor cost? Give --store to measure it there, or --figures to read it");
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(flags.store, db::AccessMode::kReadOnly));
  return MeasureVisits(store);
}

std::array<std::pair<const char*, double>, 4> Shares(const FleetLoad& load) {
  return {{{"the kiosks' hours", load.kiosk},
           {"a kiosk's link", load.link},
           {"the store's ingress", load.ingress},
           {"the night's cores", load.cores}}};
}

// 31:30 is half past seven of the next morning.
std::string Clock(double hours) {
  const int minutes = static_cast<int>(std::lround(hours * 60.0));
  return Formatted("%02d:%02d", minutes / 60 % 24, minutes % 60);
}

std::string TextOf(const VisitFigures& figures, const FleetOptions& fleet, const std::vector<FleetDay>& days) {
  std::string text = Formatted(
      "A visitor: %.1f s of capture, %.2f GB of frames, %.0f s of a core (median of %zu fits), %.2f GB of fits, %.2f "
      "GB of artifacts\n",
      figures.capture_s, figures.frames_bytes / kGb, Median(figures.fit_cpu_s), figures.fit_cpu_s.size(),
      figures.fit_bytes / kGb, figures.artifact_bytes / kGb);
  text +=
      Formatted("%d kiosks of %g visitors a day, %d machines of %d cores, %s to %s: the demand is\n", fleet.kiosks,
                fleet.visitors, fleet.machines, fleet.cores, Clock(fleet.from_h).c_str(), Clock(fleet.until_h).c_str());
  const std::pair<const char*, double>* first = nullptr;
  const auto shares = Shares(LoadOf(figures, fleet));
  for (const auto& share : shares) {
    text += Formatted("  %5.1f %% of %s\n", 100.0 * share.second, share.first);
    if (first == nullptr || share.second > first->second) first = &share;
  }
  text += Formatted("  first to run out: %s\n\n", first->first);
  text +=
      "day  captured  left  on kiosks  queue  in the morning  fitted  set aside   done  cores busy  store TB  kiosk "
      "GB\n";
  for (const FleetDay& day : days)
    text += Formatted("%3d  %8lld  %4lld  %9lld  %5lld  %14lld  %6lld  %9lld  %5s  %8.1f %%  %8.1f  %8.0f\n", day.day,
                      static_cast<long long>(day.captured), static_cast<long long>(day.came - day.captured),
                      static_cast<long long>(day.on_kiosks), static_cast<long long>(day.queue_longest),
                      static_cast<long long>(day.queue_left), static_cast<long long>(day.fitted),
                      static_cast<long long>(day.set_aside), day.done_h ? Clock(*day.done_h).c_str() : "-",
                      100.0 * day.cores_busy, day.store_bytes / kTb, day.fullest_kiosk_bytes / kGb);
  return text;
}

std::string JsonOf(const VisitFigures& figures, const FleetOptions& fleet, const std::vector<FleetDay>& days) {
  const FleetLoad load = LoadOf(figures, fleet);
  Json json = {{"figures", Json::parse(ToJson(figures))},
               {"load", {{"kiosk", load.kiosk}, {"link", load.link}, {"ingress", load.ingress}, {"cores", load.cores}}},
               {"days", Json::array()}};
  for (const FleetDay& day : days)
    json["days"].push_back({{"day", day.day},
                            {"came", day.came},
                            {"captured", day.captured},
                            {"mean_wait_s", day.mean_wait_s},
                            {"longest_wait_s", day.longest_wait_s},
                            {"pulled", day.pulled},
                            {"on_kiosks", day.on_kiosks},
                            {"queue_longest", day.queue_longest},
                            {"queue_left", day.queue_left},
                            {"fitted", day.fitted},
                            {"set_aside", day.set_aside},
                            {"attempts", day.attempts},
                            {"done_h", day.done_h ? Json(*day.done_h) : Json()},
                            {"cores_busy", day.cores_busy},
                            {"store_bytes", day.store_bytes},
                            {"fullest_kiosk_bytes", day.fullest_kiosk_bytes}});
  return json.dump(1) + "\n";
}

Status PrintScale(const ScaleFlags& flags) {
  SLX_ASSIGN_OR_RETURN(const VisitFigures figures, FiguresOf(flags));
  SLX_ASSIGN_OR_RETURN(const auto days, SimulateFleet(figures, flags.fleet));
  return WriteStdout(flags.json ? JsonOf(figures, flags.fleet, days) : TextOf(figures, flags.fleet, days));
}

}  // namespace

void AddScaleCommand(CLI::App& batch, int& exit_code) {
  auto flags = std::make_shared<ScaleFlags>();
  FleetOptions& fleet = flags->fleet;
  auto* scale =
      batch.add_subcommand("scale", "Simulate nights of many kiosks, from what a visitor of this store costs");
  scale->footer(
      "Examples:\n"
      "  stratalux-fit batch scale --store store --kiosks 50 --visitors 300 --machines 4 --cores 16\n"
      "  stratalux-fit batch scale --figures figures.json --machine-days 30 --crashes 0.01 --days 30 --json");
  scale->add_option("--store", flags->store, "Store folder, whose newest fitted visitors are measured")
      ->envname("STRATALUX_STORE");
  scale->add_option("--figures", flags->figures,
                    "File with these figures: `figures` of an earlier --json; no store is read");
  const auto number = [scale](const char* name, auto& value, const char* help) {
    scale->add_option(name, value, help)->capture_default_str();
  };
  number("--kiosks", fleet.kiosks, "Kiosks");
  number("--visitors", fleet.visitors, "Visitors per kiosk and day, at random times");
  number("--opens", fleet.opens_h, "Hour at which kiosks open");
  number("--closes", fleet.closes_h, "Hour at which they close");
  number("--between", fleet.between_s, "Seconds of a visit besides its capture");
  number("--pull-every", fleet.pull_every_h, "Hours between pulls of a kiosk");
  number("--link", fleet.link_mbit, "Mbit/s of a kiosk's link");
  number("--ingress", fleet.ingress_mbit, "Mbit/s into the store, shared by the pulls under way");
  number("--from", fleet.from_h, "Hour at which a night begins");
  number("--until", fleet.until_h, "Hour at which it ends; the same hour: round the clock");
  number("--machines", fleet.machines, "Machines that fit");
  number("--cores", fleet.cores, "Cores of each machine, one worker per core");
  number("--attempts", fleet.attempts, "Attempts per visitor before it is set aside");
  number("--away", fleet.away_share, "Share of kiosks that no pull reaches, drawn each day");
  number("--crashes", fleet.crash_share, "Share of attempts that crash before they finish");
  number("--hopeless", fleet.hopeless_share, "Share of visitors of whom every attempt crashes");
  number("--machine-days", fleet.machine_days, "Days between failures of a machine, on average; 0: none fails");
  number("--repair", fleet.repair_h, "Hours until a failed machine is back");
  number("--frames-days", fleet.frames_days, "Days that frames are kept in the store");
  number("--artifacts-days", fleet.artifacts_days, "Days that artifacts are kept, until `stratalux-fit clean`");
  number("--fits-days", fleet.fits_days, "Days that fits are kept");
  number("--kiosk-days", fleet.kiosk_days, "Days that a kiosk keeps what was pulled");
  number("--days", fleet.days, "Days to simulate");
  number("--seed", fleet.seed, "Seed of the random numbers");
  scale->add_flag("--json", flags->json, "Machine-readable");
  OnCall(*scale, exit_code, [flags](Logger&) { return PrintScale(*flags); });
}

}  // namespace stratalux::fit
