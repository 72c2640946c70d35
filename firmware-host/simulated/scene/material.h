// SPDX-License-Identifier: Apache-2.0
// What a point of the subject's surface is made of.
#pragma once

#include <array>
#include <cstdint>

#include "firmware-host/simulated/skin/skin_optics.h"

namespace stratalux::rig {

// The numbers are those of the truth map `material`.
enum class MaterialKind : uint8_t { kNone = 0, kSkin = 1, kMatt = 2, kEye = 3, kHair = 4, kWax = 5 };

struct Material {
  MaterialKind kind = MaterialKind::kSkin;
  SkinParameters skin;               // kSkin
  std::array<float, 3> albedo{};     // of an opaque, Lambertian body: all but kSkin and kWax
  float surface_reflectance = 1.0F;  // of the rough surface, relative to skin's Fresnel reflection; 0: none
  float roughness = 0.35F;           // GGX slope parameter (skin: Weyrich et al. 2006 find 0.25 to 0.4 over the face)

  // Light enters and leaves elsewhere.
  [[nodiscard]] bool Translucent() const { return kind == MaterialKind::kSkin || kind == MaterialKind::kWax; }

  static Material Skin(const SkinParameters& skin) { return {MaterialKind::kSkin, skin, {}, 1.0F, 0.35F}; }
  static Material Wax() { return {MaterialKind::kWax, {0.0F, 0.0F, 0.0F}, {}, 1.0F, 0.25F}; }
  static Material Opaque(MaterialKind kind, const std::array<float, 3>& albedo, float surface_reflectance,
                         float roughness) {
    return {kind, {}, albedo, surface_reflectance, roughness};
  }
  static Material Matt(const std::array<float, 3>& albedo) { return Opaque(MaterialKind::kMatt, albedo, 0.0F, 1.0F); }
};

}  // namespace stratalux::rig
