// SPDX-License-Identifier: Apache-2.0
// `stratalux-db import|export|reindex|backup|restore|pull`: what comes into a store, leaves it or rebuilds it.
#include <memory>
#include <optional>

#include <nlohmann/json.hpp>

#include "db/apps/command.h"
#include "db/care/reindex.h"
#include "db/interchange/export.h"
#include "db/interchange/import.h"
#include "db/transfer/backup.h"
#include "db/transfer/pull.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

struct TransferFlags {
  std::string manifest, root;                           // import
  std::optional<int> pose;                              // import
  std::string session, visitor, phase, format = "png";  // export
  std::optional<int> projector;
  std::string out, to, keys, from;
  bool merge = false, dry_run = false;
};

int RunImport(const CommonFlags& common, const TransferFlags& flags) {
  auto store = OpenStore(common, AccessMode::kReadWrite);
  if (!store.ok()) return Report(store.status());
  Logger logger;
  const auto report = ImportSession(*store, {flags.manifest, flags.root, flags.pose}, logger);
  if (!report.ok()) return Report(report.status());
  const Json json = {{"session", report->session}, {"frames", report->frames}};
  return Print(common.json ? TextOf(json)
                           : "session " + report->session + ": " + std::to_string(report->frames) + " frames\n");
}

int RunExport(const CommonFlags& common, const TransferFlags& flags) {
  if (flags.session.empty() == flags.visitor.empty())
    return Report(Status::Usage("export needs either SESSION or --visitor"));
  ExportOptions options{
      flags.out, flags.format == "tiff" ? ExportFormat::kTiff : ExportFormat::kPng, {}, flags.projector};
  if (!flags.phase.empty()) {
    const auto phase = ParseCapturePhase(flags.phase);
    if (!phase.ok()) return Report(phase.status().WithContext("--phase"));
    options.phase = *phase;
  }
  const auto store = OpenStore(common, AccessMode::kReadOnly);
  if (!store.ok()) return Report(store.status());
  Logger logger;
  Result<ExportReport> report = Status::Ok();
  if (flags.visitor.empty()) {
    const auto session = store->FindSession(flags.session);
    if (!session.ok()) return Report(session.status());
    report = ExportSession(*store, *session, options, logger);
  } else {
    report = ExportVisitor(*store, flags.visitor, options, logger);
  }
  if (!report.ok()) return Report(report.status());
  const Json json = {
      {"out", flags.out}, {"sessions", report->sessions}, {"written", report->written}, {"kept", report->kept}};
  return Print(common.json ? TextOf(json)
                           : std::to_string(report->sessions) + " session(s) in " + flags.out + ": " +
                                 std::to_string(report->written) + " frames written, " + std::to_string(report->kept) +
                                 " there already\n");
}

std::string Lines(const char* what, const std::vector<std::string>& lines) {
  std::string text;
  for (const std::string& line : lines) text += std::string("  ") + what + ": " + line + "\n";
  return text;
}

int RunReindex(const CommonFlags& common) {
  Logger logger;
  const auto report = Reindex(common.store, logger);
  if (!report.ok()) return Report(report.status());
  const Json json = {{"sessions", report->sessions},   {"frames", report->frames},      {"fits", report->fits},
                     {"forgotten", report->forgotten}, {"kept", report->kept.string()}, {"notes", report->notes},
                     {"problems", report->problems}};
  std::string text = std::to_string(report->sessions) + " sessions, " + std::to_string(report->frames) + " frames, " +
                     std::to_string(report->fits) + " fits, " + std::to_string(report->forgotten) + " forgotten\n";
  if (!report->kept.empty()) text += "the old index is kept as " + report->kept.string() + "\n";
  text += Lines("note", report->notes) + Lines("problem", report->problems);
  const int printed = Print(common.json ? TextOf(json) : text);
  if (report->newer) return static_cast<int>(StatusCode::kNewerSchema);
  return report->problems.empty() ? printed : static_cast<int>(StatusCode::kIntegrity);
}

int RunBackup(const CommonFlags& common, const TransferFlags& flags) {
  Logger logger;
  const auto report = Backup(common.store, {flags.to, flags.keys}, logger);
  if (!report.ok()) return Report(report.status());
  const Json json = {{"to", flags.to},
                     {"sessions", report->sessions},
                     {"files_copied", report->files_copied},
                     {"bytes_copied", report->bytes_copied},
                     {"files_kept", report->files_kept},
                     {"files_removed", report->files_removed},
                     {"left_out", report->left_out}};
  return Print(common.json
                   ? TextOf(json)
                   : std::to_string(report->sessions) + " sessions in " + flags.to + ": " +
                         std::to_string(report->files_copied) + " files copied (" +
                         std::to_string(report->bytes_copied / 1000) + " kB), " + std::to_string(report->files_kept) +
                         " unchanged, " + std::to_string(report->files_removed) + " removed\n" +
                         Lines("still being written, left out", report->left_out));
}

