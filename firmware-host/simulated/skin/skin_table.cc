// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin/skin_table.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numbers>
#include <span>

#include <xxhash.h>
#include <zstd.h>

namespace stratalux::rig {
namespace {

using G = SkinGrid;
constexpr float kPi = std::numbers::pi_v<float>;
constexpr char kMagic[8] = {'S', 'L', 'X', 'S', 'K', 'I', 'N', '1'};
// 16-bit code of log2(S r^1.5): 1/1200 octave a step (0.06 %), from 2^-40 up; 0 means zero.
constexpr float kCodeStep = 1200.0F;
constexpr float kCodeFloor = -40.0F;

double BinCentreMm(int bin) {
  if (bin == 0) return G::kFirstRadiusMm * 0.5;
  return std::sqrt(G::RadiusEdgeMm(bin) * G::RadiusEdgeMm(bin + 1));
}

// Base-2 logarithm, error below 1e-4: exponent bits plus a cubic of the mantissa.
float FastLog2(float x) {
  uint32_t bits;
  std::memcpy(&bits, &x, 4);
  const float exponent = static_cast<float>(static_cast<int>(bits >> 23) - 127);
  bits = (bits & 0x7fffffU) | 0x3f800000U;
  float m;
  std::memcpy(&m, &bits, 4);
  return exponent + (((-0.0821343F * m + 0.649732F) * m - 2.1347F) * m + 4.0700908F) * m - 2.5028F;
}

// atan2 / (2 pi) in [0, 1), error below 3e-5 of a turn.
float FastTurns(float y, float x) {
  const float ax = std::abs(x), ay = std::abs(y);
  const float big = std::max(ax, ay), small = std::min(ax, ay);
  const float t = big > 0.0F ? small / big : 0.0F;
  const float t2 = t * t;
  float a = (((-0.0464965F * t2 + 0.159314F) * t2 - 0.327623F) * t2 + 1.0F) * t / (2.0F * kPi);
  if (ay > ax) a = 0.25F - a;
  if (x < 0.0F) a = 0.5F - a;
  if (y < 0.0F) a = 1.0F - a;
  return a >= 1.0F ? 0.0F : a;
}

// Within half the first radius S is constant, so S r^1.5 is read there: bin 0's centre.
constexpr float kInnerMm = 0.5F * static_cast<float>(G::kFirstRadiusMm);

// Position of a radius (squared, at least kInnerMm^2) between bin centres, in bins.
float RadialPosition(float r2) {
  static const float kLogFirst = std::log2(static_cast<float>(G::kFirstRadiusMm));
  static const float kPerOctave =
      static_cast<float>((G::kRadii - 1.0) / std::log2(G::kMaxRadiusMm / G::kFirstRadiusMm));
  // Bin b >= 1 has its centre half a step after its lower edge; bin 0's centre is kFirst / 2.
  float position = 0.5F + (0.5F * FastLog2(r2) - kLogFirst) * kPerOctave;
  if (position < 1.0F) {
    static const float kInnerPosition = 0.5F - kPerOctave;  // where kFirst / 2 falls
    position = std::max(0.0F, (position - kInnerPosition) / (1.0F - kInnerPosition));
  }
  return std::min(position, G::kRadii - 1.0F);
}

// Row i: the mean of S over ring i (as S r^1.5 at its centre) of the interpolant whose node j alone is 1.
using RingMatrix = std::array<std::array<float, G::kRadii>, G::kRadii>;
RingMatrix MeansOfInterpolant() {
  constexpr int kSteps = 256;
  RingMatrix means{};
  for (int i = 0; i < G::kRadii; ++i) {
    const double a2 = std::pow(G::RadiusEdgeMm(i), 2), b2 = std::pow(G::RadiusEdgeMm(i + 1), 2);
    for (int k = 0; k < kSteps; ++k) {
      const double r2 = std::max(a2 + (b2 - a2) * (k + 0.5) / kSteps, double(kInnerMm) * kInnerMm);
      const float position = RadialPosition(static_cast<float>(r2));
      const int j = std::min(static_cast<int>(position), G::kRadii - 2);
      const float f = position - static_cast<float>(j);
      const float scale = static_cast<float>(std::pow(BinCentreMm(i) / std::sqrt(r2), 1.5) / kSteps);
      means[i][j] += (1 - f) * scale;
      means[i][j + 1] += f * scale;
    }
  }
  return means;
}

// Position of v between nodes: index of the lower one and the weight of the upper one, clamped.
std::pair<int, float> Between(std::span<const double> nodes, double v) {
  const int last = static_cast<int>(nodes.size()) - 1;
  if (v <= nodes[0]) return {0, 0.0F};
  if (v >= nodes[last]) return {last - 1, 1.0F};
  int i = 0;
  while (v >= nodes[i + 1]) ++i;
  return {i, static_cast<float>((v - nodes[i]) / (nodes[i + 1] - nodes[i]))};
}

const std::array<double, G::kThetas>& ThetaNodes() {
  static const auto nodes = [] {
    std::array<double, G::kThetas> n{};
    for (int i = 0; i < G::kThetas; ++i) n[i] = G::MeanThetaRad(i);
    return n;
  }();
  return nodes;
}

// A node of theta and its weight. `across`: on the other side of the normal, at -theta.
struct ThetaNode {
  int bin;
  float weight;
  bool across;
};

// Below the first node theta lies between that node and its image across the normal, so that the kernel passes through
// the normal without a jump and light along the normal is displaced to no side.
std::array<ThetaNode, 2> NodesAround(float theta) {
  const float first = static_cast<float>(ThetaNodes()[0]);
  if (theta < first) {
    const float weight = 0.5F + 0.5F * std::max(theta, 0.0F) / first;
    return {{{0, weight, false}, {0, 1.0F - weight, true}}};
  }
  const auto [bin, f] = Between(ThetaNodes(), theta);
  return {{{bin, 1.0F - f, false}, {bin + 1, f, false}}};
}

// Sums kernels whose lamp (x) or view (y) stands across the normal: the mirror images of the table's.
class PsiMirror {
 public:
  PsiMirror(bool x, bool y) : identity_(!x && !y) {
    constexpr int n = G::kPolar;
    for (int psi = 0; psi < n; ++psi) {
      const int in_x = x ? (n / 2 - 1 - psi + n) % n : psi;
      from_[psi] = y ? n - 1 - in_x : in_x;
    }
  }
  void Add(float weight, const float* cells, std::array<float, G::kCells>& sum) const {
    if (identity_) {
      for (int k = 0; k < G::kCells; ++k) sum[k] += weight * cells[k];
      return;
    }
    for (int i = 0; i < G::kCells; i += G::kPolar)
      for (int psi = 0; psi < G::kPolar; ++psi) sum[i + psi] += weight * cells[i + from_[psi]];
  }

