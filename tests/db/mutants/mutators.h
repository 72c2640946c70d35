// SPDX-License-Identifier: Apache-2.0
// One random change of a store.
#pragma once

#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include "tests/db/mutants/sample_stores.h"

namespace stratalux::db {

using Random = std::mt19937_64;

struct Mutant {
  std::string what;       // for people: which file, which field, from what to what
  std::string file = {};  // that was changed, within the store
  // A hash that is stored somewhere no longer fits: then every command must refuse, say, or not care.
  bool leaves_hash = false;
  // Every hash and every row was made anew, so that nothing disagrees: only a signature or a cipher can tell.
  bool consistent = false;
};

// All of them but locks and SQLite's own journals.
[[nodiscard]] std::vector<std::filesystem::path> MutableFiles(const std::filesystem::path& store);

// Changes the store in `folder`, a copy of `sample`.
[[nodiscard]] Mutant Mutate(const SampleStore& sample, const std::filesystem::path& folder, Random& random);

}  // namespace stratalux::db
