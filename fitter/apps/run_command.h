// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit run`, one verb a stage, and `report`.
#pragma once

namespace CLI {
class App;
}

namespace stratalux::fit {

// Registers the verbs; the chosen one stores its exit code.
void AddRunCommands(CLI::App& app, int& exit_code);
void AddRenderCommand(CLI::App& app, int& exit_code);
void AddProfilesCommand(CLI::App& app, int& exit_code);
void AddDecodeCommand(CLI::App& app, int& exit_code);
void AddCalibrateCommand(CLI::App& app, int& exit_code);

}  // namespace stratalux::fit
