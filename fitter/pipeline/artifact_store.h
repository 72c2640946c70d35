// SPDX-License-Identifier: Apache-2.0
// The artifacts of one session (db/catalogue/artifact_record.h): found by key, or made beside and renamed.
//
// Made in artifacts/.making-<key>-<pid>-<random>/ under a lock of the key, which a second run waits for and then reads
// what the first has made, or takes over when that has died. Files and folder are synced, the files read-only, before
// the folder gets its name. If the name exists by then, the own one is thrown away: equal by definition.
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
  int kept = 0;
};

struct CleanOptions {
  bool damaged_only = false;  // those whose files are not what their record says, and nothing else
  double keep_days = 0.0;     // younger ones stay
  bool dry_run = false;
};

class ArtifactStore {
 public:
  // `session_folder`: STORE/sessions/<id>. Removes what killed runs left half made.
  static Result<ArtifactStore> Open(const std::filesystem::path& session_folder, Logger& logger);

  [[nodiscard]] std::filesystem::path FolderOf(const db::ArtifactIdentity& identity) const {
    return folder_ / identity.FolderName();
  }
  [[nodiscard]] bool Has(const db::ArtifactIdentity& identity) const;
  // Sizes are checked always, hashes the first time that this process reads the artifact. kNotFound: not there;
  // kIntegrity names the file.
  [[nodiscard]] Result<Artifact> Read(const db::ArtifactIdentity& identity);
  // The artifact, made by `make` into the folder that it is given where it is not there yet. `making`, if there is one,
  // is told before that, under the lock.
  [[nodiscard]] Result<Artifact> Obtain(const db::ArtifactIdentity& identity,
                                        const std::function<Status(const std::filesystem::path&)>& make);
  // Records of all artifacts of a stage, the newest first; damaged ones are left out.
  [[nodiscard]] std::vector<db::ArtifactRecord> OfStage(const std::string& stage) const;
  // Until its descriptor is closed no artifact is removed: what a run has made it still has to read.
  [[nodiscard]] Result<UniqueFd> Use() const;
  // Removes artifacts that no `wanted` folder name names and no lock holds. kBusy while a run uses them.
  [[nodiscard]] Result<CleanReport> Clean(const std::set<std::string>& wanted, const CleanOptions& options);

  // The lock of an artifact's folder name, or of another name that the runs of a session agree on. Lock() waits, and
  // says that it waits for another run that `what_for`.
  [[nodiscard]] Result<KeyLock> TryLock(const std::string& name) const;
  [[nodiscard]] Result<KeyLock> Lock(const std::string& name, const std::string& what_for) const;

  // Artifacts that this one made, and found made.
  [[nodiscard]] int made() const { return made_; }

 private:
  ArtifactStore(std::filesystem::path folder, Logger& logger) : folder_(std::move(folder)), logger_(logger) {}
  Status Make(const db::ArtifactIdentity& identity, const std::function<Status(const std::filesystem::path&)>& make);
  void RemoveLeftovers();
  [[nodiscard]] Result<UniqueFd> Flock(int operation) const;

  std::filesystem::path folder_;  // artifacts/
  std::reference_wrapper<Logger> logger_;
  std::set<std::string> hashed_;  // folder names that this process has hashed
  int made_ = 0;
};

}  // namespace stratalux::fit
