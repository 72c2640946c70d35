// SPDX-License-Identifier: Apache-2.0
#include "db/base/vacuum.h"

#include <sqlite3.h>

#include "db/base/sqlite.h"

namespace stratalux::db {

Status Vacuum(Connection& connection, const std::function<bool()>& goes_on) {
  constexpr int kStepsBetween = 100;  // of SQLite's machine: some microseconds
  struct Asked {
    const std::function<bool()>& goes_on;
    bool ended = false;
  } asked{goes_on};
  const auto ask = [](void* data) {
    auto& question = *static_cast<Asked*>(data);
    question.ended = question.ended || !question.goes_on();
    return question.ended ? 1 : 0;
  };
  if (goes_on) sqlite3_progress_handler(connection.handle(), kStepsBetween, ask, &asked);
  const Status done = connection.Execute("VACUUM");
  sqlite3_progress_handler(connection.handle(), 0, nullptr, nullptr);
  return asked.ended ? Status(StatusCode::kTryAgain, "the rewriting of the index was ended") : done;
}

}  // namespace stratalux::db
