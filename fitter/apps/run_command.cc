// SPDX-License-Identifier: Apache-2.0
#include "fitter/apps/run_command.h"

#include <cstdlib>
#include <memory>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/catalogue/fit_record.h"
#include "db/privacy/access_log.h"
#include "fitter/apps/fit_flags.h"
#include "fitter/pipeline/run.h"
#include "fitter/pipeline/session_fits.h"
#include "shared/base/formatted.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

struct RunFlags {
  FitFlags fit;
  bool json = false, path_only = false, all = false;
  std::string out;
  CleanOptions clean;
};

void AddStore(CLI::App& verb, RunFlags& f) {
  verb.add_option("session", f.fit.run.session, "Session: id, unique prefix, or latest")->capture_default_str();
  verb.add_option("--store", f.fit.run.store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb.add_flag("--json", f.json, "Machine-readable result on stdout");
}

nlohmann::ordered_json FramesJson(const ThinPlan& thin) {
  return {{"asked", thin.asked},           {"kept", thin.kept.size()},
          {"whole", thin.whole},           {"evaluation_only", thin.evaluation_only},
          {"comb_every", thin.comb_every}, {"surface", thin.columns},
          {"left_out", thin.left_out}};
}

Status PrintPlan(const RunOutcome& outcome, bool json) {
  if (json) {
    nlohmann::ordered_json stages = nlohmann::ordered_json::array();
    for (const PlannedStage& s : outcome.plan)
      stages.push_back({{"stage", s.stage}, {"label", s.label}, {"key", s.key}, {"runs", !s.exists}, {"why", s.why}});
    nlohmann::ordered_json all = {{"session", outcome.session}, {"fit", outcome.fit}, {"stages", stages}};
    if (outcome.thin) all["frames"] = FramesJson(*outcome.thin);
    return WriteStdout(all.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
  }
  std::string text = outcome.thin ? "frames: " + Describe(*outcome.thin) + "\n" : "";
  for (const PlannedStage& s : outcome.plan) text += s.label + ": " + (s.exists ? "is there" : "runs: " + s.why) + "\n";
  return WriteStdout(text);
}

int Execute(const RunFlags& f) {
  Logger logger;
  auto finish = [&](const Status& status) {
    if (!status.ok()) logger.Error(status.message());
    return status.exit_code();
  };
  const Result<RunOptions> run = RunOptionsOf(f.fit);
  if (!run.ok()) return finish(run.status());
  const auto outcome = RunSession(*run, logger);
  if (!outcome.ok()) return finish(outcome.status());
  if (run->dry_run) return finish(PrintPlan(*outcome, f.json));
  const auto report = outcome->folder / "report" / "index.html";
  if (outcome->sealed)
    logger.Info("sealed under the session's key; to look at it: `stratalux-fit report " + outcome->session +
                " --out FOLDER`, or `stratalux-db serve`");
  if (f.json) {
    nlohmann::ordered_json json = {{"session", outcome->session},        {"fit", outcome->fit},
                                   {"folder", outcome->folder.string()}, {"report", report.string()},
                                   {"sealed", outcome->sealed},          {"was_complete", outcome->was_complete}};
    if (outcome->thin) json["frames"] = FramesJson(*outcome->thin);
    return finish(WriteStdout(json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n"));
  }
  return finish(WriteStdout((run->until == Stage::kReport ? report : outcome->folder).string() + "\n"));
}

std::string CleanText(const CleanReport& report, bool dry_run) {
  std::string text;
  for (const std::string& name : report.removed) text += name + "\n";
  for (const std::string& fit : report.sealed) text += "fit " + fit + (dry_run ? " would be sealed\n" : " sealed\n");
  const std::string size = Formatted("%.1f MiB", static_cast<double>(report.bytes) / (1 << 20));
  return text + std::to_string(report.removed.size()) + " artifacts " + (dry_run ? "would be removed, " : "removed, ") +
         size + "; " + std::to_string(report.kept) + " kept\n";
}

nlohmann::ordered_json CleanJson(const CleanReport& report, bool dry_run) {
  return {{"removed", report.removed},
          {"bytes", report.bytes},
          {"kept", report.kept},
          {"sealed", report.sealed},
          {"dry_run", dry_run}};
}

Status Clean(const RunFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const CleanReport report, CleanArtifacts(f.fit.run.store, f.fit.run.session, f.clean, logger));
  return WriteStdout(f.json ? CleanJson(report, f.clean.dry_run).dump(1) + "\n" : CleanText(report, f.clean.dry_run));
}

// One whose key is elsewhere or that is being fitted is left to the next time, and does not keep the others from it.
Status CleanAll(const RunFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto sessions, SessionsWithArtifacts(f.fit.run.store));
  CleanReport total;
  auto cleaned = nlohmann::ordered_json::array(), failed = nlohmann::ordered_json::array();
  Status first;
  for (const std::string& session : sessions) {
    const auto report = CleanArtifacts(f.fit.run.store, session, f.clean, logger);
    if (!report.ok()) {
      logger.Warning("session " + session + ": " + report.status().message());
      failed.push_back({{"session", session}, {"error", report.status().message()}});
      if (first.ok()) first = report.status();
      continue;
    }
    for (const std::string& name : report->removed) total.removed.push_back(session + "/" + name);
    for (const std::string& fit : report->sealed) total.sealed.push_back(session + "/" + fit);
    total.bytes += report->bytes;
    total.kept += report->kept;
    cleaned.push_back(session);
  }
  auto json = CleanJson(total, f.clean.dry_run);
  json["sessions"] = cleaned;
  json["failed"] = failed;
  SLX_RETURN_IF_ERROR(WriteStdout(f.json ? json.dump(1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n"
                                         : CleanText(total, f.clean.dry_run)));
  if (first.ok()) return first;
  return {first.code(), std::to_string(failed.size()) + " of " + std::to_string(sessions.size()) +
                            " sessions were left as they are; the first: " + first.message()};
}

Status PrintReport(const RunFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const StoredFit fit, NewestFit(f.fit.run.store, f.fit.run.session, logger));
  if (!std::filesystem::exists(fit.folder / "report" / "index.html"))
    return Status::NotFound((fit.folder / "report" / "index.html").string() +
                            " is missing; `stratalux-fit run` makes it again");
  if (std::error_code error; std::filesystem::exists(fit.folder / db::kFitRecordFile, error))
    SLX_RETURN_IF_ERROR(db::CheckFitFiles(fit.folder));
  if (fit.seal.active() && f.out.empty())
    return Status::Usage("the report of session " + fit.session +
                         " is sealed under the session's key: `--out FOLDER` writes a plain copy of it, or look at it "
                         "in a browser, without one (`stratalux-db serve`)");
  const std::filesystem::path folder = f.out.empty() ? fit.folder : std::filesystem::path(f.out);
  if (f.out.empty())
    SLX_RETURN_IF_ERROR(db::LogAccess(f.fit.run.store, "report", fit.session, "fit " + fit.id));
  else
    SLX_RETURN_IF_ERROR(CopyFit(f.fit.run.store, fit, "report", folder));
  if (fit.seal.active()) logger.Info(PlainCopyNote(fit.session, f.out));
  const auto page = folder / "report" / "index.html", metrics = folder / "metrics.json";
  if (!f.path_only) logger.Info("metrics: " + metrics.string());
  if (!f.json) return WriteStdout(page.string() + "\n");
  const nlohmann::ordered_json json = {{"report", page.string()}, {"metrics", metrics.string()}};
  return WriteStdout(json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
}

}  // namespace

std::string PlainCopyNote(const std::string& session, const std::string& folder) {
  return "session " + session + " is encrypted; the files in " + folder + " are not";
}

void AddRunCommands(CLI::App& app, int& exit_code) {
  const struct {
    const char* name;
    const char* help;
    Stage until;
  } verbs[] = {
      {"run", "Run all stages, from frames to the report; what an earlier run made is reused", Stage::kReport},
      {"reconstruct", "Decode and triangulate: position.exr, normals, mesh.ply", Stage::kReconstruct},
      {"separate", "Direct and global light as EXR", Stage::kSeparate},
      {"normals", "Normals of photometric stereo as EXR", Stage::kNormals},
      {"skin", "Tell skin from hair, brows, eyes and nostrils: skin.exr", Stage::kSkin},
      {"srd", "Extract the spatial radiance distributions", Stage::kSrd},
      {"fit", "Fit the layers: layers_*.exr, quality.exr", Stage::kFit},
      {"maps", "Fit the layers by all projectors, including the one that the fit leaves out: maps/", Stage::kMaps}};
  for (const auto& v : verbs) {
    auto flags = std::make_shared<RunFlags>();
    flags->fit.run.until = v.until;
    auto* verb = app.add_subcommand(v.name, v.help);
    const std::string command = std::string("  stratalux-fit ") + v.name + " latest --store store";
    verb->footer(
        "Examples:\n" + command + "\n" + command + " --heldout 0 --shift refracted_sine\n" + command +
        " --frames 128 --dry-run   # what of a shorter visit would be left out\n" + command +
        " --mode free --shift paper --gain none --surface free --background on --prior none   # the paper as printed");
    AddStore(*verb, *flags);
    AddFitOptions(*verb, flags->fit);
    verb->add_flag("--dry-run", flags->fit.run.dry_run, "Say which stages would run, and why; run none");
    // Of `batch`, for its workers.
    if (v.until == Stage::kReport) verb->add_option("--job", flags->fit.run.job_token)->group("");
    verb->callback([flags, &exit_code] { exit_code = Execute(*flags); });
  }
  auto cleaned = std::make_shared<RunFlags>();
  auto* clean = app.add_subcommand("clean", "Remove what the stages made and no fit of the session uses");
  clean->footer(
      "Fits keep all their files; what is removed is made again when a later run needs it.\n"
      "Examples:\n"
      "  stratalux-fit clean latest --store store --dry-run\n"
      "  stratalux-fit clean s000017 --store store --keep-days 7\n"
      "  stratalux-fit clean --all --store store --keep-days 2\n"
      "  stratalux-fit clean s000017 --store store --damaged   # only what differs from its record");
  AddStore(*clean, *cleaned);
  clean->add_option("--keep-days", cleaned->clean.keep_days, "Keep what is younger than this many days")
      ->check(CLI::Range(0.0, 36500.0))
      ->capture_default_str();
  clean->add_flag("--damaged", cleaned->clean.damaged_only, "Only artifacts whose files were changed or are missing");
  clean->add_flag("--dry-run", cleaned->clean.dry_run, "Say what would go; remove nothing");
  clean->add_flag("--all", cleaned->all, "Every session of the store; one that is being fitted is skipped, and named")
      ->excludes(clean->get_option("session"));
  clean->callback([cleaned, &exit_code] {
    Logger logger;
    const Status status = cleaned->all ? CleanAll(*cleaned, logger) : Clean(*cleaned, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
  auto flags = std::make_shared<RunFlags>();
  auto* report = app.add_subcommand("report", "Print where the newest report of a session is");
  AddStore(*report, *flags);
  report->footer(
      "Example:\n  stratalux-fit report latest --store store --out seen   # a plain copy, of an encrypted session's, "
      "too");
  report->add_option("--out", flags->out,
                     "Folder for a copy of the fit's files, unencrypted; logged, so that `forget` finds it");
  report->add_flag("--path-only", flags->path_only, "Print only the path");
  report->callback([flags, &exit_code] {
    Logger logger;
    const Status status = PrintReport(*flags, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
