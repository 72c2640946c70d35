// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit profiles fit|predict`: scattering layers of anyone's line-spread profiles, from CSV.
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iostream>
#include <iterator>
#include <memory>
#include <sstream>

#include <CLI/CLI.hpp>

#include "fitter/apps/run_command.h"
#include "fitter/profiles/profile_model.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/log.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

struct ProfilesFlags {
  std::string in = "-", out = "-", model, shift = "refracted_sine", mode = "tied", gain = "model", directional = "auto";
  EmOptions em = ProfileOptions();
};

Status WriteOut(const std::string& path, const std::string& text) {
  return path == "-" ? WriteStdout(text) : WriteText(path, text);
}

Directional DirectionalOf(const std::string& text) {
  return text == "on" ? Directional::kOn : text == "off" ? Directional::kOff : Directional::kAuto;
}

Status Fit(ProfilesFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(f.em.scattering.shift_law, ParseShiftLaw(f.shift));
  f.em.scattering.mode = f.mode == "free" ? FitMode::kFree : FitMode::kTied;
  f.em.scattering.gain_model = f.gain == "model";
  SLX_ASSIGN_OR_RETURN(const auto file, ReadProfiles(f.in, true));
  SLX_ASSIGN_OR_RETURN(const auto model, FitProfiles(file.profiles, f.em, DirectionalOf(f.directional)));
  for (const std::string& warning : model.warnings) logger.Warning(warning);
  for (const SourceFit& s : model.sources) {
    std::ostringstream line;
    line << "source " << s.source << ": incidence " << s.incidence_deg << ", exit " << s.exit_deg << " deg, slit "
         << s.slit_mm << " mm, NRMSE " << 100.0 * s.nrmse << " %";
    logger.Info(line.str());
  }
  return WriteOut(f.out, model.ToJson());
}

Status Predict(const ProfilesFlags& f) {
  if (f.model == "-" && f.in == "-") return Status::Usage("--model and --in cannot both be standard input");
  std::string text;
  if (f.model == "-") {
    text.assign(std::istreambuf_iterator<char>(std::cin), {});
  } else {
    std::ifstream in(f.model);
    if (!in) return Status::NotFound(f.model + ": " + std::strerror(errno));
    text.assign(std::istreambuf_iterator<char>(in), {});
  }
  SLX_ASSIGN_OR_RETURN(const auto model, ProfileModel::FromJson(text, f.model == "-" ? "standard input" : f.model));
  SLX_ASSIGN_OR_RETURN(const auto file, ReadProfiles(f.in, false));
  std::vector<std::vector<double>> predicted;
  for (const LineProfile& profile : file.profiles) {
    auto y = PredictProfile(model, profile);
    if (!y.ok()) return y.status().WithContext(file.table.name);
    predicted.push_back(std::move(*y));
  }
  std::vector<double> radiance;
  for (const auto& [profile, sample] : file.placement) radiance.push_back(predicted[profile][sample]);
  return WriteProfiles(f.out, file.table, radiance);
}

int Finish(const Status& status) {
  if (!status.ok()) Logger().Error(status.message());
  return status.exit_code();
}

}  // namespace

void AddProfilesCommand(CLI::App& app, int& exit_code) {
  auto* profiles = app.add_subcommand("profiles", "Layers of measured line-spread profiles, from CSV");
  profiles->require_subcommand(1);
  profiles->footer(
      "Columns: source,incidence_deg,exit_deg,slit_mm,u_mm,radiance (docs/profiles.md). - is standard input or "
      "output.\n"
      "Examples:\n"
      "  stratalux-fit profiles fit --in arm.csv --out arm.json\n"
      "  stratalux-fit profiles predict --model arm.json --in unseen.csv --out predicted.csv\n"
      "  stratalux-fit profiles fit --in - --out - --mode free --layers 8 < arm.csv");

  auto flags = std::make_shared<ProfilesFlags>();
  auto* fit = profiles->add_subcommand("fit", "Fit the layers");
  fit->add_option("--in", flags->in, "CSV of profiles")->required();
  fit->add_option("--out", flags->out, "JSON of layers")->capture_default_str();
  fit->add_option("--layers", flags->em.layers, "Scattering layers")->check(CLI::Range(1, 32))->capture_default_str();
  fit->add_option("--shift", flags->shift, "Shift law")
      ->check(CLI::IsMember({"paper", "refracted", "refracted_sine"}))
      ->capture_default_str();
  fit->add_option("--mode", flags->mode, "tied: one set of layers for all sources; free: each source on its own [M]")
      ->check(CLI::IsMember({"tied", "free"}))
      ->capture_default_str();
  fit->add_option("--eta", flags->em.scattering.eta, "Refractive index")
      ->check(CLI::Range(1.0, 3.0))
      ->capture_default_str();
  fit->add_option("--gain", flags->gain, "Angular gain of the incidence")
      ->check(CLI::IsMember({"model", "none"}))
      ->capture_default_str();
  fit->add_option("--directional", flags->directional,
                  "Layers' weights follow the directions; auto: if the sources ask for it")
      ->check(CLI::IsMember({"auto", "on", "off"}))
      ->capture_default_str();
  fit->add_option("--iterations", flags->em.max_iterations, "Maximum number of EM sweeps")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  fit->callback([flags, &exit_code] {
    Logger logger;
    exit_code = Finish(Fit(*flags, logger));
  });

  auto predicted = std::make_shared<ProfilesFlags>();
  auto* predict = profiles->add_subcommand("predict", "Predict radiances; the column is appended");
  predict->add_option("--model", predicted->model, "JSON of layers")->required();
  predict->add_option("--in", predicted->in, "CSV without radiance")->required();
  predict->add_option("--out", predicted->out, "CSV with radiance")->capture_default_str();
  predict->callback([predicted, &exit_code] { exit_code = Finish(Predict(*predicted)); });
}

}  // namespace stratalux::fit