int RunRestore(const CommonFlags& common, const TransferFlags& flags) {
  Logger logger;
  const auto report =
      Restore(flags.from, common.store, flags.merge ? RestoreInto::kMerge : RestoreInto::kNewStore, logger);
  if (!report.ok()) return Report(report.status());
  const Json json = {{"sessions", report->sessions},
                     {"files", report->files},
                     {"bytes", report->bytes},
                     {"forgotten", report->forgotten},
                     {"present", report->present}};
  return Print(common.json ? TextOf(json)
                           : std::to_string(report->sessions) + " sessions restored (" + std::to_string(report->files) +
                                 " files, " + std::to_string(report->bytes / 1000) + " kB), " +
                                 std::to_string(report->present) + " there already, " +
                                 std::to_string(report->forgotten) + " forgotten ones left out\n");
}

int RunPull(const CommonFlags& common, const TransferFlags& flags) {
  Logger logger;
  const auto report = Pull(common.store, flags.from, flags.dry_run ? PullMode::kDryRun : PullMode::kCopy, logger);
  if (!report.ok()) return Report(report.status());
  const Json json = {{"from", flags.from},
                     {"dry_run", flags.dry_run},
                     {"sessions", report->sessions},
                     {"frames", report->frames},
                     {"present", report->present},
                     {"unfinished", report->unfinished},
                     {"forgotten", report->forgotten},
                     {"problems", report->problems}};
  std::string text = std::to_string(report->sessions.size()) +
                     (flags.dry_run ? " sessions to pull, " : " sessions pulled, ") + std::to_string(report->present) +
                     " here already, " + std::to_string(report->unfinished) + " unfinished or failed, " +
                     std::to_string(report->forgotten) + " forgotten\n";
  for (const std::string& id : report->sessions) text += "  " + id + "\n";
  text += Lines("problem", report->problems);
  const int printed = Print(common.json ? TextOf(json) : text);
  return report->problems.empty() ? printed : static_cast<int>(StatusCode::kIntegrity);
}

}  // namespace

void AddTransferCommands(Commands& commands) {
  const auto flags = std::make_shared<TransferFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* import = commands.Add("import", "Store image files of another rig as a session (PNG, TIFF, TGA, PGM/PPM)",
                                  [&common, flags] { return RunImport(common, *flags); });
  import->add_option("--manifest", flags->manifest, "TOML file (docs/file-formats.md)")->required();
  import->add_option("--root", flags->root, "folder of the image files (default: the manifest's)");
  import->add_option("--pose", flags->pose, "this pose only (default: all)");

  CLI::App* exported = commands.Add("export", "Write a session, or all of one visitor, as image files with their proof",
                                    [&common, flags] { return RunExport(common, *flags); });
  exported->add_option("SESSION", flags->session, "id, unique prefix, or latest");
  exported->add_option("--visitor", flags->visitor, "all sessions, consents and fits of this pseudonym");
  exported->add_option("--out", flags->out, "a new folder, or that of an interrupted export")->required();
  exported->add_option("--format", flags->format, "png or tiff")->check(CLI::IsMember({"png", "tiff"}));
  exported->add_option("--phase", flags->phase, "this phase only");
  exported->add_option("--projector", flags->projector, "this projector only");

  commands.Add("reindex", "Build the index again from segments, manifests, fits and tombstones",
               [&common] { return RunReindex(common); });
  CLI::App* backup = commands.Add("backup", "Copy what is new to a backup; while sessions are written, too",
                                  [&common, flags] { return RunBackup(common, *flags); });
  backup->add_option("--to", flags->to, "a folder of its own, best on another disk")->required();
  backup->add_option("--keys", flags->keys, "copy keys.sqlite to this file, apart from the backup");
  CLI::App* restore = commands.Add("restore", "Make a store from a backup, every file checked against its hash",
                                   [&common, flags] { return RunRestore(common, *flags); });
  restore->add_option("--from", flags->from, "folder of the backup")->required();
  restore->add_flag("--merge", flags->merge, "into an existing store: adds the sessions that it lacks");
  CLI::App* pull = commands.Add("pull", "Fetch the finished sessions of a rig over rsync and ssh",
                                [&common, flags] { return RunPull(common, *flags); });
  pull->add_option("--from", flags->from, "user@host:/path/of/store, or a local path")->required();
  pull->add_flag("--dry-run", flags->dry_run, "say what would come");
}

}  // namespace stratalux::db
