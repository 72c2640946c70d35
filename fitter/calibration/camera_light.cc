// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/camera_light.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "fitter/calibration/monotone.h"
#include "shared/base/median.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

constexpr int kTile = 16;  // sites
constexpr int kTileColours = 3;
constexpr int kResponseNodes = 65;
constexpr int kTerms = 4;               // of h beyond the linear one
constexpr double kTransferRange = 0.6;  // of the range
constexpr double kHotSigmas = 6.0;

// h in units of the range, without the linear term's factor.
double Linearised(double s, const Eigen::VectorXd& a) {
  double sum = 1.0, power = 1.0;
  for (Eigen::Index k = 0; k < a.size(); ++k) sum += a[k] * (power *= s);
  return s * sum;
}

}  // namespace

void QuantisationStep::Add(ImageView<const uint16_t> raw) {
  for (int y = 0; y < raw.height(); ++y)
    for (int x = 0; x < raw.width(); ++x) bits_ |= raw(x, y);
}

int QuantisationStep::dn() const { return bits_ == 0 ? 1 : static_cast<int>(bits_ & (~bits_ + 1)); }

double NoiseInTheDark(double read_noise_dn, int step_dn) {
  return std::sqrt(read_noise_dn * read_noise_dn + (double(step_dn) * step_dn - 1.0) / 12.0);
}

Status DarkStatistics::Add(const Image<uint16_t>& raw, double exposure_ms) {
  if (!exposures_.empty() &&
      (raw.width() != exposures_[0].first.width() || raw.height() != exposures_[0].first.height()))
    return Status::Integrity("dark frames differ in size");
  step_.Add(raw);
  auto found = std::find_if(exposures_.begin(), exposures_.end(),
                            [&](const Exposure& e) { return std::abs(e.ms - exposure_ms) <= 1e-3 * exposure_ms; });
  if (found == exposures_.end()) {
    exposures_.push_back(
        {exposure_ms, 1, raw, Image<int32_t>(raw.width(), raw.height()), Image<int64_t>(raw.width(), raw.height())});
    return Status::Ok();
  }
  ++found->frames;
  for (size_t i = 0; i < raw.size(); ++i) {
    const int32_t d = int32_t{raw.pixels()[i]} - int32_t{found->first.pixels()[i]};
    found->sum.pixels()[i] += d;
    found->squares.pixels()[i] += int64_t{d} * d;
  }
  return Status::Ok();
}

double DarkStatistics::MeanAt(const Exposure& e, size_t site) const {
  return e.first.pixels()[site] + static_cast<double>(e.sum.pixels()[site]) / e.frames;
}

double DarkStatistics::VarianceAt(const Exposure& e, size_t site) const {
  const auto sum = static_cast<double>(e.sum.pixels()[site]);
  return (static_cast<double>(e.squares.pixels()[site]) - sum * sum / e.frames) / (e.frames - 1);
}

