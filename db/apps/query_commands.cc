// SPDX-License-Identifier: Apache-2.0
// `stratalux-db ls|query|sql`: questions to the index.
#include <algorithm>
#include <cstdio>
#include <iostream>
#include <memory>
#include <optional>
#include <sstream>

#include "db/apps/command.h"
#include "db/apps/moment.h"
#include "db/apps/table_output.h"
#include "db/apps/watchdog.h"
#include "db/catalogue/named_query.h"
#include "db/catalogue/session_filter.h"
#include "shared/base/nearest.h"

namespace stratalux::db {
namespace {

constexpr double kDefaultSeconds = 10.0;
constexpr int64_t kDefaultRows = 10'000;

struct QueryFlags {
  bool csv = false;
  std::string since, until, now;
  std::vector<std::string> statuses, kinds, rigs, visitors, visits, max_error, min_quality;
  std::string calibration, fitted, sort;
  std::optional<int64_t> limit;
  bool list = false, show_sql = false;
  std::string name;       // of a query
  std::string statement;  // of sql
  double seconds = kDefaultSeconds;
};

int PrintTable(const CommonFlags& common, const QueryFlags& flags, const ResultTable& table) {
  if (flags.csv) return PrintBytes(TableAsCsv(table));
  return Print(common.json ? TableAsJson(table) : TableAsText(table));
}

Status CheckFlags(const CommonFlags& common, const QueryFlags& flags) {
  if (common.json && flags.csv) return Status::Usage("--json and --csv cannot be used together");
  if (flags.limit && *flags.limit < 0) return Status::Usage("--limit must not be negative");
  return Status::Ok();
}

// --since, --until and --now as moments.
struct Span {
  std::optional<WallNs> since, until;
  WallNs now;
};

Result<Span> SpanOf(const QueryFlags& flags) {
  Span span{{}, {}, WallNow()};
  if (!flags.now.empty()) {
    SLX_ASSIGN_OR_RETURN(span.now, ParseMoment(flags.now, span.now).WithContext("--now"));
  }
  if (!flags.since.empty()) {
    SLX_ASSIGN_OR_RETURN(span.since, ParseMoment(flags.since, span.now).WithContext("--since"));
  }
  if (!flags.until.empty()) {
    SLX_ASSIGN_OR_RETURN(span.until, ParseMoment(flags.until, span.now).WithContext("--until"));
  }
  return span;
}

// "[NAME=]VALUE".
Result<FitBound> BoundOf(const std::string& text, const char* default_metric, FitBound::Side side) {
  const size_t equals = text.rfind('=');
  FitBound bound{equals == std::string::npos ? default_metric : text.substr(0, equals), side, 0.0};
  const std::string number = equals == std::string::npos ? text : text.substr(equals + 1);
  std::istringstream stream(number);
  if (bound.metric.empty() || !(stream >> bound.value) || !stream.eof())
    return Status::Usage("'" + text + "' is not a bound; give a number or NAME=NUMBER, such as nrmse=0.2");
  return bound;
}

Status ParseSort(const std::string& text, SessionFilter& filter) {
  if (text.empty()) return Status::Ok();
  constexpr std::pair<const char*, SortKey> kKeys[] = {{"session", SortKey::kNumber},
                                                       {"started", SortKey::kStarted},
                                                       {"frames", SortKey::kFrames},
                                                       {"bytes", SortKey::kBytes},
                                                       {"fits", SortKey::kFits},
                                                       {"nrmse", SortKey::kNrmse},
                                                       {"calibration-age", SortKey::kCalibrationAge}};
  const bool descending = text.front() == '-';
  std::string names;
  for (const auto& [name, key] : kKeys) {
    names += (names.empty() ? "" : ", ") + std::string(name);
    if (text.substr(descending ? 1 : 0) != name) continue;
    filter.sort = key;
    filter.order = descending ? SortOrder::kDescending : SortOrder::kAscending;
    return Status::Ok();
  }
  return Status::Usage("--sort '" + text + "' is unknown; allowed: " + names +
                       ", with - in front for the largest first");
}

Result<SessionFilter> FilterOf(const QueryFlags& flags) {
  SessionFilter filter;
  SLX_ASSIGN_OR_RETURN(const Span span, SpanOf(flags));
  filter.since = span.since;
  filter.until = span.until;
  for (const std::string& text : flags.statuses) {
    auto status = ParseSessionStatus(text);
    if (!status.ok())
      return Status::Usage("--status '" + text + "' is unknown; allowed: recording, complete, degraded, failed");
    filter.statuses.push_back(*status);
  }
  for (const std::string& text : flags.kinds) {
    SLX_ASSIGN_OR_RETURN(const SessionKind kind, ParseSessionKind(text).WithContext("--kind"));
    filter.kinds.push_back(kind);
  }
  filter.rigs = flags.rigs;
  filter.visitors = flags.visitors;
  filter.visits = flags.visits;
  if (!flags.calibration.empty()) filter.calibration = flags.calibration == "none" ? "" : flags.calibration;
  if (!flags.fitted.empty() && flags.fitted != "yes" && flags.fitted != "no")
    return Status::Usage("--fitted '" + flags.fitted + "' must be yes or no");
  if (!flags.fitted.empty()) filter.fitted = flags.fitted == "yes" ? Fitted::kYes : Fitted::kNo;
  for (const std::string& text : flags.max_error) {
    SLX_ASSIGN_OR_RETURN(auto bound, BoundOf(text, "nrmse", FitBound::Side::kAtMost).WithContext("--max-error"));
    filter.bounds.push_back(std::move(bound));
  }
  for (const std::string& text : flags.min_quality) {
    SLX_ASSIGN_OR_RETURN(auto bound, BoundOf(text, "ssim", FitBound::Side::kAtLeast).WithContext("--min-quality"));
    filter.bounds.push_back(std::move(bound));
  }
  SLX_RETURN_IF_ERROR(ParseSort(flags.sort, filter));
  filter.limit = flags.limit;
  return filter;
}

int RunList(const CommonFlags& common, const QueryFlags& flags) {
  if (const Status status = CheckFlags(common, flags); !status.ok()) return Report(status);
  const auto filter = FilterOf(flags);
  if (!filter.ok()) return Report(filter.status());
  // For its warnings: what a program that died has left to mend.
  if (const auto store = OpenStore(common, AccessMode::kReadOnly); !store.ok()) return Report(store.status());
  auto index = ReadOnlyIndex::Open(common.store);
  if (!index.ok()) return Report(index.status());
  const auto table = ListSessions(*index, *filter);
  return table.ok() ? PrintTable(common, flags, *table) : Report(table.status());
}

// A query that does not know a flag must not answer as if it had obeyed it.
Status CheckParameters(const NamedQuery& query, const QueryFlags& flags) {
  const auto knows = [&query](const char* name) {
    return std::find(query.parameters.begin(), query.parameters.end(), name) != query.parameters.end();
  };
  const std::pair<const char*, bool> kGiven[] = {{"since", !flags.since.empty()},
                                                 {"until", !flags.until.empty()},
                                                 {"rig", !flags.rigs.empty()},
                                                 {"kind", !flags.kinds.empty()},
                                                 {"limit", flags.limit.has_value()}};
  for (const auto& [name, given] : kGiven)
    if (given && !knows(name)) return Status::Usage("query " + query.name + " does not take --" + name);
  if (flags.rigs.size() > 1) return Status::Usage("query " + query.name + " takes one --rig");
  if (flags.kinds.size() > 1) return Status::Usage("query " + query.name + " takes one --kind");
  return Status::Ok();
}

// A mistyped one must not answer that nothing was found.
Result<FindingKind> FindingKindOf(const std::string& word) {
  std::vector<std::string> words;
  for (int i = 0; i < kFindingKindCount; ++i) words.emplace_back(ToString(static_cast<FindingKind>(i)));
  const auto at = std::find(words.begin(), words.end(), word);
  if (at == words.end()) return Status::Usage(UnknownName("kind of finding", word, words));
  return static_cast<FindingKind>(at - words.begin());
}

ResultTable ListOfQueries() {
  ResultTable table;
  table.columns = {{"query"}, {"question"}, {"parameters"}};
  for (const NamedQuery& query : NamedQueries()) {
    std::string parameters;
    for (const std::string& name : query.parameters) parameters += (parameters.empty() ? "--" : " --") + name;
    table.rows.push_back({query.name, query.question, parameters});
  }
  return table;
}

Result<ResultTable> AnswerOf(const CommonFlags& common, const QueryFlags& flags, const NamedQuery& query) {
  SLX_RETURN_IF_ERROR(CheckParameters(query, flags));
  SLX_ASSIGN_OR_RETURN(const Span span, SpanOf(flags));
  QueryParameters parameters{{"now_ns", span.now.ns}};
  if (span.since) parameters["since_ns"] = span.since->ns;
  if (span.until) parameters["until_ns"] = span.until->ns;
  if (!flags.rigs.empty()) parameters["rig"] = flags.rigs.front();
  if (!flags.kinds.empty()) {
    SLX_ASSIGN_OR_RETURN(const FindingKind kind, FindingKindOf(flags.kinds.front()));
    parameters["kind"] = std::string(ToString(kind));
  }
  if (flags.limit) parameters["limit"] = *flags.limit;
  SLX_ASSIGN_OR_RETURN(auto index, ReadOnlyIndex::Open(common.store));
  QueryLimits limits;
  limits.time = std::chrono::minutes(1);
  limits.rows = INT64_MAX;
  limits.bytes = INT64_MAX;
  return RunQuery(index, query, parameters, limits);
}

int RunNamed(const CommonFlags& common, const QueryFlags& flags) {
  if (const Status status = CheckFlags(common, flags); !status.ok()) return Report(status);
  if (flags.list) return PrintTable(common, flags, ListOfQueries());
  if (flags.name.empty()) return Report(Status::Usage("no query given; `stratalux-db query --list` lists them"));
  const auto query = FindQuery(flags.name);
  if (!query.ok()) return Report(query.status());
  if (flags.show_sql) return Print((*query)->sql);
  const auto table = AnswerOf(common, flags, **query);
  return table.ok() ? PrintTable(common, flags, *table) : Report(table.status());
}

// A byte more than any statement may have shows that there is too much.
std::string StatementFromInput() {
  std::string statement((size_t{1} << 20) + 1, '\0');
  std::cin.read(statement.data(), static_cast<std::streamsize>(statement.size()));
  statement.resize(static_cast<size_t>(std::cin.gcount()));
  return statement;
}

int RunSql(const CommonFlags& common, const QueryFlags& flags) {
  if (const Status status = CheckFlags(common, flags); !status.ok()) return Report(status);
  if (!(flags.seconds > 0.0 && flags.seconds <= 86400.0))
    return Report(Status::Usage("--seconds must be above 0 and at most 86400"));
  std::string statement = flags.statement;
  if (statement == "-") statement = StatementFromInput();
  auto index = ReadOnlyIndex::Open(common.store);
  if (!index.ok()) return Report(index.status());
  QueryLimits limits;
  limits.time = std::chrono::milliseconds(static_cast<int64_t>(flags.seconds * 1000.0));
  limits.rows = flags.limit.value_or(kDefaultRows);
  const auto run = [&] {
    // The limit of time is looked at between the steps of SQLite's machine; a step may take its time.
    const Watchdog watchdog(limits.time + std::chrono::seconds(1),
                            "stratalux-db: stopped after " + std::to_string(limits.time.count()) +
                                " ms inside one SQL function; ask for less, or for shorter values");
    return index->Run(statement, {{"now_ns", WallNow().ns}}, limits);
  };
  const auto table = run();
  if (!table.ok()) return Report(table.status());
  const int printed = PrintTable(common, flags, *table);
  if (printed != 0 || !table->truncated) return printed;
  std::fprintf(stderr, "stratalux-db: only the first %zu rows are shown; --limit N shows more\n", table->rows.size());
  // Rows that were asked for are no partial answer.
  return flags.limit ? 0 : static_cast<int>(StatusCode::kDegraded);
}

void AddSpan(CLI::App* command, QueryFlags& flags) {
  command->add_option("--since", flags.since,
                      "started at or after: 2026-11-21, 2026-11-21T18:00 (UTC), or 12h, 7d ago");
  command->add_option("--until", flags.until, "started before this time");
  command->add_option("--now", flags.now, "count ages from this moment (default: now)");
}

void AddOutput(CLI::App* command, QueryFlags& flags) {
  command->add_flag("--csv", flags.csv, "print CSV (RFC 4180)");
  command->add_option("--limit", flags.limit, "print at most this many rows");
}

void AddList(Commands& commands, const std::shared_ptr<QueryFlags>& flags) {
  const CommonFlags& common = commands.flags();
  CLI::App* ls = commands.Add("ls", "List the sessions that pass every filter, newest first",
                              [&common, flags] { return RunList(common, *flags); });
  AddSpan(ls, *flags);
  ls->add_option("--status", flags->statuses, "recording, complete, degraded, failed; several with commas")
      ->delimiter(',');
  ls->add_option("--kind", flags->kinds, "visitor, calibration, dark, flat, response; several with commas")
      ->delimiter(',');
  ls->add_option("--rig", flags->rigs, "name of the rig; may be repeated")->take_all();
  ls->add_option("--visitor", flags->visitors, "pseudonym; may be repeated")->take_all();
  ls->add_option("--visit", flags->visits, "the attempts of this visit; may be repeated")->take_all();
  ls->add_option("--calibration", flags->calibration, "prefix of the calibration's id, or none");
  ls->add_option("--fitted", flags->fitted, "yes or no");
  ls->add_option("--max-error", flags->max_error,
                 "[NAME=]VALUE: the newest fit's figure is at most that (default NAME: nrmse); may be repeated");
  ls->add_option("--min-quality", flags->min_quality,
                 "[NAME=]VALUE: the newest fit's figure is at least that (default NAME: ssim); may be repeated");
  ls->add_option("--sort", flags->sort,
                 "session, started, frames, bytes, fits, nrmse, calibration-age; -nrmse: largest first");
  AddOutput(ls, *flags);
  ls->footer(R"(Examples:
  stratalux-db ls --since 12h
  stratalux-db ls --status degraded,failed --rig kiosk --since 7d
  stratalux-db ls --kind visitor --fitted no --sort started
  stratalux-db ls --max-error 0.2 --min-quality psnr_db=35 --sort=-nrmse
  stratalux-db ls --calibration 3fa9 --csv > sessions.csv
NAME is nrmse, ssim, psnr_db, white_nrmse, divergence, depth_rms_mm or any name in the table `metrics`.)");
}

}  // namespace

void AddQueryCommands(Commands& commands) {
  const auto flags = std::make_shared<QueryFlags>();
  const CommonFlags& common = commands.flags();
  AddList(commands, flags);
  CLI::App* query = commands.Add("query", "Answer a question by its name; --list lists them",
                                 [&common, flags] { return RunNamed(common, *flags); });
  query->add_option("NAME", flags->name, "name of the query");
  query->add_flag("--list", flags->list, "list the queries and the flags each one takes");
  query->add_flag("--sql", flags->show_sql, "print the query's SQL, whose comments explain the columns");
  AddSpan(query, *flags);
  query->add_option("--rig", flags->rigs, "this rig only");
  query->add_option("--kind", flags->kinds, "findings of this kind only, such as moved");
  AddOutput(query, *flags);
  query->footer(R"(Examples:
  stratalux-db query --list
  stratalux-db query last-night
  stratalux-db query retakes --since 7d --rig kiosk
  stratalux-db query findings --kind moved --since 12h
  stratalux-db query oldest-unfitted --limit 5 --json
  stratalux-db query fit-quality --csv > quality.csv)");

  CLI::App* sql = commands.Add("sql", "Run one SELECT on the index; nothing can be written",
                               [&common, flags] { return RunSql(common, *flags); });
  sql->add_option("STATEMENT", flags->statement, "the SQL, or - to read it from stdin")->required();
  sql->add_option("--seconds", flags->seconds, "stop after this long (default 10)");
  AddOutput(sql, *flags);
  sql->footer(R"(Examples:
  stratalux-db sql "SELECT rig, count(*) FROM sessions GROUP BY rig"
  stratalux-db sql "SELECT name, sql FROM sqlite_schema WHERE type = 'view'"
  stratalux-db query retakes --sql | stratalux-db sql - --json
Without --limit at most 10000 rows are printed; exit code 3 if there are more. Exit code 2: the statement writes.)");
}

}  // namespace stratalux::db