 private:
  bool identity_;
  std::array<int, G::kPolar> from_{};
};

std::array<double, 4> Logs(const std::array<double, 4>& values) {
  std::array<double, 4> logs{};
  for (int i = 0; i < 4; ++i) logs[i] = std::log(values[i]);
  return logs;
}

}  // namespace

double SkinGrid::RadiusEdgeMm(int edge) {
  if (edge == 0) return 0.0;
  return kFirstRadiusMm * std::pow(kMaxRadiusMm / kFirstRadiusMm, (edge - 1.0) / (kRadii - 1.0));
}

size_t SkinGrid::KernelIndex(int channel, int in, int out, int azimuth, int melanin, int blood) {
  return ((((size_t(channel) * kThetas + in) * kThetas + out) * kAzimuths + azimuth) * kMelanin.size() + melanin) *
             kBlood.size() +
         blood;
}

double SkinGrid::MeanThetaRad(int bin) {
  // Mean theta under the Lambertian measure sin(2 theta) d theta.
  const double a = kThetaEdgesDeg[bin] * std::numbers::pi / 180.0,
               b = kThetaEdgesDeg[bin + 1] * std::numbers::pi / 180.0;
  auto primitive = [](double t) { return std::sin(2 * t) / 4 - t * std::cos(2 * t) / 2; };
  return (primitive(b) - primitive(a)) / (std::pow(std::sin(b), 2) - std::pow(std::sin(a), 2));
}

float SkinKernel::operator()(float x_mm, float y_mm) const {
  const float r2 = x_mm * x_mm + y_mm * y_mm;
  if (r2 >= static_cast<float>(G::kMaxRadiusMm * G::kMaxRadiusMm)) return 0.0F;
  const float clamped2 = std::max(r2, kInnerMm * kInnerMm);
  const float position = RadialPosition(clamped2);
  const int i = std::min(static_cast<int>(position), G::kRadii - 2);
  const float f = position - static_cast<float>(i);
  float turn = FastTurns(y_mm, x_mm) * G::kPolar - 0.5F;
  if (turn < 0.0F) turn += G::kPolar;
  const int j = static_cast<int>(turn);
  const float h = turn - static_cast<float>(j);
  const float* a = flat_.data() + i * (G::kPolar + 1) + j;
  const float* b = a + G::kPolar + 1;
  const float value = (1 - f) * ((1 - h) * a[0] + h * a[1]) + f * ((1 - h) * b[0] + h * b[1]);
  const float r = std::sqrt(clamped2);
  return value / (r * std::sqrt(r));
}

void SkinKernel::SetRingMeans(const std::array<float, G::kCells>& means) {
  // The mean over a ring is not the value at its centre: nodes equal to the means would lose 2 % of the light. Scaling
  // each node by what its ring lacks keeps it positive; three rounds leave less than 0.1 %.
  static const RingMatrix kMeans = MeansOfInterpolant();
  constexpr int kRounds = 3;
  constexpr float kTiny = 1e-30F;
  std::array<float, G::kCells> nodes = means;
  for (int round = 0; round < kRounds; ++round) {
    const std::array<float, G::kCells> last = nodes;
    for (int i = 0; i < G::kRadii; ++i) {
      const int lower = std::max(0, i - 1), upper = std::min(G::kRadii - 1, i + 1);
      const float a = i > 0 ? kMeans[i][lower] : 0.0F, b = kMeans[i][i], c = i < upper ? kMeans[i][upper] : 0.0F;
      for (int psi = 0; psi < G::kPolar; ++psi) {
        const float mean =
            a * last[lower * G::kPolar + psi] + b * last[i * G::kPolar + psi] + c * last[upper * G::kPolar + psi];
        nodes[i * G::kPolar + psi] *= means[i * G::kPolar + psi] / (mean + kTiny);
      }
    }
  }
  for (int i = 0; i < G::kRadii; ++i) {
    float* row = flat_.data() + i * (G::kPolar + 1);
    std::copy_n(nodes.data() + i * G::kPolar, G::kPolar, row);
    row[G::kPolar] = row[0];
  }
}

double SkinKernel::Integral() const {
  static const std::array<double, G::kRadii> kWeights = [] {
    const RingMatrix means = MeansOfInterpolant();
    std::array<double, G::kRadii> weights{};
    for (int i = 0; i < G::kRadii; ++i) {
      const double area =
          std::numbers::pi * (std::pow(G::RadiusEdgeMm(i + 1), 2) - std::pow(G::RadiusEdgeMm(i), 2)) / G::kPolar;
      for (int j = 0; j < G::kRadii; ++j) weights[j] += means[i][j] * area / std::pow(BinCentreMm(i), 1.5);
    }
    return weights;
  }();
  double sum = 0.0;
  for (int i = 0; i < G::kRadii; ++i)
    for (int j = 0; j < G::kPolar; ++j) sum += kWeights[i] * flat_[i * (G::kPolar + 1) + j];
  return sum;
}

double SkinTable::Cell(size_t kernel, int radius, int psi) const {
  return flat_[kernel * G::kCells + radius * G::kPolar + psi] / std::pow(BinCentreMm(radius), 1.5);
}

void SkinTable::Interpolate(int channel, const SkinParameters& parameters, const SkinDirections& directions,
                            SkinKernel& out) const {
  static const auto kLogMelanin = Logs(G::kMelanin);
  static const auto kLogBlood = Logs(G::kBlood);
  const float azimuth = std::clamp(directions.azimuth_rad / kPi * 4.0F, 0.0F, 4.0F);
  const int az = std::min(static_cast<int>(azimuth), 3);
  const float f_az = azimuth - static_cast<float>(az);
  const auto [me, f_me] = Between(kLogMelanin, std::log(std::max(parameters.melanin, 1e-6F)));
  const auto [bl, f_bl] = Between(kLogBlood, std::log(std::max(parameters.blood, 1e-6F)));

  std::array<float, G::kCells> sum{};
  for (const ThetaNode& in : NodesAround(directions.theta_in_rad))
    for (const ThetaNode& ex : NodesAround(directions.theta_out_rad)) {
      const PsiMirror mirror(in.across, ex.across);
      for (int corner = 0; corner < 8; ++corner) {
        const int b0 = corner & 1, b1 = corner >> 1 & 1, b2 = corner >> 2;
        const float weight = in.weight * ex.weight * (b0 != 0 ? f_az : 1 - f_az) * (b1 != 0 ? f_me : 1 - f_me) *
                             (b2 != 0 ? f_bl : 1 - f_bl);
        if (weight == 0.0F) continue;
        const int azimuth_bin = in.across == ex.across ? az + b0 : G::kAzimuths - 1 - az - b0;
        const float* cells =
            flat_.data() + G::KernelIndex(channel, in.bin, ex.bin, azimuth_bin, me + b1, bl + b2) * G::kCells;
        mirror.Add(weight, cells, sum);
      }
    }
  out.SetRingMeans(sum);
}

double SkinTable::Albedo(int channel, const SkinParameters& parameters, double theta_in_rad) const {
  double albedo = 0.0;
  SkinKernel kernel;
  for (int out = 0; out < G::kThetas; ++out)
    for (int az = 0; az < G::kAzimuths; ++az) {
      const double a = G::kThetaEdgesDeg[out] * std::numbers::pi / 180,
                   b = G::kThetaEdgesDeg[out + 1] * std::numbers::pi / 180;
      const double azimuth_width = (az == 0 || az == 4 ? 0.25 : 0.5) * std::numbers::pi;  // both signs of the azimuth
      const double projected = (std::pow(std::sin(b), 2) - std::pow(std::sin(a), 2)) / 2 * azimuth_width;
      Interpolate(
          channel, parameters,
          {static_cast<float>(theta_in_rad), static_cast<float>(ThetaNodes()[out]), static_cast<float>(az) * kPi / 4},
          kernel);
      albedo += kernel.Integral() * projected;
    }
  return albedo;
}

Status SkinTable::Save(const std::string& path, const std::string& manifest_json) const {
  std::vector<uint16_t> codes(flat_.size());
  for (size_t i = 0; i < flat_.size(); ++i) {
    const float code = flat_[i] > 0.0F ? (std::log2(flat_[i]) - kCodeFloor) * kCodeStep : 0.0F;
    codes[i] = static_cast<uint16_t>(std::clamp(code + 0.5F, flat_[i] > 0.0F ? 1.0F : 0.0F, 65535.0F));
  }
  std::vector<char> packed(ZSTD_compressBound(codes.size() * 2));
  const size_t size = ZSTD_compress(packed.data(), packed.size(), codes.data(), codes.size() * 2, 19);
  if (ZSTD_isError(size) != 0) return Status::Failed(std::string("zstd: ") + ZSTD_getErrorName(size));
  std::ofstream out(path, std::ios::binary | std::ios::trunc);
  const uint64_t header[4] = {codes.size(), size, XXH3_64bits(packed.data(), size), manifest_json.size()};
  out.write(kMagic, sizeof kMagic);
  out.write(reinterpret_cast<const char*>(header), sizeof header);
  out.write(manifest_json.data(), static_cast<std::streamsize>(manifest_json.size()));
  out.write(packed.data(), static_cast<std::streamsize>(size));
  out.flush();
  if (!out) return Status::Failed("cannot write " + path + ": " + std::strerror(errno));
  return Status::Ok();
}

Result<SkinTable> SkinTable::Load(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in)
    return Status::NotFound("skin table " + path + ": " + std::strerror(errno) +
                            " (make one with `stratalux-skin-table generate`)");
  const std::vector<char> bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  uint64_t header[4] = {};
  constexpr size_t kHeader = sizeof kMagic + sizeof header;
  if (bytes.size() < kHeader || std::memcmp(bytes.data(), kMagic, sizeof kMagic - 1) != 0)
    return Status::Integrity("skin table " + path + ": not a skin table");
  if (bytes[7] != kMagic[7])
    return Status(StatusCode::kNewerSchema, "skin table " + path + ": version " + bytes[7] + ", this program reads 1");
  std::memcpy(header, bytes.data() + sizeof kMagic, sizeof header);
  const size_t expected = G::kKernels * G::kCells;
  if (header[0] != expected || header[1] > bytes.size() || header[3] > bytes.size() ||
      kHeader + header[3] + header[1] != bytes.size())
    return Status::Integrity("skin table " + path + ": truncated, or of another grid");
  const char* packed = bytes.data() + kHeader + header[3];
  if (XXH3_64bits(packed, header[1]) != header[2]) return Status::Integrity("skin table " + path + ": hash mismatch");
  std::vector<uint16_t> codes(expected);
  if (ZSTD_decompress(codes.data(), codes.size() * 2, packed, header[1]) != codes.size() * 2)
    return Status::Integrity("skin table " + path + ": cannot be decompressed");
  SkinTable table;
  table.manifest_.assign(bytes.data() + kHeader, header[3]);
  table.flat_.resize(expected);
  for (size_t i = 0; i < expected; ++i)
    table.flat_[i] = codes[i] == 0 ? 0.0F : std::exp2(static_cast<float>(codes[i]) / kCodeStep + kCodeFloor);
  return table;
}

std::string SkinTable::DefaultPath() {
  if (const char* path = std::getenv("STRATALUX_SKIN_TABLE")) return path;
  return STRATALUX_SKIN_TABLE_PATH;
}

}  // namespace stratalux::rig
