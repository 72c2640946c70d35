// SPDX-License-Identifier: Apache-2.0
// Small whole stores of every kind, to be changed at random: a handful of sessions of tiny frames each.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "db/keys/rig_key.h"

namespace stratalux::db {

struct SampleStore {
  std::string name;
  std::filesystem::path folder;
  std::optional<PublicKey> signed_by;  // every session is signed with it
  bool encrypted = false;              // every session is, and the keys are here
};

// Complete and degraded ones; one whose writer was killed, ended by the next opening; encrypted; signed; with fits,
// their calibration and a session that used it; a forgotten one; a transcoded one of several segments; truth maps.
[[nodiscard]] std::vector<SampleStore> MakeSampleStores(const std::filesystem::path& folder);

}  // namespace stratalux::db
