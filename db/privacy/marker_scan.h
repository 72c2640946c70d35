// SPDX-License-Identifier: Apache-2.0
// Looks for many byte strings in files at once, at about the speed of reading them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::db {

class MarkerScan {
 public:
  static constexpr size_t kShortest = 8;  // bytes: shorter ones would be found by chance

  MarkerScan();
  // At least kShortest bytes; returns its number, 0, 1, ... The same bytes twice are two markers.
  int Add(std::span<const uint8_t> bytes);
  int Add(const std::string& text);
  [[nodiscard]] size_t size() const { return ends_.size(); }

  struct Hit {
    int marker = 0;
    int64_t offset = 0;
  };
  // Every place of every marker, in the order of offsets. kFailed where the file cannot be read, kTryAgain where
  // `goes_on`, asked for each MiB, ended it. A database that this process has open may be read so, too.
  [[nodiscard]] Result<std::vector<Hit>> Scan(const std::filesystem::path& file,
                                              const std::function<bool()>& goes_on = {}) const;

 private:
  void ScanBlock(std::span<const uint8_t> block, size_t starts, int64_t offset, std::vector<Hit>& hits) const;

  [[nodiscard]] std::span<const uint8_t> Marker(int number) const;

  std::vector<uint8_t> bytes_;  // of all markers, one behind the other: a forgotten visit has a thousand of them
  std::vector<size_t> ends_;    // of each in `bytes_`
  std::unordered_multimap<uint64_t, int> by_start_;  // first 8 bytes -> marker
  std::vector<uint64_t> filter_;                     // a bit for each hash of 8 bytes that may start a marker
  size_t longest_ = kShortest;
};

}  // namespace stratalux::db
