// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/face_look.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

namespace stratalux::rig {
namespace {

constexpr double kNearestMm = 100.0, kFurthestMm = 5000.0;
constexpr size_t kLeastTelling = 12;  // blocks

// The blocks connected with `start` over edges; takes them out of `left`.
std::vector<int> TakePart(const Foreground& grid, std::vector<uint8_t>& left, int start) {
  std::vector<int> part = {start};
  left[static_cast<size_t>(start)] = 0;
  for (size_t next = 0; next < part.size(); ++next) {
    const int column = part[next] % grid.columns, row = part[next] / grid.columns;
    for (const auto& [dx, dy] : {std::pair(-1, 0), std::pair(1, 0), std::pair(0, -1), std::pair(0, 1)}) {
      const int x = column + dx, y = row + dy;
      if (x < 0 || y < 0 || x >= grid.columns || y >= grid.rows) continue;
      uint8_t& neighbour = left[static_cast<size_t>(y * grid.columns + x)];
      if (neighbour != 0) part.push_back(y * grid.columns + x);
      neighbour = 0;
    }
  }
  return part;
}

// Of a block: the sum of `bit` minus `inverse`.
int64_t Difference(const CodeBit& code, int x, int y) {
  int64_t sum = 0;
  for (int j = 0; j < kLitBlock; ++j)
    for (int i = 0; i < kLitBlock; ++i) sum += int64_t{code.bit(x + i, y + j)} - code.inverse(x + i, y + j);
  return sum;
}

// Middle of the stripe that the block lies in; nullopt where an edge of the code runs through it.
std::optional<double> ColumnOf(std::span<const CodeBit> code, int code_bits, int width, int x, int y) {
  std::vector<int64_t> differences;
  int64_t strongest = 0;
  for (const CodeBit& bit : code) {
    differences.push_back(Difference(bit, x, y));
    strongest = std::max(strongest, std::abs(differences.back()));
  }
  unsigned gray = 0;
  for (const int64_t difference : differences) {
    if (3 * std::abs(difference) < strongest) return std::nullopt;
    gray = gray << 1 | (difference > 0 ? 1U : 0U);
  }
  // Codes count columns of the whole 2^code_bits.
  const double stripe = std::ldexp(1.0, code_bits - static_cast<int>(code.size()));
  const double first = stripe * BinaryFromGray(gray);
  const double last = std::min(first + stripe, static_cast<double>(width));
  return first < last ? std::optional(0.5 * (first + last) - 0.5) : std::nullopt;
}

// Where the camera's ray through the pixel has this column of the projector; the column changes one way along the ray.
std::optional<double> DepthMm(const RigCalibration& calibration, int projector, const Eigen::Vector2d& pixel,
                              double column) {
  const ProjectorCalibration& from = calibration.projectors[static_cast<size_t>(projector)];
  const Eigen::Vector3d ray = calibration.camera.model.Unproject(pixel);
  const auto beyond = [&](double depth) -> std::optional<double> {
    const auto seen = from.ProjectFromCamera(ray / ray.z() * depth);
    if (!seen) return std::nullopt;
    return seen->x() - column;
  };
  double near = kNearestMm, far = kFurthestMm;
  const auto at_far = beyond(far);
  while (near < far && !beyond(near)) near *= 1.2;
  const auto at_near = near < far ? beyond(near) : std::nullopt;
  if (!at_near || !at_far || (*at_near > 0.0) == (*at_far > 0.0)) return std::nullopt;
  while (far - near > 0.1) {
    const double middle = 0.5 * (near + far);
    ((*beyond(middle) > 0.0) == (*at_near > 0.0) ? near : far) = middle;
  }
  return near;
}

}  // namespace

int64_t Foreground::Count() const {
  return std::count_if(lit.begin(), lit.end(), [](uint8_t l) { return l != 0; });
}

std::optional<Foreground> ForegroundOf(std::span<const PreScan> scans, double read_noise_dn) {
  if (scans.empty()) return std::nullopt;
  Foreground grid;
  grid.columns = scans.front().white.width() / kLitBlock;
  grid.rows = scans.front().white.height() / kLitBlock;
  grid.lit.resize(static_cast<size_t>(grid.columns) * static_cast<size_t>(grid.rows));
  for (const PreScan& scan : scans)
    for (const LitBlock& block : LitBlocks(scan, read_noise_dn))
      grid.lit[static_cast<size_t>(block.y / kLitBlock * grid.columns + block.x / kLitBlock)] = 1;
  std::vector<uint8_t> left = grid.lit;
  std::vector<int> largest;
  for (int start = 0; start < static_cast<int>(left.size()); ++start) {
    if (left[static_cast<size_t>(start)] == 0) continue;
    std::vector<int> part = TakePart(grid, left, start);
    if (part.size() > largest.size()) largest = std::move(part);
  }
  if (largest.empty()) return std::nullopt;
  std::fill(grid.lit.begin(), grid.lit.end(), uint8_t{0});
  for (const int block : largest) grid.lit[static_cast<size_t>(block)] = 1;
  return grid;
}

FaceBox BoxOf(const Foreground& foreground) {
  std::vector<int> columns, rows;
  for (int y = 0; y < foreground.rows; ++y)
    for (int x = 0; x < foreground.columns; ++x)
      if (foreground.At(x, y)) {
        columns.push_back(x);
        rows.push_back(y);
      }
  std::sort(columns.begin(), columns.end());  // rows came in order
  const size_t stray = columns.size() / 100, last = columns.size() - 1 - stray;
  const auto share = [](int block, int blocks) { return 1000 * block / blocks; };
  return {share(columns[stray], foreground.columns), share(rows[stray], foreground.rows),
          share(columns[last] + 1, foreground.columns), share(rows[last] + 1, foreground.rows)};
}

int CoveragePermille(const Foreground& before, const Foreground& now) {
  if (before.columns != now.columns || before.rows != now.rows || before.Count() == 0) return 0;
  int64_t both = 0;
  for (size_t i = 0; i < before.lit.size(); ++i) both += before.lit[i] != 0 && now.lit[i] != 0 ? 1 : 0;
  return static_cast<int>(1000 * both / before.Count());
}

std::vector<std::pair<Pattern, Pattern>> CoarseCode(const CapturePlan& plan, int projector, int bits) {
  std::vector<std::pair<Pattern, Pattern>> code;
  for (const PlanStep& step : plan.steps) {
    const Pattern& p = step.pattern;
    if (step.projector != projector || p.kind != PatternKind::kGray || p.axis != PatternAxis::kColumns || p.inverse)
      continue;
    if (p.bit != static_cast<int>(code.size()) || p.bit >= bits) continue;
    // Reflected Gray code, as the memory has it for boards: its leading bits tell by themselves.
    Pattern bit{.kind = PatternKind::kGray, .axis = p.axis, .bit = p.bit, .bits = p.bits};
    Pattern inverse = bit;
    inverse.inverse = true;
    code.emplace_back(bit, inverse);
  }
  return code;
}

std::optional<double> MedianDistanceMm(const Foreground& foreground, std::span<const CodeBit> code, int code_bits,
                                       const RigCalibration& calibration, int projector) {
  const int width = calibration.projectors[static_cast<size_t>(projector)].model.width;
  std::vector<double> depths;
  for (int y = 0; y < foreground.rows; ++y)
    for (int x = 0; x < foreground.columns; ++x) {
      if (!foreground.At(x, y)) continue;
      const auto column = ColumnOf(code, code_bits, width, x * kLitBlock, y * kLitBlock);
      if (!column) continue;
      constexpr double kMiddle = 0.5 * (kLitBlock - 1);
      const Eigen::Vector2d pixel(x * kLitBlock + kMiddle, y * kLitBlock + kMiddle);
      if (const auto depth = DepthMm(calibration, projector, pixel, *column)) depths.push_back(*depth);
    }
  if (depths.size() < kLeastTelling) return std::nullopt;
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  return *middle;
}

}  // namespace stratalux::rig
