// SPDX-License-Identifier: Apache-2.0
#include "fitter/apps/run_command.h"

#include <charconv>
#include <cstdlib>
#include <memory>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/catalogue/fit_record.h"
#include "db/privacy/access_log.h"
#include "fitter/pipeline/run.h"
#include "fitter/pipeline/session_fits.h"
#include "shared/base/formatted.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

struct RunFlags {
  RunOptions run;
  std::string shift = "refracted", geometry = "reconstructed", gain = "model", mode = "tied", reading = "gather",
              distance = "tangent", directional = "off", surface = "model", background = "off", prior = "auto";
  bool json = false, path_only = false;
  std::string out;
  CleanOptions clean;
};

void AddStore(CLI::App& verb, RunFlags& f) {
  verb.add_option("session", f.run.session, "Session: id, unique prefix, or latest")->capture_default_str();
  verb.add_option("--store", f.run.store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb.add_flag("--json", f.json, "Machine-readable result on stdout");
}

void AddFitOptions(CLI::App& verb, RunFlags& f) {
  verb.add_option("--layers", f.run.fit.em.layers, "Scattering layers a pixel")
      ->check(CLI::Range(1, 32))
      ->capture_default_str();
  verb.add_option("--mode", f.mode,
                  "tied: one set of layers a pixel for all lights; free: each SRD on its own, as the paper has it")
      ->check(CLI::IsMember({"tied", "free"}))
      ->capture_default_str();
  verb.add_option("--shift", f.shift, "Shift law: paper, refracted, refracted_sine")->capture_default_str();
  verb.add_option("--eta", f.run.fit.em.scattering.eta, "Refractive index of skin")
      ->check(CLI::Range(1.0, 3.0))
      ->capture_default_str();
  verb.add_option("--gain", f.gain, "Angular gain: model or none")
      ->check(CLI::IsMember({"model", "none"}))
      ->capture_default_str();
  verb.add_option("--directional", f.directional,
                  "on: weights of the layers that follow the directions, chosen on the training lights; off")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb.add_option("--surface", f.surface,
                  "Light reflected by the very surface. model: facets of one roughness and strength, found on the "
                  "training lights; free: of each light its own, near 5 %")
      ->check(CLI::IsMember({"model", "free"}))
      ->capture_default_str();
  verb.add_option("--background", f.background,
                  "on: a uniform floor beside the layers, for rooms whose light returns from far; off")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb.add_option("--prior", f.prior,
                  "Photons of the session's mean layers that count beside each profile's own: a number; auto: what "
                  "predicts the training lights, left out in turn, best; none: every pixel on its own")
      ->capture_default_str();
  verb.add_option("--iterations", f.run.fit.em.max_iterations,
                  "EM sweeps of the mean layers (without prior: of each pixel) at most, times the square of --pool")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  verb.add_option("--heldout", f.run.heldout, "Projector left out of the fit")
      ->check(CLI::Range(0, 15))
      ->capture_default_str();
  verb.add_option("--pool", f.run.srd.pool, "Quads per side of a fitted profile")
      ->check(CLI::Range(1, 16))
      ->capture_default_str();
  verb.add_option("--reading", f.reading,
                  "gather: a pixel's response over the sweep; scatter: the profile across the line that lies on it")
      ->check(CLI::IsMember({"gather", "scatter"}))
      ->capture_default_str();
  verb.add_option("--distance", f.distance, "Distances across the line: on the tangent plane, or along the surface")
      ->check(CLI::IsMember({"tangent", "surface"}))
      ->capture_default_str();
  verb.add_option("--geometry", f.geometry, "reconstructed, or truth (simulation)")
      ->check(CLI::IsMember({"reconstructed", "truth"}))
      ->capture_default_str();
  verb.add_flag("--full-evaluation", f.run.full_evaluation,
                "Hold out every projector in turn; baselines and ablations");
  verb.add_flag(
      "--standard-errors", f.run.standard_errors,
      "standard_errors.exr, too: of total weight, mean depth and width of each pixel (takes long at full size)");
  verb.add_flag("--dry-run", f.run.dry_run, "Say which stages would run, and why; run none");
}

Status ParsePrior(const std::string& text, FitOptions& fit) {
  LayerPrior& prior = fit.em.prior;
  fit.choose.prior = text == "auto";
  prior = {};
  if (fit.choose.prior || text == "none") return Status::Ok();
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), prior.photons);
  if (error == std::errc() && end == text.data() + text.size() && prior.photons > 0.0 && prior.photons <= 1e7)
    return Status::Ok();
  return Status::Usage("--prior " + text + ": auto, none, or photons above 0 and up to 1e7");
}

