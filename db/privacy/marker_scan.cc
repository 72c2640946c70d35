// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/marker_scan.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <unistd.h>

#include "db/base/descriptor.h"
#include "db/base/held_descriptor.h"
#include "shared/base/check.h"

namespace stratalux::db {
namespace {

constexpr int kFilterBits = 20;  // 128 KiB: stays in the cache next to the data
constexpr size_t kBlock = size_t{1} << 20;

uint64_t Load(const uint8_t* at) {
  uint64_t word = 0;
  std::memcpy(&word, at, sizeof word);
  return word;
}
// Multiplicative hashing: the upper bits of the product depend on all bytes.
uint64_t FilterBit(uint64_t word) { return (word * 0x9e3779b97f4a7c15ULL) >> (64 - kFilterBits); }

// Fills `block` behind its first `kept` bytes; it begins at `offset` of the file. Returns how many bytes are valid.
Result<size_t> ReadBlock(int fd, std::span<uint8_t> block, size_t kept, int64_t offset) {
  size_t filled = kept;
  while (filled < block.size()) {
    const ssize_t got = pread(fd, block.data() + filled, block.size() - filled, offset + static_cast<int64_t>(filled));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return Status::Failed(std::string("cannot read: ") + std::strerror(errno));
    if (got == 0) break;
    filled += static_cast<size_t>(got);
  }
  return filled;
}

}  // namespace

MarkerScan::MarkerScan() : filter_((size_t{1} << kFilterBits) / 64) {}

int MarkerScan::Add(std::span<const uint8_t> bytes) {
  SLX_CHECK(bytes.size() >= kShortest);
  const int number = static_cast<int>(ends_.size());
  const uint64_t start = Load(bytes.data());
  bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
  ends_.push_back(bytes_.size());
  by_start_.emplace(start, number);
  filter_[FilterBit(start) / 64] |= uint64_t{1} << (FilterBit(start) % 64);
  longest_ = std::max(longest_, bytes.size());
  return number;
}

int MarkerScan::Add(const std::string& text) {
  return Add(std::span(reinterpret_cast<const uint8_t*>(text.data()), text.size()));
}

std::span<const uint8_t> MarkerScan::Marker(int number) const {
  const auto index = static_cast<size_t>(number);
  const size_t begin = index == 0 ? 0 : ends_[index - 1];
  return std::span(bytes_).subspan(begin, ends_[index] - begin);
}

// Markers that start at the first `starts` bytes of the block.
void MarkerScan::ScanBlock(std::span<const uint8_t> block, size_t starts, int64_t offset,
                           std::vector<Hit>& hits) const {
  for (size_t i = 0; i < starts && i + kShortest <= block.size(); ++i) {
    const uint64_t word = Load(block.data() + i);
    const uint64_t bit = FilterBit(word);
    if ((filter_[bit / 64] >> (bit % 64) & 1U) == 0) continue;
    const auto [first, last] = by_start_.equal_range(word);
    for (auto candidate = first; candidate != last; ++candidate) {
      const auto marker = Marker(candidate->second);
      if (marker.size() <= block.size() - i && std::memcmp(marker.data(), block.data() + i, marker.size()) == 0)
        hits.push_back({candidate->second, offset + static_cast<int64_t>(i)});
    }
  }
}

Result<std::vector<MarkerScan::Hit>> MarkerScan::Scan(const std::filesystem::path& file,
                                                      const std::function<bool()>& goes_on) const {
  const bool held = MayBeOfSqlite(file);
  const UniqueFd own = held ? UniqueFd() : OpenDescriptor(file, O_RDONLY);
  const int fd = held ? HeldDescriptor(file) : own.get();
  if (fd < 0) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
  std::vector<Hit> hits;
  std::vector<uint8_t> block(kBlock + longest_ - 1);
  size_t kept = 0;  // bytes of the block before, in which a marker may have started
  int64_t offset = 0;
  while (true) {
    if (goes_on && !goes_on()) return Status(StatusCode::kTryAgain, "the search of " + file.string() + " was stopped");
    const auto filled = ReadBlock(fd, block, kept, offset);
    if (!filled.ok()) return filled.status().WithContext(file.string());
    const bool last = *filled < block.size();
    const size_t starts = last ? *filled : kBlock;
    ScanBlock(std::span(block).first(*filled), starts, offset, hits);
    if (last) return hits;
    kept = *filled - starts;
    std::memmove(block.data(), block.data() + starts, kept);
    offset += static_cast<int64_t>(starts);
  }
}

}  // namespace stratalux::db