Result<DarkReport> DarkStatistics::Finish() const {
  DarkReport report;
  if (exposures_.empty()) return Status::Failed("no dark frame");
  for (const Exposure& e : exposures_) {
    report.frames += e.frames;
    if (e.frames < 4)
      return Status::Failed("only " + std::to_string(e.frames) + " dark frames of " + std::to_string(e.ms) + " ms");
  }
  const auto by_time = [](const Exposure& a, const Exposure& b) { return a.ms < b.ms; };
  const Exposure& shortest = *std::min_element(exposures_.begin(), exposures_.end(), by_time);
  const Exposure& longest = *std::max_element(exposures_.begin(), exposures_.end(), by_time);
  const int width = shortest.first.width(), height = shortest.first.height();
  // Level = offset + rate t, by least squares over the exposures: weights of each mean in both.
  double t_mean = 0.0, t_square = 0.0;
  const auto n = static_cast<double>(exposures_.size());
  for (const Exposure& e : exposures_) t_mean += e.ms / n;
  for (const Exposure& e : exposures_) t_square += (e.ms - t_mean) * (e.ms - t_mean);
  report.offset_dn = Image<float>(width, height);
  report.read_noise_dn_map = Image<float>(width, height);
  report.hot = Image<uint8_t>(width, height);
  std::vector<double> rates(report.hot.size()), levels(report.hot.size());
  double offset_noise = 0.0;  // variance of an offset, in units of a frame's
  for (const Exposure& e : exposures_) {
    const double slope = t_square > 0.0 ? (e.ms - t_mean) / t_square : 0.0, weight = 1.0 / n - slope * t_mean;
    offset_noise += weight * weight / e.frames;
    for (size_t i = 0; i < rates.size(); ++i) {
      const double mean = MeanAt(e, i);
      rates[i] += slope * mean;
      report.offset_dn.pixels()[i] += static_cast<float>(weight * mean);
    }
  }
  for (size_t i = 0; i < levels.size(); ++i) {
    levels[i] = MeanAt(longest, i);
    report.read_noise_dn_map.pixels()[i] = static_cast<float>(std::sqrt(std::max(0.0, VarianceAt(shortest, i))));
  }
  const double usual = Median(levels);
  std::vector<double> deviations(levels.size());
  for (size_t i = 0; i < levels.size(); ++i) deviations[i] = std::abs(levels[i] - usual);
  const double limit = kHotSigmas * std::max(Median(deviations) / 0.6745, 0.5 / std::sqrt(longest.frames));
  double offsets = 0.0, squares = 0.0, variance = 0.0;
  int64_t count = 0;
  for (size_t i = 0; i < levels.size(); ++i) {
    if (levels[i] - usual > limit) {
      report.hot.pixels()[i] = 1;
      ++report.hot_pixels;
      continue;
    }
    const double offset = report.offset_dn.pixels()[i];
    offsets += offset;
    squares += (offset - usual) * (offset - usual);
    variance += VarianceAt(shortest, i);
    ++count;
  }
  const auto sites = static_cast<double>(count);
  report.black_level_dn = offsets / sites;
  variance /= sites;
  const double bias = report.black_level_dn - usual;
  report.offset_spread_dn = std::sqrt(std::max(0.0, squares / sites - bias * bias - variance * offset_noise));
  report.step_dn = step_.dn();
  report.read_noise_dn = std::sqrt(std::max(0.0, variance - report.step_dn * report.step_dn / 12.0));
  report.dark_current_dn_per_s = 1000.0 * Median(rates);
  return report;
}

void ExposureRamp::Add(const RampFrames& frames) {
  const int width = frames.white_a.width(), height = frames.white_a.height();
  const int columns = width / kTile, rows = height / kTile;
  for (const auto* raw : {&frames.white_a, &frames.white_b, &frames.black}) step_.Add(*raw);
  Exposure exposure{frames.exposure_ms, std::vector<Cell>(static_cast<size_t>(columns) * rows * kTileColours)};
  ParallelFor(rows, 4, [&](int64_t begin, int64_t end) {
    for (int64_t j = begin; j < end; ++j)
      for (int i = 0; i < columns; ++i) {
        std::array<double, kTileColours> light{}, dark{}, difference{}, square{};
        std::array<int, kTileColours> count{};
        std::array<bool, kTileColours> saturated{};
        for (int y = static_cast<int>(j) * kTile; y < (static_cast<int>(j) + 1) * kTile; ++y)
          for (int x = i * kTile; x < (i + 1) * kTile; ++x) {
            const int c = CfaColour(cfa_, x, y);
            const double a = frames.white_a(x, y), b = frames.white_b(x, y);
            saturated[c] = saturated[c] || a >= saturation_dn_ || b >= saturation_dn_;
            light[c] += 0.5 * (a + b);
            dark[c] += frames.black(x, y);
            difference[c] += a - b;
            square[c] += (a - b) * (a - b);
            ++count[c];
          }
        for (int c = 0; c < kTileColours; ++c) {
          if (saturated[c] || count[c] < 8) continue;
          Cell& cell = exposure.cells[(static_cast<size_t>(j) * columns + i) * kTileColours + c];
          const double n = count[c];
          // The lamp may differ between the two by a little, alike in all of the tile: the mean goes.
          cell = {light[c] / n, dark[c] / n, 0.5 * (square[c] - difference[c] * difference[c] / n) / (n - 1.0),
                  count[c]};
        }
      }
  });
  exposures_.push_back(std::move(exposure));
}

