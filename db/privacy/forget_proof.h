// SPDX-License-Identifier: Apache-2.0
// What the first half of a forgetting hands to the second. Internal to db/privacy.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "db/privacy/forget.h"
#include "db/privacy/forget_intent.h"
#include "db/privacy/store_scan.h"

namespace stratalux::db {

struct ForgetProof::Removed {
  std::filesystem::path store;
  std::function<void(ForgetStep)> after_step;
  std::vector<std::string> visitors;  // of the request
  std::vector<ForgetIntent> intents;
  ForgetReport report;  // sessions in the order of intents
  std::vector<std::string> gone_visitors;
  std::vector<StoreScanResult::Leftover> kept_exports;  // and old indexes that cannot be read
  // Of the search.
  ScanPlan plan;
  StoreScanResult scan;

  void Done(ForgetStep step) const {
    if (after_step) after_step(step);
  }
};

// Empties the index's log; kBusy while somebody reads what it holds.
Status Checkpoint(Connection& connection);

}  // namespace stratalux::db
