// SPDX-License-Identifier: Apache-2.0
// `stratalux-db import|export|reindex|backup|restore|pull`: what comes into a store, leaves it or rebuilds it.
#include <memory>
#include <optional>

#include <nlohmann/json.hpp>

#include "db/apps/command.h"
#include "db/apps/crate_command.h"
#include "db/care/reindex.h"
#include "db/interchange/export.h"
#include "db/interchange/import.h"
#include "db/transfer/backup.h"
#include "db/transfer/pull.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

struct TransferFlags {
  std::string manifest, root, crate;           // import
  std::optional<int> pose;                     // import
  std::vector<std::string> sessions;           // export
  std::string visitor, phase, format = "png";  // export
  CrateFlags crate_export;
  std::optional<int> projector;
  std::string out, to, keys, from;
  std::vector<std::string> sources;    // pull
  std::string scrub = "turn", ledger;  // backup; restore
  int timeout_s = 60, limit_min = 0;   // pull
  bool merge = false, dry_run = false, obey = false;
};

int RunImport(const CommonFlags& common, const TransferFlags& flags) {
  if (!flags.crate.empty()) return RunCrateImport(common, flags.crate);
  if (flags.manifest.empty())
    return Report(Status::Usage("import needs --manifest FILE (image files) or --crate DIR (an RO-Crate)"));
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
  if (!flags.crate_export.crate.empty()) return RunCrateExport(common, flags.sessions, flags.crate_export);
  if (flags.sessions.empty() == flags.visitor.empty())
    return Report(Status::Usage("export needs either SESSION or --visitor"));
  if (flags.sessions.size() > 1) return Report(Status::Usage("several sessions can be exported only with --crate"));
  if (flags.out.empty()) return Report(Status::Usage("export needs --out DIR, or --crate DIR for an RO-Crate"));
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
    const auto session = store->FindSession(flags.sessions[0]);
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

// What is partly done says so: the list names what is missing.
int Ending(int printed, const std::vector<std::string>& problems) {
  return problems.empty() || printed != 0 ? printed : static_cast<int>(StatusCode::kDegraded);
}

int RunBackup(const CommonFlags& common, const TransferFlags& flags) {
  Logger logger;
  const auto report = Backup(
      common.store, {flags.to, flags.keys, flags.scrub == "all" ? ScrubShare::kAll : ScrubShare::kInTurn}, logger);
  if (!report.ok()) return Report(report.status());
  const Json json = {{"to", flags.to},
                     {"sessions", report->sessions},
                     {"files_copied", report->files_copied},
                     {"bytes_copied", report->bytes_copied},
                     {"files_kept", report->files_kept},
                     {"files_continued", report->files_continued},
                     {"files_removed", report->files_removed},
                     {"files_reread", report->files_reread},
                     {"mended", report->mended},
                     {"left_out", report->left_out},
                     {"problems", report->problems}};
  const std::string text = std::to_string(report->sessions) + " sessions in " + flags.to + ": " +
                           std::to_string(report->files_copied) + " files copied (" +
                           std::to_string(report->bytes_copied / 1000) + " kB), " +
                           std::to_string(report->files_kept + report->files_continued) + " unchanged, " +
                           std::to_string(report->files_removed) + " removed, " + std::to_string(report->files_reread) +
                           " copies reread\n" + Lines("still being written, left out", report->left_out) +
                           Lines("damaged copy replaced", report->mended) + Lines("problem", report->problems);
  return Ending(Print(common.json ? TextOf(json) : text), report->problems);
}

int RunRestore(const CommonFlags& common, const TransferFlags& flags) {
  Logger logger;
  const auto report = Restore(flags.from, common.store,
                              {flags.merge ? RestoreInto::kMerge : RestoreInto::kNewStore, flags.ledger}, logger);
  if (!report.ok()) return Report(report.status());
  const Json json = {{"sessions", report->sessions}, {"files", report->files},
                     {"bytes", report->bytes},       {"forgotten", report->forgotten},
                     {"present", report->present},   {"withdrawals", report->withdrawals},
                     {"notes", report->notes},       {"problems", report->problems}};
  const std::string text = std::to_string(report->sessions) + " sessions restored (" + std::to_string(report->files) +
                           " files, " + std::to_string(report->bytes / 1000) + " kB), " +
                           std::to_string(report->present) + " there already, " + std::to_string(report->forgotten) +
                           " forgotten ones left out, " + std::to_string(report->withdrawals) +
                           " consents withdrawn\n" + Lines("note", report->notes) + Lines("problem", report->problems);
  return Ending(Print(common.json ? TextOf(json) : text), report->problems);
}

std::string PullText(const PullReport& report, bool dry_run) {
  std::string text = std::to_string(report.sessions.size()) + (dry_run ? " sessions to pull, " : " sessions pulled, ") +
                     std::to_string(report.fits.size()) + " later fits, " + std::to_string(report.present) +
                     " here already, " + std::to_string(report.unfinished) + " unfinished or failed, " +
                     std::to_string(report.forgotten) + " forgotten\n";
  for (const std::string& id : report.sessions) text += "  " + id + "\n";
  if (report.withdrawals != 0)
    text += "  " + std::to_string(report.withdrawals) + " consents withdrawn, as the source's ledger says\n";
  if (report.keys != 0) text += "  " + std::to_string(report.keys) + " sealed keys of sessions that were here before\n";
  return text + Lines("fit", report.fits) + Lines("forgotten here, as at the source", report.obeyed) +
         Lines("wiped", report.wiped) + Lines("note", report.notes) + Lines("problem", report.problems);
}

Json JsonOf(const PullReport& report) {
  return {{"sessions", report.sessions},
          {"fits", report.fits},
          {"keys", report.keys},
          {"frames", report.frames},
          {"present", report.present},
          {"unfinished", report.unfinished},
          {"forgotten", report.forgotten},
          {"ledger_entries", report.ledger_entries},
          {"withdrawals", report.withdrawals},
          {"obeyed", report.obeyed},
          {"wiped", report.wiped},
          {"notes", report.notes},
          {"problems", report.problems}};
}

// Where some came and others did not, that is a part; where none did, why the first did not.
int CodeOf(const std::vector<SourcePull>& pulls) {
  bool whole = true, none = true;
  for (const SourcePull& pull : pulls) {
    whole = whole && pull.status.ok() && pull.report.problems.empty();
    none = none && !pull.status.ok();
  }
  return whole ? 0 : none ? pulls[0].status.exit_code() : static_cast<int>(StatusCode::kDegraded);
}

int RunPull(const CommonFlags& common, const TransferFlags& flags) {
  Logger logger;
  const PullOptions options{flags.dry_run ? PullMode::kDryRun : PullMode::kCopy,
                            flags.obey ? ForgottenElsewhere::kForget : ForgottenElsewhere::kName,
                            std::chrono::seconds(flags.timeout_s), std::chrono::minutes(flags.limit_min)};
  const auto pulls = PullAll(common.store, flags.sources, options, logger);
  if (!pulls.ok()) return Report(pulls.status());
  const SourcePull& first = pulls->front();
  const bool single = pulls->size() == 1;
  if (single && !first.status.ok() && first.status.code() != StatusCode::kTryAgain) return Report(first.status);
  Json sources = Json::array();
  std::string text;
  for (const SourcePull& pull : *pulls) {
    Json json = {{"from", pull.from}, {"dry_run", flags.dry_run}};
    if (!single || !pull.status.ok())
      json.update({{"code", pull.status.exit_code()}, {"error", pull.status.message()}});
    json.update(JsonOf(pull.report));
    sources.push_back(std::move(json));
    if (!single) text += pull.from + ": ";
    if (!pull.status.ok()) text += "stopped: " + pull.status.message() + "\n" + (single ? "" : "  ");
    text += PullText(pull.report, flags.dry_run);
  }
  const int printed = Print(common.json ? TextOf(single ? sources[0] : Json{{"sources", sources}}) : text);
  return printed != 0 ? printed : CodeOf(*pulls);
}

}  // namespace

