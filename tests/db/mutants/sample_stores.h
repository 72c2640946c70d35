// SPDX-License-Identifier: Apache-2.0
// Small whole stores of every kind, to be changed at random: a handful of sessions of tiny frames each.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "db/keys/rig_key.h"

namespace stratalux::db {

// Who reads the changed folder: the commands of a store; a restore, for which it is a backup; a pull, its source.
enum class Road { kOwn, kRestore, kPull };

struct SampleStore {
  std::string name;
  std::filesystem::path folder;
  std::optional<PublicKey> signed_by;  // every session is signed with it
  bool encrypted = false;              // every session is, and the keys are here
  Road road = Road::kOwn;
  std::filesystem::path other;  // kRestore: the store with the newest ledger; kPull: an empty store that pulls
  // Of a session that was being written: file -> bytes that hold acknowledged frames. Its recovery may cut what
  // follows.
  std::map<std::string, size_t> acknowledged;
};

// Complete ones and degraded ones with a plan; one whose writer was killed, ended by the next opening; one that is not
// ended yet; encrypted ones, one of them fitted; signed; with fits, their calibration and a session that used it; a
// forgotten one; a transcoded one of several segments; truth maps; a backup; the source of a pull.
[[nodiscard]] std::vector<SampleStore> MakeSampleStores(const std::filesystem::path& folder);

}  // namespace stratalux::db
