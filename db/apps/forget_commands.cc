// SPDX-License-Identifier: Apache-2.0
// `stratalux-db forget|purge|deletions`.
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>

#include <nlohmann/json.hpp>

#include "db/apps/command.h"
#include "db/apps/display_text.h"
#include "db/care/incoming.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/ledger_follow.h"
#include "db/catalogue/session_index.h"
#include "db/privacy/forget.h"
#include "db/privacy/retention.h"
#include "db/privacy/ticket.h"
#include "shared/base/json_nesting.h"
#include "shared/config/store_config.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

struct ForgetFlags {
  std::string session, visitor, ticket;
  bool dry_run = false, yes = false, resume = false;
  // purge
  std::string config, now;
  std::optional<int> short_days, standard_days, long_days;
};

using Reasons = std::map<std::string, std::string>;  // session id -> why it is due

Json ExportsAsJson(const std::vector<ForgottenExport>& exports) {
  Json json = Json::array();
  for (const ForgottenExport& e : exports) json.push_back({{"place", e.place}, {"state", ToString(e.state)}});
  return json;
}

std::string ExportsAsText(const std::vector<ForgottenExport>& exports, const ForgetFlags& flags) {
  std::string text;
  for (const ForgottenExport& e : exports)
    text += "  export " + e.place + ": " +
            (!flags.dry_run                     ? ToString(e.state)
             : e.state == ExportState::kDeleted ? "would be deleted"
             : e.state == ExportState::kKept    ? "cannot be read from here, and would stay"
                                                : ToString(e.state)) +
            "\n";
  return text;
}

// Folders of sessions, whose ids they end with.
Json IncomingAsJson(const std::vector<std::string>& places, const Reasons& due) {
  Json incoming = Json::array();
  for (const std::string& place : places) {
    Json json = {{"place", place}};
    if (const auto reason = due.find(fs::path(place).filename().string()); reason != due.end())
      json["due"] = reason->second;
    incoming.push_back(std::move(json));
  }
  return incoming;
}

std::string IncomingAsText(const std::vector<std::string>& places, const Reasons& due, const ForgetFlags& flags) {
  std::string text;
  for (const std::string& place : places) {
    const auto reason = due.find(fs::path(place).filename().string());
    text += place + (flags.dry_run ? ": would go" : ": gone") +
            (reason == due.end() ? "" : " (" + reason->second + ")") + "\n";
  }
  return text;
}

Json JsonOf(const ForgetReport& report, const Reasons& due, const ForgetFlags& flags) {
  Json sessions = Json::array();
  for (const ForgottenSession& s : report.sessions) {
    Json json = {{"session", s.id},
                 {"frames", s.frames},
                 {"fits", s.fits},
                 {"files", s.files},
                 {"bytes", s.bytes},
                 {"encrypted", s.encrypted},
                 {"exports", ExportsAsJson(s.exports)},
                 {"visitor_removed", s.visitor_removed}};
    if (const auto reason = due.find(s.id); reason != due.end()) json["due"] = reason->second;
    sessions.push_back(std::move(json));
  }
  return {{"dry_run", flags.dry_run},
          {"sessions", sessions},
          {"incoming", IncomingAsJson(report.incoming, due)},
          {"markers", report.markers},
          {"files_read", report.scanned_files},
          {"bytes_read", report.scanned_bytes},
          {"leftovers", report.leftovers}};
}

std::string SessionText(const ForgottenSession& s, const Reasons& due, const ForgetFlags& flags) {
  std::string text = s.id + (flags.dry_run ? ": would go: " : ": gone: ") + std::to_string(s.frames) + " frames, " +
                     std::to_string(s.fits) + " fits, " + std::to_string(s.files) + " files, " +
                     std::to_string(s.bytes) + " bytes" + (s.encrypted ? ", its key" : "") +
                     (s.visitor_removed ? ", the visitor and its consents" : "");
  if (const auto reason = due.find(s.id); reason != due.end()) text += " (" + reason->second + ")";
  return text + "\n" + ExportsAsText(s.exports, flags);
}

