// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/run_options.h"

#include <sstream>

#include <nlohmann/json.hpp>

namespace stratalux::fit {
namespace {

std::string PriorText(const FitOptions& fit) {
  if (fit.choose.prior) return "auto";
  if (!(fit.em.prior.photons > 0.0)) return "none";
  std::ostringstream text;
  text << fit.em.prior.photons;
  return text.str();
}

}  // namespace

const char* ToString(GeometrySource source) { return source == GeometrySource::kTruth ? "truth" : "reconstructed"; }

// Free layers are averages over the lights, no maximum that sweeps could go on from.
bool RunOptions::MakesMaps() const { return maps && fit.em.scattering.mode == FitMode::kTied; }

Status RunOptions::Validate() const {
  SLX_RETURN_IF_ERROR(fit.em.Validate());
  if (heldout < 0 || heldout > 15)
    return Status::Usage("held-out projector " + std::to_string(heldout) + " must lie in 0 .. 15");
  if (standard_errors && fit.em.scattering.mode == FitMode::kFree)
    return Status::Usage("standard errors need a tied fit: leave out --mode free or --standard-errors");
  if (frames && *frames < 1) return Status::Usage("--frames " + std::to_string(*frames) + ": must be 1 or more");
  if (until == Stage::kMaps && !MakesMaps())
    return Status::Usage("maps from all projectors need a tied fit: leave out --mode free and --maps off");
  if (fit.choose.directions && fit.em.scattering.mode == FitMode::kFree)
    return Status::Usage("directional weights need a tied fit: leave out --mode free or --directional on");
  return srd.Validate();
}

std::string RunOptions::ToJson() const {
  const EmOptions& em = fit.em;
  const ScatteringModel& model = em.scattering;
  nlohmann::ordered_json json = {{"layers", em.layers},
                                 {"mode", model.mode == FitMode::kTied ? "tied" : "free"},
                                 {"shift", fit::ToString(model.shift_law)},
                                 {"eta", model.eta},
                                 {"gain_model", model.gain_model},
                                 {"directional", fit.choose.directions},
                                 {"surface", fit.choose.reflection ? "model" : "free"},
                                 {"background", em.background_term},
                                 {"iterations", em.max_iterations},
                                 {"prior", PriorText(fit)},
                                 {"neighbours", fit.choose.neighbours},
                                 {"tolerance", em.tolerance},
                                 {"heldout", heldout},
                                 {"pool", srd.pool},
                                 {"reading", fit::ToString(srd.reading)},
                                 {"distance", fit::ToString(srd.distance)},
                                 {"full_evaluation", full_evaluation},
                                 {"offset", offset},
                                 {"motion", motion},
                                 {"maps", MakesMaps()},
                                 {"standard_errors", standard_errors},
                                 {"geometry", fit::ToString(geometry)}};
  if (frames) json["frames"] = *frames;
  return json.dump();
}

}  // namespace stratalux::fit
