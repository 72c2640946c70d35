// SPDX-License-Identifier: Apache-2.0
// Filling the skin table: photons run through clear skin once per channel, incidence bin and scattering; every node of
// melanin, blood and epidermal thickness re-weights them by their path lengths in thin layers.
#include <algorithm>
#include <cmath>
#include <mutex>
#include <numbers>

#include "firmware-host/simulated/skin/skin_table.h"
#include "firmware-host/simulated/skin/skin_table_code.h"
#include "shared/base/formatted.h"

namespace stratalux::rig {
namespace {

using G = SkinGrid;
constexpr int kNodes = G::kNodes;

// Integral of cos(theta) over an exit bin; the azimuth bin counts both signs.
double ProjectedSolidAngle(int out, int azimuth) {
  const double width = (azimuth == 0 || azimuth == G::kAzimuths - 1 ? 0.25 : 0.5) * std::numbers::pi;
  return 0.5 * (G::Sin2Edge(out + 1) - G::Sin2Edge(out)) * width;
}

double CellAreaMm2(int radius) {
  return std::numbers::pi * (std::pow(G::RadiusEdgeMm(radius + 1), 2) - std::pow(G::RadiusEdgeMm(radius), 2)) /
         G::kPolar;
}

// Where an escaped photon falls; out < 0 beyond the last exit bin.
struct Bin {
  int out = -1, azimuth = 0, radius = -1, psi = 0;
};

Bin BinOf(const EscapedPhoton& e) {
  Bin bin;
  const double sin2 = std::max(0.0, 1.0 - double(e.uz) * e.uz);
  for (int i = 0; i < G::kThetas; ++i)
    if (sin2 >= G::Sin2Edge(i) && sin2 < G::Sin2Edge(i + 1)) bin.out = i;
  if (bin.out < 0) return bin;
  // Light comes from +x. Mirror so that omega_out lies on the side of +y.
  const double azimuth = std::atan2(e.uy, e.ux);
  const double y = azimuth < 0.0 ? -e.y_mm : e.y_mm;
  bin.azimuth = std::min(static_cast<int>(std::abs(azimuth) / (std::numbers::pi / 4) + 0.5), G::kAzimuths - 1);
  const double r = std::hypot(e.x_mm, y);
  if (r >= G::kMaxRadiusMm) return bin;
  bin.radius = 0;
  if (r >= G::kFirstRadiusMm)
    bin.radius = std::min(1 + static_cast<int>(std::log(r / G::kFirstRadiusMm) /
                                               std::log(G::kMaxRadiusMm / G::kFirstRadiusMm) * (G::kRadii - 1)),
                          G::kRadii - 1);
  const double turn = std::atan2(y, e.x_mm) / (2 * std::numbers::pi);
  bin.psi = static_cast<int>((turn < 0 ? turn + 1 : turn) * G::kPolar) % G::kPolar;
  return bin;
}

// Weights of each node for one channel. The layers of the run are the skin between the thickness nodes, its rest, and
// the subcutis: node e's epidermis is the layers 0 .. e.
class Reweighting {
 public:
  explicit Reweighting(int channel) {
    for (size_t m = 0; m < kM; ++m)
      epidermis_[m] = SkinAbsorption(channel, {static_cast<float>(G::kMelanin[m]), 0.0F})[0];
    for (size_t b = 0; b < kB; ++b) {
      const auto a = SkinAbsorption(channel, {0.01F, static_cast<float>(G::kBlood[b])});
      dermis_[b] = a[1];
      subcutis_ = a[2];
    }
  }
  void Weights(const EscapedPhoton& e, std::array<double, kNodes>& weights) const {
    const double rest = e.weight * std::exp(-subcutis_ * e.path_mm[kE + 1]);
    double skin = 0.0;
    for (size_t l = 0; l <= kE; ++l) skin += e.path_mm[l];
    double above = 0.0;
    for (size_t k = 0; k < kE; ++k) {
      above += e.path_mm[k];
      std::array<double, kB> dermis{};
      for (size_t b = 0; b < kB; ++b) dermis[b] = rest * std::exp(-dermis_[b] * (skin - above));
      for (size_t m = 0; m < kM; ++m) {
        const double epidermis = std::exp(-epidermis_[m] * above);
        for (size_t b = 0; b < kB; ++b) weights[(m * kB + b) * kE + k] = epidermis * dermis[b];
      }
    }
  }

