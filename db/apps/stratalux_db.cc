// SPDX-License-Identifier: Apache-2.0
// stratalux-db: the store's command line.
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/apps/extract.h"
#include "db/apps/session_views.h"
#include "db/interchange/import.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

constexpr const char* kExamples = R"(Examples:
  stratalux-db init --store store
  stratalux-db ls --store store
  stratalux-db show latest --json
  stratalux-db frames s000017 --phase sweep --projector 2
  stratalux-db frames latest --phase reference --extract pictures
  stratalux-db verify
  stratalux-db import --manifest procam_gray_kamino.toml --root captures --pose 2

SESSION is an id, a unique prefix of one, or 'latest'. Without --store, $STRATALUX_STORE names the store.
Exit codes: 0 ok, 1 failed, 2 usage, 4 not found, 5 store busy, 6 damaged, 7 store of a newer program.)";

struct Flags {
  std::string store, session;
  std::string phase, extract;
  std::optional<int> projector, pose;
  std::string manifest, root;
  bool json = false;
};

int Report(const Status& status) {
  std::fprintf(stderr, "stratalux-db: %s\n", status.message().c_str());
  return status.exit_code();
}

// Data go to stdout; a full pipe or disk must not pass for success.
int Print(const std::string& text) {
  if (std::fputs(text.c_str(), stdout) >= 0 && std::fflush(stdout) == 0) return 0;
  return Report(Status::Failed("cannot write the output"));
}

