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

  // A command with --store and --json; `run` gives the exit code. Give it examples of its own: Examples().
  // `needs_store`: asked when it runs, for a command some of whose verbs touch no store; empty: it does.
  CLI::App* Add(const std::string& name, const std::string& description, std::function<int()> run,
                std::function<bool()> needs_store = {});
  [[nodiscard]] const CommonFlags& flags() const { return flags_; }
  // Of the command that was parsed.
  int Run();

 private:
  struct Entry {
    CLI::App* app;
    std::function<int()> run;
    std::function<bool()> needs_store;
  };
  CLI::App& app_;
  CommonFlags flags_;
  std::vector<Entry> entries_;
};

// Each keeps its own flags alive as long as its commands.
void AddViewCommands(Commands& commands);      // init, show, frames, verify
void AddQueryCommands(Commands& commands);     // ls, query, sql
void AddStatsCommand(Commands& commands);      // stats
void AddPrivacyCommands(Commands& commands);   // consent, access
void AddKeyCommand(Commands& commands);        // key
void AddForgetCommands(Commands& commands);    // forget, purge, deletions
void AddTransferCommands(Commands& commands);  // import
void AddTranscodeCommand(Commands& commands);
// --crate and what belongs to it; `others` are the options of an export into plain files, which exclude it.
struct CrateFlags;
void AddCrateExportFlags(CLI::App* command, const std::vector<CLI::Option*>& others, CrateFlags& flags);
void AddServeCommand(Commands& commands);

// The store of --store; what opening it mended or could not goes to stderr as warnings.
Result<SessionStore> OpenStore(const CommonFlags& flags, AccessMode mode);

// The end of a command's --help: "Examples:", each behind "stratalux-db ", then `notes` on lines of their own.
[[nodiscard]] std::string Examples(const std::vector<std::string>& commands, const std::string& notes = "");

// Prints to stderr, with what would steer a terminal written out; the status's exit code.
int Report(const Status& status);
// Data go to stdout; a full pipe or disk must not pass for success. What would steer a terminal is written out (JSON of
// TextOf holds nothing of the kind).
int Print(const std::string& text);
// Byte by byte: CSV.
int PrintBytes(const std::string& bytes);
// Two spaces of indent and a newline; what is no UTF-8 is replaced, what would steer a terminal escaped.
[[nodiscard]] std::string TextOf(const nlohmann::ordered_json& json);

}  // namespace stratalux::db
