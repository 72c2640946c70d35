// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/gloss_field.h"

#include <Eigen/SparseCore>
#include <algorithm>
#include <array>
#include <cmath>

namespace stratalux::fit {
namespace {

// The most that a cell's profiles count for, all lights together: what (2) leaves is common to neighbours.
constexpr double kOfACell = 10.0;
// Of squared differences between neighbouring nodes.
constexpr double kTogether = 5.0;
// A node's gloss before light has told is exponential of that rate: most of a face is dry.
constexpr double kDry = 2.0;

int NodesOver(int pixels, int cell_px) { return (pixels - 1) / cell_px + 2; }

struct Corner {
  Eigen::Index node = 0;
  double share = 0.0;
};

// The nodes around a profile.
std::array<Corner, 4> CornersOf(const GlossField& field, int64_t profile) {
  const int64_t pixel = profile / field.channels, columns = field.columns;
  const int64_t rows = std::ssize(field.nodes) / columns;
  const double x = static_cast<double>(pixel % field.width) / field.cell_px,
               y = static_cast<double>(pixel / field.width) / field.cell_px;
  const int64_t i = std::clamp<int64_t>(static_cast<int64_t>(x), 0, columns - 2),
                j = std::clamp<int64_t>(static_cast<int64_t>(y), 0, rows - 2);
  const double right = std::clamp(x - static_cast<double>(i), 0.0, 1.0),
               below = std::clamp(y - static_cast<double>(j), 0.0, 1.0);
  const Eigen::Index first = j * columns + i;
  return {{{first, (1.0 - right) * (1.0 - below)},
           {first + 1, right * (1.0 - below)},
           {first + columns, (1.0 - right) * below},
           {first + columns + 1, right * below}}};
}

// Least squares under that bound, node by node: convex, so that they come to rest at its one solution.
void SolveNonNegative(const Eigen::SparseMatrix<double>& normal, const Eigen::VectorXd& right,
                      std::vector<double>& nodes) {
  constexpr int kMostSweeps = 10000;
  constexpr double kAtRest = 1e-6;
  double moved = 1.0;
  for (int sweep = 0; sweep < kMostSweeps && moved > kAtRest; ++sweep) {
    moved = 0.0;
    for (Eigen::Index k = 0; k < normal.cols(); ++k) {
      double own = 0.0, left = right[k];
      for (Eigen::SparseMatrix<double>::InnerIterator at(normal, k); at; ++at)
        if (at.row() == k)
          own = at.value();
        else
          left -= at.value() * nodes[static_cast<size_t>(at.row())];
      const double solved = std::max(left / own, 0.0);
      moved = std::max(moved, std::abs(solved - nodes[static_cast<size_t>(k)]));
      nodes[static_cast<size_t>(k)] = solved;
    }
  }
}

}  // namespace

double GlossField::At(int64_t profile) const {
  if (nodes.empty()) return 0.0;
  double gloss = 0.0;
  for (const auto& [node, share] : CornersOf(*this, profile)) gloss += share * nodes[static_cast<size_t>(node)];
  return gloss;
}

bool GlossField::IsOf(const ProfileGrid& map) const {
  if (nodes.empty()) return true;
  if (width != map.width || channels != map.channels || width < 1 || map.height < 1 || channels < 1 || cell_px < 1)
    return false;
  return columns == NodesOver(map.width, cell_px) &&
         std::ssize(nodes) == int64_t{columns} * NodesOver(map.height, cell_px) &&
         std::ranges::all_of(nodes, [](double gloss) { return gloss >= 0.0 && std::isfinite(gloss); });
}

GlossField FlatGloss(const ProfileGrid& grid) {
  GlossField field{.width = grid.width, .channels = grid.channels, .nodes = {}};
  if (!(grid.spacing_mm > 0.0) || grid.width < 1 || grid.height < 1) return field;
  field.cell_px = std::max(1, static_cast<int>(std::lround(std::min(kGlossCellMm / grid.spacing_mm, 1e6))));
  field.columns = NodesOver(grid.width, field.cell_px);
  field.nodes.assign(static_cast<size_t>(field.columns) * static_cast<size_t>(NodesOver(grid.height, field.cell_px)),
                     0.0);
  return field;
}

void SolveGloss(std::span<const GlossWitness> witnesses, GlossField& field) {
  if (field.nodes.empty()) return;
  const auto nodes = static_cast<Eigen::Index>(field.nodes.size());
  std::vector<double> profiles(field.nodes.size(), 0.0);  // by the nodes that they lie around
  for (const GlossWitness& w : witnesses)
    for (const auto& [node, share] : CornersOf(field, w.profile)) profiles[static_cast<size_t>(node)] += share;
  std::vector<Eigen::Triplet<double>> normal;
  Eigen::VectorXd right = Eigen::VectorXd::Constant(nodes, -kDry);
  for (const GlossWitness& w : witnesses) {
    const auto corners = CornersOf(field, w.profile);
    double near = 0.0;
    for (const auto& [node, share] : corners) near += share * profiles[static_cast<size_t>(node)];
    const double weight = std::min(1.0, kOfACell / near);
    for (const auto& [node, share] : corners) {
      right[node] += weight * share * w.along;
      for (const auto& [other, of_other] : corners)
        normal.emplace_back(node, other, weight * share * of_other * w.square);
    }
  }
  const auto hold = [&](Eigen::Index a, Eigen::Index b) {
    normal.emplace_back(a, a, kTogether);
    normal.emplace_back(b, b, kTogether);
    normal.emplace_back(a, b, -kTogether);
    normal.emplace_back(b, a, -kTogether);
  };
  for (Eigen::Index k = 0; k < nodes; ++k) {
    if ((k + 1) % field.columns != 0) hold(k, k + 1);
    if (k + field.columns < nodes) hold(k, k + field.columns);
  }
  Eigen::SparseMatrix<double> matrix(nodes, nodes);
  matrix.setFromTriplets(normal.begin(), normal.end());
  SolveNonNegative(matrix, right, field.nodes);
}

}  // namespace stratalux::fit
