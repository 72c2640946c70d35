// SPDX-License-Identifier: Apache-2.0
// What happened in a night, a line of JSON an event, written as it happens, in STORE/nights/<night>: night.jsonl, and
// SESSION.jsonl for each visitor, beside what its workers said (SESSION-ATTEMPT.log). A file each, so that forgetting a
// session takes what was said of it along (db/privacy/forget.h) while the night goes on. Morning report, `batch status`
// and `batch watch` read them.
#pragma once

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/units/time.h"

namespace stratalux::fit {

enum class NightEventKind {
  kBegan,
  kLeftOut,   // reason: why this visitor is not fitted tonight
  kStarted,   // an attempt
  kDone,      // fitted
  kRetry,     // the attempt failed; another follows
  kFailed,    // another is no use
  kSetAside,  // the last attempt failed
  kDropped,   // forgotten or consent withdrawn on the way
  kReleased,  // given back: the night ends before it
  kEnded
};
[[nodiscard]] const char* ToString(NightEventKind kind);
// A visitor's last word: kDone, kFailed, kSetAside, kDropped.
[[nodiscard]] bool IsEnd(NightEventKind kind);

struct NightEvent {
  NightEventKind kind = NightEventKind::kBegan;
  WallNs at = {};
  std::string session = {}, fit = {};
  int attempt = 0;
  double seconds = 0.0, cpu_seconds = 0.0;  // of the attempt; kEnded: of the night
  int64_t peak_bytes = 0;
  std::string why = {};     // kLeftOut: its name (LeftOut)
  std::string reason = {};  // for people
  int64_t count = 0;        // kBegan: visitors chosen; kEnded: fitted
  bool by_error = false;    // kEnded: an error ended it, the reason; it may have left visitors who could be fitted
};

[[nodiscard]] std::string ToJson(const NightEvent& event);
// A line of the file. kIntegrity for what is none.
[[nodiscard]] Result<NightEvent> ParseNightEvent(const std::string& line);

// "20260514T200000.000Z": how the names of nights begin, so that they sort, those of one second too.
[[nodiscard]] std::string NightMoment(WallNs time);

class NightLog {
 public:
  // Makes STORE/nights/<night>, named after the moment and this process.
  [[nodiscard]] static Result<NightLog> Begin(const std::filesystem::path& store);
  // The night of that name, made where it is not there yet.
  [[nodiscard]] static Result<NightLog> Open(const std::filesystem::path& store, const std::string& name);
  // On the disk when it returns. Of a session that was forgotten meanwhile, only that somebody was; where that cannot
  // be asked, it is written to the session's file, which a forgetting wipes, and without a name if the session is not
  // there: its forgetting may be over. kUsage for what is no session.
  Status Add(const NightEvent& event);
  // All that was said of a session: it was forgotten.
  Status Remove(const std::string& session);
  [[nodiscard]] std::filesystem::path WorkerLog(const std::string& session, int attempt) const;
  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }

 private:
  NightLog(std::filesystem::path store, std::filesystem::path folder)
      : store_(std::move(store)), folder_(std::move(folder)) {}
  std::filesystem::path store_, folder_;
};

// The nights of a store, oldest first: names of folders.
[[nodiscard]] std::vector<std::string> Nights(const std::filesystem::path& store);
// In the order in which they happened, those of a file in its own, whatever the clock said. A line that a power cut
// left half, or of a later version, is left out and counted.
struct NightRecord {
  std::vector<NightEvent> events;
  int unread = 0;
};
[[nodiscard]] Result<NightRecord> ReadNight(const std::filesystem::path& folder);

}  // namespace stratalux::fit
