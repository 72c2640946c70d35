// SPDX-License-Identifier: Apache-2.0
// What a point of the subject's surface is made of.
#pragma once

#include <array>
#include <cstdint>

#include "firmware-host/simulated/scene/surface_reflection.h"
#include "firmware-host/simulated/skin/skin_optics.h"
#include "shared/capture/surface_class.h"

namespace stratalux::rig {

// The numbers are those of the truth map `material`.
enum class MaterialKind : uint8_t { kNone = 0, kSkin = 1, kMatt = 2, kEye = 3, kHair = 4, kWax = 5 };

struct Material {
  MaterialKind kind = MaterialKind::kSkin;
  SkinParameters skin;            // kSkin
  std::array<float, 3> albedo{};  // of an opaque, Lambertian body: all but kSkin and kWax
  SurfaceReflection surface;
  SurfaceClass part = SurfaceClass::kNone;  // of a face; light does not depend on it

  // Light enters and leaves elsewhere.
  [[nodiscard]] bool Translucent() const { return kind == MaterialKind::kSkin || kind == MaterialKind::kWax; }

  static Material Skin(const SkinParameters& skin, const SurfaceReflection& surface = {},
                       SurfaceClass part = SurfaceClass::kSkin) {
    return {MaterialKind::kSkin, skin, {}, surface, part};
  }
  static Material Wax() { return {MaterialKind::kWax, {0.0F, 0.0F, 0.0F}, {}, {.roughness = 0.25F}, {}}; }
  // `strength`: of the GGX surface, 0: none.
  static Material Opaque(MaterialKind kind, const std::array<float, 3>& albedo, float strength, float roughness,
                         SurfaceClass part = SurfaceClass::kNone) {
    return {kind, {}, albedo, {.strength = strength, .roughness = roughness}, part};
  }
  static Material Matt(const std::array<float, 3>& albedo) { return Opaque(MaterialKind::kMatt, albedo, 0.0F, 1.0F); }
};

}  // namespace stratalux::rig
