// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/pull.h"

#include <algorithm>

#include "db/base/durable_file.h"
#include "db/care/session_rebuild.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/session_index.h"
#include "db/ledger/tombstone.h"
#include "db/transfer/adopt.h"
#include "db/transfer/program.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

Result<std::string> Rsync(const std::vector<std::string>& options, const std::string& source, const fs::path& target) {
  // -s: names reach the other side as they are. Deltas also between local folders, so that a cut copy is continued.
  std::vector<std::string> arguments = {"rsync", "-rts", "--no-whole-file", "--partial"};
  arguments.insert(arguments.end(), options.begin(), options.end());
  arguments.insert(arguments.end(), {"--", source, target.string() + "/"});
  auto outcome = RunProgram(arguments);
  if (outcome.status().code() == StatusCode::kNotFound)
    return Status::NotFound("pull needs rsync, which is not installed here; apt-get install rsync");
  if (!outcome.ok()) return outcome.status();
  if (outcome->code == 0) return outcome->output;
  std::string reason = outcome->errors.substr(0, outcome->errors.find("\nrsync error"));
  std::replace(reason.begin(), reason.end(), '\n', ' ');
  return Status::Failed("rsync from " + source + " failed (" + std::to_string(outcome->code) + "): " + reason +
                        "; run pull again to go on");
}

// Manifests and tombstones of the source: small, and all that is needed to decide.
Status FetchCatalogue(const std::string& from, const fs::path& catalogue) {
  std::error_code error;
  fs::remove_all(catalogue, error);
  SLX_RETURN_IF_ERROR(MakeFolder(catalogue));
  SLX_RETURN_IF_ERROR(Rsync({"--include=/sessions/", "--include=/sessions/*/", "--include=/sessions/*/manifest.json",
                             "--include=/sessions/*/place.json", "--include=/deletions/", "--include=/deletions/*.json",
                             "--include=/deletions/*.forgetting", "--exclude=*"},
                            from + "/", catalogue)
                          .status());
  if (!fs::is_directory(catalogue / "sessions", error))
    return Status::NotFound("no store in " + from + " (it has no folder 'sessions')");
  return Status::Ok();
}

struct Offer {
  std::string id;
  int64_t number = 0;  // in the source
};

// In the order of the source: its numbers, which no clock decides.
std::vector<Offer> Offers(const fs::path& catalogue, PullReport& report) {
  std::vector<Offer> offers;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(catalogue / "sessions", error)) {
    const std::string id = entry.path().filename().string();
    const auto manifest = ReadManifest(entry.path());
    if (manifest.status().code() == StatusCode::kNotFound) {
      ++report.unfinished;
    } else if (!manifest.ok() || manifest->id != id) {
      report.problems.push_back("session " + id + ": " +
                                (manifest.ok() ? "its manifest names " + manifest->id : manifest.status().message()));
    } else if (manifest->status != SessionStatus::kComplete && manifest->status != SessionStatus::kDegraded) {
      ++report.unfinished;
    } else {
      offers.push_back({id, PlaceOf(entry.path()).value_or(0)});
    }
  }
  std::sort(offers.begin(), offers.end(),
            [](const Offer& a, const Offer& b) { return a.number != b.number ? a.number < b.number : a.id < b.id; });
  return offers;
}

Status Fetch(const std::string& from, const std::string& id, const fs::path& incoming) {
  SLX_RETURN_IF_ERROR(MakeFolder(incoming));
  const std::string source = from + "/sessions/" + id + "/";
  SLX_RETURN_IF_ERROR(Rsync({"--delete", "--exclude=*.partial", "--exclude=/place.json"}, source, incoming).status());
  // Segments carry their hashes; the others are compared with the source once more.
  SLX_ASSIGN_OR_RETURN(const std::string different,
                       Rsync({"--dry-run", "--checksum", "--out-format=%n", "--exclude=*.partial",
                              "--exclude=/place.json", "--exclude=*.seg", "--omit-dir-times"},
                             source, incoming));
  if (different.find_first_not_of("./\n") != std::string::npos)
    return Status::Integrity("session " + id + " changed at the source while it was copied: " +
                             different.substr(0, different.find('\n')) + "; run pull again");
  return VerifyFolder(incoming).status();
}

