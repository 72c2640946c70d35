// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/normal_error.h"

#include <algorithm>
#include <cmath>

#include "fitter/photometric/diffuse_normals.h"
#include "fitter/stages/colours.h"
#include "shared/base/median.h"
#include "shared/image/finite_at.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

double MedianOf(const Image<float>& map, int channel, const Image<uint8_t>& quads) {
  std::vector<double> values;
  for (int j = 0; j < map.height(); ++j)
    for (int i = 0; i < map.width(); ++i)
      if (quads(i, j) != 0 && std::isfinite(map(i, j, channel))) values.push_back(map(i, j, channel));
  return Median(values);
}

}  // namespace

AngleError CompareNormals(const Image<float>& normal, const Image<float>& truth, const Image<uint8_t>& quads) {
  std::vector<double> angles;
  double squares = 0.0;
  for (int j = 0; j < normal.height(); ++j)
    for (int i = 0; i < normal.width(); ++i) {
      if (quads(i, j) == 0 || !FiniteAt(normal, i, j) || !FiniteAt(truth, i, j)) continue;
      double chord2 = 0.0;
      for (int k = 0; k < 3; ++k) chord2 += std::pow(double(normal(i, j, k)) - truth(i, j, k), 2);
      // Small angles, too, which the cosine of single precision does not tell.
      angles.push_back(DegFromRad(2.0 * std::asin(std::min(1.0, 0.5 * std::sqrt(chord2)))));
      squares += angles.back() * angles.back();
    }
  if (angles.empty()) return {};
  const auto quads_compared = static_cast<int64_t>(angles.size());
  return {Median(angles), std::sqrt(squares / static_cast<double>(quads_compared)), quads_compared};
}

NormalFigures CompareNormalsWithTruth(const FoundNormals& found, const TrueSurface& truth) {
  Image<uint8_t> quads = truth.surface.mask;
  for (size_t q = 0; q < quads.size() && !truth.skin.empty(); ++q)
    if (truth.skin.pixels()[q] == 0) quads.pixels()[q] = 0;
  const Image<float>& normal = truth.surface.normal;
  NormalFigures figures{CompareNormals(found.specular, normal, quads),
                        CompareNormals(found.surface, normal, quads),
                        CompareNormals(found.photometric, normal, quads),
                        {}};
  const int colours = found.diffuse.channels() / 3;
  if (truth.diffuse_normal.channels() != found.diffuse.channels() || truth.spread_mm.channels() != colours)
    return figures;
  for (int c = 0; c < colours; ++c) {
    const Image<float> of_colour = NormalsOfColour(truth.diffuse_normal, c);
    figures.diffuse.push_back({Colours(colours)[c], CompareNormals(NormalsOfColour(found.diffuse, c), of_colour, quads),
                               CompareNormals(found.specular, of_colour, quads), MedianOf(found.width_mm, c, quads),
                               MedianOf(truth.spread_mm, c, quads)});
  }
  return figures;
}

}  // namespace stratalux::fit