 private:
  static constexpr size_t kM = G::kMelanin.size(), kB = G::kBlood.size(), kE = G::kEpidermisMm.size();
  std::array<double, kM> epidermis_{};
  std::array<double, kB> dermis_{};
  double subcutis_ = 0.0;
};

MonteCarloOptions RunOptions(int channel, int in, const SkinTableRun& run) {
  MonteCarloOptions options;
  options.photons = run.photons;
  options.seed = run.seed * 1000003 + channel * 101 + in;
  options.sin2_theta_low = G::Sin2Edge(in);
  options.sin2_theta_high = G::Sin2Edge(in + 1);
  options.max_path_mm = 200.0;  // at the least absorption (630 nm, 0.03 / mm) exp(-6) of a photon
  options.max_radius_mm = 40.0;
  options.threads = run.threads;
  return options;
}

// Fills the kernels of one channel and incidence bin; weigh(photon, weights) gives the photon's weight in each node.
template <typename Weigh>
void AccumulateRun(const Tissue& tissue, int channel, int in, const MonteCarloOptions& options, int nodes,
                   const Weigh& weigh, std::vector<float>& flat) {
  const auto photons = static_cast<double>(options.photons);
  const size_t size = size_t{G::kThetas} * G::kAzimuths * nodes * G::kCells;
  // Fixed-point integers make the sum independent of the order in which the threads deliver.
  std::vector<int64_t> fixed(size, 0);  // [out][azimuth][cell][node]
  constexpr double kFixed = 0x1p44;     // 2^19 photons in one cell overflow: kMostPhotons
  std::mutex mutex;
  TraceLayeredTissue(tissue, options, [&](int64_t, std::span<const EscapedPhoton> list) {
    std::array<double, kNodes> weights{};
    const std::lock_guard lock(mutex);
    for (const EscapedPhoton& e : list) {
      const Bin bin = BinOf(e);
      if (bin.out < 0 || bin.radius < 0) continue;
      weigh(e, weights);
      const size_t cell = size_t(bin.radius) * G::kPolar + bin.psi;
      int64_t* sums = fixed.data() + ((size_t(bin.out) * G::kAzimuths + bin.azimuth) * G::kCells + cell) * nodes;
      for (int n = 0; n < nodes; ++n) sums[n] += static_cast<int64_t>(weights[n] * kFixed);
    }
  });
  for (int out = 0; out < G::kThetas; ++out)
    for (int az = 0; az < G::kAzimuths; ++az)
      for (int n = 0; n < nodes; ++n)
        for (int r = 0; r < G::kRadii; ++r) {
          const double centre = r == 0 ? G::kFirstRadiusMm / 2 : std::sqrt(G::RadiusEdgeMm(r) * G::RadiusEdgeMm(r + 1));
          const double scale =
              std::pow(centre, 1.5) / (kFixed * photons * CellAreaMm2(r) * ProjectedSolidAngle(out, az));
          for (int psi = 0; psi < G::kPolar; ++psi) {
            const size_t cell = size_t(r) * G::kPolar + psi;
            const size_t from = ((size_t(out) * G::kAzimuths + az) * G::kCells + cell) * nodes + n;
            flat[(G::DirectionIndex(channel, in, out, az) * nodes + n) * G::kCells + cell] =
                static_cast<float>(static_cast<double>(fixed[from]) * scale);
          }
        }
}

// Averaging each path with the reverse one doubles the photons and makes the table exactly reciprocal.
void Symmetrise(int nodes, std::vector<float>& flat) {
  std::vector<float> mean(flat.size());
  for (int c = 0; c < kSkinChannels; ++c)
    for (int in = 0; in < G::kThetas; ++in)
      for (int out = 0; out < G::kThetas; ++out)
        for (int az = 0; az < G::kAzimuths; ++az)
          for (int n = 0; n < nodes; ++n) {
            const size_t a = (G::DirectionIndex(c, in, out, az) * nodes + n) * G::kCells;
            const size_t b = (G::DirectionIndex(c, out, in, az) * nodes + n) * G::kCells;
            for (int r = 0; r < G::kRadii; ++r)
              for (int psi = 0; psi < G::kPolar; ++psi) {
                const int other = G::ReciprocalPsi(az, psi);
                mean[a + r * G::kPolar + psi] =
                    0.5F * (flat[a + r * G::kPolar + psi] + flat[b + r * G::kPolar + other]);
              }
          }
  flat = std::move(mean);
}

// Far from the entry the kernel is smooth in psi: a binomial filter quietens the few photons there and keeps every
// ring's sum and (times 0.96) its first moment.
void SmoothFarRings(std::vector<float>& flat) {
  constexpr double kFromMm = 4.0;
  for (size_t k = 0; k < flat.size() / G::kCells; ++k)
    for (int r = 0; r < G::kRadii; ++r) {
      if (G::RadiusEdgeMm(r) < kFromMm) continue;
      float* ring = flat.data() + k * G::kCells + r * G::kPolar;
      std::array<float, G::kPolar> copy{};
      std::copy_n(ring, G::kPolar, copy.begin());
      for (int i = 0; i < G::kPolar; ++i)
        ring[i] = 0.5F * copy[i] + 0.25F * (copy[(i + 1) % G::kPolar] + copy[(i + G::kPolar - 1) % G::kPolar]);
    }
}

std::vector<uint16_t> Finished(int nodes, std::vector<float>& flat) {
  Symmetrise(nodes, flat);
  SmoothFarRings(flat);
  std::vector<uint16_t> codes(flat.size());
  std::transform(flat.begin(), flat.end(), codes.begin(), EncodeEntry);
  return codes;
}

// The codes of one scattering, [direction][node][cell].
std::vector<uint16_t> RunSkin(const SkinTableRun& run, double scattering, Progress& progress) {
  std::vector<float> flat(G::kDirections * kNodes * G::kCells, 0.0F);
  for (int c = 0; c < kSkinChannels; ++c) {
    const Reweighting reweighting(c);
    const auto weigh = [&](const EscapedPhoton& e, std::array<double, kNodes>& weights) {
      reweighting.Weights(e, weights);
    };
    for (int in = 0; in < G::kThetas; ++in) {
      AccumulateRun(ClearSkin(c, G::kEpidermisMm, scattering), c, in, RunOptions(c, in, run), kNodes, weigh, flat);
      progress.Advance();
    }
  }
  return Finished(kNodes, flat);
}

// As RunSkin would make them, from a table that has them; empty where none has.
std::vector<uint16_t> MadeBefore(std::span<const SkinTable> made, const SkinTableRun& run, double scattering) {
  for (const SkinTable& table : made) {
    const auto& nodes = table.scatterings();
    const auto found = std::find(nodes.begin(), nodes.end(), scattering);
    if (found == nodes.end() || !table.IsOf(run)) continue;
    const size_t block = size_t{kNodes} * G::kCells, all = block * nodes.size();
    std::vector<uint16_t> part(G::kDirections * block);
    for (size_t direction = 0; direction < G::kDirections; ++direction)
      std::copy_n(table.codes().data() + direction * all + static_cast<size_t>(found - nodes.begin()) * block, block,
                  part.data() + direction * block);
    return part;
  }
  return {};
}

// Three million put less than 10^5 into the fullest cell, and AccumulateRun holds five times as many there.
constexpr int64_t kMostPhotons = 10'000'000;

Status CheckPhotons(int64_t photons) {
  if (photons >= 1000 && photons <= kMostPhotons) return Status::Ok();
  return Status::Usage("skin table: photons = " + std::to_string(photons) + ", allowed: 1000 .. " +
                       std::to_string(kMostPhotons));
}

}  // namespace

Status CheckScatterings(const std::vector<double>& scatterings) {
  constexpr double kLeast = 0.1, kMost = 3.0;
  bool right = !scatterings.empty() && scatterings.size() <= size_t{G::kMostScatterings};
  for (size_t i = 0; i < scatterings.size(); ++i)
    right =
        right && scatterings[i] >= kLeast && scatterings[i] <= kMost && (i == 0 || scatterings[i] > scatterings[i - 1]);
  if (right) return Status::Ok();
  return Status::Usage(Formatted("scatterings of a skin table: 1 to %d of them, rising, each %g .. %g",
                                 G::kMostScatterings, kLeast, kMost));
}

Result<SkinTable> GenerateSkinTable(const SkinTableRun& run, std::vector<double> scatterings,
                                    std::span<const SkinTable> made, Logger& logger) {
  SLX_RETURN_IF_ERROR(CheckPhotons(run.photons));
  SLX_RETURN_IF_ERROR(CheckScatterings(scatterings));
  const size_t block = size_t{kNodes} * G::kCells, all = block * scatterings.size();
  std::vector<uint16_t> codes(G::kDirections * all);
  Progress progress(logger, "skin table", std::ssize(scatterings) * kSkinChannels * G::kThetas);
  for (size_t s = 0; s < scatterings.size(); ++s) {
    const std::vector<uint16_t> known = MadeBefore(made, run, scatterings[s]);
    if (!known.empty()) progress.Advance(kSkinChannels * G::kThetas);
    const std::vector<uint16_t> part = known.empty() ? RunSkin(run, scatterings[s], progress) : known;
    for (size_t direction = 0; direction < G::kDirections; ++direction)
      std::copy_n(part.data() + direction * block, block, codes.data() + direction * all + s * block);
  }
  return SkinTable(run, std::move(scatterings), std::move(codes));
}

Result<SkinTable> GenerateWaxTable(const SkinTableRun& run, Logger& logger) {
  SLX_RETURN_IF_ERROR(CheckPhotons(run.photons));
  std::vector<float> flat(G::kDirections * G::kCells, 0.0F);
  Progress progress(logger, "wax table", kSkinChannels * G::kThetas);
  for (int c = 0; c < kSkinChannels; ++c)
    for (int in = 0; in < G::kThetas; ++in) {
      MonteCarloOptions options = RunOptions(c, in, run);
      options.max_path_mm = 1000.0;  // at the least absorption, 0.002 / mm, exp(-2); few come back from so far
      AccumulateRun(
          WaxSlab(c), c, in, options, 1,
          [](const EscapedPhoton& e, std::array<double, kNodes>& weights) { weights[0] = e.weight; }, flat);
      progress.Advance();
    }
  return SkinTable(run, {}, Finished(1, flat));
}

std::vector<SkinCellCheck> RegenerateSkinCell(const SkinTable& table, const SkinColumn& column, int64_t photons,
                                              uint64_t seed) {
  const auto [channel, in, out, azimuth, scattering] = column;
  const Tissue skin = ClearSkin(channel, G::kEpidermisMm, table.scatterings().at(static_cast<size_t>(scattering)));
  const Reweighting reweighting(channel);
  std::array<double, kNodes> sum{}, squares{};
  std::mutex mutex;
  TraceLayeredTissue(skin, RunOptions(channel, in, {photons, seed, 0}),
                     [&, out = out, azimuth = azimuth](int64_t, std::span<const EscapedPhoton> list) {
                       std::array<double, kNodes> weights{};
                       const std::lock_guard lock(mutex);
                       for (const EscapedPhoton& e : list) {
                         const Bin bin = BinOf(e);
                         if (bin.out != out || bin.azimuth != azimuth || bin.radius < 0) continue;
                         reweighting.Weights(e, weights);
                         for (int n = 0; n < kNodes; ++n) {
                           sum[n] += weights[n];
                           squares[n] += weights[n] * weights[n];
                         }
                       }
                     });
  std::vector<SkinCellCheck> checks(kNodes);
  const double scale = 1.0 / (static_cast<double>(photons) * ProjectedSolidAngle(out, azimuth));
  for (int n = 0; n < kNodes; ++n) {
    const size_t kernel = table.KernelIndex(channel, in, out, azimuth, scattering * kNodes + n);
    for (int r = 0; r < G::kRadii; ++r)
      for (int psi = 0; psi < G::kPolar; ++psi) checks[n].table += table.Cell(kernel, r, psi) * CellAreaMm2(r);
    checks[n].mean = sum[n] * scale;
    checks[n].standard_error = std::sqrt(squares[n]) * scale;
  }
  return checks;
}

}  // namespace stratalux::rig
