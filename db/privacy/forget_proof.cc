// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/forget_proof.h"

#include <algorithm>
#include <iterator>
#include <set>

#include <nlohmann/json.hpp>

#include "db/base/vacuum.h"
#include "db/base/write_lock.h"
#include "db/catalogue/ledger_follow.h"
#include "db/ledger/ledger.h"
#include "db/privacy/access_log.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

std::string Without(std::string text, const std::string& pseudonym) {
  if (pseudonym.empty()) return text;
  for (size_t at = 0; (at = text.find(pseudonym, at)) != std::string::npos;)
    text.replace(at, pseudonym.size(), "(forgotten)");
  return text;
}

bool Concerns(const StoreScanResult::Leftover& leftover, const ForgetIntent& intent) {
  return leftover.session.empty() ? leftover.visitor == intent.visitor : leftover.session == intent.session;
}

bool HoldsOfIndex(const StoreScanResult& scan) {
  return std::any_of(scan.leftovers.begin(), scan.leftovers.end(),
                     [](const auto& leftover) { return IsOfIndex(leftover.file); });
}

std::string CertificateFor(const ForgetIntent& intent, const ForgottenSession& session, const StoreScanResult& scan,
                           WallNs now) {
  Json exports = Json::array(), leftovers = Json::array();
  for (const ForgottenExport& e : session.exports)
    exports.push_back({{"place", Without(e.place, intent.visitor)}, {"state", ToString(e.state)}});
  for (const auto& leftover : scan.leftovers)
    if (Concerns(leftover, intent)) leftovers.push_back(Without(leftover.text, intent.visitor));
  const Json json = {{"schema", 1},
                     {"session", intent.session},
                     {"reason", intent.reason},
                     {"deleted", ToIso8601(now)},
                     {"deleted_wall_ns", now.ns},
                     {"by", OperatingSystemUser()},
                     {"program_version", kVersion},
                     {"frames", session.frames},
                     {"fits", session.fits},
                     {"files", session.files},
                     {"bytes", session.bytes},
                     {"key_destroyed", session.encrypted},
                     {"visitor_removed", session.visitor_removed},
                     {"exports", exports},
                     {"verification",
                      {{"clean", leftovers.empty()},
                       {"markers", scan.markers},
                       {"files_read", scan.files},
                       {"bytes_read", scan.bytes},
                       {"leftovers", leftovers}}}};
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);  // as the ledger writes it
}

// Sessions that another proof has certified since, and visitors of none that is left.
void LeaveOutProven(ForgetProof::Removed& removed) {
  std::set<std::string> visitors(removed.visitors.begin(), removed.visitors.end());
  for (size_t i = removed.intents.size(); i-- > 0;) {
    const ForgetIntent& intent = removed.intents[i];
    std::error_code error;
    if (fs::exists(IntentFile(removed.store, intent.session), error)) {
      visitors.insert(intent.visitor);
      continue;
    }
    std::erase_if(removed.kept_exports, [&](const auto& kept) { return kept.session == intent.session; });
    removed.intents.erase(removed.intents.begin() + static_cast<std::ptrdiff_t>(i));
    removed.report.sessions.erase(removed.report.sessions.begin() + static_cast<std::ptrdiff_t>(i));
  }
  std::erase_if(removed.gone_visitors, [&](const std::string& visitor) { return !visitors.contains(visitor); });
}

}  // namespace

Status Checkpoint(Connection& connection) {
  // The first column says whether somebody kept the log from being emptied.
  SLX_ASSIGN_OR_RETURN(const int64_t busy, connection.QueryInteger("PRAGMA wal_checkpoint(TRUNCATE)"));
  if (busy != 0)
    return Status::Busy(
        "another program is reading the index, so its log still holds the old rows; the frames are"
        " gone: run `stratalux-db forget --resume` once it has finished");
  return Status::Ok();
}

ForgetProof::ForgetProof(std::unique_ptr<Removed> removed) : removed_(std::move(removed)) {}
ForgetProof::ForgetProof(ForgetProof&&) noexcept = default;
ForgetProof& ForgetProof::operator=(ForgetProof&&) noexcept = default;
ForgetProof::~ForgetProof() = default;

