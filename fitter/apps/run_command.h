// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit run`, one verb a stage, and `report`.
#pragma once

#include <string>

namespace CLI {
class App;
}

namespace stratalux::fit {

// What whoever writes plain files of an encrypted session says, once.
[[nodiscard]] std::string PlainCopyNote(const std::string& session, const std::string& folder);

// Registers the verbs; the chosen one stores its exit code.
void AddRunCommands(CLI::App& app, int& exit_code);
void AddBatchCommands(CLI::App& app, int& exit_code);
void AddRenderCommand(CLI::App& app, int& exit_code);
void AddExportCommand(CLI::App& app, int& exit_code);
void AddProfilesCommand(CLI::App& app, int& exit_code);
void AddDecodeCommand(CLI::App& app, int& exit_code);
void AddModulationCommand(CLI::App& app, int& exit_code);
void AddCloudCommand(CLI::App& app, int& exit_code);
void AddCalibrateCommand(CLI::App& app, int& exit_code);

}  // namespace stratalux::fit
