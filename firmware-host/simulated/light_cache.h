// SPDX-License-Identifier: Apache-2.0
// LightCache: results of costly computations of the simulated rig, kept on disk. An entry is found by the hash of
// everything that its result depends on, so a change of any of it finds nothing. What cannot be read or written is
// computed again: never an error.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "shared/base/log.h"

namespace stratalux::rig {

// XXH3-128 of what was added, in order.
class CacheKey {
 public:
  CacheKey();
  ~CacheKey();
  CacheKey(CacheKey&&) noexcept;
  CacheKey& operator=(CacheKey&&) noexcept;

  void AddBytes(std::span<const std::byte> bytes);
  // Numbers alone: bytes between the members of a structure mean nothing.
  template <typename T>
  void Add(const T& value) {
    static_assert(std::is_arithmetic_v<T> || std::is_enum_v<T>);
    AddBytes(std::as_bytes(std::span(&value, 1)));
  }
  template <typename T>
  void AddAll(std::span<const T> values) {
    static_assert(std::is_arithmetic_v<T>);
    Add(values.size());
    AddBytes(std::as_bytes(values));
  }
  [[nodiscard]] std::array<uint64_t, 2> Digest() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// Thread-safe; several processes may share a folder.
class LightCache {
 public:
  static constexpr uint64_t kDefaultLimitBytes = uint64_t{4} << 30;
  using Digest = std::array<uint64_t, 2>;

  // `folder` is made when the first entry is kept. Above `limit_bytes` the entries that were used longest ago go.
  LightCache(std::filesystem::path folder, uint64_t limit_bytes, Logger& logger);

  // Numbers kept under `key`, exactly `count`; nullopt: none, or damaged ones, which are deleted.
  [[nodiscard]] std::optional<std::vector<float>> Load(const Digest& key, size_t count);
  void Keep(const Digest& key, std::span<const float> values);

  // $STRATALUX_CACHE, else stratalux in $XDG_CACHE_HOME, else in ~/.cache; empty: no cache is wanted, or no place is
  // known.
  [[nodiscard]] static std::filesystem::path FolderOfUser();

 private:
  [[nodiscard]] std::filesystem::path FileOf(const Digest& key) const;
  void MakeRoom();
  void WarnOnce(const std::string& message);

  const std::filesystem::path folder_;
  const uint64_t limit_bytes_;
  Logger& logger_;
  std::mutex mutex_;
  bool warned_ = false;
};

}  // namespace stratalux::rig
