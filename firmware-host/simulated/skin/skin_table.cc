// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin/skin_table.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <numbers>
#include <numeric>
#include <span>

#include <nlohmann/json.hpp>

#include "firmware-host/simulated/skin/skin_table_code.h"
#include "firmware-host/simulated/skin/subcutis_table.h"
#include "shared/base/check.h"
#include "shared/base/formatted.h"
#include "shared/base/program_data.h"
#include "shared/base/version.h"
#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;
using G = SkinGrid;
constexpr float kFloatPi = std::numbers::pi_v<float>;

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
  float a = (((-0.0464965F * t2 + 0.159314F) * t2 - 0.327623F) * t2 + 1.0F) * t / (2.0F * kFloatPi);
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

// Fresnel transmittance into skin at sin(theta) outside.
double TransmittanceAt(double sine) {
  return 1.0 - FresnelReflectance(1.0, kSkinIndex, std::sqrt(std::max(0.0, 1.0 - sine * sine)));
}

// What light meets at the surface is known: S holds the Fresnel transmittance of each of its two directions, which
// falls steeply towards grazing, and inside the tissue it goes on at sin(theta) / n, on which the rest depends
// smoothly. So each bin is a node at its mean sin(theta), transmittance taken out.
struct ThetaBins {
  std::array<double, G::kThetas> sine{}, transmittance{};
  ThetaBins() {
    constexpr int kSteps = 1000;
    for (int i = 0; i < G::kThetas; ++i) {
      const double low = G::Sin2Edge(i), high = G::Sin2Edge(i + 1);
      for (int k = 0; k < kSteps; ++k) {  // evenly in sin^2: the Lambertian measure
        const double s = std::sqrt(low + (high - low) * (k + 0.5) / kSteps), t = TransmittanceAt(s);
        sine[i] += s * t;
        transmittance[i] += t / kSteps;
      }
      sine[i] /= kSteps * transmittance[i];
    }
  }
};
const ThetaBins& Thetas() {
  static const ThetaBins bins;
  return bins;
}

// A node of theta and its weight, the transmittance at theta included. `across`: on the other side of the normal, at
// -theta.
struct ThetaNode {
  int bin;
  float weight;
  bool across;
};

// Below the first node theta lies between that node and its image across the normal, so that the kernel passes through
// the normal without a jump and light along the normal is displaced to no side.
std::array<ThetaNode, 2> ThetasAround(float theta) {
  const ThetaBins& bins = Thetas();
  const double sine = std::sin(std::clamp(theta, 0.0F, 0.5F * kFloatPi));
  const double transmittance = TransmittanceAt(sine);
  auto weight = [&](int bin, double share) {
    return static_cast<float>(share * transmittance / bins.transmittance[bin]);
  };
  if (sine < bins.sine[0]) {
    const double same = 0.5 + 0.5 * sine / bins.sine[0];
    return {{{0, weight(0, same), false}, {0, weight(0, 1.0 - same), true}}};
  }
  const auto [bin, f] = Between(bins.sine, sine);
  return {{{bin, weight(bin, 1.0 - f), false}, {bin + 1, weight(bin + 1, f), false}}};
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

// Position between nodes on the scale of v^power.
template <size_t N>
class PowerScale {
 public:
  PowerScale(const std::array<double, N>& nodes, double power) : power_(power) {
    for (size_t i = 0; i < N; ++i) nodes_[i] = std::pow(nodes[i], power);
  }
  [[nodiscard]] std::pair<int, float> Around(float v) const {
    return Between(nodes_, std::pow(std::max(static_cast<double>(v), 0.0), power_));
  }

 private:
  double power_;
  std::array<double, N> nodes_{};
};

// Position between the nodes of scattering, on the scale of its square root: that of light far out, exp(-mu_eff r).
std::pair<int, float> ScatteringsAround(const std::vector<double>& nodes, float scattering) {
  const auto upper = std::upper_bound(nodes.begin(), nodes.end(), static_cast<double>(scattering));
  const int first =
      std::clamp(static_cast<int>(upper - nodes.begin()) - 1, 0, std::max(0, static_cast<int>(nodes.size()) - 2));
  if (nodes.size() == 1) return {first, 0.0F};
  const double low = std::sqrt(nodes[first]), high = std::sqrt(nodes[first + 1]);
  const double f = (std::sqrt(std::max(0.0F, scattering)) - low) / (high - low);
  return {first, static_cast<float>(std::clamp(f, 0.0, 1.0))};
}

}  // namespace

