// SPDX-License-Identifier: Apache-2.0
// The store that a shard works in: on this machine's own disk, since SQLite does not bear a network file system, with
// an index built from the sealed sessions, whose files it links to. What its workers make lies in
// RESULTS/sessions/<id>.
//
//   SCRATCH/stratalux-shard-<pid>-<random>/          removed with the shard; of one that was killed, by the next
//     ledger/                                        copies of the store's chains
//     sessions/<id>/{manifest.json, *.seg, ...}      links into the store
//     sessions/<id>/{artifacts, fits}                links into the results
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "db/base/file_lock.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct ShardStoreOptions {
  std::filesystem::path store;    // of the sealed sessions; only read, and nothing but sessions/ and ledger/
  std::filesystem::path results;  // written
  std::filesystem::path scratch;  // a folder of a disk of this machine
  std::vector<std::string> sessions;
};

class ShardStore {
 public:
  // Sessions that cannot be listed are told by Trouble() and keep no other from it. kUsage where scratch lies on a
  // network file system.
  [[nodiscard]] static Result<ShardStore> Make(const ShardStoreOptions& options, Logger& logger);
  ShardStore(ShardStore&& other) noexcept;
  ShardStore& operator=(ShardStore&&) = delete;
  ~ShardStore();

  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }
  // kOk for a session that is listed.
  [[nodiscard]] Status Trouble(const std::string& session) const;

 private:
  ShardStore() = default;
  std::filesystem::path folder_, lock_file_;
  db::FileLock lock_;
  std::map<std::string, Status> troubles_;
};

// What the ledger of the sealed sessions' store says, read anew: kUsage for a session that was forgotten or whose
// visitor's consent was withdrawn.
[[nodiscard]] Status LedgerAllows(const std::filesystem::path& store, const std::string& session);

}  // namespace stratalux::fit
