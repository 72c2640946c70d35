// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit render`: a fitted face under a light that nobody captured.
#include <cstdio>
#include <memory>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/privacy/export_marker.h"
#include "fitter/apps/run_command.h"
#include "fitter/evaluation/interval_figures.h"
#include "fitter/pipeline/session_fits.h"
#include "fitter/session/choose_session.h"
#include "fitter/session/session_frames.h"
#include "fitter/stages/relight.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

struct RenderFlags {
  std::string store, session = "latest", fit, out, pattern, maps = "auto";
  std::vector<double> point, direction, colour;
  int projector = -1;
  double white = 0.0;
  bool json = false;
};

Result<VirtualLight> LightOf(const RenderFlags& f) {
  VirtualLight light;
  const int given = (f.point.empty() ? 0 : 1) + (f.direction.empty() ? 0 : 1) + (f.projector >= 0 ? 1 : 0);
  if (given != 1) return Status::Usage("give one light: --point X,Y,Z, --direction X,Y,Z or --projector N");
  if (!f.colour.empty()) light.colour = {f.colour[0], f.colour[1], f.colour[2]};
  if (f.projector >= 0) {
    light.kind = VirtualLight::Kind::kProjector;
    light.projector = f.projector;
    SLX_ASSIGN_OR_RETURN(light.pattern, Pattern::Parse(f.pattern.empty() ? "white" : f.pattern));
    return light;
  }
  if (!f.pattern.empty())
    return Status::Usage("--pattern '" + f.pattern + "' is what a projector shows: give it with --projector N");
  const auto& v = f.point.empty() ? f.direction : f.point;
  light.kind = f.point.empty() ? VirtualLight::Kind::kDirectional : VirtualLight::Kind::kPoint;
  light.vector = {v[0], v[1], v[2]};
  return light;
}

LayerChoice ChoiceOf(const std::string& maps) {
  return maps == "on" ? LayerChoice::kMaps : maps == "off" ? LayerChoice::kFit : LayerChoice::kBest;
}

Status Render(const RenderFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto light, LightOf(f));
  SLX_RETURN_IF_ERROR(light.Validate());
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(f.store, f.session, SessionUse::kFit, logger));
  SLX_ASSIGN_OR_RETURN(auto frames, SessionFrames::Open(f.store, chosen));
  for (const std::string& note : frames.store().notes()) logger.Warning(note);
  const std::string session = frames.info().id;
  SLX_ASSIGN_OR_RETURN(const auto stored,
                       f.fit.empty() ? NewestFit(f.store, session, logger) : NamedFit(f.store, session, f.fit, logger));
  SavedFit fit;
  SLX_RETURN_IF_ERROR(ReadFit(stored, [&](const std::filesystem::path& folder) -> Status {
    SLX_ASSIGN_OR_RETURN(fit, LoadFit(folder, ChoiceOf(f.maps)));
    return Status::Ok();
  }));
  logger.Info("relighting fit " + stored.id + " of session " + session + ", layers " + fit.provenance);
  SLX_ASSIGN_OR_RETURN(auto relit, Relight(fit, light));
  const auto intervals = ReadIntervals(stored.folder / "metrics.json");
  if (!intervals.ok() && intervals.status().code() != StatusCode::kNotFound) return intervals.status();
  if (intervals.ok() && static_cast<int>(intervals->colours.size()) == relit.total.channels())
    relit.half_width = HalfWidths(fit.shape.surface, relit.light_mm, relit.total,
                                  relit.white.empty() ? relit.total : relit.white, intervals->colours);
  else
    logger.Info("fit " + stored.id +
                " does not say how far predictions may be off: no interval.exr (fit the session again)");
  for (const std::string& note : relit.Notes()) logger.Warning(note);
  SLX_RETURN_IF_ERROR(db::WriteExport(f.store, "render", session, f.out, RelitFiles(),
                                      [&] { return WriteRelit(f.out, relit, f.white, session, stored.id); }));
  if (stored.seal.active()) logger.Info(PlainCopyNote(session, f.out));
  if (f.json) {
    const nlohmann::ordered_json json = {
        {"session", session}, {"fit", stored.id}, {"folder", f.out}, {"layers", fit.provenance}};
    return WriteStdout(json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
  }
  return WriteStdout((std::filesystem::path(f.out) / "total.png").string() + "\n");
}

}  // namespace

void AddRenderCommand(CLI::App& app, int& exit_code) {
  auto flags = std::make_shared<RenderFlags>();
  auto* verb = app.add_subcommand(
      "render",
      "Render a fitted face under a new light: subsurface, surface and total as EXR, PNG; how far they may be off");
  verb->footer(
      "Camera frame, mm: +x right, +y down, +z away from the camera. A light of colour 1 makes a white target at the\n"
      "middle of the face, turned to it, read 1.\n"
      "interval.exr: half the 95 % interval of total, from the fit's errors on held-out light "
      "(docs/math/evaluation.md).\n"
      "Examples:\n"
      "  stratalux-fit render latest --store store --point=-200,-150,250 --out relit\n"
      "  stratalux-fit render latest --store store --direction=1,-0.3,-0.4 --colour 1,0.8,0.6 --out evening\n"
      "  stratalux-fit render latest --store store --projector 3 --pattern 'comb columns period=128 width=2 shift=0' "
      "--out stripe");
  verb->add_option("session", flags->session, "Session: id, unique prefix, or latest")->capture_default_str();
  verb->add_option("--store", flags->store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb->add_option("--fit", flags->fit, "Fit (default: the newest complete one)");
  verb->add_option("--point", flags->point, "Point light at X,Y,Z mm")->delimiter(',')->expected(3);
  verb->add_option("--direction", flags->direction, "Light from far away; X,Y,Z points towards it")
      ->delimiter(',')
      ->expected(3);
  verb->add_option("--projector", flags->projector, "A projector of the rig")->check(CLI::Range(0, 15));
  verb->add_option("--pattern", flags->pattern, "What that projector shows; default: white");
  verb->add_option("--colour", flags->colour, "R,G,B of the light")->delimiter(',')->expected(3);
  verb->add_option("--maps", flags->maps,
                   "on: the layers from all projectors; off: those of the fit, which leave one out; auto: from all "
                   "if the fit has them")
      ->check(CLI::IsMember({"auto", "on", "off"}))
      ->capture_default_str();
  verb->add_option("--white", flags->white,
                   "Linear value that becomes white in the PNGs (default: chosen automatically)")
      ->check(CLI::PositiveNumber);
  verb->add_option("--out", flags->out, "Folder for the pictures")->required();
  verb->add_flag("--json", flags->json, "Machine-readable result on stdout");
  verb->callback([flags, &exit_code] {
    Logger logger;
    const Status status = Render(*flags, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