std::string ReportAsText(const ForgetReport& report, const Reasons& due, const ForgetFlags& flags) {
  std::string text;
  for (const ForgottenSession& s : report.sessions) text += SessionText(s, due, flags);
  text += IncomingAsText(report.incoming, due, flags);
  if (report.sessions.empty() && report.incoming.empty()) text += "no session\n";
  if (flags.dry_run) return text + "nothing was changed (--dry-run)\n";
  if (report.scanned_files > 0)
    text += "scan: " + std::to_string(report.markers) + " markers looked for in " +
            std::to_string(report.scanned_files) + " files (" + std::to_string(report.scanned_bytes) + " bytes): " +
            (report.leftovers.empty() ? "none found" : "FOUND, remove by hand and run `forget --resume`") + "\n";
  for (const std::string& leftover : report.leftovers) text += "  " + leftover + "\n";
  return text;
}

int Finish(const CommonFlags& common, const ForgetFlags& flags, ForgetRequest request, const Reasons& due) {
  Logger logger;
  const auto report = flags.dry_run ? PlanForget(common.store, request) : Forget(common.store, request, logger);
  if (!report.ok()) return Report(report.status());
  const int printed = Print(common.json ? TextOf(JsonOf(*report, due, flags)) : ReportAsText(*report, due, flags));
  return report->leftovers.empty() ? printed : static_cast<int>(StatusCode::kDegraded);
}

// The sessions a forget speaks of. One that is forgotten already gives none, unless it lies here again.
Result<ForgetRequest> RequestFor(const CommonFlags& common, const ForgetFlags& flags) {
  ForgetRequest request;
  SLX_ASSIGN_OR_RETURN(const auto store, SessionStore::Open(common.store, AccessMode::kReadOnly));
  if (flags.resume) return request;
  if (!flags.visitor.empty()) {
    SLX_ASSIGN_OR_RETURN(const auto rows, store.ListSessionsOf(flags.visitor));
    for (const SessionSummary& row : rows) request.sessions.push_back(row.info.id);
    SLX_ASSIGN_OR_RETURN(const auto consents, ListConsents(common.store, flags.visitor));
    if (request.sessions.empty() && consents.empty() && IncomingPlaces(common.store, {}, {flags.visitor}).empty())
      return Status::NotFound("visitor '" + flags.visitor + "' has neither sessions nor consents in " + common.store);
    request.visitors.push_back(flags.visitor);
    return request;
  }
  const auto row = store.FindSession(flags.session);
  if (row.ok()) {
    request.sessions.push_back(row->info.id);
    return request;
  }
  SLX_ASSIGN_OR_RETURN(const std::string forgotten, FindForgotten(common.store, flags.session));
  if (!forgotten.empty()) {
    SLX_ASSIGN_OR_RETURN(const bool returned, HasReturned(common.store, forgotten));
    if (returned) request.sessions.push_back(forgotten);
    return request;
  }
  // Of a transfer that was broken off, never listed.
  if (row.status().code() != StatusCode::kNotFound || IncomingPlaces(common.store, {flags.session}).empty())
    return row.status();
  request.leftovers.push_back(flags.session);
  return request;
}

int RunForget(const CommonFlags& common, ForgetFlags flags) {
  if (int(!flags.session.empty()) + int(!flags.visitor.empty()) + int(!flags.ticket.empty()) + int(flags.resume) != 1)
    return Report(Status::Usage(
        "forget: name a SESSION, --visitor V or --ticket CODE (or --resume to finish an interrupted one)"));
  if (!flags.ticket.empty()) {
    auto visitor = VisitorOfTicket(flags.ticket);
    if (!visitor.ok()) return Report(visitor.status().WithContext("--ticket " + Printable(flags.ticket)));
    flags.visitor = std::move(visitor).value();
  }
  auto request = RequestFor(common, flags);
  if (!request.ok()) return Report(request.status());
  const bool nothing = request->sessions.empty() && request->visitors.empty() && request->leftovers.empty();
  const auto begun = UnfinishedForgets(common.store);
  if (!begun.ok()) return Report(begun.status());
  if (!flags.resume && nothing && begun->empty()) {
    std::fprintf(stderr,
                 "stratalux-db: session %s was already forgotten (`stratalux-db deletions` shows its certificate)\n",
                 flags.session.c_str());
    return common.json ? Print(TextOf(JsonOf({}, {}, flags))) : 0;
  }
  if (!flags.dry_run && !flags.yes && !flags.resume)
    return Report(Status::Usage("forget removes " +
                                std::to_string(request->sessions.size() + request->leftovers.size()) +
                                " session(s) for ever; --dry-run shows them, --yes does it"));
  return Finish(common, flags, std::move(request).value(), {});
}

