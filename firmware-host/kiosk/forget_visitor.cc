// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/forget_visitor.h"

#include <chrono>
#include <thread>

#include "db/catalogue/consent.h"
#include "db/catalogue/session_store.h"
#include "db/privacy/forget.h"

namespace stratalux::rig {
namespace {

constexpr int kTries = 5;  // a second apart

Result<db::ForgetRequest> RequestOf(const std::string& folder, const std::string& visitor) {
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto rows, store.ListSessionsOf(visitor));
  SLX_ASSIGN_OR_RETURN(const auto consents, db::ListConsents(folder, visitor));
  if (rows.empty() && consents.empty()) return Status::NotFound("the store holds nothing of that visitor");
  db::ForgetRequest request;
  for (const db::SessionSummary& row : rows) request.sessions.push_back(row.info.id);
  request.visitors = {visitor};
  return request;
}

}  // namespace

Status ForgetVisitor(const std::string& folder, const std::string& visitor, Logger& logger) {
  Status last;
  for (int attempt = 0; attempt < kTries; ++attempt) {
    if (attempt > 0) std::this_thread::sleep_for(std::chrono::seconds(1));
    SLX_ASSIGN_OR_RETURN(const auto request, RequestOf(folder, visitor));
    const Result<db::ForgetReport> report = db::Forget(folder, request, logger);
    if (report.ok() && report->leftovers.empty()) return Status::Ok();
    if (report.ok()) return Status::Failed("found after all: " + report->leftovers.front());
    last = report.status();
    if (last.code() != StatusCode::kBusy) return last;
  }
  return last;
}

}  // namespace stratalux::rig