std::vector<double> ExposureRamp::Offsets() const {
  if (exposures_.empty()) return {};
  std::vector<double> offsets(exposures_[0].cells.size(), 0.0);
  for (size_t k = 0; k < offsets.size(); ++k) {
    Eigen::Matrix2d normal = Eigen::Matrix2d::Zero();
    Eigen::Vector2d right = Eigen::Vector2d::Zero();
    for (const Exposure& e : exposures_) {
      if (e.cells[k].sites == 0) continue;
      const Eigen::Vector2d row(1.0, e.ms);
      normal += row * row.transpose();
      right += row * e.cells[k].black;
    }
    if (normal.determinant() > 1e-9) offsets[k] = normal.ldlt().solve(right)[0];
  }
  return offsets;
}

Result<PhotonTransfer> ExposureRamp::Transfer(const std::vector<double>& response) const {
  struct Tile {
    double signal, straight, variance, sites;  // straight: L / h'^2, to which the shot noise of `signal` belongs
  };
  const double quantisation = step_.dn() * step_.dn() / 12.0;
  CameraCalibration camera;
  camera.black_level_dn = 0.0;
  camera.saturation_dn = range_dn_;
  camera.response = response;
  const auto of_straight = [&](double level) {
    const double reach = range_dn_ / kResponseNodes;
    const double slope = (camera.LinearDn(level + reach) - camera.LinearDn(level - reach)) / (2.0 * reach);
    return camera.LinearDn(level) / (slope * slope);
  };
  const std::vector<double> offsets = Offsets();
  std::vector<Tile> tiles;
  for (const Exposure& e : exposures_)
    for (size_t k = 0; k < e.cells.size(); ++k) {
      const Cell& cell = e.cells[k];
      const double signal = cell.level - offsets[k];
      if (cell.sites > 0 && signal < kTransferRange * range_dn_)
        tiles.push_back({signal, of_straight(signal), cell.variance - quantisation, static_cast<double>(cell.sites)});
    }
  if (tiles.size() < 50) return Status::Failed("photon transfer: only " + std::to_string(tiles.size()) + " tiles");
  // A variance from n differences has a relative variance of 2 / (n - 1); the weights follow the line itself.
  Eigen::Vector2d line(1.0, 1.0);
  Eigen::Matrix2d normal;
  for (int round = 0; round < 8; ++round) {
    normal.setZero();
    Eigen::Vector2d right = Eigen::Vector2d::Zero();
    for (const Tile& t : tiles) {
      const Eigen::Vector2d row(1.0, t.straight);
      const double expected = std::max(round == 0 ? t.variance : line.dot(row), 0.05) + quantisation;
      const double weight = 0.5 * (t.sites - 1.0) / (expected * expected);
      normal += weight * row * row.transpose();
      right += weight * t.variance * row;
    }
    line = normal.ldlt().solve(right);
  }
  if (!(line[1] > 0.0) || !line.allFinite())
    return Status::Failed("photon transfer: the noise does not grow with the light");
  PhotonTransfer transfer;
  transfer.gain_e_per_dn = 1.0 / line[1];
  transfer.gain_sd = std::sqrt(normal.inverse()(1, 1)) / (line[1] * line[1]);
  transfer.read_noise_dn = std::sqrt(std::max(0.0, line[0]));
  transfer.step_dn = step_.dn();
  constexpr int kPoints = 24;
  transfer.points.resize(kPoints);
  for (const Tile& t : tiles) {
    const int k = std::clamp(static_cast<int>(kPoints * t.signal / (kTransferRange * range_dn_)), 0, kPoints - 1);
    TransferPoint& p = transfer.points[k];
    p.signal_dn += t.signal * t.sites;
    p.variance_dn2 += (t.variance + quantisation) * t.sites;
    p.sites += static_cast<int64_t>(t.sites);
  }
  std::erase_if(transfer.points, [](const TransferPoint& p) { return p.sites == 0; });
  for (TransferPoint& p : transfer.points) {
    p.signal_dn /= static_cast<double>(p.sites);
    p.variance_dn2 /= static_cast<double>(p.sites);
  }
  return transfer;
}

