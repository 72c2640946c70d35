// SPDX-License-Identifier: Apache-2.0
// Storage of the EM kernels: one profile a lane, sixteen lanes a row, rows on cache lines.
#pragma once

#include <array>
#include <cstddef>
#include <new>
#include <vector>

namespace stratalux::fit {

inline constexpr int kEmLanes = 16;

// Where a row begins.
inline size_t RowOf(int row) { return static_cast<size_t>(row) * kEmLanes; }

template <typename T>
struct CacheAligned {
  using value_type = T;
  static constexpr std::align_val_t kLine{64};
  CacheAligned() = default;
  template <typename U>
  CacheAligned(const CacheAligned<U>& /*other*/) {}
  T* allocate(size_t count) { return static_cast<T*>(::operator new(count * sizeof(T), kLine)); }
  void deallocate(T* at, size_t /*count*/) { ::operator delete(at, kLine); }
  friend bool operator==(const CacheAligned&, const CacheAligned&) { return true; }
};

using LaneRows = std::vector<float, CacheAligned<float>>;  // [row][lane]
struct alignas(64) LaneRow {
  std::array<float, kEmLanes> at{};
  float& operator[](int lane) { return at[lane]; }
  float operator[](int lane) const { return at[lane]; }
  [[nodiscard]] const float* data() const { return at.data(); }
  [[nodiscard]] float* data() { return at.data(); }
};

}  // namespace stratalux::fit
