// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/key_exchange.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/file_lock.h"
#include "db/keys/reader_key.h"
#include "db/keys/sealed_key.h"
#include "db/privacy/access_log.h"
#include "fitter/batch/shard_keys.h"
#include "shared/base/formatted.h"
#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"
#include "shared/base/read_file.h"
#include "shared/base/unique_fd.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kKeysFolder = "keys";
constexpr const char* kAskStart = "ask-";
constexpr const char* kAskEnd = ".json";
constexpr const char* kAnswerFile = "answer.json";
constexpr const char* kAnswerLock = ".answer.lock";  // in RESULTS
constexpr size_t kMostAskBytes = 4096;
constexpr int kSchema = 1;

std::string ToText(const Shard& shard) { return Formatted("%d/%d", shard.index, shard.count); }

fs::path AskFile(const fs::path& results, const db::ReaderId& reader) {
  return results / kKeysFolder / (kAskStart + db::ToHex(reader) + kAskEnd);
}
fs::path AnswerFolder(const fs::path& results, const db::ReaderId& reader) {
  return results / kKeysFolder / db::ToHex(reader);
}

// kNewerSchema, kIntegrity; what `read` throws, too.
template <typename Read>
Status ParseMessage(const fs::path& file, const std::string& text, const Read& read) {
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file.string()));
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

bool IsGone(const fs::path& file) {
  struct stat info {};
  return lstat(file.c_str(), &info) != 0 && errno == ENOENT;
}

// Whose asks are answered: this program's user's, and for root, who may read every key, those of whoever owns RESULTS.
uid_t AskersOf(const fs::path& results) {
  struct stat info {};
  return geteuid() == 0 && stat(results.c_str(), &info) == 0 ? info.st_uid : geteuid();
}

Status CheckOwner(const fs::path& path, const struct stat& info, uid_t asker) {
  if (info.st_uid != asker && info.st_uid != geteuid())
    return Status::Usage(Formatted("%s belongs to user %u, not to %u: not answered", path.c_str(),
                                   static_cast<unsigned>(info.st_uid), static_cast<unsigned>(asker)));
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0)
    return Status::Usage(path.string() + ": others may write to it: not answered (chmod go-w)");
  return Status::Ok();
}

// Of the very file that was checked: a name may mean another one the next moment. kNotFound where it is gone.
Result<std::string> ReadOwn(const fs::path& file, uid_t asker) {
  const UniqueFd fd(open(file.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC));
  if (fd.get() < 0 && errno == ENOENT) return Status::NotFound(file.string() + " is gone");
  if (fd.get() < 0 && errno == ELOOP) return Status::Usage(file.string() + " is not a plain file: not answered");
  struct stat info {};
  if (fd.get() < 0 || fstat(fd.get(), &info) != 0)
    return Status::Failed("cannot open " + file.string() + ": " + std::strerror(errno));
  if (!S_ISREG(info.st_mode)) return Status::Usage(file.string() + " is not a plain file: not answered");
  SLX_RETURN_IF_ERROR(CheckOwner(file, info, asker));
  std::string text(kMostAskBytes + 1, '\0');
  size_t filled = 0;
  while (filled < text.size()) {
    const ssize_t got = read(fd.get(), text.data() + filled, text.size() - filled);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
    if (got == 0) break;
    filled += static_cast<size_t>(got);
  }
  if (filled > kMostAskBytes) return Status::Usage(file.string() + " is too large for a request: not answered");
  text.resize(filled);
  return text;
}

Result<Ask> ReadAsk(const fs::path& results, const fs::path& file, uid_t asker, const ShardPlan& plan) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadOwn(file, asker));
  std::string of_plan, shard, reader;
  SLX_RETURN_IF_ERROR(ParseMessage(file, text, [&](const Json& json) {
    json.at("plan").get_to(of_plan);
    json.at("shard").get_to(shard);
    json.at("reader").get_to(reader);
  }));
  if (of_plan != plan.id) return Status::Usage(file.string() + " asks for another plan than " + plan.id);
  Ask ask;
  SLX_ASSIGN_OR_RETURN(ask.shard, ParseShard(shard).WithContext(file.string()));
  const auto key = db::ReaderPublicKeyOf(reader);
  if (!key) return Status::Usage(file.string() + ": '" + reader + "' is not a public key: not answered");
  ask.reader = *key;
  if (AskFile(results, db::IdOf(ask.reader)) != file)
    return Status::Usage(file.string() + " names a key other than its own: not answered");
  return ask;
}

// What lies in folders that are there alone: what goes meanwhile is not made again.
Status MakeIn(const fs::path& folder) {
  std::error_code error;
  fs::create_directory(folder, error);
  return error ? Status::Failed("cannot make " + folder.string() + ": " + error.message()) : Status::Ok();
}

// The answer is whole once its own file is there.
Result<size_t> Answer(const fs::path& store, const fs::path& results, const ShardPlan& plan, const Ask& ask,
                      std::vector<std::string>& problems) {
  const db::ReaderId reader = db::IdOf(ask.reader);
  SLX_ASSIGN_OR_RETURN(const ShardKeys found, KeysOf(store, plan, ask.shard));
  const fs::path folder = AnswerFolder(results, reader);
  SLX_RETURN_IF_ERROR(MakeIn(folder));
  for (size_t i = 0; i < found.keys.size(); ++i) {
    const std::string& session = found.sessions[i];
    SLX_RETURN_IF_ERROR(db::LogAccess(
        store.string(), "batch keys", session,
        "to shard " + ToText(ask.shard) + " of " + results.string() + ", which asked as " + db::ToHex(reader)));
    SLX_RETURN_IF_ERROR(MakeIn(folder / session));
    SLX_RETURN_IF_ERROR(db::WriteSealedKey(folder / session, session, found.keys[i], ask.reader));
  }
  problems.insert(problems.end(), found.missing.begin(), found.missing.end());
  const Json answer = {{"schema", kSchema}, {"sessions", found.sessions}, {"missing", found.missing}};
  SLX_RETURN_IF_ERROR(
      db::ReplaceFile(folder / kAnswerFile, answer.dump(1, ' ', false, Json::error_handler_t::replace) + "\n"));
  return found.keys.size();
}

