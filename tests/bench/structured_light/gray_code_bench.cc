// SPDX-License-Identifier: Apache-2.0
// Columns and rows of a simulated face from Gray codes and their inverses, beside OpenCV's GrayCodePattern on the same
// frames (its own rule, a pixel at a time, of the frames as 8 bit): how many sites of lit skin get the projector pixel
// that the truth says, and what a site costs on one thread. docs/benchmarks.md.
//   STRATALUX_BENCH_STORE=store build/bench/bin/gray_code_bench [SESSION]      a simulated session, with its truth
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <string>
#include <vector>

#include <opencv2/structured_light.hpp>

#include "fitter/evaluation/truth.h"
#include "fitter/session/session_frames.h"
#include "fitter/structured_light/gray_decoder.h"
#include "shared/base/check.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

constexpr double kRightPx = 1.0;  // a whole projector pixel is the most that a code alone can be held to

template <typename T>
T Must(Result<T> result) {
  if (!result.ok()) {
    std::fprintf(stderr, "error: %s\n", result.status().message().c_str());
    std::exit(result.status().exit_code());
  }
  return std::move(result).value();
}

// The code's frames of one projector, by axis and bit.
struct Codes {
  Image<uint16_t> white;
  Image<float> black;
  std::vector<Image<uint16_t>> frames[2]{}, inverses[2]{}, shifts[2]{};
  int count[2] = {0, 0};
  int period_px = 0;
};

Codes ReadCodes(const SessionFrames& session, int projector) {
  const PlanOptions& plan = *session.plan();
  Codes codes{.white = Must(session.Read(projector, CapturePhase::kReference, {.kind = PatternKind::kWhite})),
              .black = Must(session.MeanBlack(projector))};
  codes.count[0] = plan.projector_width;
  codes.count[1] = plan.projector_height;
  codes.period_px = plan.separation_period;
  for (int axis = 0; axis < 2; ++axis) {
    Pattern pattern{.kind = PatternKind::kGray, .axis = axis == 0 ? PatternAxis::kColumns : PatternAxis::kRows};
    pattern.bits = GrayBits(codes.count[axis]);
    for (pattern.bit = 0; pattern.bit < pattern.bits; ++pattern.bit)
      for (pattern.inverse = false;; pattern.inverse = true) {
        auto& list = pattern.inverse ? codes.inverses[axis] : codes.frames[axis];
        list.push_back(Must(session.Read(projector, CapturePhase::kCorrespondence, pattern)));
        if (pattern.inverse) break;
      }
    for (int shift = 0; shift < plan.separation_shifts; ++shift) {
      const Pattern sinusoid{.kind = PatternKind::kSinusoid,
                             .axis = pattern.axis,
                             .period = plan.separation_period,
                             .shift = shift,
                             .shifts = plan.separation_shifts};
      if (session.Find(projector, CapturePhase::kSeparation, sinusoid) == nullptr) break;
      codes.shifts[axis].push_back(Must(session.Read(projector, CapturePhase::kSeparation, sinusoid)));
    }
  }
  return codes;
}

// Where a decoder says that each site sees the projector; NaN where it says nothing.
struct Columns {
  Image<float> column, row;
  double seconds = 0.0;
};

double ProcessorSeconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

enum class Sinusoids { kRead, kLeft };
Columns Ours(const Codes& codes, const SensorNoise& noise, Sinusoids sinusoids) {
  DecodeInput input{.white = codes.white, .black = codes.black};
  for (int axis = 0; axis < 2; ++axis) {
    AxisCode& code = axis == 0 ? input.columns : input.rows;
    code.count = codes.count[axis];
    for (size_t b = 0; b < codes.frames[axis].size(); ++b)
      code.bits.push_back({codes.frames[axis][b], codes.inverses[axis][b]});
    if (sinusoids == Sinusoids::kLeft || codes.shifts[axis].empty()) continue;
    for (const auto& shift : codes.shifts[axis]) code.shifts.push_back(shift);
    code.period_px = codes.period_px;
  }
  const double begin = ProcessorSeconds();
  DecodeReport report = Must(DecodeGray(input, noise));
  return {std::move(report.map.column), std::move(report.map.row), ProcessorSeconds() - begin};
}

cv::Mat EightBits(ImageView<const uint16_t> image, double black_dn, double saturation_dn) {
  cv::Mat mat(image.height(), image.width(), CV_8U);
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x)
      mat.at<uchar>(y, x) = cv::saturate_cast<uchar>(255.0 * (image(x, y) - black_dn) / (saturation_dn - black_dn));
  return mat;
}

struct PeerLimits {
  int white, black;  // GrayCodePattern's thresholds of a pair's and of white minus black's difference, of 255
};
Columns Peer(const Codes& codes, const SensorNoise& noise, const PeerLimits& limits) {
  const auto convert = [&](ImageView<const uint16_t> image) {
    return EightBits(image, noise.black_level_dn, noise.saturation_dn);
  };
  std::vector<cv::Mat> frames;
  for (int axis = 0; axis < 2; ++axis)
    for (size_t b = 0; b < codes.frames[axis].size(); ++b) {
      frames.push_back(convert(codes.frames[axis][b]));
      frames.push_back(convert(codes.inverses[axis][b]));
    }
  const cv::Mat white = convert(codes.white);
  const double dn = (noise.saturation_dn - noise.black_level_dn) / 255.0;
  auto pattern = cv::structured_light::GrayCodePattern::create(codes.count[0], codes.count[1]);
  pattern->setWhiteThreshold(static_cast<size_t>(limits.white));
  const int width = codes.white.width(), height = codes.white.height();
  Columns columns{Image<float>(width, height, 1, std::nanf("")), Image<float>(width, height, 1, std::nanf(""))};
  const double begin = ProcessorSeconds();
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const double black = (codes.black(x, y) - noise.black_level_dn) / dn;
      if (white.at<uchar>(y, x) - black <= limits.black) continue;
      cv::Point at;
      if (pattern->getProjPixel(frames, x, y, at)) continue;  // true: an error
      columns.column(x, y) = static_cast<float>(at.x);
      columns.row(x, y) = static_cast<float>(at.y);
    }
  columns.seconds = ProcessorSeconds() - begin;
  return columns;
}

