// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/simulation_file.h"

#include <filesystem>

#include "shared/config/toml_reader.h"

namespace stratalux::rig {

Result<Simulation> LoadSimulation(const std::string& name_or_file) {
  Simulation simulation;
  if (!name_or_file.ends_with(".toml")) {
    SLX_ASSIGN_OR_RETURN(simulation.scene, SceneOfName(name_or_file));
    return simulation;
  }
  SLX_ASSIGN_OR_RETURN(auto root, TomlTable::ParseFile(name_or_file));
  SLX_ASSIGN_OR_RETURN(simulation.scene, ReadScene(root));
  SLX_ASSIGN_OR_RETURN(simulation.devices, ReadDevices(root));
  SLX_ASSIGN_OR_RETURN(simulation.faults, ReadFaults(root));
  SLX_RETURN_IF_ERROR(root.Finish());
  if (!root.Has("name")) simulation.scene.name = std::filesystem::path(name_or_file).stem().string();
  // Names of other files are meant from where the scene lies.
  for (std::string* named : {&simulation.scene.mesh.file, &simulation.scene.mesh.albedo})
    if (!named->empty()) *named = (std::filesystem::path(name_or_file).parent_path() / *named).string();
  SLX_RETURN_IF_ERROR(simulation.scene.Validate().WithContext(name_or_file));
  return simulation;
}

}  // namespace stratalux::rig
