// SPDX-License-Identifier: Apache-2.0
#include "db/apps/crate_command.h"

#include <cstdio>

#include <nlohmann/json.hpp>

#include "db/interchange/crate_export.h"
#include "db/interchange/crate_import.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

// 0 for all, 2 for none, 3 for some.
int ExitCode(size_t done, size_t refused) {
  if (refused == 0) return 0;
  return static_cast<int>(done == 0 ? StatusCode::kUsage : StatusCode::kDegraded);
}

CrateOptions OptionsOf(const CrateFlags& flags) {
  CrateOptions options;
  options.out = flags.crate;
  options.frames = flags.frames == "png16" ? ExportFormat::kPng : ExportFormat::kTiff;
  options.scope = flags.scope == "research"      ? CrateScope::kResearch
                  : flags.scope == "publication" ? CrateScope::kPublication
                                                 : CrateScope::kNotStated;
  options.pseudonyms = flags.keep_pseudonym ? CratePseudonyms::kKept : CratePseudonyms::kFresh;
  options.title = flags.title;
  options.licence = flags.licence;
  return options;
}

}  // namespace

void AddCrateExportFlags(CLI::App* command, const std::vector<CLI::Option*>& others, CrateFlags& flags) {
  CLI::Option* crate =
      command->add_option("--crate", flags.crate, "write an RO-Crate of the sessions to this new folder");
  for (CLI::Option* other : others) crate->excludes(other);
  const std::vector<CLI::Option*> own = {
      command->add_option("--frames", flags.frames, "format of the crate's frames: tiff16 or png16")
          ->check(CLI::IsMember({"tiff16", "png16"})),
      command->add_option("--scope", flags.scope, "purpose of exporting visitors' sessions: research or publication")
          ->check(CLI::IsMember({"research", "publication"})),
      command->add_option("--title", flags.title, "name of the crate"),
      command->add_option("--licence,--license", flags.licence, "SPDX identifier of the licence, such as CC-BY-4.0"),
      command->add_flag("--keep-pseudonym", flags.keep_pseudonym,
                        "keep the store's pseudonyms; do not make new ones for this crate")};
  for (CLI::Option* option : own) option->needs(crate);
}

int RunCrateExport(const CommonFlags& common, const std::vector<std::string>& sessions, const CrateFlags& flags) {
  if (sessions.empty()) return Report(Status::Usage("export --crate needs sessions: ids, unique prefixes, or latest"));
  const auto store = OpenStore(common, AccessMode::kReadOnly);
  if (!store.ok()) return Report(store.status());
  std::vector<SessionRow> rows;
  for (const std::string& selector : sessions) {
    auto row = store->FindSession(selector);
    if (!row.ok()) return Report(row.status());
    rows.push_back(std::move(row).value());
  }
  Logger logger;
  const auto report = ExportCrate(*store, rows, OptionsOf(flags), logger);
  if (!report.ok()) return Report(report.status());
  Json refused = Json::array();
  std::string text;
  for (const auto& refusal : report->refused) {
    refused.push_back({{"session", refusal.session}, {"reason", refusal.reason}});
    logger.Warning("not exported: " + refusal.reason);
  }
  for (const std::string& note : report->notes) logger.Warning(note);
  const Json json = {{"crate", flags.crate},   {"sessions", report->sessions}, {"refused", refused},
                     {"notes", report->notes}, {"frames", report->frames},     {"files", report->files},
                     {"bytes", report->bytes}};
  text = report->sessions.empty() ? "nothing was written\n"
                                  : std::to_string(report->sessions.size()) + " session(s) in " + flags.crate + ": " +
                                        std::to_string(report->frames) + " frames, " + std::to_string(report->files) +
                                        " files, " + std::to_string(report->bytes / 1000) + " kB\n";
  const int printed = Print(common.json ? TextOf(json) : text);
  return printed != 0 ? printed : ExitCode(report->sessions.size(), report->refused.size());
}

int RunCrateImport(const CommonFlags& common, const std::string& crate) {
  const auto store = OpenStore(common, AccessMode::kReadWrite);
  if (!store.ok()) return Report(store.status());
  Logger logger;
  const auto report = ImportCrate(*store, crate, logger);
  if (!report.ok()) return Report(report.status());
  for (const std::string& id : report->forgotten)
    logger.Warning("session " + id + " was forgotten here and is not imported again (`stratalux-db deletions`)");
  const Json json = {{"crate", crate},
                     {"sessions", report->sessions},
                     {"present", report->present},
                     {"forgotten", report->forgotten},
                     {"frames", report->frames},
                     {"fits", report->fits}};
  std::string text = std::to_string(report->sessions.size()) + " session(s) imported with " +
                     std::to_string(report->frames) + " frames and " + std::to_string(report->fits) + " fits, " +
                     std::to_string(report->present.size()) + " here already, " +
                     std::to_string(report->forgotten.size()) + " forgotten here\n";
  for (const std::string& id : report->sessions) text += "  " + id + "\n";
  const int printed = Print(common.json ? TextOf(json) : text);
  return printed != 0 ? printed : ExitCode(report->sessions.size() + report->present.size(), report->forgotten.size());
}

}  // namespace stratalux::db