// Projector pixel of each site of skin that the projector lights; NaN elsewhere.
struct Truth {
  Image<float> column, row;
  int64_t sites = 0;
};

Truth TrueColumns(const SceneTruth& scene, const RigCalibration& rig, int projector) {
  const SurfaceMap surface = Must(scene.Surface(rig));
  const Image<uint8_t> skin = Must(scene.Skin()), lit = Must(scene.LitBy(projector));
  const Pinhole& camera = rig.camera.model;
  const ProjectorCalibration& p = rig.projectors[projector];
  Truth truth{Image<float>(camera.width, camera.height, 1, std::nanf("")),
              Image<float>(camera.width, camera.height, 1, std::nanf(""))};
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const int i = x / 2, j = y / 2;
      if (!skin.contains(i, j) || skin(i, j) == 0 || lit(i, j) == 0) continue;
      // The site's ray, on the tangent plane of its quad.
      const Eigen::Vector3d ray = camera.Unproject({double(x), double(y)});
      const Eigen::Vector3d point = surface.Point(i, j), normal = surface.Normal(i, j);
      if (!point.allFinite() || !normal.allFinite()) continue;
      const Eigen::Vector3d hit = ray * (point.dot(normal) / ray.dot(normal));
      const auto seen = p.model.Project(p.camera_from_projector.Inverse() * hit);
      if (!seen) continue;
      truth.column(x, y) = static_cast<float>(seen->x());
      truth.row(x, y) = static_cast<float>(seen->y());
      ++truth.sites;
    }
  return truth;
}

void Print(const char* name, const Columns& columns, const Truth& truth, double ours_seconds) {
  int64_t right = 0, wrong = 0;
  double sum = 0.0, sum2 = 0.0;
  for (size_t k = 0; k < truth.column.size(); ++k) {
    const double du = columns.column.pixels()[k] - truth.column.pixels()[k],
                 dv = columns.row.pixels()[k] - truth.row.pixels()[k];
    if (std::isnan(truth.column.pixels()[k]) || std::isnan(du + dv)) continue;
    const bool is_right = std::abs(du) <= kRightPx && std::abs(dv) <= kRightPx;
    ++(is_right ? right : wrong);
    if (!is_right) continue;
    sum += du;
    sum2 += du * du;
  }
  const auto percent = [&](int64_t n) { return 100.0 * static_cast<double>(n) / static_cast<double>(truth.sites); };
  const double mean = sum / static_cast<double>(std::max<int64_t>(right, 1));
  const double rms = std::sqrt(sum2 / static_cast<double>(std::max<int64_t>(right, 1)) - mean * mean);
  std::printf("%-44s %8.2f %8.2f %10.3f %10.3f %12.1f %8.2f\n", name, percent(right), percent(wrong), mean, rms,
              1e9 * columns.seconds / static_cast<double>(columns.column.size()), columns.seconds / ours_seconds);
}

int Main(const std::string& store, const std::string& selector) {
  const SessionFrames session = Must(SessionFrames::Open(store, selector));
  const auto scene = Must(SceneTruth::Open(session.folder()));
  if (!scene || !session.plan()) {
    std::fprintf(stderr, "error: %s has no truth: a simulated session is asked for\n", session.folder().c_str());
    return 2;
  }
  const RigCalibration& rig = *session.calibration();
  const SensorNoise noise = SensorNoise::From(rig.camera);
  for (int p = 0; p < static_cast<int>(rig.projectors.size()); ++p) {
    const Codes codes = ReadCodes(session, p);
    const Truth truth = TrueColumns(*scene, rig, p);
    std::printf("projector %d: %lld sites of lit skin; column and row within %.0f px of the truth\n", p,
                static_cast<long long>(truth.sites), kRightPx);
    std::printf("%-44s %8s %8s %10s %10s %12s %8s\n", "", "right, %", "wrong, %", "mean, px", "rms, px", "ns a site",
                "times");
    const Columns bits = Ours(codes, noise, Sinusoids::kLeft);
    Print("Gray codes alone", bits, truth, bits.seconds);
    Print("Gray codes and sinusoids", Ours(codes, noise, Sinusoids::kRead), truth, bits.seconds);
    for (const PeerLimits& limits :
         {PeerLimits{5, 40}, PeerLimits{5, 8}, PeerLimits{2, 8}, PeerLimits{0, 4}, PeerLimits{0, 1}}) {
      const std::string name = "GrayCodePattern, white " + std::to_string(limits.white) + ", black " +
                               std::to_string(limits.black) + (limits.black == 40 ? " (its own)" : "");
      Print(name.c_str(), Peer(codes, noise, limits), truth, bits.seconds);
    }
  }
  return 0;
}

}  // namespace
}  // namespace stratalux::fit

int main(int argc, char** argv) {
  setenv("STRATALUX_THREADS", "1", 1);
  const char* store = std::getenv("STRATALUX_BENCH_STORE");
  if (store == nullptr) {
    std::fprintf(stderr, "error: STRATALUX_BENCH_STORE names no store\n");
    return 2;
  }
  return stratalux::fit::Main(store, argc > 1 ? argv[1] : "latest");
}
