// SPDX-License-Identifier: Apache-2.0
// What every command makes of a changed store, and whether that is right.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "tests/db/mutants/mutators.h"
#include "tests/db/mutants/sample_stores.h"

namespace stratalux::db {

// All that a store answers: every row of the index (but of jobs and the access log, which no file tells and nothing is
// computed from) and the pixels of every frame.
using Picture = std::vector<std::string>;
[[nodiscard]] Picture PictureOf(const std::filesystem::path& store);

struct Expected {
  Picture as_it_is, rebuilt;  // of the unchanged store; after a reindex of it
};
[[nodiscard]] Expected ExpectedOf(const SampleStore& sample, const std::filesystem::path& scratch);

enum class Verdict { kFound, kHarmless, kRightlyTaken, kSilent, kLaundered, kFramesLost };
[[nodiscard]] const char* ToString(Verdict verdict);
[[nodiscard]] inline bool IsWrong(Verdict verdict) { return verdict >= Verdict::kSilent; }

// Runs the commands on the changed store in `folder`; `why` is told for the wrong ones. Aborts and hangs are the
// caller's to see.
[[nodiscard]] Verdict Judge(const SampleStore& sample, const Expected& expected, const Mutant& mutant,
                            const std::filesystem::path& folder, std::string& why);

}  // namespace stratalux::db
