// SPDX-License-Identifier: Apache-2.0
#include "db/ledger/tombstone.h"

#include <algorithm>

namespace stratalux::db {

namespace fs = std::filesystem;

fs::path CertificateFile(const fs::path& store, const std::string& session_id) {
  return store / "deletions" / (session_id + ".json");
}

fs::path IntentFile(const fs::path& store, const std::string& session_id) {
  return store / "deletions" / (session_id + ".forgetting");
}

bool HasTombstone(const fs::path& store, const std::string& session_id) {
  if (session_id.empty() || session_id.find('/') != std::string::npos) return false;  // no id of ours
  std::error_code error;
  return fs::exists(CertificateFile(store, session_id), error) || fs::exists(IntentFile(store, session_id), error);
}

std::vector<fs::path> ListTombstones(const fs::path& store) {
  std::vector<fs::path> files;
  std::error_code error;
  for (auto entry = fs::directory_iterator(store / "deletions", error); !error && entry != fs::directory_iterator();
       entry.increment(error))
    if (entry->path().extension() == ".json") files.push_back(entry->path());
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace stratalux::db
