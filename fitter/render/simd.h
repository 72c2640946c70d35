// SPDX-License-Identifier: Apache-2.0
// Sixteen floats at a time, for the inner loops of fitter/render.
#pragma once

#include <cstdint>
#include <cstring>

// Vector types of GCC and Clang: sixteen floats, lowered to whatever the machine has. On x86-64 the loader picks the
// widest clone.
#if defined(__x86_64__)
#define SLX_SIMD_CLONES __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define SLX_SIMD_CLONES
#endif

namespace stratalux::fit {

inline constexpr int kLanes = 16;

typedef float Vec __attribute__((vector_size(4 * kLanes)));
typedef int32_t IntVec __attribute__((vector_size(4 * kLanes)));

inline __attribute__((always_inline)) Vec Load(const float* p) {
  Vec v;
  std::memcpy(&v, p, sizeof v);
  return v;
}
inline __attribute__((always_inline)) void Store(float* p, Vec v) { std::memcpy(p, &v, sizeof v); }

// Whether any lane differs from +0.
inline __attribute__((always_inline)) bool Any(Vec v) {
  uint64_t words[kLanes / 2];
  std::memcpy(words, &v, sizeof words);
  uint64_t all = 0;
  for (uint64_t word : words) all |= word;
  return all != 0;
}

// e^x, relative error 2e-7: 2^n times a polynomial of the remainder; 0 below -80, held at e^60 above.
inline __attribute__((always_inline)) Vec Exp(Vec x) {
  const IntVec vanishes = x < -80.0F;
  x = vanishes ? Vec{} - 80.0F : x;
  x = x > 60.0F ? Vec{} + 60.0F : x;
  const Vec t = x * 1.44269504F;
  const IntVec n = __builtin_convertvector(t + (t < 0.0F ? Vec{} - 0.5F : Vec{} + 0.5F), IntVec);
  const Vec fn = __builtin_convertvector(n, Vec);
  const Vec r = (x - fn * 0.693145752F) - fn * 1.42860677e-6F;
  Vec p = 1.38889e-3F * r + 8.33333e-3F;
  p = p * r + 4.1666666e-2F;
  p = p * r + 1.6666667e-1F;
  p = p * r + 0.5F;
  p = p * r + 1.0F;
  p = p * r + 1.0F;
  const IntVec bits = (n + 127) << 23;
  Vec scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return vanishes ? Vec{} : p * scale;
}

}  // namespace stratalux::fit
