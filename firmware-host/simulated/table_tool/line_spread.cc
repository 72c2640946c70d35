// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/table_tool/line_spread.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <mutex>
#include <numbers>

#include "shared/base/formatted.h"

namespace stratalux::rig {
namespace {

// A photon's displacement along u and what it weighs, for one exit direction.
struct Hit {
  float u_mm;
  float weight;
};

// Share of a slit-wide line (centred at 0, uniform) displaced by u that falls into [low, high], over the slit's flux.
double Overlap(double u, double slit, double low, double high) {
  return std::max(0.0, std::min(u + slit / 2, high) - std::max(u - slit / 2, low)) / slit;
}

std::vector<Hit> Trace(const LineSpreadOptions& o, double incidence_deg, double exit_deg) {
  // The tracer's light comes from +x and travels towards -x; incidence > 0 travels towards +u, so u = -x there. A
  // negative incidence is the mirror image.
  const double sign = incidence_deg >= 0.0 ? -1.0 : 1.0;
  const double sin_in = std::sin(std::abs(incidence_deg) * std::numbers::pi / 180.0);
  const double exit = exit_deg * std::numbers::pi / 180.0;
  const double cos_cone = std::cos(o.acceptance_deg * std::numbers::pi / 180.0);
  // Wanted exit direction in tracer coordinates: towards +u, up.
  const double wx = sign * std::sin(exit), wz = -std::cos(exit);
  MonteCarloOptions run;
  run.photons = o.photons;
  // Photons of its own: those of the mirrored light would make one the exact image of the other, noise and all.
  run.seed = o.seed + (incidence_deg < 0.0 ? 0x9e3779b97f4a7c15U : 0U);
  run.sin2_theta_low = run.sin2_theta_high = sin_in * sin_in;
  run.max_path_mm = 300.0;
  run.max_radius_mm = 60.0;
  std::vector<std::vector<Hit>> chunks(static_cast<size_t>(MonteCarloChunks(run)));
  TraceLayeredTissue(AbsorbingSkin(o.channel, o.skin), run, [&](int64_t chunk, std::span<const EscapedPhoton> list) {
    for (const EscapedPhoton& e : list)
      if (e.ux * wx + e.uz * wz >= cos_cone) chunks[chunk].push_back({static_cast<float>(sign * e.x_mm), e.weight});
  });
  // Radiance = flux / (area, projected solid angle of the cone); reflectance unit = pi radiance / irradiance.
  const double projected = std::numbers::pi * (1.0 - cos_cone * cos_cone) * std::cos(exit);
  const double scale = std::numbers::pi / (static_cast<double>(o.photons) * projected);
  std::vector<Hit> hits;
  for (const auto& chunk : chunks)
    for (const Hit& h : chunk) hits.push_back({h.u_mm, static_cast<float>(h.weight * scale)});
  return hits;
}

}  // namespace

Status LineSpreadOptions::Validate() const {
  constexpr double kMostMm = 1000.0, kMostSteps = 100'000.0;
  if (!(half_width_mm > 0.0 && half_width_mm <= kMostMm))
    return Status::Usage(Formatted("profiles: half width = %g mm, allowed: above 0 .. %g", half_width_mm, kMostMm));
  if (!(step_mm > 0.0) || !(half_width_mm / step_mm <= kMostSteps))
    return Status::Usage(Formatted("profiles: step = %g mm, allowed: %g (%g steps to the half width) or more", step_mm,
                                   half_width_mm / kMostSteps, kMostSteps));
  for (const double slit : slit_mm)
    if (!(slit > 0.0 && slit <= kMostMm))
      return Status::Usage(Formatted("profiles: slit = %g mm, allowed: above 0 .. %g", slit, kMostMm));
  return Status::Ok();
}

std::string LineSpreadCsv(const LineSpreadOptions& o) {
  std::string csv = "source,incidence_deg,exit_deg,slit_mm,u_mm,radiance\n";
  const int half = static_cast<int>(std::floor(o.half_width_mm / o.step_mm));
  for (double incidence : o.incidence_deg)
    for (double exit : o.exit_deg) {
      const std::vector<Hit> hits = Trace(o, incidence, exit);
      for (double slit : o.slit_mm) {
        std::vector<double> bins(2 * half + 1, 0.0);
        for (const Hit& h : hits) {
          const int first = std::max(0, static_cast<int>(std::floor((h.u_mm - slit / 2) / o.step_mm + 0.5)) + half);
          const int last =
              std::min(2 * half, static_cast<int>(std::floor((h.u_mm + slit / 2) / o.step_mm + 0.5)) + half);
          for (int k = first; k <= last; ++k) {
            const double low = (k - half - 0.5) * o.step_mm;
            // Flux of the line per mm of its length is irradiance times slit; the mean over the step divides by the
            // step.
            bins[k] += h.weight * Overlap(h.u_mm, slit, low, low + o.step_mm) * slit / o.step_mm;
          }
        }
        for (int k = 0; k < static_cast<int>(bins.size()); ++k) {
          char line[160];
          std::snprintf(line, sizeof line, "i%g e%g s%g,%g,%g,%g,%.6g,%.8g\n", incidence, exit, slit, incidence, exit,
                        slit, (k - half) * o.step_mm, bins[k]);
          csv += line;
        }
      }
    }
  return csv;
}

}  // namespace stratalux::rig
