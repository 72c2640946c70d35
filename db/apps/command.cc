// SPDX-License-Identifier: Apache-2.0
#include "db/apps/command.h"

#include <cstdio>
#include <cstdlib>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/apps/display_text.h"
#include "shared/base/log.h"
#include "shared/base/standard_output.h"

namespace stratalux::db {

CLI::App* Commands::Add(const std::string& name, const std::string& description, std::function<int()> run,
                        std::function<bool()> needs_store) {
  CLI::App* command = app_.add_subcommand(name, description);
  command->add_option("--store", flags_.store, "folder of the store (default: $STRATALUX_STORE)");
  command->add_flag("--json", flags_.json, "print JSON");
  entries_.push_back({command, std::move(run), std::move(needs_store)});
  return command;
}

int Commands::Run() {
  if (const char* store = std::getenv("STRATALUX_STORE"); store != nullptr && flags_.store.empty())
    flags_.store = store;
  for (const Entry& entry : entries_) {
    if (!entry.app->parsed()) continue;
    if (flags_.store.empty() && (!entry.needs_store || entry.needs_store()))
      return Report(Status::Usage("no store given; use --store DIR or set STRATALUX_STORE"));
    return entry.run();
  }
  return Report(Status::Usage("no command given; --help lists them"));
}

Result<SessionStore> OpenStore(const CommonFlags& flags, AccessMode mode) {
  auto store = SessionStore::Open(flags.store, mode);
  Logger logger;
  if (store.ok())
    for (const std::string& note : store->notes()) logger.Warning(note);
  return store;
}

std::string Examples(const std::vector<std::string>& commands, const std::string& notes) {
  std::string text = "Examples:";
  for (const std::string& command : commands) text += "\n  stratalux-db " + command;
  return notes.empty() ? text : text + "\n" + notes;
}

int Report(const Status& status) {
  Say(LogLevel::kError, "stratalux-db: " + status.message() + "\n");
  return status.exit_code();
}

int Print(const std::string& text) { return PrintBytes(PrintableLines(text)); }

int PrintBytes(const std::string& bytes) {
  const Status written = WriteStdout(bytes);
  return written.ok() ? 0 : Report(written);
}

std::string TextOf(const nlohmann::ordered_json& json) {
  return PrintableJson(json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace)) + "\n";
}

}  // namespace stratalux::db
