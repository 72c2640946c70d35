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
#include "db/base/memory_folder.h"
#include "fitter/pipeline/interruption.h"
#include "fitter/pipeline/stopwatch.h"
#include "shared/base/version.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

constexpr const char* kMaking = ".making-";
constexpr const char* kLock = ".lock-";
constexpr auto kLookAgain = milliseconds(50);

fs::path NewMakingFolder(const fs::path& folder, const std::string& name) {
  std::random_device random;
  return folder / (kMaking + name + "-" + std::to_string(getpid()) + "-" + std::to_string(random()));
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

// Its name, size and kind are asked before it is read, its bytes where they then lie.
Status CopyInto(const fs::path& making, const fs::path& made, const db::ArtifactRecord& record,
                const db::RecordedFile& file) {
  db::ArtifactRecord one = record;
  one.files = {file};
  SLX_RETURN_IF_ERROR(db::CheckArtifactFiles(made, one, db::FileDepth::kSizes));
  SLX_RETURN_IF_ERROR(MakeFoldersBelow(making, fs::path(file.name).parent_path()));
  std::error_code error;
  fs::copy_file(made / file.name, making / file.name, error);
  return error ? Status::Failed("cannot copy " + (made / file.name).string() + ": " + error.message()) : Status::Ok();
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

Result<ArtifactStore> ArtifactStore::Open(const fs::path& session_folder, PlainFiles files, Logger& logger) {
  ArtifactStore store(session_folder / db::kArtifactsFolder, std::move(files), logger);
  // One level: the folder of a session that was forgotten stays gone.
  if (mkdir(store.folder_.c_str(), 0750) != 0 && errno != EEXIST)
    return Status::Failed("cannot create " + store.folder_.string() + ": " + std::strerror(errno));
  store.RemoveLeftovers();
  return store;
}

void ArtifactStore::RemoveLeftovers() {
  db::RemoveAbandonedMemory();
  std::error_code error;
  std::multimap<std::string, fs::path> left;  // by what the lock is of
  for (const auto& entry : fs::directory_iterator(folder_, error)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with(kMaking)) left.emplace(NameMadeIn(name), entry.path());
    if (name.starts_with(kLock)) left.emplace(name.substr(std::strlen(kLock)), fs::path());
  }
  for (const auto& [name, making] : left) {
    // Whoever makes it holds its lock. The lock's own file goes with ours.
    const auto lock = KeyLock::Try(folder_ / (kLock + name));
    if (lock.ok() && lock->held() && !making.empty()) fs::remove_all(making, error);
  }
}

Result<KeyLock> ArtifactStore::TryLock(const std::string& name) const { return KeyLock::Try(folder_ / (kLock + name)); }

Result<KeyLock> ArtifactStore::Lock(const std::string& name, const std::string& what_for) const {
  for (bool said = false;; said = true) {
    SLX_ASSIGN_OR_RETURN(auto lock, TryLock(name));
    if (lock.held()) return lock;
    if (!said) logger_.get().Info("waiting for another run that " + what_for);
    std::this_thread::sleep_for(kLookAgain);
  }
}

bool ArtifactStore::Has(const db::ArtifactIdentity& identity) const {
  std::error_code error;
  return fs::exists(FolderOf(identity), error);
}

Result<Artifact> ArtifactStore::Read(const db::ArtifactIdentity& identity) {
  Artifact artifact{FolderOf(identity), {}};
  const std::string name = identity.FolderName();
  const auto check = [&]() -> Status {
    auto record = db::ReadArtifactRecord(artifact.folder);
    // A folder gets this name with all that is in it.
    if (record.status().code() == StatusCode::kNotFound && Has(identity))
      return Status::Integrity((artifact.folder / db::kArtifactRecordFile).string() + " is missing");
    SLX_RETURN_IF_ERROR(record.status());
    artifact.record = std::move(*record);
    return db::CheckArtifactFiles(artifact.folder, artifact.record,
                                  hashed_.contains(name) ? db::FileDepth::kSizes : db::FileDepth::kHashes);
  };
  const Status whole = check();
  if (whole.code() == StatusCode::kIntegrity)
    return Status(whole.code(), whole.message() +
                                    ": it was changed after it was made; `stratalux-fit clean --damaged` removes such "
                                    "artifacts, and the next run makes them again");
  SLX_RETURN_IF_ERROR(whole);
  hashed_.insert(name);
  return artifact;
}

Status ArtifactStore::ReadFiles(const Artifact& artifact, const UseOfFolder& read) {
  const std::string name = artifact.folder.filename().string();
  const auto places = [&](const std::string& file) { return std::set{db::PlaceOfArtifact(name, file)}; };
  return files_.Read(artifact.folder, places, {db::kArtifactRecordFile}, read);
}

Status ArtifactStore::Beside(const std::string& name, const UseOfFolder& use) const {
  const fs::path making = NewMakingFolder(folder_, name);
  const RemovedOnSignal guard(making);
  const auto made = [&]() -> Status {
    {
      const NotInterrupted whole;
      if (mkdir(making.c_str(), 0750) != 0)
        return Status::Failed("cannot create " + making.string() + ": " + std::strerror(errno));
    }
    return use(making);
  };
  const Status used = made();
  std::error_code error;
  fs::remove_all(making, error);
  return used;
}

Status ArtifactStore::PutInPlace(const db::ArtifactIdentity& identity,
                                 const std::function<Result<db::ArtifactRecord>(const fs::path& making)>& fill) const {
  return Beside(identity.FolderName(), [&](const fs::path& making) -> Status {
    SLX_ASSIGN_OR_RETURN(const db::ArtifactRecord record, fill(making));
    SLX_RETURN_IF_ERROR(MakeReadOnly(making));
    SLX_RETURN_IF_ERROR(db::SyncTree(making));
    const fs::path place = FolderOf(identity);
    const NotInterrupted whole;  // what is being removed gets no name
    if (rename(making.c_str(), place.c_str()) != 0) {
      if (errno != EEXIST && errno != ENOTEMPTY)
        return Status::Failed("cannot move " + making.string() + " to " + place.string() + ": " + std::strerror(errno));
      HoldAgainstFirst(place, record);
    }
    return db::SyncFolder(folder_);
  });
}

Status ArtifactStore::Make(const db::ArtifactIdentity& identity, const UseOfFolder& make) {
  const Stopwatch watch;
  const auto fill = [&](const fs::path& making) -> Result<db::ArtifactRecord> {
    SLX_RETURN_IF_ERROR(files_.Write(making, std::string(db::kArtifactsFolder) + "/" + identity.FolderName(), make));
    db::ArtifactRecord record{identity, {}, watch.Seconds(), watch.CpuSeconds(), PeakRssBytes(), kVersion, WallNow()};
    SLX_ASSIGN_OR_RETURN(record.files, db::ListFiles(making, db::kArtifactRecordFile));
    SLX_RETURN_IF_ERROR(db::ReplaceFile(making / db::kArtifactRecordFile, ToJson(record)));
    return record;
  };
  const Status made = PutInPlace(identity, fill);
  made_ += made.ok() ? 1 : 0;
  return made;
}

Status ArtifactStore::Adopt(const fs::path& made) {
  SLX_ASSIGN_OR_RETURN(const db::ArtifactRecord record, db::ReadArtifactRecord(made));
  const std::string name = record.identity.FolderName();
  if (record.identity.seal != files_.seal().key_id())
    return Status::Integrity(made.string() + " is not sealed as its session is");
  if (Has(record.identity)) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const KeyLock lock, Lock(name, "adopts '" + record.identity.stage + "'"));
  if (Has(record.identity)) return Status::Ok();
  return PutInPlace(record.identity, [&](const fs::path& making) -> Result<db::ArtifactRecord> {
    for (const db::RecordedFile& file : record.files) SLX_RETURN_IF_ERROR(CopyInto(making, made, record, file));
    SLX_RETURN_IF_ERROR(db::ReplaceFile(making / db::kArtifactRecordFile, ToJson(record)));
    SLX_RETURN_IF_ERROR(
        db::CheckArtifactFiles(making, record, db::FileDepth::kHashes).WithContext("from " + made.string()));
    return record;
  });
}