Status PrintPlan(const RunOutcome& outcome, bool json) {
  if (json) {
    nlohmann::ordered_json stages = nlohmann::ordered_json::array();
    for (const PlannedStage& s : outcome.plan)
      stages.push_back({{"stage", s.stage}, {"label", s.label}, {"key", s.key}, {"runs", !s.exists}, {"why", s.why}});
    const nlohmann::ordered_json all = {{"session", outcome.session}, {"fit", outcome.fit}, {"stages", stages}};
    return WriteStdout(all.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
  }
  std::string text;
  for (const PlannedStage& s : outcome.plan) text += s.label + ": " + (s.exists ? "is there" : "runs: " + s.why) + "\n";
  return WriteStdout(text);
}

int Execute(RunFlags& f) {
  Logger logger;
  auto finish = [&](const Status& status) {
    if (!status.ok()) logger.Error(status.message());
    return status.exit_code();
  };
  const auto law = ParseShiftLaw(f.shift);
  if (!law.ok()) return finish(law.status());
  EmOptions& em = f.run.fit.em;
  em.scattering.shift_law = *law;
  const auto reading = ParseSrdReading(f.reading);
  if (!reading.ok()) return finish(reading.status());
  f.run.srd.reading = *reading;
  const auto distance = ParseSrdDistance(f.distance);
  if (!distance.ok()) return finish(distance.status());
  f.run.srd.distance = *distance;
  if (const Status prior = ParsePrior(f.prior, f.run.fit); !prior.ok()) return finish(prior);
  em.scattering.mode = f.mode == "free" ? FitMode::kFree : FitMode::kTied;
  em.scattering.gain_model = f.gain == "model";
  f.run.fit.choose.reflection = f.surface == "model";
  em.background_term = f.background == "on";
  f.run.fit.choose.directions = f.directional == "on";
  f.run.geometry = f.geometry == "truth" ? GeometrySource::kTruth : GeometrySource::kReconstructed;
  const auto outcome = RunSession(f.run, logger);
  if (!outcome.ok()) return finish(outcome.status());
  if (f.run.dry_run) return finish(PrintPlan(*outcome, f.json));
  const auto report = outcome->folder / "report" / "index.html";
  if (outcome->sealed)
    logger.Info("sealed under the session's key; to look at it: `stratalux-fit report " + outcome->session +
                " --out FOLDER`, or `stratalux-db serve`");
  if (f.json) {
    const nlohmann::ordered_json json = {{"session", outcome->session},        {"fit", outcome->fit},
                                         {"folder", outcome->folder.string()}, {"report", report.string()},
                                         {"sealed", outcome->sealed},          {"was_complete", outcome->was_complete}};
    return finish(WriteStdout(json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n"));
  }
  return finish(WriteStdout((f.run.until == Stage::kReport ? report : outcome->folder).string() + "\n"));
}

Status Clean(const RunFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const CleanReport report, CleanArtifacts(f.run.store, f.run.session, f.clean, logger));
  if (f.json) {
    const nlohmann::ordered_json json = {{"removed", report.removed},
                                         {"bytes", report.bytes},
                                         {"kept", report.kept},
                                         {"sealed", report.sealed},
                                         {"dry_run", f.clean.dry_run}};
    return WriteStdout(json.dump(1) + "\n");
  }
  std::string text;
  for (const std::string& name : report.removed) text += name + "\n";
  for (const std::string& fit : report.sealed)
    text += "fit " + fit + (f.clean.dry_run ? " would be sealed\n" : " sealed\n");
  const std::string size = Formatted("%.1f MiB", static_cast<double>(report.bytes) / (1 << 20));
  return WriteStdout(text + std::to_string(report.removed.size()) + " artifacts " +
                     (f.clean.dry_run ? "would be removed, " : "removed, ") + size + "; " +
                     std::to_string(report.kept) + " kept\n");
}

Status PrintReport(const RunFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const StoredFit fit, NewestFit(f.run.store, f.run.session, logger));
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
    SLX_RETURN_IF_ERROR(db::LogAccess(f.run.store, "report", fit.session, "fit " + fit.id));
  else
    SLX_RETURN_IF_ERROR(CopyFit(f.run.store, fit, "report", folder));
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
      {"run", "All stages, from frames to the report; what an earlier run made is not made again", Stage::kReport},
      {"reconstruct", "Decode and triangulate: position.exr, normals, mesh.ply", Stage::kReconstruct},
      {"separate", "Direct and global light as EXR", Stage::kSeparate},
      {"normals", "Four-source normals as EXR", Stage::kNormals},
      {"srd", "Extract the spatial radiance distributions", Stage::kSrd},
      {"fit", "Fit the layers: layers_*.exr, quality.exr", Stage::kFit}};
  for (const auto& v : verbs) {
    auto flags = std::make_shared<RunFlags>();
    flags->run.until = v.until;
    auto* verb = app.add_subcommand(v.name, v.help);
    const std::string command = std::string("  stratalux-fit ") + v.name + " latest --store store";
    verb->footer(
        "Examples:\n" + command + "\n" + command + " --heldout 0 --shift refracted_sine\n" + command +
        " --mode free --shift paper --gain none --surface free --background on --prior none   # the paper as printed");
    AddStore(*verb, *flags);
    AddFitOptions(*verb, *flags);
    verb->callback([flags, &exit_code] { exit_code = Execute(*flags); });
  }
  auto cleaned = std::make_shared<RunFlags>();
  auto* clean = app.add_subcommand("clean", "Removes what the stages made and no fit of the session points to");
  clean->footer(
      "Fits keep all their files; what is removed is made again where a later run wants it.\n"
      "Examples:\n  stratalux-fit clean latest --store store --dry-run\n"
      "  stratalux-fit clean s000017 --store store --keep-days 7\n"
      "  stratalux-fit clean s000017 --store store --damaged   # only what is not what its record says");
  AddStore(*clean, *cleaned);
  clean->add_option("--keep-days", cleaned->clean.keep_days, "Keep what is younger")
      ->check(CLI::Range(0.0, 36500.0))
      ->capture_default_str();
  clean->add_flag("--damaged", cleaned->clean.damaged_only, "Only artifacts whose files were changed or are missing");
  clean->add_flag("--dry-run", cleaned->clean.dry_run, "Say what would go; remove nothing");
  clean->callback([cleaned, &exit_code] {
    Logger logger;
    const Status status = Clean(*cleaned, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
  auto flags = std::make_shared<RunFlags>();
  auto* report = app.add_subcommand("report", "Where the newest report of a session is");
  AddStore(*report, *flags);
  report->footer(
      "Example:\n  stratalux-fit report latest --store store --out seen   # a plain copy, of an encrypted session's, "
      "too");
  report->add_option("--out", flags->out, "Folder for a copy of the fit's files, plain; logged, and found by `forget`");
  report->add_flag("--path-only", flags->path_only, "Nothing but the path");
  report->callback([flags, &exit_code] {
    Logger logger;
    const Status status = PrintReport(*flags, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
