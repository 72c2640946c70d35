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

// What a restore of the folder, or a pull from it, made of it.
struct Arrival {
  Status status;
  std::vector<std::string> words;  // problems, notes and what was counted out
  Picture picture;                 // of the store that it arrived in
};
[[nodiscard]] Arrival Arrive(const SampleStore& sample, const std::filesystem::path& from,
                             const std::filesystem::path& into);

struct Expected {
  Picture as_it_is, rebuilt;  // of the unchanged store; after a reindex of it
  Arrival arrival;            // of an unchanged backup or source
};
[[nodiscard]] Expected ExpectedOf(const SampleStore& sample, const std::filesystem::path& scratch);

enum class Verdict { kFound, kHarmless, kRightlyTaken, kSilent, kLaundered, kFramesLost };
[[nodiscard]] const char* ToString(Verdict verdict);
[[nodiscard]] inline bool IsWrong(Verdict verdict) { return verdict >= Verdict::kSilent; }

// Everything that `verify --deep` complains of.
[[nodiscard]] std::vector<std::string> Complaints(const SampleStore& sample, const std::filesystem::path& folder);
// The first line that only one of them has, for people.
[[nodiscard]] std::string FirstDifference(const Picture& before, const Picture& after);

// Runs the commands on the changed store in `folder`; `why` is told for the wrong ones. Aborts and hangs are the
// caller's to see.
[[nodiscard]] Verdict Judge(const SampleStore& sample, const Expected& expected, const Mutant& mutant,
                            const std::filesystem::path& folder, std::string& why);

// The same for a changed backup or source, whose own index no command opens.
[[nodiscard]] Verdict JudgeArrival(const SampleStore& sample, const Expected& expected, const Mutant& mutant,
                                   const std::filesystem::path& folder, std::string& why);

}  // namespace stratalux::db