// Made at the same time where this lock does not reach, on another machine. The first one stays.
void ArtifactStore::HoldAgainstFirst(const fs::path& place, const db::ArtifactRecord& own) const {
  const auto first = db::ReadArtifactRecord(place);
  if (!first.ok()) return;  // damaged: who reads it says so
  for (const db::RecordedFile& file : own.files)
    if (std::ranges::find(first->files, file) == first->files.end())
      return logger_.get().Warning(place.string() + ": made twice at once, and " + file.name +
                                   " came out differently; the first one is kept. A stage depends on something that is "
                                   "not in its key: please report it, with both machines' processors");
}

Result<Artifact> ArtifactStore::Obtain(const db::ArtifactIdentity& identity, const UseOfFolder& make) {
  if (!Has(identity)) {
    SLX_ASSIGN_OR_RETURN(const KeyLock lock, Lock(identity.FolderName(), "makes '" + identity.stage + "'"));
    if (!Has(identity)) SLX_RETURN_IF_ERROR(Make(identity, make));
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

// The folder itself: locked by runs together, by a cleaning alone; the kernel drops it with the process.
Result<UniqueFd> ArtifactStore::Flock(int operation) const {
  UniqueFd fd(open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd.ok()) return Status::Failed("cannot lock " + folder_.string() + ": " + std::strerror(errno));
  while (flock(fd.get(), operation) != 0) {
    if (errno == EINTR) continue;
    if (errno == EWOULDBLOCK)
      return Status::Busy("a run works on the artifacts in " + folder_.string() + "; clean up once it has ended");
    return Status::Failed("cannot lock " + folder_.string() + ": " + std::strerror(errno));
  }
  return fd;
}

Result<UniqueFd> ArtifactStore::Use() const { return Flock(LOCK_SH); }

Result<CleanReport> ArtifactStore::Clean(const std::function<Result<std::set<std::string>>()>& wanted_by_fits,
                                         const CleanOptions& options) {
  UniqueFd alone;
  if (!options.dry_run) {
    SLX_ASSIGN_OR_RETURN(alone, Flock(LOCK_EX | LOCK_NB));
  }
  SLX_ASSIGN_OR_RETURN(const std::set<std::string> wanted, wanted_by_fits());
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
    const bool plain = record.ok() && record->identity.seal != files_.seal().key_id();  // or of no seal of this session
    const bool goes =
        damaged || plain || (!options.damaged_only && !wanted.contains(name) && age_days >= options.keep_days);
    const auto lock = TryLock(name);
    if (!goes || !lock.ok() || !lock->held()) {
      ++report.kept;
      continue;
    }
    report.removed.push_back(name);
    report.bytes += BytesOf(folder);
    if (options.dry_run) continue;
    // By a name that nobody reads, so that no half of it is ever found.
    const fs::path aside = NewMakingFolder(folder_, name);
    const RemovedOnSignal guard(aside);
    fs::rename(folder, aside, error);
    if (!error) fs::remove_all(aside, error);
    if (error) return Status::Failed("cannot remove " + folder.string() + ": " + error.message());
  }
  return report;
}

}  // namespace stratalux::fit