void ForgetProof::Include(ForgetProof earlier) {
  Removed &mine = *removed_, &other = *earlier.removed_;
  std::set<std::string> known;
  for (const ForgetIntent& intent : mine.intents) known.insert(intent.session);
  for (size_t i = 0; i < other.intents.size(); ++i) {
    if (known.contains(other.intents[i].session)) continue;
    mine.intents.push_back(std::move(other.intents[i]));
    mine.report.sessions.push_back(std::move(other.report.sessions[i]));
  }
  std::copy_if(other.kept_exports.begin(), other.kept_exports.end(), std::back_inserter(mine.kept_exports),
               [&](const auto& kept) { return !known.contains(kept.session); });
  const auto unite = [](std::vector<std::string>& to, std::vector<std::string>& from) {
    for (std::string& text : from)
      if (std::find(to.begin(), to.end(), text) == to.end()) to.push_back(std::move(text));
  };
  unite(mine.visitors, other.visitors);
  unite(mine.gone_visitors, other.gone_visitors);
  unite(mine.report.incoming, other.report.incoming);
}

Status ForgetProof::Search(Logger& logger, const std::function<bool()>& goes_on) {
  Removed& r = *removed_;
  LeaveOutProven(r);
  if (r.intents.empty() && r.gone_visitors.empty()) return Status::Ok();  // nothing to look for
  {
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(r.store, AccessMode::kReadOnly));
    SLX_ASSIGN_OR_RETURN(r.plan, PlanScan(index, r.intents, r.gone_visitors));
  }
  SLX_ASSIGN_OR_RETURN(r.scan, ScanStore(r.store, r.intents, r.plan, logger, goes_on));
  r.Done(ForgetStep::kScanned);
  return Status::Ok();
}

bool ForgetProof::NeedsIndexRewritten() const { return HoldsOfIndex(removed_->scan); }

// Written anew, no page ever held it.
Status ForgetProof::RewriteIndex(const std::function<bool()>& goes_on) {
  Removed& r = *removed_;
  {
    SLX_ASSIGN_OR_RETURN(const auto lock, WriteLock::Take(r.store));
    SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(r.store, AccessMode::kReadWrite));
    SLX_RETURN_IF_ERROR(Vacuum(index.connection(), goes_on));
    SLX_RETURN_IF_ERROR(Checkpoint(index.connection()));
  }
  SLX_ASSIGN_OR_RETURN(const auto again, ScanIndex(r.store, r.intents, r.plan));
  std::erase_if(r.scan.leftovers, [](const auto& leftover) { return IsOfIndex(leftover.file); });
  r.scan.leftovers.insert(r.scan.leftovers.end(), again.leftovers.begin(), again.leftovers.end());
  return Status::Ok();
}

// In the ledger, which the index follows. Two forgets that finish the same session at once certify it twice.
Result<ForgetReport> ForgetProof::Certify() {
  Removed& r = *removed_;
  r.scan.leftovers.insert(r.scan.leftovers.end(), r.kept_exports.begin(), r.kept_exports.end());
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(r.store, AccessMode::kReadWrite));
  for (size_t i = 0; i < r.intents.size(); ++i) {
    const WallNs now = WallNow();
    const std::string certificate = CertificateFor(r.intents[i], r.report.sessions[i], r.scan, now);
    SLX_RETURN_IF_ERROR(
        AppendToLedger(r.store, {LedgerKind::kForgotten, now, {r.intents[i].session}, "", certificate}));
    r.Done(ForgetStep::kEntry);
  }
  SLX_RETURN_IF_ERROR(FollowLedger(index, r.store));
  r.Done(ForgetStep::kCertified);
  // What is not clean stays begun, so that the next call looks again.
  for (const ForgetIntent& intent : r.intents) {
    if (std::any_of(r.scan.leftovers.begin(), r.scan.leftovers.end(),
                    [&](const auto& leftover) { return Concerns(leftover, intent); }))
      continue;
    SLX_RETURN_IF_ERROR(WipeIntent(r.store, intent.session));
  }
  (void)Checkpoint(index.connection()).ok();  // of the certificate alone: a reader may keep that in the log
  r.Done(ForgetStep::kDone);
  r.report.markers = r.scan.markers;
  r.report.scanned_files = r.scan.files;
  r.report.scanned_bytes = r.scan.bytes;
  for (const auto& leftover : r.scan.leftovers) r.report.leftovers.push_back(leftover.text);
  return std::move(r.report);
}

}  // namespace stratalux::db
