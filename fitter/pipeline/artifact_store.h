// SPDX-License-Identifier: Apache-2.0
// The artifacts of one session (db/catalogue/artifact_record.h): found by key, or made beside and renamed.
//
// Made in artifacts/.making-<key>-<pid>-<random>/ under a lock of the key, which a second run waits for and then reads
// what the first has made, or takes over when that has died. Files and folder are synced, the files read-only, before
// the folder gets its name. Of an encrypted session they are sealed (plain_files.h), and what an older program left
// plain is of another key, hence not found. If the name exists by then, the own one is thrown away: equal by
// definition.
//
// Processes may share a store; an ArtifactStore is bound to a thread.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "db/catalogue/artifact_record.h"
#include "fitter/pipeline/key_lock.h"
#include "fitter/pipeline/plain_files.h"
#include "shared/base/log.h"
#include "shared/base/unique_fd.h"

namespace stratalux::fit {

// One whole artifact, its files checked.
struct Artifact {
  std::filesystem::path folder;
  db::ArtifactRecord record;
};

// What went, or would go, and what was kept.
struct CleanReport {
  std::vector<std::string> removed;  // folder names
  int64_t bytes = 0;                 // of those
  std::vector<std::string> sealed;   // fits that lay plain in an encrypted session
  int kept = 0;
};

struct CleanOptions {
  bool damaged_only = false;  // those whose files are not what their record says or must not be, and nothing else
  double keep_days = 0.0;     // younger ones stay
  bool dry_run = false;
};

class ArtifactStore {
 public:
  // `session_folder`: STORE/sessions/<id>. Removes what killed runs left half made, or in memory.
  static Result<ArtifactStore> Open(const std::filesystem::path& session_folder, PlainFiles files, Logger& logger);

  [[nodiscard]] std::filesystem::path FolderOf(const db::ArtifactIdentity& identity) const {
    return folder_ / identity.FolderName();
  }
  [[nodiscard]] bool Has(const db::ArtifactIdentity& identity) const;
  // Sizes are checked always, hashes the first time that this process reads the artifact. kNotFound: not there;
  // kIntegrity names the file.
  [[nodiscard]] Result<Artifact> Read(const db::ArtifactIdentity& identity);
  // The artifact, made by `make` into the folder that it is given where it is not there yet. `making`, if there is one,
  // is told before that, under the lock.
  [[nodiscard]] Result<Artifact> Obtain(const db::ArtifactIdentity& identity, const UseOfFolder& make);
  // One that was made elsewhere, in a folder of its name: copied, held against its record, and put in its place, unless
  // that is there already. kIntegrity for what is damaged, sealed under another key, or plain of an encrypted session;
  // `made` stays.
  Status Adopt(const std::filesystem::path& made);
  // `use` gets an empty folder beside the artifacts, on their disk, gone when it returns, and with the next run where
  // this one is killed. The caller holds the lock of `name`.
  Status Beside(const std::string& name, const UseOfFolder& use) const;
  // `read` finds its files in the folder it is given, for as long as it runs.
  Status ReadFiles(const Artifact& artifact, const UseOfFolder& read);
  // Records of all artifacts of a stage, the newest first; damaged ones are left out.
  [[nodiscard]] std::vector<db::ArtifactRecord> OfStage(const std::string& stage) const;
  // Until its descriptor is closed no artifact is removed: what a run has made it still has to read.
  [[nodiscard]] Result<UniqueFd> Use() const;
  // Removes artifacts that are not wanted and that no lock holds, and whatever is damaged or, of an encrypted session,
  // plain. kBusy while a run uses them. Whose folder names are wanted is asked when no run can enter another fit.
  [[nodiscard]] Result<CleanReport> Clean(const std::function<Result<std::set<std::string>>()>& wanted_by_fits,
                                          const CleanOptions& options);

  // The lock of an artifact's folder name, or of another name that the runs of a session agree on. Lock() waits, and
  // says that it waits for another run that `what_for`.
  [[nodiscard]] Result<KeyLock> TryLock(const std::string& name) const;
  [[nodiscard]] Result<KeyLock> Lock(const std::string& name, const std::string& what_for) const;

  // Artifacts that this one made, and found made.
  [[nodiscard]] int made() const { return made_; }
  [[nodiscard]] PlainFiles& files() { return files_; }

 private:
  ArtifactStore(std::filesystem::path folder, PlainFiles files, Logger& logger)
      : folder_(std::move(folder)), files_(std::move(files)), logger_(logger) {}
  Status Make(const db::ArtifactIdentity& identity, const UseOfFolder& make);
  // What `fill` puts into a folder, its record included, synced, read-only and by its name.
  Status PutInPlace(const db::ArtifactIdentity& identity,
                    const std::function<Result<db::ArtifactRecord>(const std::filesystem::path& making)>& fill) const;
  void HoldAgainstFirst(const std::filesystem::path& place, const db::ArtifactRecord& own) const;
  void RemoveLeftovers();
  [[nodiscard]] Result<UniqueFd> Flock(int operation) const;

  std::filesystem::path folder_;  // artifacts/
  PlainFiles files_;
  std::reference_wrapper<Logger> logger_;
  std::set<std::string> hashed_;  // folder names that this process has hashed
  int made_ = 0;
};

}  // namespace stratalux::fit
