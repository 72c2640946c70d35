// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/night_log.h"

#include <algorithm>
#include <cerrno>
#include <concepts>
#include <cstring>
#include <ctime>
#include <sstream>
#include <utility>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/catalogue/deletions.h"
#include "fitter/batch/visit_cost.h"
#include "shared/base/formatted.h"
#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"
#include "shared/base/unique_fd.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kNightsFolder = "nights";
constexpr const char* kNight = "night";  // of all
constexpr const char* kEnding = ".jsonl";
constexpr std::pair<NightEventKind, const char*> kKinds[] = {
    {NightEventKind::kBegan, "began"},        {NightEventKind::kLeftOut, "left-out"},
    {NightEventKind::kStarted, "started"},    {NightEventKind::kDone, "done"},
    {NightEventKind::kRetry, "retry"},        {NightEventKind::kFailed, "failed"},
    {NightEventKind::kSetAside, "set-aside"}, {NightEventKind::kDropped, "dropped"},
    {NightEventKind::kReleased, "released"},  {NightEventKind::kEnded, "ended"}};

template <typename T>
void Read(const Json& json, const char* key, T& value) {
  if constexpr (std::integral<T> && !std::same_as<T, bool>)
    value = WholeOr(json, key, value);
  else if (json.contains(key))
    value = json.at(key).get<T>();
}

bool IsThere(const fs::path& store, const std::string& session) {
  std::error_code error;
  return fs::exists(fs::symlink_status(store / "sessions" / session, error));
}

}  // namespace

const char* ToString(NightEventKind kind) {
  for (const auto& [value, name] : kKinds)
    if (value == kind) return name;
  return "?";
}

bool IsEnd(NightEventKind kind) {
  return kind == NightEventKind::kDone || kind == NightEventKind::kFailed || kind == NightEventKind::kSetAside ||
         kind == NightEventKind::kDropped;
}

std::string NightMoment(WallNs time) {
  const std::time_t seconds = time.ns / 1'000'000'000;
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  char text[32];
  std::strftime(text, sizeof text, "%Y%m%dT%H%M%S", &utc);
  return Formatted("%s.%03dZ", text, static_cast<int>(time.ns / 1'000'000 % 1000));
}

