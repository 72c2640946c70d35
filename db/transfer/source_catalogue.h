// SPDX-License-Identifier: Apache-2.0
// What another store offers, by its manifests, its fits' records and its ledger; kept between pulls in
// STORE/incoming/.sources/<XXH3-64 of the source's name>, so that only what changed is sent again.
#pragma once

#include <cstdint>
#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "db/transfer/rsync.h"

namespace stratalux::db {

struct Offer {
  std::string id;
  int64_t number = 0;             // in the source
  std::vector<std::string> fits;  // ids
};

struct SourceOffers {
  std::vector<Offer> sessions;        // finished ones, in the order of the source: its numbers, which no clock decides
  std::set<std::string> folders;      // every id that the source still has a folder of
  std::set<std::string> unfinished;   // recording or failed there, or not fetched
  std::vector<std::string> problems;  // manifests that cannot be read, one a session
};

class SourceCatalogue {
 public:
  // `source`: as Rsync takes it, without a slash at its end.
  SourceCatalogue(std::filesystem::path store, std::string source, RsyncLimits limits);
  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }

  // Brings it up to date. Of the sessions in `forgotten` nothing is fetched. kNotFound where there is no store; a part
  // that could not be read is a problem, not an end.
  Status Fetch(const std::set<std::string>& forgotten, std::vector<std::string>& problems);
  [[nodiscard]] SourceOffers Read() const;
  // True where another source, when it was last asked, had the session.
  [[nodiscard]] bool OthersHave(const std::string& id) const;

  // A folder of the source (sessions/x), whole, into `target`; what is there already is not sent again. All but
  // segments, which carry their hashes, is compared by checksums once more: kIntegrity where it changed meanwhile.
  Status Copy(const std::string& path, const std::filesystem::path& target) const;

 private:
  const std::filesystem::path store_;
  const std::string source_;
  const std::filesystem::path folder_;
  const RsyncLimits limits_;
};

}  // namespace stratalux::db