// "2027-01-31" or "2027-01-31T12:00:00Z".
Result<WallNs> ParseDate(const std::string& text) {
  for (const char* format : {"%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%d"}) {
    std::tm utc{};
    const char* end = strptime(text.c_str(), format, &utc);
    if (end == nullptr || *end != '\0') continue;
    int64_t ns = 0;
    if (__builtin_mul_overflow(static_cast<int64_t>(timegm(&utc)), int64_t{1'000'000'000}, &ns))
      return Status::Usage("--now '" + text + "' is outside the years 1678 to 2262 that the store can represent");
    return WallNs{ns};
  }
  return Status::Usage("--now '" + text + "': expected a date such as 2027-01-31 or 2027-01-31T12:00:00Z");
}

Result<RetentionDays> DaysFor(const ForgetFlags& flags) {
  RetentionDays days;
  if (!flags.config.empty()) {
    SLX_ASSIGN_OR_RETURN(const auto config, LoadStoreConfig(flags.config));
    days = config.retention;
  }
  days.short_days = flags.short_days.value_or(days.short_days);
  days.standard_days = flags.standard_days.value_or(days.standard_days);
  days.long_days = flags.long_days.value_or(days.long_days);
  return days;
}

// What a purge would take, by the index alone: a hundred thousand folders are not measured. Printed as it comes.
class PurgePlan {
 public:
  PurgePlan(const CommonFlags& common, const ForgetFlags& flags) : common_(common), flags_(flags) {}
  // `incoming`: places of what incoming/ alone knows, due for `reasons`.
  int Print(const std::vector<DueSession>& due, const std::vector<std::string>& incoming, const Reasons& reasons) {
    const auto exports = LoggedExports(common_.store);
    if (!exports.ok()) return Report(exports.status());
    if (common_.json) pending_ = "{\n  \"dry_run\": true,\n  \"by\": \"index\",\n  \"sessions\": [";
    for (const DueSession& session : due) {
      const auto places = exports->find(session.id);
      Add(session, places == exports->end() ? std::vector<std::string>() : places->second);
      if (pending_.size() >= kChunk_bytes && Flush() != 0) return 1;
    }
    pending_ += common_.json ? JsonEnd(incoming, reasons) : TextEnd(incoming, reasons);
    return Flush();
  }

 private:
  static constexpr size_t kChunk_bytes = 1 << 16;

  void Add(const DueSession& session, const std::vector<std::string>& places) {
    std::vector<ForgottenExport> exports;
    for (const std::string& place : places) exports.push_back(PlanExport(place, session.id));
    if (common_.json) {
      const Json json = {{"session", session.id},          {"frames", session.frames},
                         {"fits", session.fits},           {"bytes", session.bytes},
                         {"encrypted", session.encrypted}, {"exports", ExportsAsJson(exports)},
                         {"due", session.reason}};
      pending_ += (sessions_ == 0 ? "\n    " : ",\n    ") + InOneLine(json);
    } else {
      pending_ += session.id + ": would go: " + std::to_string(session.frames) + " frames, " +
                  std::to_string(session.fits) + " fits, " + std::to_string(session.bytes) + " bytes" +
                  (session.encrypted ? ", its key" : "") + " (" + session.reason + ")\n" +
                  ExportsAsText(exports, flags_);
    }
    ++sessions_;
    frames_ += session.frames;
    fits_ += session.fits;
    bytes_ += session.bytes;
  }
  [[nodiscard]] std::string TextEnd(const std::vector<std::string>& incoming, const Reasons& reasons) const {
    const std::string total = std::to_string(sessions_) + " sessions, " + std::to_string(frames_) + " frames, " +
                              std::to_string(fits_) + " fits, " + std::to_string(bytes_) +
                              " bytes of frames (from the index; fits and other files are not counted)\n";
    return IncomingAsText(incoming, reasons, flags_) +
           (sessions_ > 0      ? total
            : incoming.empty() ? "no session\n"
                               : "") +
           "nothing was changed (--dry-run)\n";
  }
  [[nodiscard]] std::string JsonEnd(const std::vector<std::string>& incoming, const Reasons& reasons) const {
    const Json total = {{"sessions", sessions_}, {"frames", frames_}, {"fits", fits_}, {"bytes", bytes_}};
    return std::string(sessions_ == 0 ? "]" : "\n  ]") +
           ",\n  \"incoming\": " + InOneLine(IncomingAsJson(incoming, reasons)) +
           ",\n  \"total\": " + InOneLine(total) + "\n}\n";
  }
  static std::string InOneLine(const Json& json) {
    return PrintableJson(json.dump(-1, ' ', false, Json::error_handler_t::replace));
  }
  int Flush() {
    const int printed = stratalux::db::Print(pending_);
    pending_.clear();
    return printed;
  }

  const CommonFlags& common_;
  const ForgetFlags& flags_;
  std::string pending_;
  int64_t sessions_ = 0, frames_ = 0, fits_ = 0, bytes_ = 0;
};

// What incoming/ alone knows and is due. What a transfer at work has before it is no leftover yet; while the lock is
// held none begins.
Result<IncomingLock> AddLeftovers(const CommonFlags& common, const ForgetFlags& flags, const RetentionDays& days,
                                  WallNs now, ForgetRequest& request, Reasons& reasons) {
  IncomingLock lock;
  if (IncomingLock::IsHeld(common.store)) {
    std::fprintf(stderr, "stratalux-db: a pull or restore is running: incoming/ was not checked\n");
    return lock;
  }
  SLX_ASSIGN_OR_RETURN(auto leftovers, DueIncoming(common.store, days, now));
  if (!flags.dry_run && !leftovers.sessions.empty()) {
    SLX_ASSIGN_OR_RETURN(lock, IncomingLock::Take(common.store));
    SLX_ASSIGN_OR_RETURN(leftovers, DueIncoming(common.store, days, now));
  }
  for (const std::string& newer : leftovers.newer)
    std::fprintf(stderr, "stratalux-db: of a newer program, not purged: %s\n", Printable(newer).c_str());
  for (const DueSession& leftover : leftovers.sessions) {
    request.leftovers.push_back(leftover.id);
    reasons[leftover.id] = leftover.reason;
  }
  return lock;
}

// Consents that the ledger withdraws and the index does not know of yet, also by the moment alone at which they were
// given.
Status FollowLedgerFirst(const CommonFlags& common) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(common.store, AccessMode::kReadWrite));
  return FollowWithdrawals(index, common.store).status();
}

int RunPurge(const CommonFlags& common, const ForgetFlags& flags) {
  const auto days = DaysFor(flags);
  if (!days.ok()) return Report(days.status());
  const auto now = flags.now.empty() ? Result<WallNs>(WallNow()) : ParseDate(flags.now);
  if (!now.ok()) return Report(now.status());
  if (!flags.dry_run)
    if (const Status followed = FollowLedgerFirst(common); !followed.ok()) return Report(followed);
  const auto due = DueSessions(common.store, *days, *now);
  if (!due.ok()) return Report(due.status());
  ForgetRequest request;
  request.reason = ForgetReason::kPurge;
  Reasons reasons;
  const auto no_transfer = AddLeftovers(common, flags, *days, *now, request, reasons);
  if (!no_transfer.ok()) return Report(no_transfer.status());
  if (flags.dry_run) {
    const auto leftovers = PlanForget(common.store, request);
    return leftovers.ok() ? PurgePlan(common, flags).Print(*due, leftovers->incoming, reasons)
                          : Report(leftovers.status());
  }
  for (const DueSession& session : *due) {
    request.sessions.push_back(session.id);
    reasons[session.id] = session.reason;
  }
  const auto begun = UnfinishedForgets(common.store);
  if (!begun.ok()) return Report(begun.status());
  if (request.sessions.empty() && request.leftovers.empty() && begun->empty())
    return Print(common.json ? TextOf(JsonOf({}, {}, flags)) : "no session is due\n");
  return Finish(common, flags, std::move(request), reasons);
}

// Of a certificate that somebody may have edited: a value of another type counts as none.
std::string TextIn(const Json& json, const char* key) {
  const auto found = json.find(key);
  return found != json.end() && found->is_string() ? found->get<std::string>() : std::string("?");
}
long long NumberIn(const Json& json, const char* key) {
  const auto found = json.find(key);
  return found != json.end() && found->is_number_integer() ? found->get<long long>() : 0;
}

std::string DeletionLine(const std::string& session, const Json& certificate) {
  const Json& proof = certificate["verification"];
  const auto clean = proof.find("clean");
  const bool is_clean = clean != proof.end() && clean->is_boolean() && clean->get<bool>();
  char line[200];
  std::snprintf(line, sizeof line, "%-16.64s  %-20.20s  %-7.16s  %6lld  %-5s  %7lld  %lld\n", session.c_str(),
                Printable(TextIn(certificate, "deleted")).c_str(), Printable(TextIn(certificate, "reason")).c_str(),
                NumberIn(certificate, "frames"), is_clean ? "yes" : "NO", NumberIn(proof, "markers"),
                NumberIn(proof, "files_read"));
  return line;
}

int RunDeletions(const CommonFlags& common) {
  const auto deletions = ListDeletions(common.store);
  if (!deletions.ok()) return Report(deletions.status());
  Json all = Json::array();
  std::string text = "session           deleted               reason   frames  clean  markers  files read\n";
  for (const Deletion& deletion : *deletions) {
    const bool sound = CheckNesting(deletion.certificate_json).ok();
    const Json json = Json::parse(sound ? deletion.certificate_json : std::string(), nullptr, false);
    if (!json.is_object() || !json.contains("verification") || !json["verification"].is_object()) {
      all.push_back({{"session", deletion.session}, {"unfinished", true}});
      text += deletion.session + "  begun but not finished: run `stratalux-db forget --resume`\n";
      continue;
    }
    all.push_back(json);
    text += DeletionLine(deletion.session, json);
  }
  if (deletions->empty()) text += "(none)\n";
  return Print(common.json ? TextOf(all) : text);
}

}  // namespace

