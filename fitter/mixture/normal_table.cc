// SPDX-License-Identifier: Apache-2.0
#include "fitter/mixture/normal_table.h"

#include <cmath>
#include <numbers>
#include <vector>

namespace stratalux::fit {
namespace {

constexpr double kTableEnd = 7.0;  // beyond they are 0, 1 or x, to 1e-11
constexpr double kNodesPerUnit = 128.0;
constexpr int kTableIntervals = static_cast<int>(2 * kTableEnd * kNodesPerUnit);

double Density(double x) { return std::exp(-0.5 * x * x) / std::sqrt(2 * std::numbers::pi); }
double Below(double x) { return 0.5 * std::erfc(-x / std::numbers::sqrt2); }

// Cubic Hermite interpolation between nodes.
class Table {
 public:
  template <typename Value, typename Slope>
  Table(const Value& value, const Slope& slope) {
    for (int i = 0; i <= kTableIntervals; ++i) {
      const double at = i / kNodesPerUnit - kTableEnd;
      nodes_.push_back({value(at), slope(at) / kNodesPerUnit});
    }
  }
  // `place`: intervals from the first node, inside.
  [[nodiscard]] double At(double place) const {
    const int i = static_cast<int>(place);
    const double t = place - i, rise = nodes_[i + 1].value - nodes_[i].value;
    const double c = nodes_[i].slope - rise, d = rise - nodes_[i + 1].slope;
    return nodes_[i].value + t * (rise + (1.0 - t) * (c * (1.0 - t) + d * t));
  }

 private:
  struct Node {
    double value, slope;  // slope: per interval
  };
  std::vector<Node> nodes_;
};

}  // namespace

double NormalBelow(double x) {
  static const Table table(Below, Density);
  const double place = (x + kTableEnd) * kNodesPerUnit;
  if (!(place > 0.0)) return 0.0;
  return place >= kTableIntervals ? 1.0 : table.At(place);
}

double NormalRamp(double x) {
  static const Table table([](double at) { return at * Below(at) + Density(at); }, Below);
  const double place = (x + kTableEnd) * kNodesPerUnit;
  if (!(place > 0.0)) return 0.0;
  return place >= kTableIntervals ? x : table.At(place);
}

}  // namespace stratalux::fit