double SkinGrid::RadiusEdgeMm(int edge) {
  if (edge == 0) return 0.0;
  return kFirstRadiusMm * std::pow(kMaxRadiusMm / kFirstRadiusMm, (edge - 1.0) / (kRadii - 1.0));
}

int SkinGrid::NodeIndex(int melanin, int blood, int epidermis) {
  return (melanin * static_cast<int>(kBlood.size()) + blood) * static_cast<int>(kEpidermisMm.size()) + epidermis;
}

size_t SkinGrid::DirectionIndex(int channel, int in, int out, int azimuth) {
  return ((size_t(channel) * kThetas + in) * kThetas + out) * kAzimuths + azimuth;
}

SkinParameters SkinGrid::NodeParameters(int node) {
  constexpr int kE = static_cast<int>(kEpidermisMm.size()), kB = static_cast<int>(kBlood.size());
  return {static_cast<float>(kMelanin[node / kE / kB]), static_cast<float>(kBlood[node / kE % kB]),
          static_cast<float>(kEpidermisMm[node % kE])};
}

double SkinGrid::Sin2Edge(int edge) { return std::pow(std::sin(kThetaEdgesDeg[edge] * std::numbers::pi / 180.0), 2); }

double SkinGrid::NodeThetaRad(int bin) { return std::asin(Thetas().sine[bin]); }