void AddTransferCommands(Commands& commands) {
  const auto flags = std::make_shared<TransferFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* import =
      commands.Add("import", "Store image files of another rig as a session (PNG, TIFF, TGA, PGM/PPM); or an RO-Crate",
                   [&common, flags] { return RunImport(common, *flags); });
  import->footer(Examples({"import --manifest procam_gray_kamino.toml --root captures --pose 2",
                           "import --manifest export/import.toml", "import --crate crate"},
                          "A manifest may have at most 16 MiB, a picture at most 1 GiB and 268435456 pixels."));
  CLI::Option* manifest = import->add_option("--manifest", flags->manifest, "TOML file (docs/file-formats.md)");
  import->add_option("--crate", flags->crate, "an RO-Crate that `export --crate` wrote")->excludes(manifest);
  import->add_option("--root", flags->root, "folder of the image files (default: the manifest's)");
  import->add_option("--pose", flags->pose, "this pose only (default: all)");

  CLI::App* exported =
      commands.Add("export", "Write a session, or all of one visitor, as image files with their proof; or an RO-Crate",
                   [&common, flags] { return RunExport(common, *flags); });
  exported->footer(Examples({"export latest --out pictures --format tiff", "export s000017 --out sweep --phase sweep",
                             "export --visitor v-5f3a91c2 --out for-v-5f3a91c2",
                             "export s000017 s000018 --crate crate --scope research"}));
  exported->add_option("SESSION", flags->sessions, "id, unique prefix, or latest; several with --crate");
  const std::vector<CLI::Option*> plain = {
      exported->add_option("--visitor", flags->visitor, "all sessions, consents and fits of this pseudonym"),
      exported->add_option("--out", flags->out, "a new folder, or the folder of an interrupted export"),
      exported->add_option("--format", flags->format, "png or tiff")->check(CLI::IsMember({"png", "tiff"})),
      exported->add_option("--phase", flags->phase, "this phase only"),
      exported->add_option("--projector", flags->projector, "this projector only")};
  AddCrateExportFlags(exported, plain, flags->crate_export);

  CLI::App* reindex = commands.Add("reindex", "Build the index again from segments, manifests, fits and ledger",
                                   [&common] { return RunReindex(common); });
  reindex->footer(Examples({"reindex", "reindex --json"}));
  CLI::App* backup = commands.Add("backup", "Copy what is new to a backup, even while sessions are being written",
                                  [&common, flags] { return RunBackup(common, *flags); });
  backup->footer(Examples({"backup --to /media/disk/store-backup",
                           "backup --to /media/disk/store-backup --keys /media/stick/keys.sqlite"}));
  backup->add_option("--to", flags->to, "a separate folder, preferably on another disk")->required();
  backup->add_option("--keys", flags->keys, "copy keys.sqlite to this file, separate from the backup");
  backup
      ->add_option("--scrub", flags->scrub,
                   "copies of earlier backups to read again: turn (the eighth unread for longest; default) or all")
      ->check(CLI::IsMember({"turn", "all"}));
  CLI::App* restore = commands.Add("restore", "Make a store from a backup, checking every file against its hash",
                                   [&common, flags] { return RunRestore(common, *flags); });
  restore->footer(Examples({"restore --from /media/disk/store-backup --store new-store --ledger store",
                            "restore --from /media/disk/store-backup --merge"}));
  restore->add_option("--from", flags->from, "folder of the backup")->required();
  restore->add_flag("--merge", flags->merge, "into an existing store: adds the sessions that it lacks");
  restore->add_option(
      "--ledger", flags->ledger,
      "required for a new store: the newest ledger (a store, its ledger folder, another backup), or none");
  CLI::App* pull = commands.Add("pull", "Fetch the finished sessions of rigs over rsync and ssh",
                                [&common, flags] { return RunPull(common, *flags); });
  pull->footer(
      Examples({"pull --from kiosk@rig-1:/var/lib/stratalux/store",
                "pull --store archive --from kiosk@rig-1:/var/lib/stratalux/store --dry-run",
                "pull --from kiosk@rig-1:/var/lib/stratalux/store --obey",
                "pull --from kiosk@rig-1:store kiosk@rig-2:store --limit 40"},
               "Exit code 3: something was not fetched, or one of several sources failed; 75: --limit ran out."));
  pull->add_option("--from", flags->sources,
                   "user@host:/path/of/store, or a local path; several are pulled in parallel")
      ->required()
      ->expected(1, -1);
  pull->add_flag("--dry-run", flags->dry_run, "show what would be fetched");
  pull->add_flag("--obey", flags->obey, "forget what is still here but was forgotten at the source");
  pull->add_option("--timeout", flags->timeout_s, "give up on a source after this many seconds without data")
      ->check(CLI::Range(1, 86400));
  pull->add_option("--limit", flags->limit_min,
                   "time limit for each source, minutes; the next pull continues (default: none)")
      ->check(CLI::Range(1, 10080));
}

}  // namespace stratalux::db
