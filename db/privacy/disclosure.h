// SPDX-License-Identifier: Apache-2.0
// Pictures of a session for somebody's screen: what every page asks before it shows one, and enters in the access log.
#pragma once

#include <filesystem>
#include <mutex>
#include <optional>
#include <set>
#include <string>

#include "db/catalogue/read_only_index.h"
#include "db/ledger/kept_ledger.h"
#include "shared/base/result.h"
#include "shared/capture/session.h"
#include "shared/units/time.h"

namespace stratalux::db {

// Why pictures and reports of a session are not shown: a withdrawn consent, or none that covers `fit`. Empty: they are.
// Sessions that show nobody are.
[[nodiscard]] std::string WhyWithheld(SessionKind kind, const Consent& consent, std::optional<WallNs> withdrawn);

// Whether pictures of the session with this id may be shown. kNotFound, also for one whose forgetting has begun; kUsage
// where they are withheld. The ledger and the index are of one store.
[[nodiscard]] Status MayBeShown(KeptLedger& ledger, ReadOnlyIndex& index, const std::string& id);
// Whether its forgetting has begun, by either.
[[nodiscard]] Result<bool> IsForgotten(KeptLedger& ledger, ReadOnlyIndex& index, const std::string& id);

// The frame by which a session is known at a glance: the brightest of the reference phase, where there is one.
// kNotFound: it has no frame.
[[nodiscard]] Result<int64_t> FrameAtAGlance(ReadOnlyIndex& index, const std::string& id);

// What a program that shows pictures keeps: the store's ledger, and its own entries in the access log, once a run of it
// for each session and `what`. Thread-safe.
class DisclosureLog {
 public:
  // `program`: the entries' action ("serve", "kiosk").
  DisclosureLog(std::filesystem::path store, std::string program)
      : store_(std::move(store)), program_(std::move(program)), ledger_(store_) {}
  [[nodiscard]] KeptLedger& ledger() { return ledger_; }
  // Before the bytes leave; where it cannot be entered they stay. `peer`: who looks.
  Status Enter(const std::string& id, const std::string& what, const std::string& peer);

 private:
  const std::filesystem::path store_;
  const std::string program_;
  KeptLedger ledger_;
  std::mutex mutex_;
  std::set<std::string> entered_;
};

}  // namespace stratalux::db
