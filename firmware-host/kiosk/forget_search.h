// SPDX-License-Identifier: Apache-2.0
// ForgetSearch: the second half of forgettings, search and certificate, one after another on threads of its own; every
// other one goes before the search. Visits, lights and the program's end never wait for it.
#pragma once

#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>

#include "db/privacy/forget.h"
#include "shared/base/log.h"

namespace stratalux::rig {

class ForgetSearch {
 public:
  // `found`, on the search's thread: something was left after all, or the search could not be made; the log says what.
  // `logger` outlives the search.
  ForgetSearch(std::function<void()> found, Logger& logger);
  // Ends what runs within a MiB of reading, or in the midst of a rewriting. What is not certified then, db::BeginForget
  // takes up at the next start.
  ~ForgetSearch();
  ForgetSearch(const ForgetSearch&) = delete;
  ForgetSearch& operator=(const ForgetSearch&) = delete;

  void Add(db::ForgetProof proof);
  // Whether nobody is served: only then does it take the store's write lock, where the index must be rewritten; false
  // ends a rewriting, which begins anew later.
  void SetRest(bool rest);
  // For who writes to the store: while it is held, the search takes no lock.
  [[nodiscard]] std::unique_lock<std::mutex> Turn() { return std::unique_lock(turn_); }

 private:
  void Work();
  void Prove(db::ForgetProof proof);
  Status RewriteIndex(db::ForgetProof& proof);
  [[nodiscard]] bool goes_on() const;
  [[nodiscard]] bool at_rest() const;

  const std::function<void()> found_;
  Logger& logger_;
  std::mutex turn_;  // taken before mutex_
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<db::ForgetProof> waiting_;
  bool rest_ = true, ending_ = false;
  std::thread thread_;
};

}  // namespace stratalux::rig
