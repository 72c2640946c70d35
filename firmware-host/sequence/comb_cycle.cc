// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/comb_cycle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>

#include "shared/base/median.h"

namespace stratalux::rig {
namespace {

constexpr size_t kFewestOfCycle = 300;  // of a cycle that is judged
constexpr size_t kFewestInCell = 30;    // of a cell that a plane is laid through
constexpr int kFewestFar = 8;           // frames
constexpr double kClip = 4.0;           // standard deviations; edges and shadows must not speak for all
constexpr float kLeastLevel = -0.5F, kMostLevel = 1.5F;  // of a probe's white; beyond lies another's light, or noise
constexpr double kBeyondOthers = 4.5;                    // standard deviations of the frames' own unevenness
constexpr double kBeyondNoise = 5.0;                     // standard deviations; a session asks hundreds of lines

// From the frame in which the line passes to `frame`: onwards, and the short way round.
int Ahead(int frame, int passed_in, int frames) { return (frame - passed_in + frames) % frames; }
int Offset(int frame, int passed_in, int frames) {
  const int ahead = Ahead(frame, passed_in, frames);
  return ahead < (frames + 1) / 2 ? ahead : ahead - frames;
}

std::vector<size_t> KnownProbes(const CombCycle& cycle) {
  std::vector<size_t> known;
  for (size_t i = 0; i < cycle.passed_in.size(); ++i)
    if (cycle.passed_in[i] >= 0) known.push_back(i);
  return known;
}

// Level by distance from the passage (ahead: 0 .. K - 1): its mean, and its variance among probes. `share`: of each
// probe, here and below.
struct Passage {
  std::vector<double> mean, variance;
};

Passage MeanPassage(const CombCycle& cycle, const std::vector<size_t>& known, const std::vector<float>& share) {
  std::vector<double> weight(cycle.frames), sum(cycle.frames), squares(cycle.frames);
  for (int k = 0; k < cycle.frames; ++k)
    for (const size_t i : known) {
      const int ahead = Ahead(k, cycle.passed_in[i], cycle.frames);
      const double of_probe = share[i], level = cycle.level[k][i];
      weight[ahead] += of_probe;
      sum[ahead] += of_probe * level;
      squares[ahead] += of_probe * level * level;
    }
  Passage passage;
  for (int o = 0; o < cycle.frames; ++o) {
    const double all = std::max(1e-9, weight[o]), mean = sum[o] / all;
    passage.mean.push_back(mean);
    passage.variance.push_back(std::max(0.0, squares[o] / all - mean * mean));
  }
  return passage;
}

// Light of each frame over what the passage says of its probes, each distance weighed.
std::vector<double> LightOverMean(const CombCycle& cycle, const std::vector<size_t>& known,
                                  const std::vector<float>& share, const std::vector<double>& mean,
                                  const std::vector<double>& weight) {
  std::vector<double> gain;
  for (int k = 0; k < cycle.frames; ++k) {
    double light = 0.0, expected = 0.0;
    for (const size_t i : known) {
      const int ahead = Ahead(k, cycle.passed_in[i], cycle.frames);
      const double of_probe = share[i] * weight[ahead];
      light += of_probe * cycle.level[k][i];
      expected += of_probe * mean[ahead];
    }
    gain.push_back(light / std::max(1e-9, expected));
  }
  return gain;
}

// Plane through values over the lattice, outliers left out.
struct Plane {
  Eigen::Vector3d at = Eigen::Vector3d::Zero();  // value at the mean place, slopes along x and y
  std::vector<double> rest;
};

Plane LayPlane(const std::vector<Eigen::Vector2d>& place, const std::vector<double>& value) {
  Eigen::Vector2d middle = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : place) middle += p / static_cast<double>(place.size());
  Plane plane;
  plane.at[0] = Median(value);
  auto take_off = [&] {
    plane.rest.clear();
    for (size_t i = 0; i < value.size(); ++i)
      plane.rest.push_back(value[i] - plane.at[0] - plane.at.tail<2>().dot(place[i] - middle));
  };
  take_off();
  for (int round = 0; round < 2; ++round) {
    std::vector<double> off;
    for (const double r : plane.rest) off.push_back(std::abs(r));
    const double limit = 4.5 * Median(std::move(off)) + 1e-9;
    Eigen::Matrix3d normal = 1e-9 * Eigen::Matrix3d::Identity();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (size_t i = 0; i < value.size(); ++i) {
      if (std::abs(plane.rest[i]) > limit) continue;
      const Eigen::Vector3d row(1.0, place[i].x() - middle.x(), place[i].y() - middle.y());
      normal += row * row.transpose();
      right += row * value[i];
    }
    plane.at = normal.ldlt().solve(right);
    take_off();
  }
  return plane;
}

// What one probe says: its excess of light over its deviation, and what each of a, b, c would make of it.
struct Excess {
  int passed_in = 0;
  double sigmas = 0.0, deviation = 1.0;
  Eigen::Vector3d effect = Eigen::Vector3d::UnitX();
};

struct Near {
  double light = 0.0, variance = 0.0;
};

Near NearLight(const CombCycle& cycle, size_t probe, const MotionOptions& options) {
  const int near = 2 * options.near_frames + 1, far = cycle.frames - near;
  const double share = static_cast<double>(near) / far;
  Near sum;
  for (int k = 0; k < cycle.frames; ++k) {
    const bool is_near = std::abs(Offset(k, cycle.passed_in[probe], cycle.frames)) <= options.near_frames;
    const double weight = is_near ? 1.0 : -share;
    sum.light += weight * cycle.level[k][probe];
    sum.variance += weight * weight * cycle.variance[k][probe];
  }
  return sum;
}

void AddCell(const CombCycle& cycle, const std::vector<size_t>& probes, const MotionOptions& options,
             std::vector<Excess>& all) {
  std::vector<Eigen::Vector2d> place;
  std::vector<double> light, deviation, position;
  for (const size_t i : probes) {
    const Near near = NearLight(cycle, i, options);
    place.emplace_back(cycle.x[i], cycle.y[i]);
    light.push_back(near.light);
    deviation.push_back(std::sqrt(near.variance + options.model_error * options.model_error));
    position.push_back(cycle.position[i]);
  }
  const Plane even = LayPlane(place, light), slope = LayPlane(place, position);
  for (size_t k = 0; k < probes.size(); ++k)
    all.push_back({cycle.passed_in[probes[k]],
                   std::clamp(even.rest[k] / deviation[k], -kClip, kClip),
                   deviation[k],
                   {1.0, slope.at[1], slope.at[2]}});
}

// `slope`: rms of the projector position's change from camera pixel to camera pixel, px.
std::vector<Excess> ExcessOfAll(const CombCycle& cycle, const std::vector<size_t>& known, const MotionOptions& options,
                                double& slope) {
  std::map<std::pair<int, int>, std::vector<size_t>> cells;
  for (const size_t i : known) cells[{cycle.y[i] / options.cell, cycle.x[i] / options.cell}].push_back(i);
  std::vector<Excess> all;
  for (const auto& [place, probes] : cells)
    if (probes.size() >= kFewestInCell) AddCell(cycle, probes, options, all);
  // Slopes in units of their rms, so that b and c are comparable with a.
  double squares = 0.0;
  for (const Excess& e : all) squares += e.effect.tail<2>().squaredNorm();
  const double rms = std::sqrt(squares / std::max(1.0, static_cast<double>(all.size()))) + 1e-9;
  for (Excess& e : all) e.effect.tail<2>() /= rms;
  slope = rms / cycle.pitch;
  return all;
}

// Score and rms change of the probes passed in one stretch.
struct Fit {
  double score = 0.0, change = 0.0;
};

Fit FitStretch(const std::vector<const Excess*>& probes, const MotionOptions& options) {
  Eigen::Matrix3d normal = 1e-6 * Eigen::Matrix3d::Identity();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (const Excess* e : probes) {
    const Eigen::Vector3d row = e->effect / e->deviation;
    normal += row * row.transpose();
    right += row * e->sigmas;
  }
  const Eigen::Vector3d fitted = normal.ldlt().solve(right);
  Eigen::Matrix3d covariance = normal.inverse();
  covariance(0, 0) += options.uneven_light * options.uneven_light;
  for (int k : {1, 2}) covariance(k, k) += options.uneven_slope * options.uneven_slope;
  double squares = 0.0;
  for (const Excess* e : probes) squares += std::pow(e->effect.dot(fitted), 2);
  return {fitted.dot(covariance.ldlt().solve(fitted)), std::sqrt(squares / static_cast<double>(probes.size()))};
}

}  // namespace

