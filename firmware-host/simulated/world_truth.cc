// SPDX-License-Identifier: Apache-2.0
// Truth maps of the simulated world: names and shapes in docs/simulated-rig.md.
#include <limits>

#include "firmware-host/simulated/truth_normals.h"
#include "firmware-host/simulated/world.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::rig {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// `mixed` becomes 1 where a site of a quad sees another material than the quad's centre does, nothing being one: its
// colours are those of two things.
void MarkMixedQuads(const std::vector<SubjectPixel>& sites, int step, const Image<float>& material,
                    Image<float>& mixed) {
  Image<uint8_t> of_nothing(material.width(), material.height(), 1, static_cast<uint8_t>(step * step));
  for (const SubjectPixel& site : sites) {
    const int i = site.x / step, j = site.y / step;
    if (!material.contains(i, j)) continue;
    --of_nothing(i, j);
    if (material(i, j) != static_cast<float>(site.material.kind)) mixed(i, j) = 1.0F;
  }
  for (size_t q = 0; q < mixed.size(); ++q)
    if (material.pixels()[q] != 0.0F && of_nothing.pixels()[q] != 0) mixed.pixels()[q] = 1.0F;
}

}  // namespace

Image<float> World::ToQuads(const Stage& stage, const std::vector<float>& per_pixel, double exposure_ms) const {
  const Pinhole& camera = calibration_.camera.model;
  const Cfa cfa = calibration_.camera.cfa;
  const int step = QuadStep(cfa);
  Image<float> quads(camera.width / step, camera.height / step, QuadChannels(cfa));
  for (size_t i = 0; i < stage.pixels.size(); ++i) {
    const SubjectPixel& s = stage.pixels[i];
    if (s.x / step >= quads.width() || s.y / step >= quads.height()) continue;
    const int colour = CfaColour(cfa, s.x, s.y);
    quads(s.x / step, s.y / step, colour) +=
        static_cast<float>(exposure_ms) * per_pixel[i] * (colour == 1 ? 0.5F : 1.0F);
  }
  return quads;
}

void World::AddTruthOfShape(const Stage& stage, std::vector<TruthMap>& maps) const {
  const Pinhole& camera = calibration_.camera.model;
  const Cfa cfa = calibration_.camera.cfa;
  const int width = camera.width / QuadStep(cfa), height = camera.height / QuadStep(cfa);
  TruthMap depth{"depth", Image<float>(width, height, 1, kNaN)}, normal{"normal", Image<float>(width, height, 3, kNaN)};
  TruthMap mask{"mask", Image<float>(width, height)}, optics{"optics", Image<float>(width, height, 2, kNaN)};
  TruthMap material{"material", Image<float>(width, height)}, part{"class", Image<float>(width, height)};
  TruthMap layers{"layers", Image<float>(width, height, 2, kNaN)}, mixed{"mixed", Image<float>(width, height)};
  TruthMap spread{"spread", Image<float>(width, height, QuadChannels(cfa), kNaN)};
  TruthMap subcutis{"subcutis", Image<float>(width, height, 2, kNaN)};
  SeenSurface seen{Image<float>(width, height, 3, kNaN), {}, Image<Material>(width, height)};
  for (Material& nothing : seen.material.pixels()) nothing.kind = MaterialKind::kNone;
  ParallelFor(height, 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < width; ++i) {
        const auto hit = stage.scene.Intersect({Eigen::Vector3d::Zero(), camera.Unproject(QuadCentre(cfa, i, j))});
        if (!hit) continue;
        const Eigen::Vector3d n = stage.scene.Normal(*hit);
        const Material here = stage.scene.MaterialAt(*hit);
        mask.map(i, j) = 1.0F;
        material.map(i, j) = static_cast<float>(here.kind);
        part.map(i, j) = static_cast<float>(here.part);
        depth.map(i, j) = static_cast<float>(hit->z());
        for (int k = 0; k < 3; ++k) normal.map(i, j, k) = static_cast<float>(n[k]);
        for (int k = 0; k < 3; ++k) seen.point_mm(i, j, k) = static_cast<float>((*hit)[k]);
        seen.material(i, j) = here;
        if (!Scatters()) seen.material(i, j).kind = MaterialKind::kMatt;
        if (here.kind != MaterialKind::kSkin) continue;
        optics.map(i, j, 0) = here.skin.melanin;
        optics.map(i, j, 1) = here.skin.blood;
        layers.map(i, j, 0) = here.skin.epidermis_mm;
        layers.map(i, j, 1) = here.skin.scattering;
        subcutis.map(i, j, 0) = here.skin.subcutis_absorption;
        subcutis.map(i, j, 1) = static_cast<float>(here.skin.skin_mm);
        for (int c = 0; c < spread.map.channels() && Scatters(); ++c)
          spread.map(i, j, c) = static_cast<float>(table_.EffectiveWidthMm(c, here.skin));
      }
  });
  MarkMixedQuads(stage.pixels, QuadStep(cfa), material.map, mixed.map);
  seen.normal = normal.map;
  maps.push_back({"diffuse normal", DiffuseNormals(seen, table_, camera, cfa)});
  for (TruthMap* map : {&depth, &normal, &mask, &optics, &material, &part, &layers, &mixed, &spread})
    maps.push_back(std::move(*map));
  const SkinDescription& skin = scene_.description().skin;
  if (skin.subcutis_absorption != 1.0 || skin.skin_mm != kSkinMm) maps.push_back(std::move(subcutis));
}

