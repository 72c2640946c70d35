// SPDX-License-Identifier: Apache-2.0
#include "fitter/apps/fit_flags.h"

#include <algorithm>
#include <charconv>

#include <CLI/CLI.hpp>

namespace stratalux::fit {
namespace {

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

}  // namespace

std::vector<CLI::Option*> AddFitOptions(CLI::App& verb, FitFlags& f) {
  const std::vector<CLI::Option*> before = verb.get_options();
  verb.add_option("--layers", f.run.fit.em.layers, "Scattering layers per pixel")
      ->check(CLI::Range(1, 32))
      ->capture_default_str();
  verb.add_option("--mode", f.mode,
                  "tied: one set of layers per pixel for all lights; free: each SRD on its own, as in the paper")
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
                  "Light reflected by the surface itself. model: facets of one roughness and strength, found on the "
                  "training lights; free: each light's own, near 5 %")
      ->check(CLI::IsMember({"model", "free"}))
      ->capture_default_str();
  verb.add_option("--background", f.background,
                  "on: a uniform floor beside the layers, for rooms where light returns from far away; off")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb.add_option("--prior", f.prior,
                  "Photons of the session's mean layers that are added to each profile's own: a number; auto: the "
                  "number that best predicts the training lights, each left out in turn; none: every pixel on its own")
      ->capture_default_str();
  verb.add_option("--neighbours", f.neighbours,
                  "on: a pixel's prior is the layers of the skin around it that returns as much light; off: the "
                  "session's mean layers alone. Only in a tied fit with a prior")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb.add_option("--iterations", f.run.fit.em.max_iterations,
                  "Maximum number of EM sweeps of each pixel without a prior, and a tenth of that of the mean layers "
                  "(a fiftieth from 20 on), which all pixels share; times the square of --pool")
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
  verb.add_option("--frames", f.run.frames,
                  "Use at most this many of the visit's frames, as if a shorter visit had been captured (default: "
                  "all). Too few for codes need --geometry truth (--dry-run says what is left out)")
      ->check(CLI::Range(1, 1000000));
  verb.add_option("--offset", f.offset,
                  "on: the reconstructed surface is moved along the view to where the sweeps say it lies, because "
                  "scattering hides that from the codes; off: taken as it is")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb.add_option("--motion", f.motion,
                  "on: the head's motion is found from white frames and codes, and compensated; off: the head is "
                  "taken to have held still")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb.add_option("--maps", f.maps,
                  "on: also make maps/, the layers by all projectors, none left out, for pictures and exports; off. "
                  "A free fit has none")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb.add_flag("--full-evaluation", f.run.full_evaluation,
                "Hold out every projector in turn; baselines and ablations");
  verb.add_flag("--standard-errors", f.run.standard_errors,
                "Also make standard_errors.exr: those of each pixel's total weight, mean depth and width, by noise "
                "and by fits that leave out each projector in turn (takes long at full size; --full-evaluation makes "
                "the same fits)");
  std::vector<CLI::Option*> added = verb.get_options();
  std::erase_if(added,
                [&](CLI::Option* option) { return std::find(before.begin(), before.end(), option) != before.end(); });
  return added;
}

Result<RunOptions> RunOptionsOf(const FitFlags& flags) {
  RunOptions run = flags.run;
  SLX_ASSIGN_OR_RETURN(run.fit.em.scattering.shift_law, ParseShiftLaw(flags.shift));
  SLX_ASSIGN_OR_RETURN(run.srd.reading, ParseSrdReading(flags.reading));
  SLX_ASSIGN_OR_RETURN(run.srd.distance, ParseSrdDistance(flags.distance));
  SLX_RETURN_IF_ERROR(ParsePrior(flags.prior, run.fit));
  run.fit.em.scattering.mode = flags.mode == "free" ? FitMode::kFree : FitMode::kTied;
  run.fit.em.scattering.gain_model = flags.gain == "model";
  run.fit.choose.reflection = flags.surface == "model";
  run.fit.em.background_term = flags.background == "on";
  run.fit.choose.neighbours = flags.neighbours == "on";
  run.fit.choose.directions = flags.directional == "on";
  run.offset = flags.offset == "on";
  run.motion = flags.motion == "on";
  run.maps = flags.maps == "on";
  run.geometry = flags.geometry == "truth" ? GeometrySource::kTruth : GeometrySource::kReconstructed;
  return run;
}

std::vector<std::string> GivenArguments(const std::vector<CLI::Option*>& options) {
  std::vector<std::string> given;
  for (const CLI::Option* option : options) {
    if (option->count() == 0) continue;
    const bool flag = option->get_items_expected_max() == 0;
    given.push_back(option->get_name() + (flag ? "" : "=" + option->results().back()));
  }
  return given;
}

Result<RunOptions> RunOptionsOf(const std::vector<std::string>& given) {
  CLI::App app;
  FitFlags flags;
  AddFitOptions(app, flags);
  std::vector<std::string> words(given.rbegin(), given.rend());  // as CLI11 takes them
  try {
    app.parse(words);
  } catch (const CLI::ParseError& error) {
    return Status::Usage(std::string("options of a fit: ") + error.what());
  }
  return RunOptionsOf(flags);
}

}  // namespace stratalux::fit