// A folder's name may be no UTF-8, which JSON is.
std::string TextOf(const nlohmann::ordered_json& json) {
  return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

int RunInit(const Flags& flags) {
  const Status status = SessionStore::Create(flags.store);
  if (!status.ok()) return Report(status);
  const nlohmann::ordered_json json = {{"store", flags.store}, {"schema", kSchemaVersion}};
  return Print(flags.json ? TextOf(json)
                          : "store " + flags.store + " is ready (schema " + std::to_string(kSchemaVersion) + ")\n");
}

int RunList(const SessionStore& store, const Flags& flags) {
  const auto sessions = ListWithFits(store);
  if (!sessions.ok()) return Report(sessions.status());
  return Print((flags.json ? SessionsAsJson : SessionsAsText)(*sessions));
}

int RunShow(const SessionStore& store, const Flags& flags) {
  const auto details = LoadDetails(store, flags.session);
  if (!details.ok()) return Report(details.status());
  return Print((flags.json ? DetailsAsJson : DetailsAsText)(*details));
}

int RunFrames(const SessionStore& store, const Flags& flags) {
  FrameFilter filter{{}, flags.projector};
  if (!flags.phase.empty()) {
    const auto phase = ParseCapturePhase(flags.phase);
    if (!phase.ok()) return Report(phase.status().WithContext("--phase"));
    filter.phase = *phase;
  }
  const auto session = store.FindSession(flags.session);
  if (!session.ok()) return Report(session.status());
  const auto all = store.ListFrames(session->info.id);
  if (!all.ok()) return Report(all.status());
  const auto frames = Filter(*all, filter);
  if (!flags.extract.empty()) {
    Logger logger;
    const Status status = ExtractFrames(store, session->info.id, frames, flags.extract, logger);
    if (!status.ok()) return Report(status);
  }
  return Print((flags.json ? FramesAsJson : FramesAsText)(frames));
}

int RunVerify(const SessionStore& store, const Flags& flags) {
  std::vector<SessionRow> sessions;
  if (flags.session.empty()) {
    auto all = store.ListSessions();
    if (!all.ok()) return Report(all.status());
    sessions = std::move(all).value();
  } else {
    const auto one = store.FindSession(flags.session);
    if (!one.ok()) return Report(one.status());
    sessions.push_back(*one);
  }
  Verified verified;
  bool sound = true;
  for (const SessionRow& session : sessions) {
    auto report = VerifySession(store, session);
    if (!report.ok()) return Report(report.status());
    sound = sound && report->problems.empty();
    verified.emplace_back(session.info.id, std::move(report).value());
  }
  const int printed = Print((flags.json ? VerifiedAsJson : VerifiedAsText)(verified));
  return sound ? printed : static_cast<int>(StatusCode::kIntegrity);
}

int RunImport(SessionStore& store, const Flags& flags) {
  Logger logger;
  const auto report = ImportSession(store, {flags.manifest, flags.root, flags.pose}, logger);
  if (!report.ok()) return Report(report.status());
  const nlohmann::ordered_json json = {{"session", report->session}, {"frames", report->frames}};
  return Print(flags.json ? TextOf(json)
                          : "session " + report->session + ": " + std::to_string(report->frames) + " frames\n");
}

struct Commands {
  CLI::App *init, *list, *show, *frames, *verify, *import;
};

Commands AddCommands(CLI::App& app, Flags& flags) {
  Commands c{};
  c.init = app.add_subcommand("init", "Make a store; leaves an existing one as it is");
  c.list = app.add_subcommand("ls", "List the sessions, newest first");
  c.show = app.add_subcommand("show", "Show one session");
  c.frames = app.add_subcommand("frames", "List the frames of a session with their proof; extract them as PNG");
  c.verify = app.add_subcommand("verify", "Read every byte of one session or of all and compare it with its hash");
  c.import = app.add_subcommand("import", "Store image files of another rig as a session");
  for (CLI::App* command : {c.init, c.list, c.show, c.frames, c.verify, c.import}) {
    command->add_option("--store", flags.store, "folder of the store (default: $STRATALUX_STORE)");
    command->add_flag("--json", flags.json, "print JSON");
    command->footer(kExamples);
  }
  c.show->add_option("SESSION", flags.session, "id, unique prefix, or latest")->required();
  c.frames->add_option("SESSION", flags.session, "id, unique prefix, or latest")->required();
  c.verify->add_option("SESSION", flags.session, "id, unique prefix, or latest (default: all)");
  c.frames->add_option("--phase", flags.phase, "this phase only: preroll, reference, correspondence, separation, ...");
  c.frames->add_option("--projector", flags.projector, "this projector only; -1: frames lit by all of them");
  c.frames->add_option("--extract", flags.extract, "write the frames to this folder as PNG (12-bit values << 4)");
  c.import->add_option("--manifest", flags.manifest, "TOML file (docs/file-formats.md)")->required();
  c.import->add_option("--root", flags.root, "folder of the image files (default: the manifest's)");
  c.import->add_option("--pose", flags.pose, "this pose only (default: all)");
  return c;
}

int Run(const Commands& commands, const Flags& flags) {
  if (flags.store.empty()) return Report(Status::Usage("no store given; use --store DIR or set STRATALUX_STORE"));
  if (commands.init->parsed()) return RunInit(flags);
  const bool writes = commands.import->parsed();
  auto store = SessionStore::Open(flags.store, writes ? AccessMode::kReadWrite : AccessMode::kReadOnly);
  if (!store.ok()) return Report(store.status());
  if (writes) return RunImport(*store, flags);
  if (commands.list->parsed()) return RunList(*store, flags);
  if (commands.show->parsed()) return RunShow(*store, flags);
  if (commands.frames->parsed()) return RunFrames(*store, flags);
  return RunVerify(*store, flags);
}

int Main(int argc, char** argv) {
  Flags flags;
  CLI::App app("Stratalux's session store: list, show, verify and import sessions");
  app.footer(kExamples);
  app.set_version_flag("--version", std::string("stratalux-db ") + kVersion);
  app.require_subcommand(1);
  const Commands commands = AddCommands(app, flags);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    // CLI11's own codes are not ours: any wrong flag is a usage error.
    return app.exit(error) == 0 ? 0 : static_cast<int>(StatusCode::kUsage);
  }
  if (const char* store = std::getenv("STRATALUX_STORE"); store != nullptr && flags.store.empty()) flags.store = store;
  return Run(commands, flags);
}

}  // namespace
}  // namespace stratalux::db

int main(int argc, char** argv) { return stratalux::db::Main(argc, argv); }
