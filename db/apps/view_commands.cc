// SPDX-License-Identifier: Apache-2.0
// `stratalux-db init|show|frames|verify`.
#include <filesystem>
#include <memory>
#include <optional>

#include <nlohmann/json.hpp>

#include "db/apps/command.h"
#include "db/apps/extract.h"
#include "db/apps/session_views.h"

namespace stratalux::db {
namespace {

struct ViewFlags {
  std::string session, phase, extract, public_key;
  std::optional<int> projector;
  bool deep = false;
};

// What file systems and desktops put into a folder by themselves.
bool IsOfTheFileSystem(const std::string& name) {
  if (name == "lost+found" || name == ".snapshot" || name == ".snapshots" || name == ".zfs") return true;
  return name.starts_with(".Trash") || name.starts_with(".nfs");
}

// A store takes a folder for itself: in one that holds other things it would be lost, and be cleaned away with them.
Status RefuseForeignFolder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::directory_iterator entries(folder, error);
  if (error) return Status::Ok();  // not there yet, or no folder: making it says why
  for (const char* own : {"index.sqlite", "sessions"})
    if (std::filesystem::exists(folder / own, error)) return Status::Ok();
  for (; entries != std::filesystem::directory_iterator(); entries.increment(error)) {
    const std::string name = entries->path().filename().string();
    if (!IsOfTheFileSystem(name))
      return Status::Usage(folder.string() + " holds other things ('" + name + "'" +
                           "); a store needs a folder of its own, such as `stratalux-db init --store " +
                           (folder / "store").string() + "`");
    if (error) return Status::Failed("cannot read folder " + folder.string() + ": " + error.message());
  }
  return Status::Ok();
}

int RunInit(const CommonFlags& common) {
  if (const Status own = RefuseForeignFolder(common.store); !own.ok()) return Report(own);
  const Status status = SessionStore::Create(common.store);
  if (!status.ok()) return Report(status);
  const nlohmann::ordered_json json = {{"store", common.store}, {"schema", kSchemaVersion}};
  return Print(common.json ? TextOf(json)
                           : "store " + common.store + " is ready (schema " + std::to_string(kSchemaVersion) + ")\n");
}

int RunShow(const CommonFlags& common, const ViewFlags& flags) {
  const auto store = OpenStore(common, AccessMode::kReadOnly);
  if (!store.ok()) return Report(store.status());
  const auto details = LoadDetails(*store, flags.session);
  if (!details.ok()) return Report(details.status());
  return Print((common.json ? DetailsAsJson : DetailsAsText)(*details));
}

int RunFrames(const CommonFlags& common, const ViewFlags& flags) {
  FrameFilter filter{{}, flags.projector};
  if (!flags.phase.empty()) {
    const auto phase = ParseCapturePhase(flags.phase);
    if (!phase.ok()) return Report(phase.status().WithContext("--phase"));
    filter.phase = *phase;
  }
  const auto store = OpenStore(common, AccessMode::kReadOnly);
  if (!store.ok()) return Report(store.status());
  const auto session = store->FindSession(flags.session);
  if (!session.ok()) return Report(session.status());
  const auto all = store->ListFrames(session->info.id);
  if (!all.ok()) return Report(all.status());
  const auto frames = Filter(*all, filter);
  if (!flags.extract.empty()) {
    Logger logger;
    const Status status = ExtractFrames(*store, session->info.id, frames, flags.extract, logger);
    if (!status.ok()) return Report(status);
  }
  return Print((common.json ? FramesAsJson : FramesAsText)(frames));
}

// What may have been forgotten since it was listed.
Result<VerifyReport> VerifyNow(const SessionStore& store, const std::string& id, const VerifyOptions& options) {
  VerifyReport none;
  const auto row = store.FindSession(id);
  if (row.status().code() == StatusCode::kNotFound) {
    none.notes.push_back(row.status().message());
    return none;
  }
  auto report = row.ok() ? VerifySession(store, *row, options) : Result<VerifyReport>(row.status());
  if (report.ok()) return report;
  none.problems.push_back(report.status().message());
  return none;
}

int RunVerify(const CommonFlags& common, const ViewFlags& flags) {
  VerifyOptions options{flags.deep ? VerifyDepth::kDeep : VerifyDepth::kHeaders};
  if (!flags.public_key.empty()) {
    const auto key = ParsePublicKey(flags.public_key);
    if (!key.ok()) return Report(key.status().WithContext("--public-key"));
    options.signed_by = *key;
  }
  const auto store = OpenStore(common, AccessMode::kReadOnly);
  if (!store.ok()) return Report(store.status());
  std::vector<SessionSummary> sessions;
  if (flags.session.empty()) {
    auto all = store->ListSessions();
    if (!all.ok()) return Report(all.status());
    sessions = std::move(all).value();
  } else {
    const auto one = store->FindSession(flags.session);
    if (!one.ok()) return Report(one.status());
    sessions.push_back(*one);
  }
  Logger logger;
  int64_t frames = 0;
  for (const SessionSummary& session : sessions) frames += session.frames;
  Verified verified;
  bool sound = true;
  {
    Progress progress(logger, "verify", frames);
    options.progress = &progress;
    auto add = [&](const std::string& name, Result<VerifyReport> report) {
      sound = sound && report->problems.empty();
      verified.emplace_back(name, std::move(report).value());
    };
    if (flags.session.empty()) {
      auto report = VerifyStore(*store, options);
      if (!report.ok()) return Report(report.status());
      if (!report->problems.empty() || !report->notes.empty()) add("store", std::move(report));
    }
    // One that cannot be looked at is a finding among the others'.
    for (const SessionSummary& session : sessions) add(session.info.id, VerifyNow(*store, session.info.id, options));
  }
  if (verified.empty() && !common.json) return Print("store: ok, no sessions\n");
  const int printed = Print((common.json ? VerifiedAsJson : VerifiedAsText)(verified));
  return sound ? printed : static_cast<int>(StatusCode::kIntegrity);
}

}  // namespace

