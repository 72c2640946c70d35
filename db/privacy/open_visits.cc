// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/open_visits.h"

#include <algorithm>

#include "db/base/durable_file.h"
#include "db/base/listing.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
constexpr const char* kOpen = ".open";
constexpr const char* kTorn = ".new";  // what ReplaceFile had not yet renamed

constexpr const char* kLock = "kiosk.lock";

std::string TakenText(const fs::path& store) {
  return "another kiosk serves " + store.string() + "; a store can have only one kiosk";
}

fs::path Folder(const fs::path& store) { return store / "visits"; }
fs::path NoteOf(const fs::path& store, const std::string& visit) { return Folder(store) / (visit + kOpen); }

}  // namespace

Status NoteOpenVisit(const fs::path& store, const std::string& visit, const std::string& visitor) {
  // One that is torn, or half closed, is none.
  if (const auto there = ReadFile(NoteOf(store, visit)); there.ok() && *there == visitor) return Status::Ok();
  SLX_RETURN_IF_ERROR(MakeFolder(Folder(store)));
  return ReplaceFile(NoteOf(store, visit), visitor);
}

Status CloseVisit(const fs::path& store, const std::string& visit) {
  std::error_code error;
  if (!fs::exists(Folder(store), error)) return Status::Ok();
  SLX_RETURN_IF_ERROR(WipeFile(NoteOf(store, visit).string() + kTorn));
  SLX_RETURN_IF_ERROR(WipeFile(NoteOf(store, visit)));
  return SyncFolder(Folder(store));
}

Result<std::vector<OpenVisit>> OpenVisits(const fs::path& store) {
  std::vector<OpenVisit> visits;
  SLX_ASSIGN_OR_RETURN(const std::vector<fs::path> files, EntriesOf(Folder(store)));
  for (const fs::path& file : files) {
    if (file.extension() == kTorn && file.stem().extension() == kOpen) {
      visits.push_back({file.stem().stem().string(), ""});
    } else if (file.extension() == kOpen) {
      SLX_ASSIGN_OR_RETURN(std::string visitor, ReadFile(file));
      // Wiped and not yet removed: it was closed.
      if (visitor.find('\0') != std::string::npos) visitor.clear();
      visits.push_back({file.stem().string(), std::move(visitor)});
    }
  }
  // A whole note and a torn one of a visit are one visit, the whole one's.
  std::sort(visits.begin(), visits.end(), [](const OpenVisit& a, const OpenVisit& b) {
    return a.visit != b.visit ? a.visit < b.visit : a.visitor > b.visitor;
  });
  visits.erase(std::unique(visits.begin(), visits.end(),
                           [](const OpenVisit& a, const OpenVisit& b) { return a.visit == b.visit; }),
               visits.end());
  return visits;
}

Result<FileLock> LockVisits(const fs::path& store) {
  SLX_RETURN_IF_ERROR(MakeFolder(Folder(store)));
  return FileLock::TryTake(Folder(store) / kLock, TakenText(store));
}

Status CheckVisitsAreFree(const fs::path& store) {
  return FileLock::IsHeld(Folder(store) / kLock) ? Status(StatusCode::kBusy, TakenText(store)) : Status::Ok();
}

bool HasVisits(const fs::path& store) {
  std::error_code error;
  return fs::exists(Folder(store), error);
}

}  // namespace stratalux::db
