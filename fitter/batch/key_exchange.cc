// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/key_exchange.h"

#include <algorithm>
#include <optional>

#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/keys/reader_key.h"
#include "db/keys/sealed_key.h"
#include "db/privacy/access_log.h"
#include "fitter/batch/shard_keys.h"
#include "shared/base/formatted.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kFolder = "keys";
constexpr const char* kAskStart = "ask-";
constexpr const char* kAnswerFile = "answer.json";
constexpr int kSchema = 1;

std::string ToText(const Shard& shard) { return Formatted("%d/%d", shard.index, shard.count); }

fs::path AskFile(const fs::path& results, const db::ReaderId& reader) {
  return results / kFolder / (kAskStart + db::ToHex(reader) + ".json");
}
fs::path AnswerFolder(const fs::path& results, const db::ReaderId& reader) {
  return results / kFolder / db::ToHex(reader);
}

// kNewerSchema, kIntegrity; what `read` throws, too.
template <typename Read>
Status ReadMessage(const fs::path& file, const Read& read) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  try {
    const Json json = Json::parse(text);
    if (const auto schema = WholeAt<int64_t>(json, "schema"); schema != kSchema)
      return Status(StatusCode::kNewerSchema, Formatted("%s: schema %lld, this program knows %d", file.c_str(),
                                                        static_cast<long long>(schema), kSchema));
    read(json);
    return Status::Ok();
  } catch (const Json::exception& error) {
    return Status::Integrity(file.string() + ": " + error.what());
  }
}

struct Ask {
  Shard shard;
  db::ReaderPublicKey reader;
};

// A file of this user's, which nobody else may change.
Status CheckOwner(const fs::path& file) {
  struct stat info {};
  if (lstat(file.c_str(), &info) != 0) return Status::NotFound(file.string() + " is gone");
  if (!S_ISREG(info.st_mode)) return Status::Usage(file.string() + " is no plain file: not answered");
  if (info.st_uid != geteuid())
    return Status::Usage(Formatted("%s is of the user %u, not of this program's: not answered", file.c_str(),
                                   static_cast<unsigned>(info.st_uid)));
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0)
    return Status::Usage(file.string() + ": others may write to it: not answered (chmod 0600)");
  return Status::Ok();
}

Result<Ask> ReadAsk(const fs::path& results, const fs::path& file, const ShardPlan& plan) {
  SLX_RETURN_IF_ERROR(CheckOwner(file));
  std::string of_plan, shard, reader;
  SLX_RETURN_IF_ERROR(ReadMessage(file, [&](const Json& json) {
    json.at("plan").get_to(of_plan);
    json.at("shard").get_to(shard);
    json.at("reader").get_to(reader);
  }));
  if (of_plan != plan.id) return Status::Usage(file.string() + " asks for another plan than " + plan.id);
  Ask ask;
  SLX_ASSIGN_OR_RETURN(ask.shard, ParseShard(shard).WithContext(file.string()));
  SLX_ASSIGN_OR_RETURN(ask.reader, db::ParseReaderPublicKey(reader).WithContext(file.string()));
  if (AskFile(results, db::IdOf(ask.reader)) != file)
    return Status::Usage(file.string() + " names another key than its own: not answered");
  return ask;
}

// The answer is whole once its own file is there.
Result<size_t> Answer(const fs::path& store, const fs::path& results, const ShardPlan& plan, const Ask& ask,
                      std::vector<std::string>& problems) {
  const db::ReaderId reader = db::IdOf(ask.reader);
  SLX_ASSIGN_OR_RETURN(const ShardKeys found, KeysOf(store, plan, ask.shard));
  const fs::path folder = AnswerFolder(results, reader);
  for (size_t i = 0; i < found.keys.size(); ++i) {
    const std::string& session = found.sessions[i];
    SLX_RETURN_IF_ERROR(db::LogAccess(
        store.string(), "batch keys", session,
        "to shard " + ToText(ask.shard) + " of " + results.string() + ", which asked as " + db::ToHex(reader)));
    SLX_RETURN_IF_ERROR(db::MakeFolder(folder / session));
    SLX_RETURN_IF_ERROR(db::WriteSealedKey(folder / session, session, found.keys[i], ask.reader));
  }
  problems.insert(problems.end(), found.missing.begin(), found.missing.end());
  SLX_RETURN_IF_ERROR(db::MakeFolder(folder));
  const Json answer = {{"schema", kSchema}, {"sessions", found.sessions}, {"missing", found.missing}};
  SLX_RETURN_IF_ERROR(
      db::ReplaceFile(folder / kAnswerFile, answer.dump(1, ' ', false, Json::error_handler_t::replace) + "\n"));
  return found.keys.size();
}