void AddViewCommands(Commands& commands) {
  const auto flags = std::make_shared<ViewFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* init =
      commands.Add("init", "Make a store; leaves an existing one as it is", [&common] { return RunInit(common); });
  init->footer(Examples({"init --store store"},
                        "The folder must be new, empty or a store; other than that, only lost+found, .Trash*, .nfs*,\n"
                        ".snapshot, .snapshots and .zfs may lie in it."));
  CLI::App* show = commands.Add("show", "Show one session", [&common, flags] { return RunShow(common, *flags); });
  CLI::App* frames = commands.Add("frames", "List the frames of a session with their proof; extract them as PNG",
                                  [&common, flags] { return RunFrames(common, *flags); });
  CLI::App* verify =
      commands.Add("verify", "Rebuild each session in memory and compare it with the index; --deep decodes every frame",
                   [&common, flags] { return RunVerify(common, *flags); });
  show->footer(Examples({"show latest", "show s000017 --json"}));
  frames->footer(Examples({"frames latest --phase sweep --projector 2",
                           "frames latest --phase reference --extract pictures", "frames s000017 --json"}));
  verify->footer(Examples({"verify", "verify --deep", "verify latest --deep --json"},
                          "Exit code 6: something is damaged; each problem is named."));
  show->add_option("SESSION", flags->session, "id, unique prefix, or latest")->required();
  frames->add_option("SESSION", flags->session, "id, unique prefix, or latest")->required();
  verify->add_option("SESSION", flags->session, "id, unique prefix, or latest (default: all, and the store itself)");
  verify->add_flag("--deep", flags->deep,
                   "also decode every frame: check pixel hash, complementary patterns, signature; open sealed files");
  verify->add_option("--public-key", flags->public_key,
                     "each session must be signed by this key: 64 hex digits, or a file that holds them");
  frames->add_option("--phase", flags->phase, "this phase only: preroll, reference, correspondence, separation, ...");
  frames->add_option("--projector", flags->projector, "this projector only; -1: frames lit by all of them");
  frames->add_option("--extract", flags->extract, "write the frames to this folder as PNG (12-bit values << 4)");
}

}  // namespace stratalux::db
