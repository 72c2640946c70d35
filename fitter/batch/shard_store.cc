// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/shard_store.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <random>
#include <utility>

#include <linux/magic.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/care/reindex.h"
#include "db/catalogue/artifact_record.h"
#include "db/catalogue/session_store.h"
#include "db/keys/sealed_key.h"
#include "db/ledger/ledger.h"
#include "fitter/batch/shard_manifest.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

constexpr const char* kName = "stratalux-shard-";
constexpr const char* kLock = ".lock";

// Those that Linux has, and whose locks or shared memory fail SQLite.
Status RefuseNetwork(const fs::path& scratch) {
  constexpr decltype(statfs::f_type) kCifs = 0xFF534D42, kLustre = 0x0BD00BD0, kCeph = 0x00C36400, kFuse = 0x65735546,
                                     kGpfs = 0x47504653, kBeeGfs = 0x19830326;
  struct statfs info {};
  if (statfs(scratch.c_str(), &info) != 0)
    return Status::NotFound("--scratch " + scratch.string() + ": " + std::strerror(errno));
  for (const auto network : {decltype(info.f_type){NFS_SUPER_MAGIC}, decltype(info.f_type){SMB_SUPER_MAGIC}, kCifs,
                             kLustre, kCeph, kFuse, kGpfs, kBeeGfs})
    if (info.f_type == network)
      return Status::Usage("--scratch " + scratch.string() +
                           " lies on a network file system, which SQLite does not support; give a folder on a disk "
                           "of this machine");
  return Status::Ok();
}

// Of shards that were killed: the lock, which is taken before the folder is made, went with them.
void RemoveLeftovers(const fs::path& scratch) {
  std::error_code error;
  std::vector<fs::path> left;
  for (const auto& entry : fs::directory_iterator(scratch, error)) {
    struct stat info {};
    if (entry.path().filename().string().starts_with(kName) && lstat(entry.path().c_str(), &info) == 0 &&
        S_ISDIR(info.st_mode) && info.st_uid == geteuid())
      left.push_back(entry.path());
  }
  for (const fs::path& folder : left) {
    const fs::path lock_file = folder.string() + kLock;
    const auto lock = db::FileLock::TryTake(lock_file, "a shard works in " + folder.string());
    if (!lock.ok()) continue;
    fs::remove_all(folder, error);
    fs::remove(lock_file, error);
  }
}

Status Link(const fs::path& to, const fs::path& from) {
  std::error_code error;
  fs::create_symlink(to, from, error);
  return error ? Status::Failed("cannot link " + from.string() + ": " + error.message()) : Status::Ok();
}

// A sealed key, which is no key without the reader's, is copied: what is read as one is no link of anybody's.
Status Bring(const fs::path& file, const fs::path& to) {
  if (!db::IsSealedKeyName(file.filename().string())) return Link(file, to);
  std::error_code error;
  fs::copy_file(file, to, error);
  return error ? Status::Failed("cannot copy " + file.string() + ": " + error.message()) : Status::Ok();
}

Status AddSession(const ShardStoreOptions& options, const fs::path& folder, const std::string& session) {
  const fs::path from = fs::absolute(options.store) / "sessions" / session, to = folder / "sessions" / session;
  std::error_code error;
  if (!fs::exists(from / "manifest.json", error))
    return Status::NotFound("session " + session + " is not in " + options.store.string() + " any more");
  fs::create_directory(to, error);
  for (const auto& entry : fs::directory_iterator(from, error))
    if (entry.is_regular_file() && entry.path().extension() != ".new")
      SLX_RETURN_IF_ERROR(Bring(entry.path(), to / entry.path().filename()));
  if (error) return Status::Failed("cannot read " + from.string() + ": " + error.message());
  for (const char* made : {db::kArtifactsFolder, "fits"}) {
    const fs::path place = fs::absolute(ResultsOf(options.results, session)) / made;
    SLX_RETURN_IF_ERROR(db::MakeFolder(place));
    SLX_RETURN_IF_ERROR(Link(place, to / made));
  }
  return Status::Ok();
}

}  // namespace

Status LedgerAllows(const fs::path& store, const std::string& session) {
  SLX_ASSIGN_OR_RETURN(const db::Ledger ledger, db::Ledger::Read(store));
  if (ledger.IsForgotten(session)) return Status::Usage("session " + session + " was forgotten");
  if (const auto withdrawn = ledger.WithdrawnAt(session))
    return Status::Usage("session " + session + ": its visitor's consent was withdrawn on " + ToIso8601(*withdrawn));
  return Status::Ok();
}

ShardStore::ShardStore(ShardStore&& other) noexcept
    : folder_(std::exchange(other.folder_, {})),
      lock_file_(std::exchange(other.lock_file_, {})),
      lock_(std::move(other.lock_)),
      troubles_(std::move(other.troubles_)) {}

ShardStore::~ShardStore() {
  std::error_code error;
  if (folder_.empty()) return;
  fs::remove_all(folder_, error);
  fs::remove(lock_file_, error);
}

Result<ShardStore> ShardStore::Make(const ShardStoreOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(RefuseNetwork(options.scratch));
  RemoveLeftovers(options.scratch);
  std::random_device random;
  ShardStore store;
  const fs::path folder =
      fs::absolute(options.scratch) / (kName + std::to_string(getpid()) + "-" + std::to_string(random()));
  store.lock_file_ = folder.string() + kLock;
  SLX_ASSIGN_OR_RETURN(store.lock_, db::FileLock::TryTake(store.lock_file_, store.lock_file_.string() + " is taken"));
  store.folder_ = folder;
  if (mkdir(folder.c_str(), 0700) != 0)
    return Status::Failed("cannot create " + folder.string() + ": " + std::strerror(errno));
  SLX_RETURN_IF_ERROR(db::MakeFolder(folder / "sessions"));
  SLX_RETURN_IF_ERROR(db::MergeLedger(folder, options.store / "ledger").status());
  for (const std::string& session : options.sessions)
    if (Status added = AddSession(options, folder, session); !added.ok()) store.troubles_[session] = std::move(added);
  SLX_ASSIGN_OR_RETURN(const db::ReindexReport report, db::Reindex(folder, logger));
  SLX_ASSIGN_OR_RETURN(const auto index, db::SessionStore::Open(folder, db::AccessMode::kReadOnly));
  for (const std::string& session : options.sessions) {
    if (index.FindSession(session).ok() || store.troubles_.contains(session)) continue;
    const auto said = std::find_if(report.problems.begin(), report.problems.end(), [&](const std::string& problem) {
      return problem.find(session) != std::string::npos;
    });
    store.troubles_[session] = Status::Integrity(said == report.problems.end() ? "cannot be listed" : *said);
  }
  return store;
}

Status ShardStore::Trouble(const std::string& session) const {
  const auto found = troubles_.find(session);
  return found == troubles_.end() ? Status::Ok() : found->second;
}

}  // namespace stratalux::fit
