// SPDX-License-Identifier: Apache-2.0
// STORE/incoming: what a pull or a restore is copying, before it is verified and listed (docs/file-formats.md, "Files
// of transfers"). A transfer that was broken off leaves it behind: whoever forgets, purges or verifies looks here, too.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/base/file_lock.h"
#include "shared/base/result.h"

namespace stratalux::db {

// One transfer into a store at a time.
class IncomingLock {
 public:
  // kBusy while another pull or restore runs.
  static Result<IncomingLock> Take(const std::filesystem::path& store);
  [[nodiscard]] static bool IsHeld(const std::filesystem::path& store);
  IncomingLock() = default;

 private:
  FileLock lock_;
};

// The places; none of them need exist. Names of sources and fits' sessions are folders of their own.
[[nodiscard]] std::filesystem::path IncomingFolder(const std::filesystem::path& store, const std::string& session_id);
[[nodiscard]] std::filesystem::path IncomingFits(const std::filesystem::path& store, const std::string& session_id);
[[nodiscard]] std::filesystem::path IncomingSources(const std::filesystem::path& store);
// What a forgetting has taken out of sessions/ and not deleted yet.
[[nodiscard]] std::filesystem::path ForgettingFolder(const std::filesystem::path& store);

// What was found of one session; the visitor as far as a manifest of it tells.
struct IncomingSession {
  std::string id, visitor;
  std::vector<std::filesystem::path> places;  // folders: of the session, of its fits
};
// By id. Catalogues of sources (manifests of sessions that were never asked for) are no leftovers and not in here.
[[nodiscard]] std::vector<IncomingSession> ListIncoming(const std::filesystem::path& store);

// The kept manifests in the catalogues of sources: a place for each source. None is opened: visitors stay empty.
[[nodiscard]] std::vector<IncomingSession> ListKeptManifests(const std::filesystem::path& store);

// All that lies in incoming/ of `sessions`, and of every session whose manifest there names one of `visitors`; the kept
// catalogues of sources included.
[[nodiscard]] std::vector<std::filesystem::path> IncomingPlaces(const std::filesystem::path& store,
                                                                const std::vector<std::string>& sessions,
                                                                const std::vector<std::string>& visitors = {});
// Overwrites and removes those. Returns the folders that went. Does not wait for a transfer
// that runs: that one asks for tombstones itself before and after each session.
[[nodiscard]] Result<std::vector<std::filesystem::path>> WipeIncoming(const std::filesystem::path& store,
                                                                      const std::vector<std::string>& sessions,
                                                                      const std::vector<std::string>& visitors = {});
// One folder, file by file: overwritten, then removed. kOk where there is none.
Status WipeFolder(const std::filesystem::path& folder);

}  // namespace stratalux::db
