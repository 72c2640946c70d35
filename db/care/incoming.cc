// SPDX-License-Identifier: Apache-2.0
#include "db/care/incoming.h"

#include <algorithm>
#include <map>
#include <set>

#include "db/base/durable_file.h"
#include "db/catalogue/manifest.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

std::vector<fs::path> FoldersIn(const fs::path& folder) {
  std::vector<fs::path> folders;
  std::error_code error;
  for (auto entry = fs::directory_iterator(folder, error); !error && entry != fs::directory_iterator();
       entry.increment(error))
    if (entry->is_directory(error) && !entry->is_symlink(error)) folders.push_back(entry->path());
  std::sort(folders.begin(), folders.end());
  return folders;
}

std::string VisitorOf(const fs::path& folder) {
  const auto manifest = ReadManifest(folder);
  return manifest.ok() ? manifest->visitor : std::string();
}

// In each source's kept catalogue: SOURCE/sessions/<id>.
std::vector<fs::path> CatalogueEntries(const fs::path& store, const std::string& id) {
  std::vector<fs::path> entries;
  std::error_code error;
  for (const fs::path& source : FoldersIn(IncomingSources(store)))
    if (fs::exists(source / "sessions" / id, error)) entries.push_back(source / "sessions" / id);
  return entries;
}

}  // namespace

Result<IncomingLock> IncomingLock::Take(const fs::path& store) {
  IncomingLock lock;
  SLX_ASSIGN_OR_RETURN(lock.lock_,
                       FileLock::TryTake(store / "incoming.lock", "another pull or restore into " + store.string() +
                                                                      " is running; try again when it has finished"));
  return lock;
}

bool IncomingLock::IsHeld(const fs::path& store) { return FileLock::IsHeld(store / "incoming.lock"); }

fs::path IncomingFolder(const fs::path& store, const std::string& id) { return store / "incoming" / id; }
fs::path IncomingFits(const fs::path& store, const std::string& id) { return store / "incoming" / ".fits" / id; }
fs::path IncomingSources(const fs::path& store) { return store / "incoming" / ".sources"; }
fs::path ForgettingFolder(const fs::path& store) { return store / "forgetting"; }

std::vector<IncomingSession> ListIncoming(const fs::path& store) {
  std::map<std::string, IncomingSession> found;
  for (const fs::path& folder : FoldersIn(store / "incoming"))
    if (!folder.filename().string().starts_with('.'))
      found[folder.filename().string()] = {folder.filename().string(), VisitorOf(folder), {folder}};
  for (const fs::path& folder : FoldersIn(store / "incoming" / ".fits")) {
    IncomingSession& session = found[folder.filename().string()];
    session.id = folder.filename().string();
    session.places.push_back(folder);
  }
  std::vector<IncomingSession> sessions;
  for (auto& [id, session] : found) {
    // The manifest comes last of a copy that was broken off; the catalogue has had it before.
    for (const fs::path& entry : CatalogueEntries(store, id))
      if (session.visitor.empty()) session.visitor = VisitorOf(entry);
    sessions.push_back(std::move(session));
  }
  return sessions;
}

Status WipeFolder(const fs::path& folder) {
  std::error_code error;
  std::vector<fs::path> files;
  if (!fs::exists(fs::symlink_status(folder, error))) return Status::Ok();
  for (auto entry = fs::recursive_directory_iterator(folder, error);
       !error && entry != fs::recursive_directory_iterator(); entry.increment(error))
    if (entry->is_regular_file(error) && !entry->is_symlink(error)) files.push_back(entry->path());
  if (error) return Status::Failed("cannot read " + folder.string() + ": " + error.message());
  for (const fs::path& file : files) SLX_RETURN_IF_ERROR(WipeFile(file));
  fs::remove_all(folder, error);
  if (error) return Status::Failed("cannot delete " + folder.string() + ": " + error.message());
  return SyncFolder(folder.parent_path());
}

std::vector<IncomingSession> ListKeptManifests(const fs::path& store) {
  std::map<std::string, IncomingSession> found;
  for (const fs::path& source : FoldersIn(IncomingSources(store)))
    for (const fs::path& entry : FoldersIn(source / "sessions")) {
      IncomingSession& session = found[entry.filename().string()];
      session.id = entry.filename().string();
      session.places.push_back(entry);
    }
  std::vector<IncomingSession> sessions;
  for (auto& [id, session] : found) sessions.push_back(std::move(session));
  return sessions;
}

std::vector<fs::path> IncomingPlaces(const fs::path& store, const std::vector<std::string>& sessions,
                                     const std::vector<std::string>& visitors) {
  std::set<fs::path> folders;
  std::error_code error;
  auto add = [&](const std::string& id) {
    if (id.empty() || id.find('/') != std::string::npos || id.starts_with('.')) return;
    for (const fs::path& folder : {IncomingFolder(store, id), IncomingFits(store, id)})
      if (fs::exists(folder, error)) folders.insert(folder);
    for (const fs::path& entry : CatalogueEntries(store, id)) folders.insert(entry);
  };
  for (const std::string& id : sessions) add(id);
  const std::set<std::string> named(visitors.begin(), visitors.end());
  if (!named.empty()) {
    for (const IncomingSession& session : ListIncoming(store))
      if (named.contains(session.visitor)) add(session.id);
    for (const fs::path& source : FoldersIn(IncomingSources(store)))
      for (const fs::path& entry : FoldersIn(source / "sessions"))
        if (named.contains(VisitorOf(entry))) folders.insert(entry);
  }
  return {folders.begin(), folders.end()};
}

Result<std::vector<fs::path>> WipeIncoming(const fs::path& store, const std::vector<std::string>& sessions,
                                           const std::vector<std::string>& visitors) {
  std::vector<fs::path> folders = IncomingPlaces(store, sessions, visitors);
  for (const fs::path& folder : folders) SLX_RETURN_IF_ERROR(WipeFolder(folder));
  return folders;
}

}  // namespace stratalux::db
