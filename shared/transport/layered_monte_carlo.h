// SPDX-License-Identifier: Apache-2.0
// Monte Carlo of light in layered tissue: the one implementation of the project. The physics is MCML's (Wang, Jacques,
// Zheng 1995): flat layers, Henyey-Greenstein scattering, Fresnel reflection and refraction at every index step.
//
// Frame: z = 0 is the surface, +z into the tissue. Light comes from the side of +x: a photon of incidence theta enters
// at the origin travelling along (-sin theta, 0, cos theta), so +x is the tangential part of omega_in (towards the
// lamp).
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <span>
#include <vector>

#include "shared/base/result.h"

namespace stratalux {

inline constexpr int kMaxTissueLayers = 8;

struct TissueLayer {
  double n = 1.4;
  double mu_a_per_mm = 0.0;
  double mu_s_per_mm = 1.0;
  double g = 0.0;                                                 // asymmetry of Henyey-Greenstein
  double thickness_mm = std::numeric_limits<double>::infinity();  // infinite only in the last layer
};

struct Tissue {
  std::vector<TissueLayer> layers;
  double n_outside = 1.0;
  [[nodiscard]] Status Validate() const;
};

struct MonteCarloOptions {
  int64_t photons = 100000;
  uint64_t seed = 1;
  // Incidence, drawn uniformly in sin^2(theta) between the two (Lambertian measure); equal values give one angle.
  double sin2_theta_low = 0.0;
  double sin2_theta_high = 0.0;
  // Photons that wandered further (path in tissue, or distance from the entry) are dropped. With absorption of at least
  // 0.02 / mm a path of 300 mm carries exp(-6) of its light at most; the totals below report what was dropped.
  double max_path_mm = std::numeric_limits<double>::infinity();
  double max_radius_mm = std::numeric_limits<double>::infinity();
  int threads = 0;
};

// A photon leaving through the top surface. The direction is that outside (refracted), z < 0.
struct EscapedPhoton {
  float x_mm, y_mm;
  float ux, uy, uz;
  float weight;  // 1 - specular(theta_in), times absorption if the tissue absorbs
  float sin2_theta_in;
  std::array<float, kMaxTissueLayers> path_mm;  // path length in each layer
};

struct MonteCarloTotals {
  struct Value {
    double mean = 0.0;
    double standard_error = 0.0;
  };
  Value specular, reflectance, transmittance, dropped;  // reflectance without the specular part
  std::vector<Value> absorbed;                          // per layer
};

// Called once a chunk of photons, in no fixed order and from several threads; `chunk` names it (combine in its order).
using EscapeSink = std::function<void(int64_t chunk, std::span<const EscapedPhoton>)>;
[[nodiscard]] int64_t MonteCarloChunks(const MonteCarloOptions& options);

// Deterministic by seed, whatever the number of threads. `sink` may be empty. Precondition: Validate() of both is ok.
MonteCarloTotals TraceLayeredTissue(const Tissue& tissue, const MonteCarloOptions& options,
                                    const EscapeSink& sink = {});

// Unpolarised Fresnel reflectance from index n1 into n2 at cosine `cos1` (>= 0); `cos2` receives the refracted cosine.
// 1 at total internal reflection.
[[nodiscard]] double FresnelReflectance(double n1, double n2, double cos1, double* cos2 = nullptr);

}  // namespace stratalux
