// SPDX-License-Identifier: Apache-2.0
// The keys of a shard's encrypted visitors, for a machine that holds no reader's key (db/keys/held_keys.h).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/keys/key_store.h"
#include "fitter/batch/shard_plan.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct ShardKeys {
  std::vector<db::SessionKey> keys;
  std::vector<std::string> sessions;  // whose
  std::vector<std::string> missing;   // a line each: whose key is not here, or who may not be fitted any more
};

// Of the shard's visitors alone, as this program finds them in `store`; unencrypted ones have none.
[[nodiscard]] Result<ShardKeys> KeysOf(const std::filesystem::path& store, const ShardPlan& plan, const Shard& shard);

// Whether the keys of some of them, sealed to readers beside their sessions, are not to be had by this program; of
// those who are not fitted yet by the shard's manifest in `results`.
[[nodiscard]] bool KeysAreMissing(const std::filesystem::path& store, const std::filesystem::path& results,
                                  const ShardPlan& plan, const Shard& shard);

}  // namespace stratalux::fit
