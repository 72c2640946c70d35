// SPDX-License-Identifier: Apache-2.0
// A session folder from elsewhere becomes a session of this store: verified, moved into place, listed.
#pragma once

#include <filesystem>
#include <string>

#include "shared/base/result.h"

namespace stratalux::db {

// One transfer into a store at a time; the kernel drops it with the process.
class IncomingLock {
 public:
  // kBusy while another pull or restore runs.
  static Result<IncomingLock> Take(const std::filesystem::path& store);
  IncomingLock() = default;
  ~IncomingLock();
  IncomingLock(IncomingLock&& other) noexcept;
  IncomingLock& operator=(IncomingLock&& other) noexcept;

 private:
  int fd_ = -1;
};

// Every byte of a finished session's folder: manifest, each segment it names whole (and sealed, unless the session
// failed), each payload against its hash. kIntegrity names file and offset. Returns the number of frames.
[[nodiscard]] Result<int64_t> VerifyFolder(const std::filesystem::path& session_folder);

// Moves `folder` (on the same disk, verified) to STORE/sessions/<id> and inserts its rows. Its number is the next one
// of this store: sessions of elsewhere come behind those that are here, in the order in which they are adopted; no
// clock decides. place.json keeps the number for `reindex`. kUsage for a forgotten session, and for one that is there.
Status AdoptFolder(const std::filesystem::path& store, const std::filesystem::path& folder, const std::string& from);

// The rows of a folder that an earlier adoption moved, but could not list.
Status ListAdopted(const std::filesystem::path& store, const std::string& session_id, const std::string& from);

}  // namespace stratalux::db
