// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/simulated/brute_force_frames.h"

#include <array>
#include <cmath>
#include <cstdio>

#include "firmware-host/simulated/simulation_file.h"
#include "firmware-host/simulated/skin/subcutis_table.h"

namespace stratalux::rig {
namespace {

constexpr std::array<const char*, 3> kColours = {"R", "G", "B"};

// The frame of one light alone; nullptr: of no light.
Result<Image<uint16_t>> Shoot(SimulatedRig& rig, const ProjectedLight* light, double exposure_ms) {
  for (LightSwitch* one : rig.switches()) one->Set(false);
  SLX_RETURN_IF_ERROR(rig.camera().SetExposure(exposure_ms, 1.0));
  if (light != nullptr) {
    SLX_RETURN_IF_ERROR(rig.projectors()[light->projector]->Load({light->pattern}));
    rig.switches()[light->projector]->Set(true);
    SLX_ASSIGN_OR_RETURN(const auto projector, rig.lines().TriggerProjector(light->projector));
    static_cast<void>(projector);
    rig.Sleep(std::chrono::milliseconds(5));  // the picture is on a while after its trigger
  }
  SLX_ASSIGN_OR_RETURN(const auto trigger, rig.lines().TriggerCamera());
  static_cast<void>(trigger);
  SLX_ASSIGN_OR_RETURN(auto frame, rig.camera().Wait(std::chrono::seconds(60)));
  if (!frame) return Status::Failed("the simulated camera gave no frame");
  return std::move(frame->pixels);
}

}  // namespace

std::vector<NamedLight> CrossCheckLights(const SimulatedRigOptions& options) {
  const int unit = std::max(1, options.projector_width / 256);
  std::vector<NamedLight> lights;
  for (const int p : {0, 3}) {
    lights.push_back({"white", {p, {.kind = PatternKind::kWhite}}});
    lights.push_back({"stripe", {p, {.kind = PatternKind::kComb, .period = 8 * unit, .width = unit, .shift = 0}}});
    lights.push_back({"spot", {p, {.kind = PatternKind::kSpots, .period = 8 * unit, .width = 2 * unit}}});
  }
  return lights;
}

std::vector<Eigen::Vector2i> CrossCheckPixels(const SimulatedRigOptions& options, int places) {
  // On the default head, mm at the working distance: forehead, cheek, cheek, side of the nose, upper lip, chin, temple.
  constexpr std::array<std::array<double, 2>, 7> kPlaces = {
      {{-12, -52}, {-38, 18}, {40, 10}, {16, 6}, {8, 43}, {-6, 74}, {52, -38}}};
  constexpr int kParity[3][2] = {{0, 0}, {1, 0}, {1, 1}};  // of R, G, B in the RGGB mosaic
  const double px_per_mm = options.camera_width / 300.0;
  std::vector<Eigen::Vector2i> pixels;
  for (int k = 0; k < std::min<int>(places, kPlaces.size()); ++k)
    for (const auto& parity : kParity) {
      const int x = static_cast<int>(options.camera_width / 2.0 + kPlaces[k][0] * px_per_mm) / 2 * 2;
      const int y = static_cast<int>(options.camera_height / 2.0 + kPlaces[k][1] * px_per_mm) / 2 * 2;
      pixels.emplace_back(x + parity[0], y + parity[1]);
    }
  return pixels;
}

Result<std::vector<ComparedPixel>> CompareWithRig(const CompareOptions& options, const std::vector<NamedLight>& lights,
                                                  const std::vector<Eigen::Vector2i>& pixels, Logger& logger) {
  SimulatedRigOptions quiet = options.rig;
  quiet.noise = false;
  SLX_ASSIGN_OR_RETURN(const auto rig, SimulatedRig::Create(quiet, logger));
  SLX_ASSIGN_OR_RETURN(const Simulation simulation, LoadSimulation(quiet.scene));
  SLX_ASSIGN_OR_RETURN(SkinTable table,
                       SkinTable::Load(quiet.skin_table.empty() ? SkinTable::DefaultPath() : quiet.skin_table));
  if (!simulation.scene.skin.Of(quiet.seed).UsualSubcutis()) {
    SLX_ASSIGN_OR_RETURN(SubcutisTable other, SubcutisTable::Load(SubcutisTable::DefaultPath()));
    table = table.With(std::move(other));
  }
  SLX_ASSIGN_OR_RETURN(const Scene scene, Scene::Create(simulation.scene, quiet.seed, &table));
  SLX_RETURN_IF_ERROR(rig->camera().Start());
  // Less the dark ones, at the nominal exposure. Lines and spots are dim: where an exposure of four times that does not
  // saturate, it keeps the rounding small.
  std::vector<Image<double>> frames;
  const double saturation_dn = rig->calibration().camera.saturation_dn;
  for (const NamedLight& l : lights) {
    Image<double> light;
    for (const double longer : l.light.pattern.kind == PatternKind::kWhite ? std::vector{1.0} : std::vector{1.0, 4.0}) {
      SLX_ASSIGN_OR_RETURN(const auto frame, Shoot(*rig, &l.light, longer * options.exposure_ms));
      SLX_ASSIGN_OR_RETURN(const auto dark, Shoot(*rig, nullptr, longer * options.exposure_ms));
      if (light.empty()) light = Image<double>(frame.width(), frame.height());
      for (size_t i = 0; i < light.size(); ++i)
        if (longer == 1.0 || frame.pixels()[i] < saturation_dn)
          light.pixels()[i] = (double(frame.pixels()[i]) - double(dark.pixels()[i])) / longer;
    }
    frames.push_back(std::move(light));
  }
  const RigCalibration& calibration = rig->calibration();
  // A projector's black still shines as white does: behind the lights, the white of each projector.
  std::vector<ProjectedLight> traced_lights;
  for (const NamedLight& l : lights) traced_lights.push_back(l.light);
  for (size_t p = 0; p < calibration.projectors.size(); ++p)
    traced_lights.push_back({static_cast<int>(p), {.kind = PatternKind::kWhite}});
  std::vector<ComparedPixel> compared;
  Progress progress(logger, "photons", static_cast<int64_t>(pixels.size()));
  for (const Eigen::Vector2i& at : pixels) {
    const auto estimates = TracePixel(scene, calibration, at.x(), at.y(), traced_lights, options.tracing);
    const auto point =
        scene.Intersect({Eigen::Vector3d::Zero(), calibration.camera.model.Unproject(at.cast<double>())});
    progress.Advance();
    if (!point) continue;
    for (size_t l = 0; l < lights.size(); ++l) {
      const int p = lights[l].light.projector;
      const double black = calibration.projectors[p].black_level, open = 1.0 - black;
      const BruteForceEstimate &e = estimates[l], &white = estimates[lights.size() + p];
      ComparedPixel c{lights[l].name, p, CfaColour(calibration.camera.cfa, at.x(), at.y()), at.x(), at.y()};
      c.light_deg = IncidenceDeg(scene, *point, calibration.projectors[p].CentreInCamera());
      c.view_deg = IncidenceDeg(scene, *point, Eigen::Vector3d::Zero());
      c.rig = frames[l](at.x(), at.y());
      c.direct = options.exposure_ms * (open * e.direct + black * white.direct);
      c.traced = options.exposure_ms * (open * e.subsurface + black * white.subsurface) + c.direct;
      c.traced_error = options.exposure_ms * std::hypot(open * e.subsurface_error, open * e.direct_error);
      compared.push_back(c);
    }
  }
  return compared;
}

double SigmaOf(const ComparedPixel& pixel, double exposure_ms) {
  const bool white = pixel.light == "white";
  const double rig_error = (white ? 0.02 : 0.04) * pixel.traced + 0.001 * exposure_ms * 3.0;
  return std::hypot(std::hypot(pixel.traced_error, pixel.RoundingDn()), rig_error);
}

std::string ComparisonTable(const std::vector<ComparedPixel>& pixels) {
  std::string table =
      "| light | projector | colour | pixel | light, view | rig DN | photons DN | std error | of it at the surface | "
      "deviation |\n|---|---|---|---|---|---|---|---|---|---|\n";
  for (const ComparedPixel& c : pixels) {
    char line[256];
    std::snprintf(line, sizeof line,
                  "| %s | %d | %s | %d, %d | %.0f, %.0f deg | %.1f | %.1f | %.1f | %.1f | %+.1f %% |\n",
                  c.light.c_str(), c.projector, kColours[c.colour], c.x, c.y, c.light_deg, c.view_deg, c.rig, c.traced,
                  c.traced_error, c.direct, 100.0 * c.Deviation());
    table += line;
  }
  return table;
}

}  // namespace stratalux::rig