std::vector<double> FrameGains(const CombCycle& as_seen) {
  const std::vector<size_t> known = KnownProbes(as_seen);
  if (known.size() < kFewestOfCycle) return {};
  CombCycle cycle = as_seen;
  for (auto& levels : cycle.level)
    for (float& level : levels) level = std::clamp(level, kLeastLevel, kMostLevel);
  // The lamp scales all of a frame's light alike, but what a probe has under the line itself depends on its skin and on
  // where in the line's step it lies: least squares, by how far probes agree at each distance. They differ by a share
  // of their own white more than by their photons' noise, so each counts alike: by contrast, six highlights on dark
  // skin, ten times as bright as all else, had spoken for a line's three hundred probes.
  const std::vector<float> alike(cycle.passed_in.size(), 1.0F);
  const Passage passage = MeanPassage(cycle, known, alike);
  std::vector<double> weight;
  for (int o = 0; o < cycle.frames; ++o)
    weight.push_back(std::max(0.0, passage.mean[o]) / std::max(1e-9, passage.variance[o]));
  return LightOverMean(cycle, known, alike, passage.mean, weight);
}

std::vector<Blink> FindBlinks(const std::vector<double>& gain, double tolerance) {
  const auto frames = static_cast<std::ptrdiff_t>(gain.size()), about = std::min<std::ptrdiff_t>(frames, 7);
  std::vector<double> light, off;
  for (std::ptrdiff_t k = 0; k < frames; ++k) {
    const auto first = gain.begin() + std::clamp<std::ptrdiff_t>(k - about / 2, 0, frames - about);
    light.push_back(gain[k] / std::max(1e-9, Median({first, first + about})));
    off.push_back(std::abs(light.back() - 1.0));
  }
  std::vector<Blink> blinks;
  for (int k = 0; k < static_cast<int>(frames); ++k) {
    std::vector<double> others = off;
    others.erase(others.begin() + k);
    const double limit = std::max(tolerance, kBeyondOthers * kMadToDeviation * Median(std::move(others)));
    if (off[k] > limit) blinks.push_back({k, light[k], limit});
  }
  return blinks;
}

