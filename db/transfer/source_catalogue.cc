// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/source_catalogue.h"

#include <algorithm>
#include <array>
#include <cstdio>

#include <xxhash.h>

#include "db/base/durable_file.h"
#include "db/care/incoming.h"
#include "db/care/session_rebuild.h"
#include "db/catalogue/manifest.h"

namespace stratalux::db {
namespace {

// Fits have all their files; what else the fitter made is made again where it is wanted.
constexpr const char* kNoArtifacts = "--exclude=/artifacts/";
// Keys may be sealed to another reader while a session is fetched, and after it.
constexpr const char *kSealedKeys = "--include=/sessions/*/key-*.sealed",
                     *kNoKeyInTheMaking = "--exclude=/key-*.sealed.new";

namespace fs = std::filesystem;

fs::path CatalogueFolder(const fs::path& store, const std::string& source) {
  std::array<char, 17> name{};
  std::snprintf(name.data(), name.size(), "%016llx",
                static_cast<unsigned long long>(XXH3_64bits(source.data(), source.size())));
  return IncomingSources(store) / name.data();
}

std::vector<std::string> FitsIn(const fs::path& folder) {
  std::vector<std::string> fits;
  std::error_code error;
  for (const auto& fit : fs::directory_iterator(folder, error))
    if (fs::exists(fit.path() / "fit.json", error)) fits.push_back(fit.path().filename().string());
  std::sort(fits.begin(), fits.end());
  return fits;
}

// A pattern that means this name alone.
std::string Literal(const std::string& name) {
  std::string pattern;
  for (const char c : name)
    pattern += std::string("*?[\\").find(c) == std::string::npos ? std::string(1, c) : std::string("\\") + c;
  return pattern;
}

}  // namespace

SourceCatalogue::SourceCatalogue(fs::path store, std::string source, RsyncLimits limits)
    : store_(std::move(store)),
      source_(std::move(source)),
      folder_(CatalogueFolder(store_, source_)),
      limits_(limits) {}

Status SourceCatalogue::Fetch(const std::set<std::string>& forgotten, std::vector<std::string>& problems) {
  SLX_RETURN_IF_ERROR(MakeFolder(folder_));
  const fs::path refused = folder_.string() + ".refused";
  std::string rules;
  for (const std::string& id : forgotten) rules += "/sessions/" + Literal(id) + "/*\n";
  SLX_RETURN_IF_ERROR(ReplaceFile(refused, rules));
  const auto fetched = Rsync(
      {{"--delete", "--exclude=*.partial", "--exclude-from=" + refused.string(), "--include=/sessions/",
        "--include=/sessions/*/", "--include=/sessions/*/manifest.json", "--include=/sessions/*/place.json",
        kSealedKeys, "--include=/sessions/*/fits/", "--include=/sessions/*/fits/*/",
        "--include=/sessions/*/fits/*/fit.json", "--include=/ledger/", "--include=/ledger/*.jsonl",
        "--include=/deletions/", "--include=/deletions/*.json", "--include=/deletions/*.forgetting", "--exclude=*"},
       limits_},
      source_ + "/", folder_);
  SLX_RETURN_IF_ERROR(WipeFile(refused));  // tombstones belong into the ledger
  if (!fetched.ok()) {
    if (fetched.status().code() != StatusCode::kIntegrity) return fetched.status();
    if (!Rsync({{"--list-only", "--dirs"}, limits_}, source_ + "/sessions", folder_).ok())
      return Status::NotFound("no store in " + source_ + " (it has no folder 'sessions')");
    problems.push_back("not all of the source could be read: " + fetched.status().message());
  }
  std::error_code error;
  if (!fs::is_directory(folder_ / "sessions", error))
    return Status::NotFound("no store in " + source_ + " (it has no folder 'sessions')");
  return Status::Ok();
}

SourceOffers SourceCatalogue::Read() const {
  SourceOffers offers;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder_ / "sessions", error)) {
    const std::string id = entry.path().filename().string();
    if (id.starts_with('.')) continue;
    offers.folders.insert(id);
    const auto manifest = ReadManifest(entry.path());
    if (manifest.status().code() == StatusCode::kNotFound) {
      offers.unfinished.insert(id);
    } else if (!manifest.ok() || manifest->id != id) {
      offers.problems.push_back("session " + id + ": " +
                                (manifest.ok() ? "its manifest names " + manifest->id : manifest.status().message()));
      fs::remove(entry.path() / "manifest.json", error);  // fetched again, should the damage be ours
    } else if (manifest->status != SessionStatus::kComplete && manifest->status != SessionStatus::kDegraded) {
      offers.unfinished.insert(id);
    } else {
      offers.sessions.push_back({id, PlaceOf(entry.path()).value_or(0), FitsIn(entry.path() / "fits")});
    }
  }
  std::sort(offers.sessions.begin(), offers.sessions.end(),
            [](const Offer& a, const Offer& b) { return a.number != b.number ? a.number < b.number : a.id < b.id; });
  return offers;
}

bool SourceCatalogue::OthersHave(const std::string& id) const {
  std::error_code error;
  for (const auto& other : fs::directory_iterator(IncomingSources(store_), error))
    if (other.path() != folder_ && fs::exists(other.path() / "sessions" / id / "manifest.json", error)) return true;
  return false;
}

Status SourceCatalogue::Copy(const std::string& path, const fs::path& target) const {
  SLX_RETURN_IF_ERROR(MakeFolder(target));
  const std::string from = source_ + "/" + path + "/";
  SLX_RETURN_IF_ERROR(
      Rsync({{"--delete", "--exclude=*.partial", "--exclude=/place.json", kNoKeyInTheMaking, kNoArtifacts}, limits_},
            from, target)
          .status());
  SLX_ASSIGN_OR_RETURN(
      const std::string different,
      Rsync({{"--dry-run", "--checksum", "--delete", "--out-format=%n", "--exclude=*.partial", "--exclude=/place.json",
              kNoKeyInTheMaking, kNoArtifacts, "--exclude=*.seg", "--omit-dir-times"},
             limits_},
            from, target));
  if (different.find_first_not_of("./\n") == std::string::npos) return Status::Ok();
  return Status::Integrity(path + " changed at the source while it was copied: " +
                           different.substr(0, different.find('\n')) + "; run pull again");
}

}  // namespace stratalux::db
