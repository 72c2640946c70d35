// SPDX-License-Identifier: Apache-2.0
// Finished sessions of other stores, over rsync and ssh. The other side's SQLite is never opened: its manifests say
// what there is, its ledger what must not be.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::db {

enum class PullMode { kCopy, kDryRun };
// Sessions that are here and were forgotten at the source: named with the command that forgets them, or forgotten.
enum class ForgottenElsewhere { kName, kForget };

struct PullOptions {
  PullMode mode = PullMode::kCopy;
  ForgottenElsewhere forgotten = ForgottenElsewhere::kName;
  std::chrono::seconds timeout{60};  // of the network, without a byte
  std::chrono::seconds limit{0};     // for each source; what it has not given by then waits for the next pull. 0: none
};

struct PullReport {
  std::vector<std::string> sessions;  // pulled, or to be pulled (kDryRun), in the order of the source
  std::vector<std::string> fits;      // session/fit: new fits and calibrations of sessions that were here
  int64_t keys = 0;                   // sealed keys that came for sessions that were here
  int64_t frames = 0;                 // of those that were pulled
  int64_t present = 0;                // here already
  int64_t unfinished = 0;             // recording or failed there: left there
  int64_t forgotten = 0;              // offered, and kept away by the ledger of either side
  int64_t ledger_entries = 0;         // of the source's ledger that were new here
  int64_t withdrawals = 0;            // consents that they withdrew here
  std::vector<std::string> wiped;     // leftovers of broken-off pulls, and why they went
  std::vector<std::string> obeyed;    // sessions forgotten here, because they were at the source (kForget)
  std::vector<std::string> notes;
  std::vector<std::string> problems;  // sessions and fits not taken, what verify says of those taken, what only
                                      // the source has forgotten
};

// `from`: user@host:/path/of/the/store or a local path. The source's ledger is taken over first: what either side has
// forgotten is not fetched, and what lies of it in STORE/incoming is wiped, as is what the source no longer offers.
// Each session is copied to STORE/incoming/<id> (an interrupted copy goes on from there), every frame decoded and held
// against its pixel hash (hashed only, where its key is not here), each fit against its fit.json, the other files
// against rsync's checksums, and only then moved into place and listed; later fits and sealed keys of sessions that are
// here follow. Of a session that the source has forgotten the sealed keys go, also where it stays. A
// session that fails is a problem of its own, so is a fit, which is left out; the others come. kNotFound: no store
// there, no rsync here; kFailed: no contact, no space, a chain of the ledger that cannot be read; kBusy: another
// transfer, or a session is being written.
[[nodiscard]] Result<PullReport> Pull(const std::filesystem::path& store, const std::string& from,
                                      const PullOptions& options, Logger& logger);

// What became of one of several sources: the report goes as far as it came.
struct SourcePull {
  std::string from;
  Status status;  // as Pull() has it; kTryAgain: its limit
  PullReport report;
};

// From several sources side by side, in the order given: whoever is away, slow or damaged delays nobody else. One of
// them works on the store at a time, while the others copy. A session that two of them have comes from whichever begins
// with it first. Not ok where nothing was begun: kUsage for no source, too many, or the same twice; kBusy as Pull().
[[nodiscard]] Result<std::vector<SourcePull>> PullAll(const std::filesystem::path& store,
                                                      const std::vector<std::string>& from, const PullOptions& options,
                                                      Logger& logger);

}  // namespace stratalux::db
