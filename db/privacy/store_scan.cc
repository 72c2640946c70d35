// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/store_scan.h"

#include <algorithm>
#include <cctype>
#include <map>
#include <unordered_set>

#include "db/care/incoming.h"
#include "db/catalogue/consent.h"
#include "db/keys/rig_key.h"
#include "db/privacy/marker_scan.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

enum class Kind { kId, kKeyId, kHash, kVisitor };

// Whose it is. Of a pseudonym, no session.
struct Owner {
  std::string session, visitor;
};
struct Marker {
  Kind kind = Kind::kId;
  int owner = 0;
};

const char* ToString(Kind kind) {
  switch (kind) {
    case Kind::kId:
      return "session id";
    case Kind::kKeyId:
      return "key id";
    case Kind::kHash:
      return "payload hash";
    case Kind::kVisitor:
      break;
  }
  return "pseudonym";
}

class Markers {
 public:
  Status Add(const ForgetIntent& intent, const std::set<uint64_t>& shared_hashes) {
    const int owner = AddOwner({intent.session, intent.visitor});
    AddBytes(TextBytes(intent.session), {Kind::kId, owner});
    if (!intent.key_id.empty()) {
      SLX_ASSIGN_OR_RETURN(const auto key_id, FromHex(intent.key_id));
      AddBoth(key_id, intent.key_id, {Kind::kKeyId, owner});
    }
    for (const uint64_t hash : intent.hashes) {
      if (shared_hashes.contains(hash)) continue;
      const auto bytes = BytesOf(hash);
      AddBoth(bytes, ToHex(bytes), {Kind::kHash, owner});
    }
    return Status::Ok();
  }
  void AddPseudonym(const std::string& visitor) {
    AddBytes(TextBytes(visitor), {Kind::kVisitor, AddOwner({"", visitor})});
  }
  [[nodiscard]] const MarkerScan& scan() const { return scan_; }
  [[nodiscard]] const Marker& operator[](int number) const { return all_[static_cast<size_t>(number)]; }
  [[nodiscard]] const Owner& OwnerOf(const Marker& marker) const { return owners_[static_cast<size_t>(marker.owner)]; }

 private:
  static std::span<const uint8_t> TextBytes(const std::string& text) {
    return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
  }
  int AddOwner(Owner owner) {
    owners_.push_back(std::move(owner));
    return static_cast<int>(owners_.size()) - 1;
  }
  // As bytes and as text: files of either kind may hold it.
  void AddBoth(std::span<const uint8_t> bytes, const std::string& text, Marker marker) {
    if (bytes.size() < MarkerScan::kShortest) return;
    AddBytes(bytes, marker);
    AddBytes(TextBytes(text), marker);
  }
  void AddBytes(std::span<const uint8_t> bytes, Marker marker) {
    if (bytes.size() < MarkerScan::kShortest) return;
    scan_.Add(bytes);
    all_.push_back(marker);
  }
  MarkerScan scan_;
  std::vector<Marker> all_;
  std::vector<Owner> owners_;
};

// How often the index may hold the id: its deletions row (table and key) and its access_log rows (table and index).
Result<int64_t> AllowedInIndex(SessionIndex& index, const std::string& id) {
  SLX_ASSIGN_OR_RETURN(
      auto select,
      index.connection().Prepare(
          "SELECT coalesce((SELECT 2 + (length(certificate_json) - length(replace(certificate_json, ?1, '')))"
          " / length(?1) FROM deletions WHERE session_id = ?1), 0)"
          " + coalesce((SELECT sum(2 + (length(detail) - length(replace(detail, ?1, ''))) / length(?1))"
          " FROM access_log WHERE session_id = ?1), 0)"));
  SLX_RETURN_IF_ERROR(select.Bind(1, id).Step().status());
  return select.Integer(0);
}

// Of the store, or of a source that it pulls from, whose chains are copied before they are merged.
bool IsChain(const fs::path& store, const fs::path& file) {
  const fs::path folder = file.parent_path();
  return file.extension() == ".jsonl" && folder.filename() == "ledger" &&
         (folder.parent_path() == store || folder.parent_path().parent_path() == IncomingSources(store));
}

