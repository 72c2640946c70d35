// SPDX-License-Identifier: Apache-2.0
#include "tests/db/crash/enumeration.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <set>

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
  const size_t offset = random() % static_cast<size_t>(options.stride);
  int64_t promise = 0;
  for (size_t i = 0; i < log.calls.size(); ++i) {
    const DiskCall& call = log.calls[i];
    disk.Apply(call);
    if (call.kind == DiskCall::Kind::kMark) promise = call.offset;
    // What is promised is always looked at: the first moment of each mark is the hardest.
    const bool drawn = i % static_cast<size_t>(options.stride) == offset || call.kind == DiskCall::Kind::kMark;
    if (i < options.from_call || !drawn) continue;
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
  return text == nullptr ? 6 : std::max(1, std::atoi(text));
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
  std::printf(
      "%s: %lld points, %lld power cuts, %lld distinct disks; %lld sessions and %lld frames read, %lld violations\n",
      title.c_str(), static_cast<long long>(r.points), static_cast<long long>(r.cuts),
      static_cast<long long>(r.checked.stores), static_cast<long long>(r.checked.sessions),
      static_cast<long long>(r.checked.frames), static_cast<long long>(r.violations));
}

}  // namespace stratalux::db::crash
