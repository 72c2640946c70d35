// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/simulated_rig.h"

#include <utility>

#include "firmware-host/simulated/simulated_devices.h"
#include "firmware-host/simulated/simulation_file.h"

namespace stratalux::rig {
namespace {

bool IsWax(const Scene& scene) { return scene.description().shape == ShapeKind::kSlab; }

Result<Scene> SubjectOf(const SubjectOptions& options, SceneDescription description) {
  SLX_RETURN_IF_ERROR(description.TakePose(options.board_pose).WithContext(options.scene));
  return Scene::Create(description, options.seed);
}

Result<SkinTable> TableFor(const SimulatedRigOptions& options, const Scene& scene) {
  const bool wax = IsWax(scene);
  const std::string shipped = wax ? SkinTable::DefaultWaxPath() : SkinTable::DefaultPath();
  Result<SkinTable> loaded = SkinTable::Load(options.skin_table.empty() ? shipped : options.skin_table);
  if (loaded.status().code() == StatusCode::kNotFound && options.skin_table.empty()) {
    std::string places;
    for (const std::string& place : SkinTable::DefaultPlaces(wax ? SkinTable::kWaxFile : SkinTable::kSkinFile))
      places += (places.empty() ? "" : ", ") + place;
    return Status::NotFound("no skin table; looked for " + places + " (STRATALUX_SKIN_TABLE names another place)");
  }
  SLX_ASSIGN_OR_RETURN(SkinTable table, std::move(loaded));
  if ((table.nodes() == 1) != wax)
    return Status::Usage("skin table " + options.skin_table + ": of " +
                         (wax ? "skin, the scene is a slab of wax" : "wax, the scene is of skin"));
  return table;
}

}  // namespace

Status SimulatedDevices::SetSubject(const SubjectOptions& subject) {
  SLX_ASSIGN_OR_RETURN(const Simulation simulation, LoadSimulation(subject.scene));
  SLX_ASSIGN_OR_RETURN(Scene scene, SubjectOf(subject, simulation.scene));
  const Turn turn(*this);
  const std::lock_guard lock(world_mutex_);
  std::optional<SkinTable> table;
  if (IsWax(scene) != (world_.table().nodes() == 1)) {
    SLX_ASSIGN_OR_RETURN(table, TableFor(options_, scene));
  }
  world_.SetSubject(std::move(scene), std::move(table), clock_);
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
  SLX_ASSIGN_OR_RETURN(Scene scene,
                       SubjectOf({given.scene, given.seed, given.board_pose, given.lens_covered}, simulation.scene));
  SLX_ASSIGN_OR_RETURN(SkinTable table, TableFor(options, scene));
  return std::unique_ptr<SimulatedRig>(new SimulatedDevices(options, std::move(scene), std::move(table), logger));
}

Result<std::unique_ptr<LightGuard>> GuardLight(SimulatedRig& rig, StopToken& stop) {
  std::vector<std::vector<LightSwitch*>> projectors;
  for (LightSwitch* one : rig.switches()) projectors.push_back({one});
  return LightGuard::Start(std::move(projectors), &rig.interlock(), stop, {.clock = &rig.clock()});
}

}  // namespace stratalux::rig
