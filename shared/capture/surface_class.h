// SPDX-License-Identifier: Apache-2.0
// What part of a face a point of a simulated subject is: the numbers of the truth map `class`.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace stratalux {

// Frozen: a released number never changes. From kSkin to kScar it is skin.
enum class SurfaceClass : uint8_t {
  kNone = 0,  // no subject there, or no part of a face (boards, wax)
  kSkin = 1,  // of no region below: temples, jaw, around the mouth, neck; bodies of skin other than a head
  kForehead = 2,
  kCheek = 3,
  kNose = 4,
  kLips = 5,  // the vermilion alone
  kEyelids = 6,
  kChin = 7,
  kScar = 8,
  kEye = 9,
  kBrow = 10,
  kHair = 11,
  kStubble = 12,
  kNostril = 13,
  kLashes = 14,  // the slit of a closed eye
};

// In the order of their numbers.
inline constexpr std::array<std::string_view, 15> kSurfaceClassNames = {
    "none", "skin", "forehead", "cheek", "nose",    "lips",    "eyelids", "chin",
    "scar", "eye",  "brow",     "hair",  "stubble", "nostril", "lashes"};

[[nodiscard]] constexpr std::string_view ToString(SurfaceClass surface) {
  return kSurfaceClassNames[static_cast<size_t>(surface)];
}
[[nodiscard]] constexpr bool IsSkin(SurfaceClass surface) {
  return surface >= SurfaceClass::kSkin && surface <= SurfaceClass::kScar;
}

}  // namespace stratalux
