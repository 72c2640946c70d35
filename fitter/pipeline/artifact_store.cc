// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/artifact_store.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <random>
#include <thread>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "fitter/pipeline/interruption.h"
#include "fitter/pipeline/stopwatch.h"
#include "shared/base/unique_fd.h"
#include "shared/base/version.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

constexpr const char* kMaking = ".making-";
constexpr const char* kLock = ".lock-";
constexpr auto kLookAgain = milliseconds(50);

// The lock of a key, held by one process at a time; the kernel drops it with the process. Its file is removed while it
// is held, so who got a lock looks whether the name still leads to the file that it has locked.
class KeyLock {
 public:
  static Result<KeyLock> Try(const fs::path& file, bool& held_by_another) {
    held_by_another = false;
    UniqueFd fd(open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0640));
    if (!fd.ok()) return Status::Failed("cannot lock " + file.string() + ": " + std::strerror(errno));
    struct stat mine {
    }, named{};
    const bool locked = flock(fd.get(), LOCK_EX | LOCK_NB) == 0;
    held_by_another = !locked || fstat(fd.get(), &mine) != 0 || lstat(file.c_str(), &named) != 0 ||
                      mine.st_ino != named.st_ino || mine.st_dev != named.st_dev;
    if (held_by_another) return KeyLock();
    const std::string pid = std::to_string(getpid()) + "\n";
    static_cast<void>(!write(fd.get(), pid.data(), pid.size()));  // for people
    KeyLock lock;
    lock.fd_ = std::move(fd);
    lock.file_ = file;
    return lock;
  }
  KeyLock() = default;
  KeyLock(KeyLock&& other) noexcept : fd_(std::move(other.fd_)), file_(std::exchange(other.file_, {})) {}
  KeyLock& operator=(KeyLock&&) = delete;
  ~KeyLock() {
    std::error_code error;
    if (!file_.empty()) fs::remove(file_, error);
  }

 private:
  UniqueFd fd_;
  fs::path file_;
};

Result<fs::path> NewMakingFolder(const fs::path& folder, const std::string& name) {
  std::random_device random;
  fs::path making = folder / (kMaking + name + "-" + std::to_string(getpid()) + "-" + std::to_string(random()));
  if (mkdir(making.c_str(), 0750) != 0)
    return Status::Failed("cannot create " + making.string() + ": " + std::strerror(errno));
  return making;
}

// ".making-<stage>-<key>-<pid>-<random>" -> "<stage>-<key>".
std::string NameMadeIn(const std::string& making) {
  std::string name = making.substr(std::strlen(kMaking));
  for (int part = 0; part < 2; ++part) name = name.substr(0, name.rfind('-'));
  return name;
}

Status MakeReadOnly(const fs::path& folder) {
  std::error_code error;
  for (auto entry = fs::recursive_directory_iterator(folder, error); !error && entry != fs::end(entry);
       entry.increment(error))
    if (entry->is_regular_file(error) && chmod(entry->path().c_str(), 0440) != 0)
      return Status::Failed("cannot protect " + entry->path().string() + ": " + std::strerror(errno));
  return error ? Status::Failed("cannot read " + folder.string() + ": " + error.message()) : Status::Ok();
}

int64_t BytesOf(const fs::path& folder) {
  int64_t bytes = 0;
  std::error_code error, unknown;
  for (auto entry = fs::recursive_directory_iterator(folder, error); !error && entry != fs::end(entry);
       entry.increment(error))
    if (entry->is_regular_file(unknown)) bytes += static_cast<int64_t>(entry->file_size(unknown));
  return bytes;
}

}  // namespace

Result<ArtifactStore> ArtifactStore::Open(const fs::path& session_folder, Logger& logger) {
  ArtifactStore store(session_folder / db::kArtifactsFolder, logger);
  // One level: the folder of a session that was forgotten stays gone.
  if (mkdir(store.folder_.c_str(), 0750) != 0 && errno != EEXIST)
    return Status::Failed("cannot create " + store.folder_.string() + ": " + std::strerror(errno));
  store.RemoveLeftovers();
  return store;
}

void ArtifactStore::RemoveLeftovers() {
  std::error_code error;
  std::vector<fs::path> left;
  for (const auto& entry : fs::directory_iterator(folder_, error))
    if (entry.path().filename().string().starts_with(kMaking)) left.push_back(entry.path());
  for (const fs::path& making : left) {
    // Whoever makes it holds its lock.
    bool at_work = false;
    const auto lock = KeyLock::Try(folder_ / (kLock + NameMadeIn(making.filename().string())), at_work);
    if (lock.ok() && !at_work) fs::remove_all(making, error);
  }
}

bool ArtifactStore::Has(const db::ArtifactIdentity& identity) const {
  std::error_code error;
  return fs::exists(FolderOf(identity) / db::kArtifactRecordFile, error);
}