void AddForgetCommands(Commands& commands) {
  const auto flags = std::make_shared<ForgetFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* forget = commands.Add("forget", "Remove a session or a visitor for ever, prove it, certify it",
                                  [&common, flags] { return RunForget(common, *flags); });
  forget->add_option("SESSION", flags->session, "id, unique prefix, or latest");
  forget->add_option("--visitor", flags->visitor, "all sessions and consents of this pseudonym");
  forget->add_option("--ticket", flags->ticket, "the same for the visitor whose kiosk ticket has this code");
  forget->add_flag("--resume", flags->resume, "only finish what was interrupted");
  forget->add_flag("--yes", flags->yes, "do it");
  forget->footer(Examples({"forget s000017 --dry-run", "forget s000017 --yes", "forget --visitor v-5f3a91c2 --yes",
                           "forget --ticket 7K3QZ-M0P4T-3 --yes", "forget --resume"},
                          "Exit code 3: traces were found after all; the report says where."));
  CLI::App* purge =
      commands.Add("purge", "Forget visitors' sessions kept past their time, or whose consent was withdrawn",
                   [&common, flags] { return RunPurge(common, *flags); });
  purge->add_option("--config", flags->config, "TOML file with [retention] (docs/examples/rig.toml)");
  purge->add_option("--short-days", flags->short_days, "days that the class short is kept (default: 30)");
  purge->add_option("--standard-days", flags->standard_days, "days that the class standard is kept (default: 365)");
  purge->add_option("--long-days", flags->long_days, "days that the class long is kept (default: 3650)");
  purge->add_option("--now", flags->now, "as if today were this date, such as 2027-01-31 (UTC)");
  for (CLI::App* command : {forget, purge})
    command->add_flag("--dry-run", flags->dry_run, "show what would go; change nothing");
  purge->footer(Examples({"purge --dry-run", "purge --dry-run --now 2027-01-31", "purge --config rig.toml"}));
  for (const char* name : {"--short-days", "--standard-days", "--long-days"})
    purge->get_option(name)->check(CLI::Range(0, 100000));
  CLI::App* deletions = commands.Add("deletions", "List the certificates of what was forgotten",
                                     [&common] { return RunDeletions(common); });
  deletions->footer(Examples({"deletions", "deletions --json"}));
}

}  // namespace stratalux::db
