// SPDX-License-Identifier: Apache-2.0
// The regions of a face, and how the skin of each differs from the cheek's. They lie where the head's features do.
//
// Where the factors come from (what the line spread makes of them: docs/simulated-rig.md, "Regions"):
// - Epidermis: ultrasound of 118 people (BMC Med. Imaging 22 (2022) 113, Table 2, mean of all): forehead 0.208, nasal
//   dorsum 0.194, eyelid 0.174, zygoma 0.196 mm; here over the zygoma's. Lips: a thinly keratinised epithelium deeply
//   penetrated by vascular papillae (Wertz, "Lip skin"); what counts is the blood-free layer above them: 0.7, assumed.
// - Scattering: eyelids, whose dermis is loose, 0.8, assumed (that it is thin, 0.63 of the zygoma's in the same table,
//   changes the half-light radius by 3 % at most, by photons). Scar: attenuation at 1300 nm of normotrophic burn scars
//   over normal skin, 4.2 / 6.3 per mm (Gong et al., J. Biomed. Opt. 19 (2013) 021111); reduced scattering of keloids
//   falls with their severity, too (Hsu et al., Biomed. Opt. Express 6 (2015) 390), although their collagen is denser.
//   Nose: were a quarter of its skin sebaceous glands that scatter like subcutis (0.4 of dermis at 630 nm), 0.85;
//   lips: loose tissue over muscle, 0.75; both assumed.
// - Blood: regions of the face differ (Tur et al., J. Invest. Dermatol. 81 (1983) 442): forehead paler, nose redder,
//   lips several times the cheek's, amounts from memory.
// - Melanin: the forehead above other sites, lids darker, lips nearly without: amounts from memory.
#pragma once

#include <array>
#include <cstdint>

#include "firmware-host/simulated/scene/face_features.h"
#include "shared/capture/surface_class.h"

namespace stratalux::rig {

enum class FaceRegion : uint8_t { kOther, kForehead, kCheek, kNose, kLips, kEyelids, kChin };
inline constexpr size_t kFaceRegions = 7;

[[nodiscard]] SurfaceClass ClassOf(FaceRegion region);

// Over the cheek's.
struct SkinFactors {
  double epidermis = 1.0, blood = 1.0, melanin = 1.0, scattering = 1.0;
};

inline constexpr std::array<SkinFactors, kFaceRegions> kRegionFactors = {{
    {},                      // other
    {1.06, 0.75, 1.2, 1.0},  // forehead
    {},                      // cheek
    {1.0, 1.5, 1.0, 0.85},   // nose
    {0.7, 6.0, 0.35, 0.75},  // lips
    {0.89, 1.2, 1.15, 0.8},  // eyelids
    {1.05, 1.1, 1.1, 1.0},   // chin
}};
// Of the scar's axis, over the skin around it; melanin and blood also without regions.
inline constexpr SkinFactors kScarFactors = {1.0, 0.4, 0.3, 0.67};

// How much a point belongs to each region: 0 .. 1, together 1, without a step anywhere.
using RegionWeights = std::array<double, kFaceRegions>;

class FaceRegions {
 public:
  explicit FaceRegions(const FaceFeatures& features) : features_(features) {}
  // At a point of the face's frame, mm. Borders are soft over 1 mm at the vermilion, 4 to 8 mm elsewhere.
  [[nodiscard]] RegionWeights WeightsAt(double x, double y) const;
  // The heaviest.
  [[nodiscard]] FaceRegion At(double x, double y) const;

 private:
  FaceFeatures features_;
};

}  // namespace stratalux::rig