Result<std::vector<db::SessionKey>> OpenAnswer(const fs::path& folder, const db::ReaderKey& own, const ShardPlan& plan,
                                               const Shard& shard, Logger& logger) {
  std::vector<std::string> sessions, missing;
  SLX_RETURN_IF_ERROR(ReadMessage(folder / kAnswerFile, [&](const Json& json) {
    json.at("sessions").get_to(sessions);
    json.at("missing").get_to(missing);
  }));
  const std::vector<size_t> places = VisitsOf(plan, shard);
  std::vector<db::SessionKey> keys;
  for (const std::string& session : sessions) {
    if (std::none_of(places.begin(), places.end(), [&](size_t place) { return plan.visits[place].session == session; }))
      return Status::Integrity((folder / kAnswerFile).string() + ": '" + session + "' is none of shard " +
                               ToText(shard));
    const fs::path file = db::SealedKeyFile(folder / session, db::IdOf(own.public_key()));
    SLX_ASSIGN_OR_RETURN(const auto header, db::ReadSealedKeyHeader(file));
    SLX_ASSIGN_OR_RETURN(const auto key, db::OpenSealedKey(folder / session, session, header.key, own));
    keys.push_back(key);
  }
  for (const std::string& line : missing) logger.Warning(line);
  return keys;
}

// Whatever becomes of it, an ask is asked by nobody any more.
class StandingAsk {
 public:
  StandingAsk(fs::path file, fs::path answer) : file_(std::move(file)), answer_(std::move(answer)) {}
  StandingAsk(const StandingAsk&) = delete;
  StandingAsk& operator=(const StandingAsk&) = delete;
  ~StandingAsk() {
    std::error_code error;
    fs::remove(file_, error);
    fs::remove_all(answer_, error);
  }

 private:
  fs::path file_, answer_;
};

}  // namespace

Result<std::vector<db::SessionKey>> AskForKeys(const fs::path& results, const ShardPlan& plan, const Shard& shard,
                                               std::chrono::milliseconds wait, std::chrono::milliseconds every,
                                               int stop, Logger& logger) {
  const db::ReaderKey own = db::ReaderKey::Passing();
  const db::ReaderId reader = db::IdOf(own.public_key());
  const fs::path file = AskFile(results, reader), folder = AnswerFolder(results, reader);
  SLX_RETURN_IF_ERROR(db::MakeFolder(results / kFolder));
  const StandingAsk standing(file, folder);
  const Json ask = {
      {"schema", kSchema}, {"plan", plan.id}, {"shard", ToText(shard)}, {"reader", db::ToText(own.public_key())}};
  SLX_RETURN_IF_ERROR(db::ReplaceFile(file, ask.dump(1) + "\n"));
  logger.Info("asking for the keys of shard " + ToText(shard) + " as " + db::ToHex(reader) + " ...");
  const auto end = std::chrono::steady_clock::now() + wait;
  std::error_code error;
  while (!fs::exists(folder / kAnswerFile, error)) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
    if (left.count() <= 0)
      return Status(StatusCode::kNotFound,
                    Formatted("nobody answered %s within %.1f min: `stratalux-fit batch keys --answer` does, where the "
                              "reader's key is",
                              file.c_str(), std::chrono::duration<double, std::ratio<60>>(wait).count()));
    pollfd asked{stop, POLLIN, 0};
    if (poll(&asked, 1, static_cast<int>(std::min(left, every).count())) > 0)
      return Status(StatusCode::kTryAgain, "stopped while it waited for the keys of shard " + ToText(shard));
  }
  return OpenAnswer(folder, own, plan, shard, logger);
}

Result<KeyAnswers> AnswerAsks(const fs::path& store, const fs::path& results, const ShardPlan& plan) {
  KeyAnswers answers;
  std::error_code error;
  std::vector<fs::path> asks;
  for (const auto& entry : fs::directory_iterator(results / kFolder, error)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with(kAskStart) && name.ends_with(".json")) asks.push_back(entry.path());
  }
  std::sort(asks.begin(), asks.end());
  for (const fs::path& file : asks) {
    const auto ask = ReadAsk(results, file, plan);
    if (!ask.ok()) {
      if (ask.status().code() != StatusCode::kNotFound) answers.problems.push_back(ask.status().message());
      continue;
    }
    if (fs::exists(AnswerFolder(results, db::IdOf(ask->reader)) / kAnswerFile, error)) continue;
    SLX_ASSIGN_OR_RETURN(const size_t keys, Answer(store, results, plan, *ask, answers.problems));
    ++answers.answered;
    answers.keys += keys;
  }
  return answers;
}

}  // namespace stratalux::fit
