// SPDX-License-Identifier: Apache-2.0
// Quads: the 2x2 Bayer blocks on which SRD, EM and all maps live. Quad (i, j) has its centre at mosaic pixel
// (2i + 0.5, 2j + 0.5); each colour's own site(s) lie off that centre (the two greens average to it).
#pragma once

#include <Eigen/Core>
#include <vector>

#include "shared/image/pixel_format.h"

namespace stratalux {

// Maps are W/2 x H/2 x 3 for Bayer mosaics and W x H x 1 for mono cameras.
[[nodiscard]] constexpr int QuadStep(Cfa cfa) { return cfa == Cfa::kMono ? 1 : 2; }
[[nodiscard]] constexpr int QuadChannels(Cfa cfa) { return cfa == Cfa::kMono ? 1 : 3; }
[[nodiscard]] inline Eigen::Vector2d QuadCentre(Cfa cfa, int i, int j) {
  const int step = QuadStep(cfa);
  return {step * i + (step - 1) * 0.5, step * j + (step - 1) * 0.5};
}
// Positions of the sites of colour `channel` within the quad, relative to its centre, mosaic px: one, or the two
// greens.
[[nodiscard]] inline std::vector<Eigen::Vector2d> QuadSites(Cfa cfa, int channel) {
  if (cfa == Cfa::kMono) return {Eigen::Vector2d(0.0, 0.0)};
  std::vector<Eigen::Vector2d> sites;
  for (int y = 0; y < 2; ++y)
    for (int x = 0; x < 2; ++x)
      if (CfaColour(cfa, x, y) == channel) sites.emplace_back(x - 0.5, y - 0.5);
  return sites;
}
// The same of each colour.
[[nodiscard]] inline std::vector<std::vector<Eigen::Vector2d>> QuadSites(Cfa cfa) {
  std::vector<std::vector<Eigen::Vector2d>> sites;
  for (int channel = 0; channel < QuadChannels(cfa); ++channel) sites.push_back(QuadSites(cfa, channel));
  return sites;
}
// Mean of those of one colour.
[[nodiscard]] inline Eigen::Vector2d QuadSiteOffset(Cfa cfa, int channel) {
  const auto sites = QuadSites(cfa, channel);
  return (sites.front() + sites.back()) / 2.0;
}

}  // namespace stratalux
