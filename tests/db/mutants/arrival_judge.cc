// SPDX-License-Identifier: Apache-2.0
// What restore and pull make of a changed backup or source: what arrives is what was there, or it is said that it is
// not.
#include <algorithm>

#include "db/transfer/backup.h"
#include "db/transfer/pull.h"
#include "tests/db/mutants/judge.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

void Append(std::vector<std::string>& all, const std::vector<std::string>& more) {
  all.insert(all.end(), more.begin(), more.end());
}

void RestoreFrom(const SampleStore& sample, const fs::path& from, const fs::path& into, Arrival& arrival) {
  Logger logger(LogLevel::kError);
  const auto report = Restore(from, into, {RestoreInto::kNewStore, sample.other.string()}, logger);
  arrival.status = report.status();
  if (!report.ok()) return;
  Append(arrival.words, report->problems);
  Append(arrival.words, report->notes);
  arrival.words.push_back(std::to_string(report->sessions) + " sessions, " + std::to_string(report->forgotten) +
                          " forgotten");
}

void PullFrom(const SampleStore& sample, const fs::path& from, const fs::path& into, Arrival& arrival) {
  Logger logger(LogLevel::kError);
  fs::copy(sample.other, into, fs::copy_options::recursive);
  const auto report = Pull(into, from.string(), {}, logger);
  arrival.status = report.status();
  if (!report.ok()) return;
  Append(arrival.words, report->problems);
  Append(arrival.words, report->notes);
  arrival.words.push_back(std::to_string(report->sessions.size()) + " sessions, " + std::to_string(report->unfinished) +
                          " unfinished, " + std::to_string(report->forgotten) + " forgotten, " +
                          std::to_string(report->ledger_entries) + " entries of the ledger");
}

// What verify finds afterwards was said on arrival: the same complaint, or that a ledger is damaged, whose readable
// entries must be kept, or that a damaged list of the backup may lack files.
bool WasSaid(const std::string& complaint, const std::vector<std::string>& words) {
  return std::any_of(words.begin(), words.end(), [&complaint](const std::string& word) {
    return word.find(complaint) != std::string::npos ||
           (complaint.find("/ledger/") != std::string::npos && word.find("ledger") != std::string::npos) ||
           (complaint.ends_with("is missing") && word.find("files may be missing") != std::string::npos);
  });
}

// Pixels that the unchanged folder would not have brought.
std::string OtherPixels(const Picture& expected, const Picture& arrived) {
  for (const std::string& line : arrived)
    if (line.find(" frame ") != std::string::npos && !line.starts_with("refused ") &&
        !std::binary_search(expected.begin(), expected.end(), line))
      return line;
  return {};
}

}  // namespace

Arrival Arrive(const SampleStore& sample, const fs::path& from, const fs::path& into) {
  Arrival arrival;
  if (sample.road == Road::kRestore)
    RestoreFrom(sample, from, into, arrival);
  else
    PullFrom(sample, from, into, arrival);
  if (arrival.status.ok()) arrival.picture = PictureOf(into);
  return arrival;
}

Verdict JudgeArrival(const SampleStore& sample, const Expected& expected, const Mutant& mutant, const fs::path& folder,
                     std::string& why) {
  const fs::path there = folder.string() + "-scratch";
  const Arrival arrival = Arrive(sample, folder, there);
  if (!arrival.status.ok()) {
    why = arrival.status.message();
    return Verdict::kFound;
  }
  const auto complaints = Complaints(sample, there);
  if (arrival.words != expected.arrival.words) {
    // Some of it was refused: what did come is right all the same.
    for (const std::string& complaint : complaints) {
      if (WasSaid(complaint, arrival.words)) continue;
      why = "arrived, and is damaged: " + complaint;
      return Verdict::kLaundered;
    }
    why = OtherPixels(expected.arrival.picture, arrival.picture);
    const bool forged = sample.road == Road::kPull && !mutant.leaves_hash;
    return why.empty() || forged ? Verdict::kFound : Verdict::kLaundered;
  }
  if (!complaints.empty()) {
    why = "arrived without a word: " + complaints[0];
    return Verdict::kLaundered;
  }
  if (arrival.picture == expected.arrival.picture) return Verdict::kHarmless;
  // Files whose hashes were all made anew convince a pull; a backup's list of hashes knows better.
  if (sample.road == Road::kPull && !mutant.leaves_hash) return Verdict::kRightlyTaken;
  why = "nothing is said\n   " + FirstDifference(expected.arrival.picture, arrival.picture);
  return Verdict::kSilent;
}

}  // namespace stratalux::db