// The first hit that must not be, if any.
const MarkerScan::Hit* Forbidden(const fs::path& store, const fs::path& file, const Markers& markers,
                                 const ScanPlan& plan, const std::vector<MarkerScan::Hit>& hits) {
  std::map<std::string, int64_t> ids;
  const bool is_index = file == store / "index.sqlite";
  for (const MarkerScan::Hit& hit : hits) {
    const Marker& marker = markers[hit.marker];
    if (marker.kind == Kind::kId && (IsChain(store, file) || file == store / "index.sqlite-wal")) continue;
    if (marker.kind == Kind::kId && is_index) {
      const std::string& session = markers.OwnerOf(marker).session;
      const auto allowed = plan.ids_in_index.find(session);
      if (allowed != plan.ids_in_index.end() && ++ids[session] <= allowed->second) continue;
    }
    return &hit;
  }
  return nullptr;
}

void AddLeftover(StoreScanResult& result, Kind kind, const Owner& owner, const std::string& file,
                 const std::string& where) {
  result.leftovers.push_back({owner.session, owner.visitor, file + where + ": " + ToString(kind), file});
}

Status ScanOne(const fs::path& store, const fs::path& file, const Markers& markers, const ScanPlan& plan,
               StoreScanResult& result, const std::function<bool()>& goes_on) {
  const auto hits = markers.scan().Scan(file, goes_on);
  if (std::error_code error; !hits.ok() && !fs::exists(file, error)) return Status::Ok();  // gone meanwhile
  if (!hits.ok()) return hits.status();
  std::error_code error;
  ++result.files;
  result.bytes += static_cast<int64_t>(fs::file_size(file, error));
  if (const MarkerScan::Hit* hit = Forbidden(store, file, markers, plan, *hits))
    AddLeftover(result, markers[hit->marker].kind, markers.OwnerOf(markers[hit->marker]),
                file.lexically_relative(store).string(), ", offset " + std::to_string(hit->offset));
  return Status::Ok();
}

// Without encryption two sessions may hold the same bytes. No index of `frames` leads from a hash to its rows: such a
// one would be one more place that keeps what is to go.
Status FindShared(Connection& connection, const std::vector<ForgetIntent>& intents, std::set<uint64_t>& shared) {
  std::unordered_set<uint64_t> ours;
  for (const ForgetIntent& intent : intents)
    if (intent.key_id.empty()) ours.insert(intent.hashes.begin(), intent.hashes.end());
  if (ours.empty()) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT hash FROM frames"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    const auto hash = select.Blob(0);
    if (hash.size() < sizeof(uint64_t)) continue;
    if (const uint64_t word = WordOf(hash); ours.contains(word)) shared.insert(word);
  }
}

// Long enough, with a digit, not the simulation's, and no part of a pseudonym that remains.
Result<bool> IsTelling(SessionIndex& index, const std::string& visitor) {
  const bool digit = std::any_of(visitor.begin(), visitor.end(), [](unsigned char c) { return std::isdigit(c) != 0; });
  if (visitor.size() < MarkerScan::kShortest || !digit || visitor == kSimulatedVisitor) return false;
  SLX_ASSIGN_OR_RETURN(auto select,
                       index.connection().Prepare("SELECT 1 FROM visitors WHERE instr(id, ?1) > 0 AND id <> ?1"));
  SLX_ASSIGN_OR_RETURN(const bool part, select.Bind(1, visitor).Step());
  return !part;
}

}  // namespace

Result<bool> HoldsMarker(const fs::path& file, const std::vector<ForgetIntent>& intents,
                         const std::vector<std::string>& pseudonyms) {
  Markers markers;
  for (const std::string& visitor : pseudonyms) markers.AddPseudonym(visitor);
  // A plain session's hashes may be another's, too; its id stands wherever its rows do.
  for (const ForgetIntent& intent : intents) {
    std::set<uint64_t> doubtful;
    if (intent.key_id.empty()) doubtful.insert(intent.hashes.begin(), intent.hashes.end());
    SLX_RETURN_IF_ERROR(markers.Add(intent, doubtful));
  }
  SLX_ASSIGN_OR_RETURN(const auto hits, markers.scan().Scan(file));
  return !hits.empty();
}

Result<std::vector<std::string>> TellingPseudonyms(SessionIndex& index, const std::vector<std::string>& gone_visitors) {
  std::vector<std::string> found;
  for (const std::string& visitor : gone_visitors) {
    SLX_ASSIGN_OR_RETURN(const bool telling, IsTelling(index, visitor));
    if (telling) found.push_back(visitor);
  }
  return found;
}

