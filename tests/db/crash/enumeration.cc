// SPDX-License-Identifier: Apache-2.0
#include "tests/db/crash/enumeration.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <set>

#include <gtest/gtest.h>
#include <xxhash.h>

namespace stratalux::db::crash {
namespace {

uint64_t HashOf(const DiskImage& image, int64_t promise) {
  uint64_t hash = static_cast<uint64_t>(promise);
  for (const auto& [path, bytes] : image) {
    hash = XXH3_64bits_withSeed(path.data(), path.size(), hash);
    hash = XXH3_64bits_withSeed(bytes.data(), bytes.size(), hash);
  }
  return hash;
}

uint64_t SeedOf() {
  const char* text = std::getenv("STRATALUX_SEED");
  return text == nullptr ? 4 : std::strtoull(text, nullptr, 10);
}

std::string Describe(const DiskCall& call) {
  switch (call.kind) {
    case DiskCall::Kind::kLink:
      return (call.old_name.empty() ? "creation of " : "renaming to ") + call.name;
    case DiskCall::Kind::kUnlink:
      return "removal of " + call.name;
    case DiskCall::Kind::kWrite:
      return "write of " + std::to_string(call.bytes.size()) + " bytes at " + std::to_string(call.offset) +
             " of inode " + std::to_string(call.file);
    case DiskCall::Kind::kTruncate:
      return "truncation of inode " + std::to_string(call.file) + " to " + std::to_string(call.offset);
    case DiskCall::Kind::kSync:
    case DiskCall::Kind::kFailedSync:
      return "sync of inode " + std::to_string(call.file);
    case DiskCall::Kind::kMark:
      break;
  }
  return "mark";
}

// What a power cut may come behind: the word of Describe(), files and folders apart where they differ.
std::string KindOf(const DiskCall& call, const std::set<Inode>& folders) {
  const std::string words = Describe(call);
  return words.substr(0, words.find(' ')) + (folders.contains(call.file) ? " of a folder" : "");
}

// Of each kind of call every stride-th, from a drawn one on, and at least one; and every mark: the first moment of what
// is promised is the hardest.
std::vector<bool> Draw(const DiskLog& log, const EnumerationOptions& options) {
  std::set<Inode> folders = {kRoot};
  for (const auto& [path, inode] : log.inodes)
    if (!log.start.contains(path)) folders.insert(inode);
  std::map<std::string, std::vector<size_t>> kinds;
  std::vector<bool> drawn(log.calls.size(), false);
  for (size_t i = 0; i < log.calls.size(); ++i) {
    const DiskCall& call = log.calls[i];
    if (call.makes_folder) folders.insert(call.file);
    if (i < options.from_call) continue;
    if (call.kind == DiskCall::Kind::kMark)
      drawn[i] = true;
    else
      kinds[KindOf(call, folders)].push_back(i);
  }
  for (const auto& [kind, calls] : kinds) {
    const auto stride = static_cast<size_t>(options.stride);
    for (auto k = static_cast<size_t>(SampledStart(static_cast<int64_t>(std::min(stride, calls.size()))));
         k < calls.size(); k += stride)
      drawn[calls[k]] = true;
  }
  return drawn;
}

// The line at the end of the program, and the number that the whole of it is to reach.
class Totals : public ::testing::Environment {
 public:
  static Totals& Get() {
    static auto* totals = new Totals;
    return *totals;
  }
  EnumerationReport sum;

  void TearDown() override {
    if (sum.points == 0) return;
    std::printf("all power cuts: %lld points, %lld cuts, %lld violations (every %d. call of each kind)\n",
                static_cast<long long>(sum.points), static_cast<long long>(sum.cuts),
                static_cast<long long>(sum.violations), SampledStride());
    const auto& run = *::testing::UnitTest::GetInstance();
    const bool all = run.test_to_run_count() == run.total_test_count();
    if (all && SampledStride() <= 2) {
      EXPECT_GE(sum.points, 1000);
    }
  }
};

[[maybe_unused]] const auto* const totals_at_the_end = ::testing::AddGlobalTestEnvironment(&Totals::Get());

}  // namespace

EnumerationReport Enumerate(const DiskLog& log, const std::vector<Promise>& promises,
                            const std::filesystem::path& folder, const EnumerationOptions& options) {
  const CheckFunction check = [&promises](const std::filesystem::path& remains, int64_t mark, CheckCounts& counts) {
    return CheckStore(remains, promises[static_cast<size_t>(mark)], counts);
  };
  return Enumerate(log, check, folder, options);
}

EnumerationReport Enumerate(const DiskLog& log, const CheckFunction& check, const std::filesystem::path& folder,
                            const EnumerationOptions& options) {
  EnumerationReport report;
  Disk disk(log);
  std::set<uint64_t> seen;
  std::mt19937_64 random(SeedOf());
  const std::vector<bool> drawn = Draw(log, options);
  int64_t promise = 0;
  for (size_t i = 0; i < log.calls.size(); ++i) {
    const DiskCall& call = log.calls[i];
    disk.Apply(call);
    if (call.kind == DiskCall::Kind::kMark) promise = call.offset;
    if (!drawn[i]) continue;
    if (call.kind != DiskCall::Kind::kMark) ++report.points;
    for (const PowerCut cut : {PowerCut::kKeepsAll, PowerCut::kDropsAll, PowerCut::kDropsNames, PowerCut::kDropsBytes,
                               PowerCut::kTearsLastWrite, PowerCut::kKeepsSomeBlocks}) {
      const bool draws = cut == PowerCut::kKeepsSomeBlocks || cut == PowerCut::kTearsLastWrite;
      for (int k = 0; k < (draws ? options.random_cuts : 1); ++k) {
        ++report.cuts;
        const DiskImage image = disk.After(cut, random);
        if (!seen.insert(HashOf(image, promise)).second) continue;
        WriteImage(image, folder);
        for (const std::string& broken : check(folder, promise, report.checked)) {
          if (++report.violations > 20) break;
          report.first_violations.push_back("call " + std::to_string(i) + " (" + Describe(call) + "), the disk " +
                                            ToString(cut) + ": " + broken);
        }
        if (report.violations > 0 && options.until_first_violation) return report;
      }
    }
  }
  return report;
}

int SampledStride() {
  const char* text = std::getenv("STRATALUX_CRASH_STRIDE");
  return text == nullptr ? 12 : std::max(1, std::atoi(text));
}

int64_t SampledStart(int64_t stride) {
  std::mt19937_64 random(SeedOf());
  return static_cast<int64_t>(random() % static_cast<uint64_t>(std::max<int64_t>(1, stride)));
}

void Add(const EnumerationReport& more, EnumerationReport& sum) {
  sum.points += more.points;
  sum.cuts += more.cuts;
  sum.violations += more.violations;
  sum.checked.stores += more.checked.stores;
  sum.checked.sessions += more.checked.sessions;
  sum.checked.frames += more.checked.frames;
  sum.first_violations.insert(sum.first_violations.end(), more.first_violations.begin(), more.first_violations.end());
}

void Print(const std::string& title, const EnumerationReport& r) {
  Add(r, Totals::Get().sum);
  std::printf(
      "%s: %lld points, %lld power cuts, %lld distinct disks; %lld sessions and %lld frames read, %lld violations\n",
      title.c_str(), static_cast<long long>(r.points), static_cast<long long>(r.cuts),
      static_cast<long long>(r.checked.stores), static_cast<long long>(r.checked.sessions),
      static_cast<long long>(r.checked.frames), static_cast<long long>(r.violations));
}

}  // namespace stratalux::db::crash
