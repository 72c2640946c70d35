// SPDX-License-Identifier: Apache-2.0
// `stratalux-db transcode`: frames of finished sessions coded anew.
#include <cstdio>
#include <memory>

#include <nlohmann/json.hpp>

#include "db/apps/command.h"
#include "db/care/transcode.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

struct TranscodeFlags {
  std::string session, codec;
  bool all = false;
};

struct Transcoded {
  std::string session;
  TranscodeReport report;
};

Result<std::vector<SessionSummary>> Selected(const SessionStore& store, const TranscodeFlags& flags) {
  if (flags.all == !flags.session.empty()) return Status::Usage("give a SESSION or --all");
  if (flags.all) return store.ListSessions();
  SLX_ASSIGN_OR_RETURN(auto row, store.FindSession(flags.session));
  return std::vector<SessionSummary>{std::move(row)};
}

std::string AsText(const std::vector<Transcoded>& done) {
  std::string text = "session           frames  rewritten  MiB before   MiB after\n";
  char line[160];
  constexpr double kMiB = 1024.0 * 1024.0;
  for (const auto& [session, r] : done) {
    std::snprintf(line, sizeof line, "%-16s  %6lld  %9lld  %10.1f  %10.1f\n", session.c_str(),
                  static_cast<long long>(r.frames), static_cast<long long>(r.changed),
                  static_cast<double>(r.bytes_before) / kMiB, static_cast<double>(r.bytes_after) / kMiB);
    text += line;
  }
  return text;
}

std::string AsJson(const std::vector<Transcoded>& done, const std::string& codec) {
  Json json = Json::array();
  for (const auto& [session, r] : done)
    json.push_back({{"session", session},
                    {"codec", codec},
                    {"frames", r.frames},
                    {"rewritten", r.changed},
                    {"bytes_before", r.bytes_before},
                    {"bytes_after", r.bytes_after}});
  return TextOf(json);
}

int RunTranscode(const CommonFlags& common, const TranscodeFlags& flags) {
  TranscodeOptions options;
  const auto codec = ParseStoreCodec(flags.codec);
  if (!codec.ok()) return Report(codec.status().WithContext("--codec"));
  options.codec = *codec;
  const auto store = SessionStore::Open(common.store, AccessMode::kReadWrite);
  if (!store.ok()) return Report(store.status());
  const auto sessions = Selected(*store, flags);
  if (!sessions.ok()) return Report(sessions.status());
  int64_t steps = 0;
  for (const SessionSummary& session : *sessions) steps += 2 * session.frames;  // written, then compared
  std::vector<Transcoded> done;
  int exit_code = 0;
  {
    Logger logger;
    Progress progress(logger, "transcode", steps);
    for (const SessionSummary& session : *sessions) {
      const auto row = store->FindSession(session.info.id);
      const auto report =
          row.ok() ? TranscodeSession(*store, *row, options, progress) : Result<TranscodeReport>(row.status());
      if (report.ok()) {
        done.push_back({session.info.id, *report});
      } else {
        const int code = Report(report.status());  // the others are transcoded all the same
        exit_code = flags.all ? static_cast<int>(StatusCode::kDegraded) : code;
      }
    }
  }
  if (done.empty() && exit_code != 0 && !common.json) return exit_code;
  const int printed = Print(common.json ? AsJson(done, flags.codec) : AsText(done));
  return exit_code != 0 ? exit_code : printed;
}

}  // namespace

void AddTranscodeCommand(Commands& commands) {
  const auto flags = std::make_shared<TranscodeFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* transcode =
      commands.Add("transcode", "Encode the frames of finished sessions again; the pixels do not change",
                   [&common, flags] { return RunTranscode(common, *flags); });
  transcode->footer(Examples({"transcode latest --codec delta", "transcode --all --codec raw12"},
                             "Exit code 3: some sessions of --all could not be transcoded; encrypted ones never can."));
  transcode->add_option("SESSION", flags->session, "id, unique prefix, or latest");
  transcode->add_flag("--all", flags->all,
                      "all sessions; those that cannot be transcoded are listed and left unchanged");
  transcode->add_option("--codec", flags->codec, "delta (less than half the bytes) or raw12 (packed)")->required();
}

}  // namespace stratalux::db