Result<bool> RowsName(const fs::path& database, const std::string& visitor) {
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(database, Connection::Mode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT 1 FROM visitors WHERE id = ?1 UNION ALL"
                                                       " SELECT 1 FROM sessions WHERE visitor = ?1"));
  return select.Bind(1, visitor).Step();
}

Result<ScanPlan> PlanScan(SessionIndex& index, const std::vector<ForgetIntent>& intents,
                          const std::vector<std::string>& gone_visitors) {
  ScanPlan plan;
  for (const ForgetIntent& intent : intents) {
    SLX_ASSIGN_OR_RETURN(plan.ids_in_index[intent.session], AllowedInIndex(index, intent.session));
  }
  SLX_ASSIGN_OR_RETURN(plan.pseudonyms, TellingPseudonyms(index, gone_visitors));
  SLX_RETURN_IF_ERROR(FindShared(index.connection(), intents, plan.shared_hashes));
  return plan;
}

bool IsOfIndex(const fs::path& file) { return file == "index.sqlite" || file == "index.sqlite-wal"; }

namespace {

struct SoughtName {
  std::string text;
  Kind kind;
  Owner owner;
};

Status AddMarkers(const std::vector<ForgetIntent>& intents, const ScanPlan& plan, Markers& markers,
                  std::vector<SoughtName>& names) {
  for (const ForgetIntent& intent : intents) {
    SLX_RETURN_IF_ERROR(markers.Add(intent, plan.shared_hashes));
    names.push_back({intent.session, Kind::kId, {intent.session, intent.visitor}});
  }
  for (const std::string& visitor : plan.pseudonyms) {
    markers.AddPseudonym(visitor);
    names.push_back({visitor, Kind::kVisitor, {"", visitor}});
  }
  return Status::Ok();
}

// Files and folders below `folder`, but intents. What goes away meanwhile is passed over.
Status ListAll(const fs::path& store, const fs::path& folder, std::vector<fs::path>& files,
               std::vector<fs::path>& all) {
  std::error_code error;
  auto entry = fs::directory_iterator(folder, error);
  for (; !error && entry != fs::directory_iterator(); entry.increment(error)) {
    const fs::path& path = entry->path();
    if (path.parent_path() == store / "ledger" && path.extension() == ".forgetting") continue;
    all.push_back(path);
    std::error_code ignored;
    if (entry->is_symlink(ignored)) continue;
    if (entry->is_regular_file(ignored)) files.push_back(path);
    if (entry->is_directory(ignored)) SLX_RETURN_IF_ERROR(ListAll(store, path, files, all));
  }
  if (error && (error != std::errc::no_such_file_or_directory || folder == store))
    return Status::Failed("cannot list " + folder.string() + ": " + error.message());
  return Status::Ok();
}

}  // namespace

Result<StoreScanResult> ScanIndex(const fs::path& store, const std::vector<ForgetIntent>& intents,
                                  const ScanPlan& plan) {
  Markers markers;
  std::vector<SoughtName> names;
  SLX_RETURN_IF_ERROR(AddMarkers(intents, plan, markers, names));
  StoreScanResult result;
  result.markers = static_cast<int64_t>(markers.scan().size());
  for (const char* file : {"index.sqlite", "index.sqlite-wal"})
    SLX_RETURN_IF_ERROR(ScanOne(store, store / file, markers, plan, result, {}));
  return result;
}

Result<StoreScanResult> ScanStore(const fs::path& store, const std::vector<ForgetIntent>& intents, const ScanPlan& plan,
                                  Logger& logger, const std::function<bool()>& goes_on) {
  Markers markers;
  std::vector<SoughtName> names;  // what a file's name may tell, too
  SLX_RETURN_IF_ERROR(AddMarkers(intents, plan, markers, names));
  StoreScanResult result;
  result.markers = static_cast<int64_t>(markers.scan().size());
  std::vector<fs::path> files, all;
  SLX_RETURN_IF_ERROR(ListAll(store, store, files, all));
  for (const fs::path& path : all)
    for (const auto& [text, kind, owner] : names)
      if (path.filename().string().find(text) != std::string::npos)
        AddLeftover(result, kind, owner, path.lexically_relative(store).string(), " (its name)");
  Progress progress(logger, "scan", static_cast<int64_t>(files.size()));
  for (const fs::path& file : files) {
    SLX_RETURN_IF_ERROR(ScanOne(store, file, markers, plan, result, goes_on));
    progress.Advance();
  }
  return result;
}

}  // namespace stratalux::db
