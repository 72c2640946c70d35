// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/simulated_rig.h"

#include <utility>

#include "firmware-host/simulated/scene/face_skin.h"
#include "firmware-host/simulated/simulated_devices.h"
#include "firmware-host/simulated/simulation_file.h"
#include "firmware-host/simulated/skin/subcutis_table.h"
#include "shared/base/formatted.h"

namespace stratalux::rig {
namespace {

bool IsWax(const SceneDescription& scene) { return scene.shape == ShapeKind::kSlab; }

bool IsSkin(const SceneDescription& scene) {
  const ShapeKind shape = scene.shape;
  return shape == ShapeKind::kHead || shape == ShapeKind::kPlane || shape == ShapeKind::kSphere ||
         shape == ShapeKind::kMesh;
}

Result<Scene> SubjectOf(const SubjectOptions& options, SceneDescription description, const SkinTable& table,
                        Logger& logger) {
  SLX_RETURN_IF_ERROR(description.TakePose(options.board_pose).WithContext(options.scene));
  SLX_ASSIGN_OR_RETURN(Scene scene, Scene::Create(description, options.seed, &table));
  for (const std::string& remark : scene.Remarks()) logger.Info(remark);
  return scene;
}

// Whether the table knows the skin of the whole subject. `seed`: where the scene has none.
Status CheckSkin(const SkinTable& table, const SceneDescription& scene, uint64_t seed) {
  if (!IsSkin(scene)) return Status::Ok();
  const SkinDescription& skin = scene.skin;
  seed = scene.seed.value_or(seed);
  const double cheek = skin.Of(seed).scattering;
  SLX_RETURN_IF_ERROR(table.CheckScattering(cheek).WithContext("[skin]"));
  const ScatteringRange range = ScatteringOf(skin, seed);
  for (const double scattering : {range.least, range.most})
    SLX_RETURN_IF_ERROR(table.CheckScattering(scattering)
                            .WithContext(Formatted("[skin] regions = %g makes %g .. %g of scattering = %g",
                                                   skin.regions, range.least, range.most, cheek)));
  return Status::Ok();
}

std::string Listed(const std::vector<std::string>& places) {
  std::string list;
  for (const std::string& place : places) list += (list.empty() ? "" : ", ") + place;
  return list;
}

// The table; where the scene's subcutis is another than the table's, with that of other subcutis.
Result<SkinTable> WithSubcutisOf(const SceneDescription& scene, uint64_t seed, SkinTable table) {
  seed = scene.seed.value_or(seed);
  SkinParameters skin = scene.skin.Of(seed);
  if (!IsSkin(scene) || skin.UsualSubcutis()) return table;
  const std::string keys =
      Formatted("[skin] subcutis_absorption = %g, skin_mm = %g", scene.skin.subcutis_absorption, scene.skin.skin_mm);
  if (table.subcutis() == nullptr) {
    Result<SubcutisTable> other = SubcutisTable::Load(SubcutisTable::DefaultPath());
    if (other.status().code() == StatusCode::kNotFound)
      return Status::NotFound(keys + ": no table of other subcutis; looked for " +
                              Listed(SkinTable::DefaultPlaces(SubcutisTable::kFile)) +
                              " (leave the keys out, or make one with `stratalux-skin-table generate --subcutis`)");
    if (!other.ok()) return other.status().WithContext(keys);
    table = table.With(*std::move(other));
  }
  const ScatteringRange range = ScatteringOf(scene.skin, seed);
  for (const double scattering : {range.least, range.most}) {
    skin.scattering = static_cast<float>(scattering);
    SLX_RETURN_IF_ERROR(table.subcutis()->Check(skin).WithContext(keys));
  }
  return table;
}

Result<SkinTable> TableFor(const SimulatedRigOptions& options, const SceneDescription& scene, uint64_t seed) {
  const bool wax = IsWax(scene);
  const std::string shipped = wax ? SkinTable::DefaultWaxPath() : SkinTable::DefaultPath();
  Result<SkinTable> loaded = SkinTable::Load(options.skin_table.empty() ? shipped : options.skin_table);
  if (loaded.status().code() == StatusCode::kNotFound && options.skin_table.empty()) {
    return Status::NotFound("no skin table; looked for " +
                            Listed(SkinTable::DefaultPlaces(wax ? SkinTable::kWaxFile : SkinTable::kSkinFile)) +
                            " (STRATALUX_SKIN_TABLE names another place)");
  }
  SLX_ASSIGN_OR_RETURN(SkinTable table, std::move(loaded));
  if ((table.nodes() == 1) != wax)
    return Status::Usage("skin table " + options.skin_table + ": it is for " +
                         (wax ? "skin, the scene is a slab of wax" : "wax, the scene is of skin"));
  SLX_RETURN_IF_ERROR(CheckSkin(table, scene, seed));
  return WithSubcutisOf(scene, seed, std::move(table));
}

}  // namespace

Status SimulatedDevices::SetSubject(const SubjectOptions& subject) {
  SLX_ASSIGN_OR_RETURN(const Simulation simulation, LoadSimulation(subject.scene));
  SLX_RETURN_IF_ERROR(simulation.scene.Validate());
  SkinTable table = [&] {
    const std::lock_guard lock(world_mutex_);
    return world_.table();
  }();
  std::optional<SkinTable> other;  // where the tissue is another
  if (IsWax(simulation.scene) != (table.nodes() == 1)) {
    SLX_ASSIGN_OR_RETURN(other, TableFor(options_, simulation.scene, subject.seed));
    table = *other;
  }
  SLX_RETURN_IF_ERROR(CheckSkin(table, simulation.scene, subject.seed));
  SLX_ASSIGN_OR_RETURN(const SkinTable whole, WithSubcutisOf(simulation.scene, subject.seed, table));
  if (whole.subcutis() != table.subcutis()) other = table = whole;
  SLX_ASSIGN_OR_RETURN(Scene scene, SubjectOf(subject, simulation.scene, table, logger_));
  const Turn turn(*this);
  const std::lock_guard lock(world_mutex_);
  world_.SetSubject(std::move(scene), std::move(other), clock_);
  world_.CoverLens(subject.lens_covered);
  pending_.clear();
  last_.reset();
  push_mm_.setZero();
  return Status::Ok();
}

Status SimulatedRigOptions::Validate() const {
  auto even = [](const char* name, int v, int low, int high) {
    if (v >= low && v <= high && v % 2 == 0) return Status::Ok();
    return Status::Usage(std::string("simulated rig: ") + name + " = " + std::to_string(v) + ", allowed: even, " +
                         std::to_string(low) + " .. " + std::to_string(high));
  };
  SLX_RETURN_IF_ERROR(even("camera width", camera_width, 64, 4096));
  SLX_RETURN_IF_ERROR(even("camera height", camera_height, 48, 4096));
  SLX_RETURN_IF_ERROR(even("projector width", projector_width, 64, 4096));
  SLX_RETURN_IF_ERROR(even("projector height", projector_height, 48, 4096));
  return Status::Ok();
}

Result<std::unique_ptr<SimulatedRig>> SimulatedRig::Create(const SimulatedRigOptions& given, Logger& logger) {
  SLX_RETURN_IF_ERROR(given.Validate());
  SLX_ASSIGN_OR_RETURN(Simulation simulation, LoadSimulation(given.scene));
  SimulatedRigOptions options = given;
  if (given.scene.ends_with(".toml")) {
    options.devices = simulation.devices;
    options.faults = simulation.faults;
    options.faults.script.insert(options.faults.script.end(), given.faults.script.begin(), given.faults.script.end());
    if (given.faults.rate > 0.0) {
      options.faults.rate = given.faults.rate;
      options.faults.seed = given.faults.seed;
      options.faults.kinds = given.faults.kinds;
      options.faults.burst = given.faults.burst;
      options.faults.pair = given.faults.pair;
    }
  }
  SLX_RETURN_IF_ERROR(simulation.scene.Validate());
  SLX_ASSIGN_OR_RETURN(SkinTable table, TableFor(options, simulation.scene, given.seed));
  SLX_ASSIGN_OR_RETURN(Scene scene, SubjectOf({given.scene, given.seed, given.board_pose, given.lens_covered},
                                              simulation.scene, table, logger));
  return std::unique_ptr<SimulatedRig>(new SimulatedDevices(options, std::move(scene), std::move(table), logger));
}

Result<std::unique_ptr<LightGuard>> GuardLight(SimulatedRig& rig, StopToken& stop) {
  std::vector<std::vector<LightSwitch*>> projectors;
  for (LightSwitch* one : rig.switches()) projectors.push_back({one});
  return LightGuard::Start(std::move(projectors), &rig.interlock(), stop, {.clock = &rig.clock()});
}

}  // namespace stratalux::rig