class Puller {
 public:
  Puller(const fs::path& store, const std::string& from, PullMode mode, PullReport& report)
      : store_(store), from_(from), mode_(mode), report_(report) {}

  Status Take(const std::string& id) {
    const fs::path catalogue = store_ / "incoming" / ".catalogue";
    SLX_ASSIGN_OR_RETURN(const bool here, IsHere(id));
    if (HasTombstone(catalogue, id) || HasTombstone(store_, id)) {
      ++report_.forgotten;
      return Status::Ok();
    }
    if (here) {
      ++report_.present;
      return Status::Ok();
    }
    if (mode_ == PullMode::kDryRun) {
      report_.sessions.push_back(id);
      return Status::Ok();
    }
    std::error_code error;
    if (fs::exists(store_ / "sessions" / id, error)) {  // moved by a pull that was cut before it could list
      SLX_RETURN_IF_ERROR(ListAdopted(store_, id, from_));
    } else {
      const fs::path incoming = store_ / "incoming" / id;
      const Status fetched = Fetch(from_, id, incoming);
      if (fetched.code() == StatusCode::kIntegrity) {
        fs::remove_all(incoming, error);  // else rsync would take the damaged copy, same size and time, for good
        report_.problems.push_back("session " + id + " was not taken: " + fetched.message());
        return Status::Ok();
      }
      SLX_RETURN_IF_ERROR(fetched);
      SLX_ASSIGN_OR_RETURN(const auto contents, ReadManifestContents(incoming));
      report_.frames += contents.frames;
      SLX_RETURN_IF_ERROR(AdoptFolder(store_, incoming, from_));
    }
    report_.sessions.push_back(id);
    return Status::Ok();
  }

  // The source's tombstones hold here, too; a session that is here is for `forget` to remove.
  Status ObeyTombstones() {
    const fs::path catalogue = store_ / "incoming" / ".catalogue";
    for (const fs::path& tombstone : ListTombstones(catalogue)) {
      const std::string id = tombstone.stem().string();
      SLX_ASSIGN_OR_RETURN(const bool here, IsHere(id));
      if (here && !HasTombstone(store_, id))
        report_.problems.push_back("session " + id +
                                   " was forgotten at the source, but is here: `stratalux-db forget " + id + "`");
    }
    return Status::Ok();
  }

 private:
  Result<bool> IsHere(const std::string& id) {
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store_, AccessMode::kReadOnly));
    const auto number = index.NumberOf(id);
    if (number.ok()) return true;
    return number.status().code() == StatusCode::kNotFound ? Result<bool>(false) : Result<bool>(number.status());
  }

  const fs::path& store_;
  const std::string& from_;
  PullMode mode_;
  PullReport& report_;
};

}  // namespace

Result<PullReport> Pull(const fs::path& store, const std::string& source, PullMode mode, Logger& logger) {
  std::string from = source;
  while (from.size() > 1 && from.ends_with('/')) from.pop_back();
  SLX_RETURN_IF_ERROR(SessionIndex::Open(store, AccessMode::kReadWrite).status());
  SLX_ASSIGN_OR_RETURN(const auto lock, IncomingLock::Take(store));
  const fs::path catalogue = store / "incoming" / ".catalogue";
  SLX_RETURN_IF_ERROR(FetchCatalogue(from, catalogue));
  PullReport report;
  const auto offers = Offers(catalogue, report);
  Puller puller(store, from, mode, report);
  {
    Progress progress(logger, "pull", static_cast<int64_t>(offers.size()));
    for (const Offer& offer : offers) {
      SLX_RETURN_IF_ERROR(puller.Take(offer.id));
      progress.Advance();
    }
  }
  SLX_RETURN_IF_ERROR(puller.ObeyTombstones());
  std::error_code error;
  fs::remove_all(catalogue, error);
  return report;
}

}  // namespace stratalux::db