std::optional<CombMotion> FindMotion(const CombCycle& cycle, const std::vector<bool>& spoilt,
                                     const MotionOptions& options) {
  const std::vector<size_t> known = KnownProbes(cycle);
  if (known.size() < kFewestOfCycle || cycle.frames < 2 * options.near_frames + 1 + kFewestFar) return std::nullopt;
  double slope = 0.0;
  const std::vector<Excess> all = ExcessOfAll(cycle, known, options, slope);
  const double limit = slope > options.coarse_px ? options.largest_still_score_coarse : options.largest_still_score;
  if (all.size() < kFewestOfCycle) return std::nullopt;
  // A frame of another light spoils what the probes have that a line passes next to it.
  constexpr int kReach = 3;
  std::vector<std::vector<const Excess*>> passed(cycle.frames);
  for (const Excess& e : all) {
    bool sound = true;
    // The cycle closes: what the last frames give is near to the first passages, too.
    for (int k = 0; k < std::min(cycle.frames, static_cast<int>(spoilt.size())); ++k)
      sound = sound && !(spoilt[k] && std::abs(Offset(k, e.passed_in, cycle.frames)) <= kReach);
    if (sound) passed[e.passed_in].push_back(&e);
  }
  std::optional<CombMotion> most;
  std::optional<int> begin;
  for (int first = 0; first + options.stretch <= cycle.frames; ++first) {
    std::vector<const Excess*> stretch;
    for (int k = first; k < first + options.stretch; ++k)
      stretch.insert(stretch.end(), passed[k].begin(), passed[k].end());
    if (stretch.size() < kFewestInCell) continue;
    const Fit fit = FitStretch(stretch, options);
    const int middle = first + options.stretch / 2;
    if (!begin && fit.score > limit) begin = middle;
    if (!most || fit.score > most->score)
      most = {.limit = limit, .score = fit.score, .change = fit.change, .frame = middle};
  }
  if (most && begin) most->frame = *begin;
  return most;
}

std::optional<MissingComb> FindMissingComb(const CombCycle& cycle) {
  const std::vector<size_t> known = KnownProbes(cycle);
  if (known.size() < kFewestOfCycle) return std::nullopt;
  const std::vector<double> passage = MeanPassage(cycle, known, cycle.contrast).mean,
                            light = LightOverMean(cycle, known, cycle.contrast, passage,
                                                  std::vector<double>(cycle.frames, 1.0));
  std::vector<double> sum(cycle.frames), weight(cycle.frames), variance(cycle.frames);
  for (const size_t i : known) {
    const double contrast = cycle.contrast[i];
    const int line = cycle.passed_in[i];
    weight[line] += contrast;
    // One black is taken off all frames: its noise adds up as it is, the frames' own in squares.
    double noise = static_cast<double>(cycle.frames) * cycle.frames * cycle.black_variance[i];
    for (int k = 0; k < cycle.frames; ++k) {
      sum[line] += contrast * cycle.level[k][i];
      noise += cycle.variance[k][i];
    }
    variance[line] += contrast * contrast * noise;
  }
  double whole = 0.0, all = 0.0;
  for (int k = 0; k < cycle.frames; ++k) {
    whole += sum[k];
    all += weight[k];
  }
  const double mean = whole / std::max(1e-9, all), half_a_frame = 0.5 * passage[0] / mean;
  std::optional<MissingComb> missing;
  bool twice = false;
  for (int k = 0; k < cycle.frames; ++k) {
    if (weight[k] <= 0.0) continue;
    const double here = sum[k] / weight[k] / mean;
    const double limit = std::max(half_a_frame, kBeyondNoise * std::sqrt(variance[k]) / weight[k] / mean);
    twice = twice || here > 1.0 + limit;
    if (here < 1.0 - limit && std::abs(light[k] - 1.0) < 0.5 && (!missing || here < missing->sum))
      missing = MissingComb{k, here, limit};
  }
  return twice ? missing : std::nullopt;
}

}  // namespace stratalux::rig