Result<std::vector<db::SessionKey>> OpenAnswer(const fs::path& folder, const db::ReaderKey& own, const ShardPlan& plan,
                                               const Shard& shard, Logger& logger) {
  std::vector<std::string> sessions, missing;
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(folder / kAnswerFile));
  SLX_RETURN_IF_ERROR(ParseMessage(folder / kAnswerFile, text, [&](const Json& json) {
    json.at("sessions").get_to(sessions);
    json.at("missing").get_to(missing);
  }));
  const std::vector<size_t> places = VisitsOf(plan, shard);
  std::vector<db::SessionKey> keys;
  for (const std::string& session : sessions) {
    if (std::none_of(places.begin(), places.end(), [&](size_t place) { return plan.visits[place].session == session; }))
      return Status::Integrity((folder / kAnswerFile).string() + ": '" + session + "' does not belong to shard " +
                               ToText(shard));
    const fs::path file = db::SealedKeyFile(folder / session, db::IdOf(own.public_key()));
    const auto header = db::ReadSealedKeyHeader(file);
    const auto key = header.ok() ? db::OpenSealedKey(folder / session, session, header->key, own)
                                 : Result<db::SessionKey>(header.status());
    if (key.ok())
      keys.push_back(*key);
    else
      logger.Warning(key.status().message());
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
  SLX_RETURN_IF_ERROR(db::MakeFolder(results / kKeysFolder));
  std::error_code error;
  fs::permissions(results / kKeysFolder, fs::perms::owner_all, error);  // of another user's, who answers or refuses
  const StandingAsk standing(file, folder);
  const Json ask = {
      {"schema", kSchema}, {"plan", plan.id}, {"shard", ToText(shard)}, {"reader", db::ToText(own.public_key())}};
  SLX_RETURN_IF_ERROR(db::ReplaceFile(file, ask.dump(1) + "\n"));
  logger.Info("asking for the keys of shard " + ToText(shard) + " as " + db::ToHex(reader) + " ...");
  const auto end = std::chrono::steady_clock::now() + wait;
  while (!fs::exists(folder / kAnswerFile, error)) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
    if (left.count() <= 0)
      return Status(StatusCode::kNotFound,
                    Formatted("nobody answered %s within %.1f min: run `stratalux-fit batch keys --answer` where the "
                              "reader's key is",
                              file.c_str(), std::chrono::duration<double, std::ratio<60>>(wait).count()));
    pollfd asked{stop, POLLIN, 0};
    if (poll(&asked, 1, static_cast<int>(std::min(left, every).count())) > 0)
      return Status(StatusCode::kTryAgain, "stopped while it waited for the keys of shard " + ToText(shard));
  }
  return OpenAnswer(folder, own, plan, shard, logger);
}

KeyAnswers AnswerAsks(const fs::path& store, const fs::path& results, const ShardPlan& plan) {
  KeyAnswers answers;
  const auto refuse = [&answers](const std::string& why) { answers.problems.push_back(why); };
  const fs::path keys = results / kKeysFolder;
  struct stat info {};
  if (lstat(keys.c_str(), &info) != 0) {
    if (errno != ENOENT) refuse("cannot look at " + keys.string() + ": " + std::strerror(errno));
    return answers;
  }
  if (!S_ISDIR(info.st_mode)) {
    refuse(keys.string() + " is not a folder: nobody is answered");
    return answers;
  }
  const uid_t asker = AskersOf(results);
  if (const Status own = CheckOwner(keys, info, asker); !own.ok()) {
    refuse(own.message());
    return answers;
  }
  const auto lock = db::FileLock::TryTake(results / kAnswerLock,
                                          "another program already answers the requests in " + results.string());
  if (!lock.ok()) {
    refuse(lock.status().message());
    return answers;
  }
  std::vector<std::string> readers;
  std::error_code error;
  for (auto entry = fs::directory_iterator(keys, error); !error && entry != fs::directory_iterator();
       entry.increment(error)) {
    const std::string name = entry->path().filename().string();
    if (name.starts_with(kAskStart) && name.ends_with(kAskEnd))
      readers.push_back(
          name.substr(std::strlen(kAskStart), name.size() - std::strlen(kAskStart) - std::strlen(kAskEnd)));
  }
  if (error) refuse("cannot read " + keys.string() + ": " + error.message());
  std::sort(readers.begin(), readers.end());
  for (const std::string& reader : readers) {
    const fs::path file = keys / (kAskStart + reader + kAskEnd), folder = keys / reader;
    // Before the ask is read: who has read its answer removes the ask first.
    if (fs::exists(folder / kAnswerFile, error)) continue;
    const auto ask = ReadAsk(results, file, asker, plan);
    if (ask.status().code() == StatusCode::kNotFound) continue;
    const auto sent = ask.ok() ? Answer(store, results, plan, *ask, answers.problems) : Result<size_t>(ask.status());
    if (sent.ok()) {
      ++answers.answered;  // also who has taken it already
      answers.keys += *sent;
    }
    // Of an asker that ended nobody opens what was sealed to it; of one that has read it the folder went before.
    if (ask.ok() && IsGone(file))
      fs::remove_all(folder, error);
    else if (!sent.ok())
      refuse(sent.status().message());
  }
  return answers;
}

}  // namespace stratalux::fit
