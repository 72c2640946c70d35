// SPDX-License-Identifier: Apache-2.0
// Which visitors a night fits, and why it leaves the others.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fitter/batch/night_log.h"
#include "fitter/pipeline/run_options.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Who is fitted first. kNewest: whoever came last may still ask for it.
enum class NightOrder { kNewest, kOldest };

// Whether an encrypted visitor needs a key here. kNot: for others to fit; it is enough that the key is sealed to
// somebody (db/keys/sealed_key.h).
enum class KeyHere { kNeeded, kNot };

struct ChoiceOptions {
  RunOptions run;  // of every visitor; its session is not read
  NightOrder order = NightOrder::kNewest;
  int most = 0;  // visitors; 0: all
  KeyHere key = KeyHere::kNeeded;
};

struct ChosenVisit {
  std::string session, fit;  // fit: its id, which names all that decides it
  int64_t sites = 0;         // of the camera's mosaic
  bool sealed = false;       // encrypted
};

enum class LeftOut {
  kComplete,  // fitted so already
  kCapture,   // failed, or is still being written
  kConsent,   // does not cover fitting, or was withdrawn
  kKey,       // encrypted, and its key is not here
  kUnusable,  // no plan, no calibration that fits
  kSetAside,  // failed in each of its attempts
  kQuota      // behind `most`
};
[[nodiscard]] const char* ToString(LeftOut why);

struct LeftOutVisit {
  std::string session;
  LeftOut why = LeftOut::kComplete;
  std::string reason;  // for people, with the remedy
};

struct NightChoice {
  std::vector<ChosenVisit> visits;  // in the order of their fitting
  std::vector<LeftOutVisit> left_out;
};

[[nodiscard]] NightEvent EventOf(const LeftOutVisit& visit);

// Looks at every visitor's session of the store; nothing is changed.
[[nodiscard]] Result<NightChoice> ChooseNight(const ChoiceOptions& options, Logger& logger);
// kOk while the session may be fitted; else why not any more: it was forgotten, or the consent is gone.
[[nodiscard]] Status MayStillBeFitted(const std::string& store, const std::string& session, const std::string& visitor);
// An answer that says no, not one that could not be had: a busy disk or a ledger's line of a later version drops
// nobody.
[[nodiscard]] bool Forbids(const Status& may);
// Of a fit with these options: what asks for it again is the same job.
[[nodiscard]] std::string JobKey(const ChosenVisit& visit);

}  // namespace stratalux::fit