Result<Artifact> ArtifactStore::Read(const db::ArtifactIdentity& identity) {
  Artifact artifact{FolderOf(identity), {}};
  SLX_ASSIGN_OR_RETURN(artifact.record, db::ReadArtifactRecord(artifact.folder));
  const std::string name = identity.FolderName();
  const auto depth = hashed_.contains(name) ? db::FileDepth::kSizes : db::FileDepth::kHashes;
  if (Status whole = db::CheckArtifactFiles(artifact.folder, artifact.record, depth); !whole.ok())
    return Status(whole.code(), whole.message() +
                                    ": it was changed after it was made; `stratalux-fit clean --damaged` removes such "
                                    "artifacts, and the next run makes them again");
  hashed_.insert(name);
  return artifact;
}

Status ArtifactStore::Make(const db::ArtifactIdentity& identity, const std::function<Status(const fs::path&)>& make) {
  const std::string name = identity.FolderName();
  SLX_ASSIGN_OR_RETURN(const fs::path making, NewMakingFolder(folder_, name));
  const RemovedOnSignal guard(making);
  const auto publish = [&]() -> Status {
    const Stopwatch watch;
    SLX_RETURN_IF_ERROR(make(making));
    db::ArtifactRecord record{identity, {}, watch.Seconds(), watch.CpuSeconds(), PeakRssBytes(), kVersion, WallNow()};
    SLX_ASSIGN_OR_RETURN(record.files, db::ListFiles(making, db::kArtifactRecordFile));
    SLX_RETURN_IF_ERROR(db::ReplaceFile(making / db::kArtifactRecordFile, ToJson(record)));
    SLX_RETURN_IF_ERROR(MakeReadOnly(making));
    SLX_RETURN_IF_ERROR(db::SyncTree(making));
    const fs::path place = folder_ / name;
    if (rename(making.c_str(), place.c_str()) != 0 && errno != EEXIST && errno != ENOTEMPTY)
      return Status::Failed("cannot move " + making.string() + " to " + place.string() + ": " + std::strerror(errno));
    return db::SyncFolder(folder_);
  };
  const Status made = publish();
  std::error_code error;
  fs::remove_all(making, error);  // of a failure, or of one that came second
  made_ += made.ok() ? 1 : 0;
  return made;
}

Result<Artifact> ArtifactStore::Obtain(const db::ArtifactIdentity& identity,
                                       const std::function<Status(const fs::path&)>& make) {
  const fs::path lock_file = folder_ / (kLock + identity.FolderName());
  bool said = false;
  while (!Has(identity)) {
    bool at_work = false;
    SLX_ASSIGN_OR_RETURN(const KeyLock lock, KeyLock::Try(lock_file, at_work));
    if (!at_work) {
      if (!Has(identity)) SLX_RETURN_IF_ERROR(Make(identity, make));
      break;
    }
    if (!std::exchange(said, true)) logger_.get().Info("waiting for another run that makes '" + identity.stage + "'");
    std::this_thread::sleep_for(kLookAgain);
  }
  return Read(identity);
}

std::vector<db::ArtifactRecord> ArtifactStore::OfStage(const std::string& stage) const {
  std::vector<db::ArtifactRecord> records;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder_, error)) {
    if (!entry.path().filename().string().starts_with(stage + "-")) continue;
    auto record = db::ReadArtifactRecord(entry.path());
    if (record.ok() && record->identity.stage == stage) records.push_back(std::move(*record));
  }
  std::sort(records.begin(), records.end(), [](const db::ArtifactRecord& a, const db::ArtifactRecord& b) {
    return a.finished_wall.ns > b.finished_wall.ns;
  });
  return records;
}

Result<CleanReport> ArtifactStore::Clean(const std::set<std::string>& wanted, const CleanOptions& options) {
  CleanReport report;
  std::error_code error;
  std::vector<fs::path> all;
  for (const auto& entry : fs::directory_iterator(folder_, error))
    if (!entry.path().filename().string().starts_with(".")) all.push_back(entry.path());
  std::sort(all.begin(), all.end());
  for (const fs::path& folder : all) {
    const std::string name = folder.filename().string();
    const auto record = db::ReadArtifactRecord(folder);
    const bool damaged = !record.ok() || !db::CheckArtifactFiles(folder, *record, db::FileDepth::kHashes).ok();
    const double age_days =
        record.ok() ? 1e-9 * static_cast<double>(WallNow().ns - record->finished_wall.ns) / 86400.0 : 0;
    const bool goes = damaged || (!options.damaged_only && !wanted.contains(name) && age_days >= options.keep_days);
    bool at_work = false;
    const auto lock = KeyLock::Try(folder_ / (kLock + name), at_work);
    if (!goes || !lock.ok() || at_work) {
      ++report.kept;
      continue;
    }
    report.removed.push_back(name);
    report.bytes += BytesOf(folder);
    if (options.dry_run) continue;
    // By a name that nobody reads, so that no half of it is ever found.
    const fs::path aside = folder_ / (kMaking + name + "-" + std::to_string(getpid()) + "-0");
    fs::rename(folder, aside, error);
    if (!error) fs::remove_all(aside, error);
    if (error) return Status::Failed("cannot remove " + folder.string() + ": " + error.message());
  }
  return report;
}

}  // namespace stratalux::fit
