// SPDX-License-Identifier: Apache-2.0
// The folder of a backup while it is brought up to date. Until backup.json is replaced, everything that the old one
// lists keeps its bytes: a new version of a listed file waits beside it. Broken off anywhere, the folder is a whole
// backup (the old one or the new one) and the next run goes on. Internal to db/transfer.
#pragma once

#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "db/transfer/backup.h"
#include "db/transfer/file_list.h"

namespace stratalux::db {

// The new version of a listed file, until the list names it.
[[nodiscard]] std::filesystem::path WaitingFile(const std::filesystem::path& file);

class BackupFolder {
 public:
  // Reads what is there and ends what an earlier run began. kNewerSchema for a backup of a later version.
  static Result<BackupFolder> Open(const std::filesystem::path& store, const std::filesystem::path& to,
                                   BackupReport& report);

  // Every file of sessions/<id>: the new and changed ones verified as a session first. Whatever cannot be read, is
  // damaged or changes under it twice: kIntegrity or the like, and the session's last good copy stays listed. kFailed:
  // the backup cannot be written.
  Status CopySession(const std::string& id);
  // What the earlier backup holds of the session stays in this one. False where it holds nothing.
  bool KeepSession(const std::string& id);
  void DropSession(const std::string& id);
  // `path` is in this backup.
  [[nodiscard]] bool Holds(const std::string& path) const { return list_.files.contains(path); }
  Status CopyFile(const std::string& path);
  // `beside` becomes `path` of the backup.
  Status PlaceFile(const std::filesystem::path& beside, const std::string& path);
  // Sessions of the earlier backup.
  [[nodiscard]] std::set<std::string> EarlierSessions() const;
  // Rereads those copies whose last check is the longest ago, and mends what rotted from the store.
  Status Scrub(ScrubShare share);
  // The list, the waiting files, and only then the removal of what no list names.
  Status Finish();

 private:
  BackupFolder(std::filesystem::path store, std::filesystem::path to, BackupReport& report)
      : store_(std::move(store)), to_(std::move(to)), report_(&report) {}
  Status GoOn();
  [[nodiscard]] bool Unchanged(const std::string& path, const ListedFile& known) const;
  [[nodiscard]] bool TakeFromJournal(const std::string& path);
  [[nodiscard]] Result<std::vector<std::string>> FilesOf(const std::string& id) const;
  // path -> time and size of what makes the session; fits are their own affair.
  using Seen = std::map<std::string, std::pair<int64_t, int64_t>>;
  [[nodiscard]] Result<Seen> LookAt(const std::string& id) const;
  Status CopyOnce(const std::string& id);
  [[nodiscard]] bool MustVerify(const std::string& id, const std::vector<std::string>& files) const;
  Status Mend(const std::string& path, ListedFile& file);
  Status Note(const std::string& path, const ListedFile& file);
  Status RemoveOthers();

  std::filesystem::path store_, to_;
  BackupReport* report_;
  FileList earlier_, list_;
  std::map<std::string, ListedFile> journal_;  // what an interrupted run had copied
  std::set<std::string> waiting_, kept_;       // paths: new version beside the old one; copied by an earlier backup
};

}  // namespace stratalux::db