std::string ToJson(const NightEvent& event) {
  Json json = {{"at", ToIso8601(event.at)}, {"at_ns", event.at.ns}, {"event", ToString(event.kind)}};
  if (!event.session.empty()) json["session"] = event.session;
  if (!event.fit.empty()) json["fit"] = event.fit;
  if (event.attempt > 0) json["attempt"] = event.attempt;
  if (event.seconds > 0.0) json["seconds"] = event.seconds;
  if (event.cpu_seconds > 0.0) json["cpu_seconds"] = event.cpu_seconds;
  if (event.peak_bytes > 0) json["peak_bytes"] = event.peak_bytes;
  if (!event.why.empty()) json["why"] = event.why;
  if (!event.reason.empty()) json["reason"] = event.reason;
  if (event.kind == NightEventKind::kBegan || event.kind == NightEventKind::kEnded) json["visitors"] = event.count;
  if (event.by_error) json["by_error"] = true;
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Result<NightEvent> ParseNightEvent(const std::string& line) {
  SLX_RETURN_IF_ERROR(CheckNesting(line));
  const Json json = Json::parse(line, nullptr, false);
  if (!json.is_object()) return Status::Integrity("not an event of a night: " + line.substr(0, 80));
  try {
    NightEvent event;
    const auto name = json.at("event").get<std::string>();
    const auto* kind =
        std::find_if(std::begin(kKinds), std::end(kKinds), [&](const auto& k) { return name == k.second; });
    if (kind == std::end(kKinds)) return Status::Integrity("event '" + name + "' is not known");
    event.kind = kind->first;
    Read(json, "at_ns", event.at.ns);
    Read(json, "session", event.session);
    Read(json, "fit", event.fit);
    Read(json, "attempt", event.attempt);
    Read(json, "seconds", event.seconds);
    Read(json, "cpu_seconds", event.cpu_seconds);
    Read(json, "peak_bytes", event.peak_bytes);
    Read(json, "why", event.why);
    Read(json, "reason", event.reason);
    Read(json, "visitors", event.count);
    Read(json, "by_error", event.by_error);
    SLX_RETURN_IF_ERROR(CheckCost({event.cpu_seconds, event.peak_bytes}));
    SLX_RETURN_IF_ERROR(CheckSeconds(event.seconds));
    if (event.at.ns < 0) return Status::Integrity("an event at " + std::to_string(event.at.ns) + " ns");
    return event;
  } catch (const Json::exception& error) {
    return Status::Integrity(std::string("not an event of a night: ") + error.what());
  }
}

Result<NightLog> NightLog::Begin(const fs::path& store) {
  return Open(store, NightMoment(WallNow()) + Formatted("-%d", static_cast<int>(getpid())));
}

Result<NightLog> NightLog::Open(const fs::path& store, const std::string& name) {
  NightLog log(store, store / kNightsFolder / name);
  SLX_RETURN_IF_ERROR(db::MakeFolder(log.folder_));
  return log;
}

Status NightLog::Add(const NightEvent& event) {
  if (event.session.find('/') != std::string::npos || event.session.starts_with('.'))
    return Status::Usage("'" + event.session + "' is not a session: a night writes only to its own folder");
  NightEvent said = event;
  // A ledger that cannot be read for the moment ends no night: the line goes where a forgetting finds it. Of whose
  // session is gone, that may be over.
  const auto forgotten = db::IsForgotten(store_, event.session);
  const bool nameless = forgotten.ok() ? *forgotten : !IsThere(store_, event.session);
  if (nameless && !event.session.empty()) {
    said.session = said.fit = "";
    said.reason = forgotten.ok() ? "was forgotten" : "is not there any more";
  }
  constexpr int kPrivate = 0640;
  const fs::path file = folder_ / ((said.session.empty() ? kNight : said.session) + kEnding);
  const UniqueFd opened(open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, kPrivate));
  if (!opened.ok()) return Status::Failed(file.string() + ": " + std::strerror(errno));
  const std::string line = ToJson(said) + "\n";
  SLX_RETURN_IF_ERROR(db::WriteAll(opened.get(), line.data(), line.size(), file.string()));
  if (fdatasync(opened.get()) != 0) return Status::Failed(file.string() + ": " + std::strerror(errno));
  return db::SyncFolder(folder_);
}

Status NightLog::Remove(const std::string& session) {
  std::error_code error;
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder_, error))
    if (entry.path().filename().string().starts_with(session)) files.push_back(entry.path());
  for (const fs::path& file : files) SLX_RETURN_IF_ERROR(db::WipeFile(file));
  return Status::Ok();
}

fs::path NightLog::WorkerLog(const std::string& session, int attempt) const {
  return folder_ / Formatted("%s-%d.log", session.c_str(), attempt);
}

std::vector<std::string> Nights(const fs::path& store) {
  std::vector<std::string> names;
  std::error_code error;
  for (fs::directory_iterator at(store / kNightsFolder, error), end; !error && at != end; at.increment(error))
    if (fs::is_directory(at->path(), error)) names.push_back(at->path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
}

Result<NightRecord> ReadNight(const fs::path& folder) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) return Status::NotFound("there is no night " + folder.string());
  NightRecord record;
  for (fs::directory_iterator at(folder, error), end; !error && at != end; at.increment(error)) {
    if (at->path().extension() != kEnding) continue;
    SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(at->path()));
    std::istringstream lines(text);
    // A clock that was set back turns nobody's story around.
    WallNs latest;
    for (std::string line; std::getline(lines, line);) {
      auto event = ParseNightEvent(line);
      if (!event.ok()) {
        ++record.unread;
        continue;
      }
      latest = event->at = std::max(event->at, latest);
      record.events.push_back(std::move(*event));
    }
  }
  std::stable_sort(record.events.begin(), record.events.end(),
                   [](const NightEvent& a, const NightEvent& b) { return a.at < b.at; });
  return record;
}

}  // namespace stratalux::fit