Result<CameraResponseReport> ExposureRamp::Response() const {
  CameraResponseReport report;
  for (const Exposure& e : exposures_) report.exposures_ms.push_back(e.ms);
  if (exposures_.size() < 4)
    return Status::Failed("camera response: only " + std::to_string(exposures_.size()) + " exposures");
  // h(s_j) = L e_j: L is projected out tile by tile, the a_k remain.
  const auto rows = static_cast<Eigen::Index>(exposures_.size());
  Eigen::VectorXd e(rows);
  for (Eigen::Index j = 0; j < rows; ++j) e[j] = exposures_[j].ms / exposures_[0].ms;
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(kTerms, kTerms);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(kTerms);
  struct Tile {
    Eigen::VectorXd s, w;
  };
  const std::vector<double> offsets = Offsets();
  std::vector<Tile> tiles;
  for (size_t k = 0; k < offsets.size(); ++k) {
    Tile tile{Eigen::VectorXd::Zero(rows), Eigen::VectorXd::Zero(rows)};
    int used = 0;
    for (Eigen::Index j = 0; j < rows; ++j) {
      const Cell& cell = exposures_[j].cells[k];
      if (cell.sites == 0) continue;
      const double signal = cell.level - offsets[k];
      tile.s[j] = signal / range_dn_;
      // Noise of the mean, and a part in 2000 for what lamp and shutter do.
      const double noise2 = std::max(cell.variance, 0.1) / cell.sites + std::pow(5e-4 * signal, 2);
      tile.w[j] = range_dn_ * range_dn_ / noise2;
      ++used;
    }
    const double brightest = tile.s.maxCoeff();
    if (used < 4 || brightest < 0.1) continue;
    Eigen::MatrixXd terms(rows, kTerms + 1);
    terms.col(0) = tile.s;
    for (int t = 1; t <= kTerms; ++t) terms.col(t) = terms.col(t - 1).cwiseProduct(tile.s);
    const double ee = (e.array().square() * tile.w.array()).sum();
    const Eigen::RowVectorXd along = (e.array() * tile.w.array()).matrix().transpose() * terms / ee;
    const Eigen::MatrixXd rest = terms - e * along;
    const Eigen::MatrixXd weighted = tile.w.asDiagonal() * rest;
    normal += rest.rightCols(kTerms).transpose() * weighted.rightCols(kTerms);
    right -= weighted.rightCols(kTerms).transpose() * rest.col(0);
    report.reached = std::max(report.reached, brightest);
    tiles.push_back(std::move(tile));
  }
  if (tiles.size() < 20) return Status::Failed("camera response: only " + std::to_string(tiles.size()) + " lit tiles");
  const Eigen::VectorXd a = normal.ldlt().solve(right);
  double squares = 0.0;
  int64_t count = 0;
  for (const Tile& tile : tiles) {
    Eigen::VectorXd h(rows);
    for (Eigen::Index j = 0; j < rows; ++j) h[j] = Linearised(tile.s[j], a);
    const double light = (e.array() * tile.w.array() * h.array()).sum() / (e.array().square() * tile.w.array()).sum();
    for (Eigen::Index j = 0; j < rows; ++j) {
      if (tile.w[j] == 0.0) continue;
      squares += std::pow(h[j] - light * e[j], 2);
      ++count;
    }
  }
  report.residual = std::sqrt(squares / static_cast<double>(count));
  // Beyond the brightest level nothing was measured: the curve goes on with the slope it has there.
  const double top = std::min(report.reached, 1.0);
  const double slope = (Linearised(top, a) - Linearised(0.98 * top, a)) / (0.02 * top);
  for (int k = 0; k < kResponseNodes; ++k) {
    const double s = static_cast<double>(k) / (kResponseNodes - 1);
    report.response.push_back(s <= top ? Linearised(s, a) : Linearised(top, a) + slope * (s - top));
  }
  report.response = MonotoneFrom(report.response);
  report.response[0] = 0.0;
  for (int k = 0; k < kResponseNodes; ++k)
    report.largest_deviation =
        std::max(report.largest_deviation,
                 std::abs(report.response[k] / report.response.back() - static_cast<double>(k) / (kResponseNodes - 1)));
  return report;
}

}  // namespace stratalux::fit