std::array<SkinNodeWeight, 8> SkinNodesAround(const SkinParameters& parameters) {
  static const PowerScale kMelanin(G::kMelanin, 0.75);
  static const PowerScale kEpidermis(G::kEpidermisMm, 0.6);
  static const PowerScale kBlood(G::kBlood, 0.67);
  const auto [m, fm] = kMelanin.Around(parameters.melanin);
  const auto [b, fb] = kBlood.Around(parameters.blood);
  const auto [e, fe] = kEpidermis.Around(parameters.epidermis_mm);
  std::array<SkinNodeWeight, 8> nodes{};
  for (int k = 0; k < 8; ++k) {
    const int up_m = k & 1, up_b = k >> 1 & 1, up_e = k >> 2;
    nodes[k].node = G::NodeIndex(m + up_m, b + up_b, e + up_e);
    nodes[k].weight = (up_m != 0 ? fm : 1 - fm) * (up_b != 0 ? fb : 1 - fb) * (up_e != 0 ? fe : 1 - fe);
  }
  return nodes;
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
  // A turn just below 0 is rounded up to the whole circle.
  const int j = std::min(static_cast<int>(turn), G::kPolar - 1);
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

SkinKernel::RadialWeights SkinKernel::WeightsOf(const std::function<double(double)>& share) {
  constexpr int kSteps = 64;  // a ring
  RadialWeights weights{};
  for (int i = 0; i < G::kRadii; ++i) {
    const double a2 = std::pow(G::RadiusEdgeMm(i), 2), b2 = std::pow(G::RadiusEdgeMm(i + 1), 2);
    for (int k = 0; k < kSteps; ++k) {
      const double r2 = a2 + (b2 - a2) * (k + 0.5) / kSteps, clamped2 = std::max(r2, double(kInnerMm) * kInnerMm);
      const float position = RadialPosition(static_cast<float>(clamped2));
      const int j = std::min(static_cast<int>(position), G::kRadii - 2);
      const double f = position - static_cast<float>(j);
      const double area = std::numbers::pi * (b2 - a2) / kSteps;
      const double scale = area * share(std::sqrt(r2)) * std::pow(clamped2, -0.75) / G::kPolar;
      weights[j] += (1.0 - f) * scale;
      weights[j + 1] += f * scale;
    }
  }
  return weights;
}

double SkinKernel::Integral(const RadialWeights& weights) const {
  double sum = 0.0;
  for (int i = 0; i < G::kRadii; ++i) {
    const float* ring = flat_.data() + i * (G::kPolar + 1);
    sum += weights[i] * std::accumulate(ring, ring + G::kPolar, 0.0F);
  }
  return sum;
}

double SkinKernel::Integral() const {
  static const RadialWeights kAll = WeightsOf([](double) { return 1.0; });
  return Integral(kAll);
}

SkinNodes SkinTable::NodesAround(const SkinParameters& parameters) const {
  if (!scatterings().empty()) return SkinNodesAround(scatterings(), parameters);
  SkinNodes nodes;
  nodes.Add({0, 1.0F});
  return nodes;
}

SkinNodes SkinNodesAround(const std::vector<double>& scatterings, const SkinParameters& parameters) {
  SkinNodes nodes;
  const auto skins = SkinNodesAround(parameters);
  const auto [first, f] = ScatteringsAround(scatterings, parameters.scattering);
  for (const auto& [scattering, share] : {std::pair{first, 1.0F - f}, std::pair{first + 1, f}}) {
    if (share == 0.0F) continue;
    for (const SkinNodeWeight& skin : skins)
      if (skin.weight != 0.0F) nodes.Add({scattering * G::kNodes + skin.node, share * skin.weight});
  }
  return nodes;
}

SkinParameters SkinTable::NodeParameters(int node) const {
  if (scatterings().empty()) return {};
  SkinParameters skin = SkinGrid::NodeParameters(node % G::kNodes);
  skin.scattering = static_cast<float>(scatterings()[static_cast<size_t>(node / G::kNodes)]);
  return skin;
}

Status SkinTable::CheckScattering(double scattering) const {
  if (scatterings().empty()) return Status::Ok();
  constexpr double kRounding = 1e-6;
  const double least = scatterings().front(), most = scatterings().back();
  if (scattering >= least - kRounding && scattering <= most + kRounding) return Status::Ok();
  const std::string known = least == most ? Formatted("only %g", least) : Formatted("%g .. %g", least, most);
  return Status::Usage(Formatted("scattering = %g: the skin table knows ", scattering) + known +
                       "; `stratalux-skin-table generate --scattering` makes one for others");
}

SkinTable::SkinTable(const SkinTableRun& run, std::vector<double> scatterings, std::vector<uint16_t> codes) {
  auto contents = std::make_shared<Contents>();
  const bool wax = scatterings.empty();
  contents->nodes = wax ? 1 : static_cast<int>(scatterings.size()) * G::kNodes;
  contents->manifest = Json{
      {"table", wax ? "stratalux wax" : "stratalux skin"},
      {"version", 3},
      {"program", kVersion},
      {"photons_per_run", run.photons},
      {"runs", kSkinChannels * G::kThetas * std::max<size_t>(1, scatterings.size())},
      {"scatterings", scatterings},
      {"seed", run.seed}}.dump();
  contents->scatterings = std::move(scatterings);
  contents->codes = std::move(codes);
  contents_ = std::move(contents);
}

bool SkinTable::IsOf(const SkinTableRun& run) const {
  const Json made = Json::parse(manifest(), nullptr, /*allow_exceptions=*/false);
  if (!made.is_object()) return false;
  const auto is = [&](const char* key, auto value) { return made.contains(key) && made[key] == Json(value); };
  return is("photons_per_run", run.photons) && is("seed", run.seed);
}

std::optional<uint64_t> SkinTable::seed() const {
  const Json made = Json::parse(manifest(), nullptr, /*allow_exceptions=*/false);
  if (!made.is_object() || !made.contains("seed") || !made["seed"].is_number_unsigned()) return std::nullopt;
  return made["seed"].get<uint64_t>();
}

const SkinTable::NodeAlbedos& SkinTable::LogAlbedos() const {
  std::call_once(contents_->albedos_made, [&] {
    for (int c = 0; c < kSkinChannels; ++c)
      for (int node = 0; node < nodes(); ++node)
        contents_->log_albedos[c].push_back(
            static_cast<float>(std::log(Albedo(c, NodeParameters(node), RadFromDeg(30)))));
  });
  return contents_->log_albedos;
}

double SkinTable::Cell(size_t kernel, int radius, int psi) const {
  const uint16_t code = contents_->codes[kernel * G::kCells + radius * G::kPolar + psi];
  return code == 0 ? 0.0 : DecodeEntry(code) / std::pow(BinCentreMm(radius), 1.5);
}

void SkinTable::Interpolate(int channel, const SkinParameters& parameters, const SkinDirections& directions,
                            SkinKernel& out) const {
  const float azimuth = std::clamp(directions.azimuth_rad / kFloatPi * 4.0F, 0.0F, 4.0F);
  const int az = std::min(static_cast<int>(azimuth), 3);
  const float f_az = azimuth - static_cast<float>(az);
  const SkinNodes nodes = NodesAround(parameters);

  std::array<float, G::kCells> sum{}, cells;
  for (const ThetaNode& in : ThetasAround(directions.theta_in_rad))
    for (const ThetaNode& ex : ThetasAround(directions.theta_out_rad)) {
      const PsiMirror mirror(in.across, ex.across);
      for (int k = 0; k < 2; ++k) {
        const float weight = in.weight * ex.weight * (k != 0 ? f_az : 1 - f_az);
        if (weight == 0.0F) continue;
        const int azimuth_bin = in.across == ex.across ? az + k : G::kAzimuths - 1 - az - k;
        DecodeCells(G::DirectionIndex(channel, in.bin, ex.bin, azimuth_bin) * this->nodes(), nodes, cells.data());
        mirror.Add(weight, cells.data(), sum);
      }
    }
  if (!parameters.UsualSubcutis() && !scatterings().empty()) {
    SLX_CHECK(subcutis() != nullptr);
    const SubcutisTable::Rings rings = subcutis()->LogRatio(channel, parameters, directions);
    for (int r = 0; r < G::kRadii; ++r) {
      const float ratio = std::exp(rings[r]);
      for (int psi = 0; psi < G::kPolar; ++psi) sum[r * G::kPolar + psi] *= ratio;
    }
  }
  out.SetRingMeans(sum);
}

void SkinTable::DecodeCells(size_t first_kernel, const SkinNodes& nodes, float* cells) const {
  std::fill_n(cells, G::kCells, 0.0F);
  for (const SkinNodeWeight& n : nodes) {
    const uint16_t* codes = contents_->codes.data() + (first_kernel + n.node) * G::kCells;
    for (int k = 0; k < G::kCells; ++k) cells[k] += n.weight * static_cast<float>(static_cast<int32_t>(codes[k]));
  }
  for (int k = 0; k < G::kCells; ++k) cells[k] = DecodeEntry(cells[k]);
}

double SkinTable::Albedo(int channel, const SkinParameters& parameters, double theta_in_rad) const {
  constexpr int kSteps = 12;  // evenly in sin^2 of the exit angle
  double albedo = 0.0;
  SkinKernel kernel;
  for (int step = 0; step < kSteps; ++step) {
    const float theta_out = static_cast<float>(std::asin(std::sqrt((step + 0.5) / kSteps)));
    for (int az = 0; az < G::kAzimuths; ++az) {
      // Both signs of the azimuth; linear between the nodes, so their weights are the trapezoid's.
      const double projected = (az == 0 || az == 4 ? 0.25 : 0.5) * std::numbers::pi * 0.5 / kSteps;
      Interpolate(channel, parameters,
                  {static_cast<float>(theta_in_rad), theta_out, static_cast<float>(az) * kFloatPi / 4}, kernel);
      albedo += kernel.Integral() * projected;
    }
  }
  return albedo;
}

double SkinTable::EffectiveWidthMm(int channel, const SkinParameters& parameters) const {
  static const SkinKernel::RadialWeights kSquares = SkinKernel::WeightsOf([](double r) { return r * r; });
  SkinKernel kernel;
  Interpolate(channel, parameters, {}, kernel);
  return std::sqrt(0.5 * kernel.Integral(kSquares) / kernel.Integral());
}

std::vector<std::string> SkinTable::DefaultPlaces(const std::string& file) {
  namespace fs = std::filesystem;
  if (const char* path = std::getenv("STRATALUX_SKIN_TABLE")) {
    return {file == kSkinFile ? path : fs::path(path).replace_filename(file).string()};
  }
  return ProgramDataPlaces(file);
}

std::string SkinTable::DefaultPathOf(const std::string& file) { return FirstThatIsThere(DefaultPlaces(file)); }

}  // namespace stratalux::rig
