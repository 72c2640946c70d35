// SPDX-License-Identifier: Apache-2.0
// VisitForgetting: how visitors go who have no ticket, or who gave it back. Of the worker's thread, but for Withdraw.
#pragma once

#include <functional>
#include <optional>
#include <set>
#include <string>

#include "db/base/file_lock.h"
#include "db/privacy/forget.h"
#include "firmware-host/kiosk/forget_search.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

class VisitForgetting {
 public:
  // `store` need not exist. `search` and `logger` outlive this. `after_step` may be empty (db/privacy/forget.h).
  VisitForgetting(std::string store, std::function<void(db::ForgetStep)> after_step, ForgetSearch& search,
                  Logger& logger);

  // Before the first capture of a visit: whatever happens from here on, it is forgotten unless Keep is called.
  Status Begin(const std::string& visit, const std::string& visitor);
  // The visitor holds the ticket.
  Status Keep(const std::string& visit);
  // Every visit that was begun and not kept, also by a program that was killed; and what broke off of a forgetting.
  // When it returns kOk, files, keys and rows are gone; the search follows. Tries again for some seconds while another
  // program writes or reads.
  Status ForgetUnkept();
  // Every session and consent of a visitor whose visit is over; from any thread. Answers as soon as ForgetUnkept does,
  // but waits for a capture that runs. kNotFound: the store holds nothing of them, or there is none; kBusy as there.
  Status Withdraw(const std::string& visitor);

 private:
  Status TryUnkept();
  // That no other kiosk forgets what this one notes, nor this one what another noted.
  Status Own();
  Status TryWithdraw(const std::string& visitor);

  const std::string store_;
  const std::function<void(db::ForgetStep)> after_step_;
  ForgetSearch& search_;
  Logger& logger_;
  std::optional<db::FileLock> alone_;
  std::set<std::string> kept_;  // visits whose note could not be closed
};

}  // namespace stratalux::rig
