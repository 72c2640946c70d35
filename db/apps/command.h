// SPDX-License-Identifier: Apache-2.0
// The frame of `stratalux-db`: each verb group adds its commands here; main parses and runs the one that was given.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json_fwd.hpp>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

// Flags that every command has.
struct CommonFlags {
  std::string store;  // --store, else $STRATALUX_STORE
  bool json = false;
};

class Commands {
 public:
  explicit Commands(CLI::App& app) : app_(app) {}

  // A command with --store and --json; `run` gives the exit code.
  CLI::App* Add(const std::string& name, const std::string& description, std::function<int()> run);
  [[nodiscard]] const CommonFlags& flags() const { return flags_; }
  // Of the command that was parsed.
  int Run();

 private:
  struct Entry {
    CLI::App* app;
    std::function<int()> run;
  };
  CLI::App& app_;
  CommonFlags flags_;
  std::vector<Entry> entries_;
};

// Each keeps its own flags alive as long as its commands.
void AddViewCommands(Commands& commands);      // init, show, frames, verify
void AddQueryCommands(Commands& commands);     // ls, query, sql
void AddStatsCommand(Commands& commands);      // stats
void AddPrivacyCommands(Commands& commands);   // consent, access, key
void AddForgetCommands(Commands& commands);    // forget, purge, deletions
void AddTransferCommands(Commands& commands);  // import
void AddTranscodeCommand(Commands& commands);
void AddServeCommand(Commands& commands);

// The store of --store; what opening it mended or could not goes to stderr as warnings.
Result<SessionStore> OpenStore(const CommonFlags& flags, AccessMode mode);

// Prints to stderr; the status's exit code.
int Report(const Status& status);
// Data go to stdout; a full pipe or disk must not pass for success.
int Print(const std::string& text);
// Two spaces of indent and a newline; what is no UTF-8 is replaced.
[[nodiscard]] std::string TextOf(const nlohmann::ordered_json& json);

}  // namespace stratalux::db