Status World::AddTruthOfLight(Stage& stage, size_t projector, const std::string& name, const Pattern& pattern,
                              double exposure_ms, std::vector<TruthMap>& maps) const {
  const float open = 1.0F - static_cast<float>(calibration_.projectors[projector].black_level);
  auto add = [&](const std::string& part, std::vector<float> light) {
    for (float& v : light) v *= open;  // what a frame minus its black frame holds
    maps.push_back({part + " " + name + " " + std::to_string(projector), ToQuads(stage, light, exposure_ms)});
  };
  std::vector<float> subsurface(stage.pixels.size(), 0.0F), direct(stage.pixels.size(), 0.0F);
  SLX_RETURN_IF_ERROR(RenderTransport(stage, projector, pattern, subsurface, direct));
  add("subsurface", std::move(subsurface));
  add("direct", std::move(direct));
  if (!scene_.description().interreflection) return Status::Ok();
  std::vector<float> indirect(stage.pixels.size(), 0.0F);
  SLX_ASSIGN_OR_RETURN(const Interreflection* bounce, Bounce(stage, projector));
  bounce->Render(pattern, indirect);
  add("interreflection", std::move(indirect));
  return Status::Ok();
}

Status World::AddTruthOfLights(Stage& stage, const CapturePlan& plan, std::vector<TruthMap>& maps) const {
  const PlanOptions& o = plan.options;
  const std::vector<std::pair<std::string, Pattern>> lights = {
      {"white", {.kind = PatternKind::kWhite}},
      {"stripe", {.kind = PatternKind::kComb, .period = o.comb_period, .width = o.comb_width, .shift = 0}},
      {"spot", {.kind = PatternKind::kSpots, .period = o.spot_pitch, .width = o.spot_radius}}};
  for (size_t p = 0; p < calibration_.projectors.size() && p < static_cast<size_t>(o.projectors); ++p) {
    for (const auto& [name, pattern] : lights) {
      if (name == "spot" && o.spot_radius == 0) continue;
      SLX_RETURN_IF_ERROR(AddTruthOfLight(stage, p, name, pattern, o.exposure_ms, maps));
    }
    TruthMap at{"column " + std::to_string(p),
                Image<float>(calibration_.camera.model.width, calibration_.camera.model.height, 2, kNaN)};
    SLX_ASSIGN_OR_RETURN(const LightTransport* transport, Transport(stage, p));
    for (size_t i = 0; i < stage.pixels.size(); ++i)
      for (int k = 0; k < 2; ++k) at.map(stage.pixels[i].x, stage.pixels[i].y, k) = transport->ColumnRow(i)[k];
    maps.push_back(std::move(at));
  }
  return Status::Ok();
}

Result<std::vector<TruthMap>> World::Truth(const CapturePlan& plan) {
  SLX_ASSIGN_OR_RETURN(Stage * stage, StageIn({}));
  std::vector<TruthMap> maps;
  AddTruthOfShape(*stage, maps);
  SLX_RETURN_IF_ERROR(AddTruthOfLights(*stage, plan, maps));
  return maps;
}

}  // namespace stratalux::rig
