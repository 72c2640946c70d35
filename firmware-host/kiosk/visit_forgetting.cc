// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/visit_forgetting.h"

#include <chrono>
#include <set>
#include <thread>
#include <utility>
#include <vector>

#include "db/catalogue/consent.h"
#include "db/catalogue/session_store.h"
#include "db/privacy/open_visits.h"

namespace stratalux::rig {
namespace {

constexpr int kTries = 5;  // a second apart, while another program writes or reads

Status CloseAll(const std::string& store, const std::vector<db::OpenVisit>& visits) {
  for (const db::OpenVisit& visit : visits) SLX_RETURN_IF_ERROR(db::CloseVisit(store, visit.visit));
  return Status::Ok();
}

std::set<std::string> VisitorsOf(const std::vector<db::OpenVisit>& visits) {
  std::set<std::string> visitors;
  for (const db::OpenVisit& visit : visits)
    if (!visit.visitor.empty()) visitors.insert(visit.visitor);
  return visitors;
}

// What the store has of them. Opened to write, so that a session in whose midst the program was killed is ended first.
Result<db::ForgetRequest> RequestFor(const std::string& folder, const std::set<std::string>& visitors) {
  db::ForgetRequest request;
  if (visitors.empty()) return request;
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(folder, db::AccessMode::kReadWrite));
  for (const std::string& visitor : visitors) {
    SLX_ASSIGN_OR_RETURN(const auto rows, store.ListSessionsOf(visitor));
    for (const db::SessionSummary& row : rows) request.sessions.push_back(row.info.id);
    SLX_ASSIGN_OR_RETURN(const auto consents, db::ListConsents(folder, visitor));
    if (!rows.empty() || !consents.empty()) request.visitors.push_back(visitor);
  }
  return request;
}

template <typename Try>
Status WhileBusy(Try attempt) {
  Status last = attempt();
  for (int tries = 1; tries < kTries && last.code() == StatusCode::kBusy; ++tries) {
    std::this_thread::sleep_for(std::chrono::seconds(1));
    last = attempt();
  }
  return last;
}

}  // namespace

VisitForgetting::VisitForgetting(std::string store, std::function<void(db::ForgetStep)> after_step,
                                 ForgetSearch& search, Logger& logger)
    : store_(std::move(store)), after_step_(std::move(after_step)), search_(search), logger_(logger) {}

Status VisitForgetting::Begin(const std::string& visit, const std::string& visitor) {
  kept_.erase(visit);
  SLX_RETURN_IF_ERROR(Own());
  return db::NoteOpenVisit(store_, visit, visitor);
}

Status VisitForgetting::Keep(const std::string& visit) {
  kept_.insert(visit);
  SLX_RETURN_IF_ERROR(db::CloseVisit(store_, visit));
  kept_.erase(visit);
  return Status::Ok();
}

Status VisitForgetting::ForgetUnkept() {
  return WhileBusy([this] { return TryUnkept(); });
}

Status VisitForgetting::Withdraw(const std::string& visitor) {
  return WhileBusy([&] { return TryWithdraw(visitor); });
}

Status VisitForgetting::Own() {
  if (alone_) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(alone_, db::LockVisits(store_));
  return Status::Ok();
}

Status VisitForgetting::TryUnkept() {
  const auto turn = search_.Turn();
  if (db::HasVisits(store_)) SLX_RETURN_IF_ERROR(Own());
  SLX_ASSIGN_OR_RETURN(auto visits, db::OpenVisits(store_));
  // Who holds a ticket is forgotten by nobody else's visit: their note, which could not be closed, is tried again.
  std::erase_if(visits, [this](const db::OpenVisit& visit) {
    if (!kept_.contains(visit.visit)) return false;
    if (const Status kept = Keep(visit.visit); !kept.ok()) logger_.Error(kept.message());
    return true;
  });
  SLX_ASSIGN_OR_RETURN(const auto begun, db::UnfinishedForgets(store_));
  if (visits.empty() && begun.empty()) return Status::Ok();
  Result<db::ForgetRequest> request = RequestFor(store_, VisitorsOf(visits));
  // No capture came as far as making one.
  if (request.status().code() == StatusCode::kNotFound) return CloseAll(store_, visits);
  if (!request.ok()) return request.status();
  for (const std::string& session : request->sessions) logger_.Info("session " + session + " has no ticket: forgotten");
  if (request->visitors.empty() && begun.empty()) return CloseAll(store_, visits);
  request->after_step = after_step_;
  SLX_ASSIGN_OR_RETURN(db::ForgetProof proof, db::BeginForget(store_, *request));
  // Before the search, which would find them.
  SLX_RETURN_IF_ERROR(CloseAll(store_, visits));
  search_.Add(std::move(proof));
  return Status::Ok();
}

Status VisitForgetting::TryWithdraw(const std::string& visitor) {
  const auto turn = search_.Turn();
  SLX_ASSIGN_OR_RETURN(db::ForgetRequest request, RequestFor(store_, {visitor}));
  if (request.visitors.empty()) return Status::NotFound("the store holds nothing of that visitor");
  request.after_step = after_step_;
  SLX_ASSIGN_OR_RETURN(db::ForgetProof proof, db::BeginForget(store_, request));
  search_.Add(std::move(proof));
  return Status::Ok();
}

}  // namespace stratalux::rig
