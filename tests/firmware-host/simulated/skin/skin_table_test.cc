// SPDX-License-Identifier: Apache-2.0
// The shipped table against Monte Carlo that shares no line with its generator but the tracer, which has published
// numbers of its own to answer to (tests/shared/transport).
#include "firmware-host/simulated/skin/skin_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <mutex>
#include <numbers>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/skin/skin_table_check.h"
#include "shared/units/angle.h"
#include "tests/firmware-host/simulated/skin/shipped_table.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

using G = SkinGrid;
using ::testing::HasSubstr;
using ::testing::Not;

double Sin2(double deg) { return std::pow(std::sin(RadFromDeg(deg)), 2); }
double RingAreaMm2(int ring) {
  return M_PI * (std::pow(G::RadiusEdgeMm(ring + 1), 2) - std::pow(G::RadiusEdgeMm(ring), 2));
}
// Sum of a kernel's cells: radiance under unit irradiance.
double CellSum(size_t kernel, int first_ring = 0, int last_ring = G::kRadii - 1) {
  double sum = 0.0;
  for (int r = first_ring; r <= last_ring; ++r)
    for (int psi = 0; psi < G::kPolar; ++psi) sum += ShippedTable().Cell(kernel, r, psi) * RingAreaMm2(r) / G::kPolar;
  return sum;
}
// Solid angle times cosine of an exit bin.
double Projected(int out, int azimuth) {
  return 0.5 * (Sin2(G::kThetaEdgesDeg[out + 1]) - Sin2(G::kThetaEdgesDeg[out])) * M_PI *
         (azimuth == 0 || azimuth == 4 ? 0.25 : 0.5);
}

struct Estimate {
  double sum = 0.0, squares = 0.0;
  void Add(double w) {
    sum += w;
    squares += w * w;
  }
};

// Photons through absorbing skin (weights by absorption on the way, not by path lengths afterwards).
template <typename Visit>
void Photons(int channel, const SkinParameters& skin, int in, int64_t photons, uint64_t seed, const Visit& visit) {
  MonteCarloOptions options;
  options.photons = photons;
  options.seed = seed;
  options.sin2_theta_low = Sin2(G::kThetaEdgesDeg[in]);
  options.sin2_theta_high = Sin2(G::kThetaEdgesDeg[in + 1]);
  options.max_path_mm = 200.0;
  std::mutex mutex;
  TraceLayeredTissue(AbsorbingSkin(channel, skin), options, [&](int64_t, std::span<const EscapedPhoton> list) {
    const std::lock_guard lock(mutex);
    for (const EscapedPhoton& e : list) visit(e);
  });
}

TEST(SkinTable, CellsAreThoseOfMonteCarlo) {
  // All 25 exit bins of one incidence bin, green, at a node of the optics.
  constexpr int kIn = 2, kChannel = 1;
  const int node = G::kNodes + G::NodeIndex(1, 2, 1);  // of the second scattering
  constexpr int64_t kPhotons = 200000;
  std::array<std::array<Estimate, G::kAzimuths>, G::kThetas> bins{};
  Photons(kChannel, ShippedTable().NodeParameters(node), kIn, kPhotons, 77, [&](const EscapedPhoton& e) {
    if (std::hypot(e.x_mm, e.y_mm) >= G::kMaxRadiusMm) return;
    const double theta = DegFromRad(std::acos(std::min(1.0, std::abs(double(e.uz)))));
    const double azimuth = DegFromRad(std::abs(std::atan2(e.uy, e.ux)));
    for (int out = 0; out < G::kThetas; ++out)
      if (theta >= G::kThetaEdgesDeg[out] && theta < G::kThetaEdgesDeg[out + 1])
        bins[out][std::min(4, static_cast<int>((azimuth + 22.5) / 45.0))].Add(e.weight);
  });
  double chi2 = 0.0;
  for (int out = 0; out < G::kThetas; ++out)
    for (int az = 0; az < G::kAzimuths; ++az) {
      const double scale = 1.0 / (kPhotons * Projected(out, az));
      const double mean = bins[out][az].sum * scale, error = std::sqrt(bins[out][az].squares) * scale;
      const double table = CellSum(ShippedTable().KernelIndex(kChannel, kIn, out, az, node));
      // The table has 3 million photons of its own, both ways: a quarter of this error at most.
      const double sigmas = (table - mean) / (error * 1.03);
      chi2 += sigmas * sigmas;
      EXPECT_LT(std::abs(sigmas), 4.0) << "exit " << out << ", azimuth " << az << ": " << table << " not " << mean;
    }
  EXPECT_LT(chi2, 25.0 + 4.0 * std::sqrt(50.0)) << "25 bins";
}

TEST(SkinTable, RadialProfileIsThatOfMonteCarlo) {
  constexpr int kIn = 1, kChannel = 0, kGroup = 3;
  const int node = 2 * G::kNodes + G::NodeIndex(1, 1, 2);  // of the samples' own
  constexpr int64_t kPhotons = 200000;
  std::array<Estimate, G::kRadii> rings{};
  Photons(kChannel, ShippedTable().NodeParameters(node), kIn, kPhotons, 78, [&](const EscapedPhoton& e) {
    if (1.0 - double(e.uz) * e.uz >= Sin2(85.0)) return;
    const double r = std::hypot(e.x_mm, e.y_mm);
    for (int k = 0; k < G::kRadii; ++k)
      if (r >= G::RadiusEdgeMm(k) && r < G::RadiusEdgeMm(k + 1)) rings[k].Add(e.weight);
  });
  for (int first = 0; first + kGroup <= 24; first += kGroup) {
    double table = 0.0, sum = 0.0, squares = 0.0;
    for (int out = 0; out < G::kThetas; ++out)
      for (int az = 0; az < G::kAzimuths; ++az)
        table += Projected(out, az) *
                 CellSum(ShippedTable().KernelIndex(kChannel, kIn, out, az, node), first, first + kGroup - 1);
    for (int k = first; k < first + kGroup; ++k) {
      sum += rings[k].sum / kPhotons;
      squares += rings[k].squares / (double(kPhotons) * kPhotons);
    }
    EXPECT_NEAR(table, sum, 4.0 * 1.03 * std::sqrt(squares)) << "from " << G::RadiusEdgeMm(first) << " mm";
  }
}

TEST(SkinTable, RegeneratesItsCellsWithinTheirStandardErrors) {
  const auto checks = RegenerateSkinCell(ShippedTable(), {2, 1, 3, 2, 2}, 150000, 5);
  ASSERT_EQ(checks.size(), size_t{G::kNodes});
  for (size_t n = 0; n < checks.size(); ++n) {
    EXPECT_GT(checks[n].mean, 0.0);
    EXPECT_LT(std::abs(checks[n].table - checks[n].mean), 4.0 * checks[n].standard_error) << "node " << n;
    EXPECT_LT(checks[n].standard_error, 0.1 * checks[n].mean) << "node " << n;
  }
}

// Mean Fresnel transmittance of a theta bin over that at its node: what a cell holds more than the kernel there.
double BinOverNodeTransmittance(int bin) {
  auto transmittance = [](double sin2) { return 1.0 - FresnelReflectance(1.0, kSkinIndex, std::sqrt(1.0 - sin2)); };
  constexpr int kSteps = 5000;
  const double low = Sin2(G::kThetaEdgesDeg[bin]), high = Sin2(G::kThetaEdgesDeg[bin + 1]);
  double mean = 0.0;
  for (int k = 0; k < kSteps; ++k) mean += transmittance(low + (high - low) * (k + 0.5) / kSteps) / kSteps;
  return mean / transmittance(std::pow(std::sin(G::NodeThetaRad(bin)), 2));
}

TEST(SkinTable, AlbedoIsTheSumOfItsKernelsAndOfMonteCarlo) {
  // At a node of melanin, blood and incidence. The table's cells end at 85 degrees of exit (0.8 % of Lambertian light)
  // and at 30 mm, and so do the photons counted for them; Albedo goes on to 90 degrees.
  constexpr int kIn = 3, kChannel = 0;
  const int node = G::NodeIndex(1, 1, 1);
  const SkinParameters skin = ShippedTable().NodeParameters(node);
  double cells = 0.0;
  for (int out = 0; out < G::kThetas; ++out)
    for (int az = 0; az < G::kAzimuths; ++az)
      cells += Projected(out, az) * CellSum(ShippedTable().KernelIndex(kChannel, kIn, out, az, node));
  const double albedo = ShippedTable().Albedo(kChannel, skin, G::NodeThetaRad(kIn)) * BinOverNodeTransmittance(kIn);
  constexpr int64_t kPhotons = 150000;
  Estimate below_85, all;
  Photons(kChannel, skin, kIn, kPhotons, 79, [&](const EscapedPhoton& e) {
    if (std::hypot(e.x_mm, e.y_mm) >= G::kMaxRadiusMm) return;
    all.Add(e.weight);
    if (1.0 - double(e.uz) * e.uz < Sin2(85.0)) below_85.Add(e.weight);
  });
  EXPECT_NEAR(cells, below_85.sum / kPhotons, 4.0 * std::sqrt(below_85.squares) / kPhotons);
  EXPECT_NEAR(albedo, all.sum / kPhotons, 4.0 * std::sqrt(all.squares) / kPhotons);
  EXPECT_NEAR(albedo / cells, all.sum / below_85.sum, 0.008);  // linear in sin(theta) between the exit nodes
}

double PlaneIntegral(const SkinKernel& kernel, double* first_moment_x = nullptr) {
  constexpr int kAngles = 64;
  double sum = 0.0, moment = 0.0;
  for (double inner = 0.0, outer = 0.001; inner < G::kMaxRadiusMm;
       inner = outer, outer = std::min(outer * 1.01, 30.0)) {
    const double r = inner > 0.0 ? std::sqrt(inner * outer) : outer / 2.0;
    const double area = M_PI * (outer * outer - inner * inner) / kAngles;
    for (int k = 0; k < kAngles; ++k) {
      const double psi = 2.0 * M_PI * (k + 0.37) / kAngles;
      const double s = kernel(static_cast<float>(r * std::cos(psi)), static_cast<float>(r * std::sin(psi))) * area;
      sum += s;
      moment += s * r * std::cos(psi);
    }
    if (outer >= 30.0) break;
  }
  if (first_moment_x != nullptr) *first_moment_x = moment / sum;
  return sum;
}

TEST(SkinKernel, InterpolationKeepsTheEnergyOfTheCells) {
  // The mean over a ring is not the value at its centre: interpolating ring means as if it were loses 2 %.
  for (int c = 0; c < kSkinChannels; ++c)
    for (int in = 0; in < G::kThetas; ++in) {
      const int out = (in + 2) % G::kThetas, az = in;
      SkinKernel kernel;
      const int node = out % 3 * G::kNodes + G::NodeIndex(1, 2, in % 3);
      ShippedTable().Interpolate(c, ShippedTable().NodeParameters(node),
                                 {static_cast<float>(G::NodeThetaRad(in)), static_cast<float>(G::NodeThetaRad(out)),
                                  static_cast<float>(az * M_PI / 4)},
                                 kernel);
      const double cells = CellSum(ShippedTable().KernelIndex(c, in, out, az, node)) /
                           (BinOverNodeTransmittance(in) * BinOverNodeTransmittance(out));
      EXPECT_NEAR(PlaneIntegral(kernel) / cells, 1.0, 0.003) << c << ' ' << in << ' ' << out;
      EXPECT_NEAR(kernel.Integral() / cells, 1.0, 0.002) << c << ' ' << in << ' ' << out;
    }
}

// Beside the seam of the directions, where rounding puts a point on the far side of the circle.
TEST(SkinKernel, ReadsNothingBehindItsLastRing) {
  struct Guarded {
    SkinKernel kernel;
    std::array<float, 4> behind;
  };
  Guarded guarded{};
  guarded.behind.fill(std::numeric_limits<float>::quiet_NaN());
  ShippedTable().Interpolate(0, {}, {}, guarded.kernel);
  constexpr auto kNearRim = static_cast<float>(0.999 * G::kMaxRadiusMm);
  const auto seam = static_cast<float>(M_PI / G::kPolar);
  const float x = kNearRim * std::cos(seam);
  const float y = kNearRim * std::sin(seam);
  for (int step = -2000; step < 2000; ++step) {
    const float beside = x + static_cast<float>(step) * 2e-6F;
    ASSERT_TRUE(std::isfinite(guarded.kernel(beside, y))) << step;
  }
}

TEST(SkinKernel, IsReciprocal) {
  // S(i -> o) at exit minus entry = x is S(o -> i) at -x, turned into the other lamp's frame.
  auto at = [](const SkinKernel& kernel, double r, double psi) {
    return kernel(static_cast<float>(r * std::cos(psi)), static_cast<float>(r * std::sin(psi)));
  };
  constexpr float kAzimuth = static_cast<float>(M_PI / 2);
  for (const auto& [in, out] : std::vector<std::pair<float, float>>{{0.1F, 0.15F}, {0.1F, 0.9F}, {0.5F, 1.1F}}) {
    SkinKernel there, back;
    ShippedTable().Interpolate(1, {}, {in, out, kAzimuth}, there);
    ShippedTable().Interpolate(1, {}, {out, in, kAzimuth}, back);
    EXPECT_NEAR(there.Integral() / back.Integral(), 1.0, 1e-4);
    for (const double r : {0.05, 0.5, 3.0})
      for (int k = 0; k < 16; ++k) {
        const double psi = 2.0 * M_PI * (k + 0.5) / 16.0;
        EXPECT_NEAR(at(back, r, kAzimuth - M_PI - psi) / at(there, r, psi), 1.0, 0.01) << r << " mm, direction " << k;
      }
  }
}

TEST(SkinKernel, IsContinuousThroughTheNormal) {
  // A view a hair to either side of the normal is the same view.
  for (const float in : {0.0F, 0.8F}) {
    SkinKernel towards, away;
    ShippedTable().Interpolate(0, {}, {in, 1e-4F, 0.0F}, towards);
    ShippedTable().Interpolate(0, {}, {in, 1e-4F, std::numbers::pi_v<float>}, away);
    double a = 0.0, b = 0.0;
    const double energy = PlaneIntegral(towards, &a) / PlaneIntegral(away, &b);
    EXPECT_NEAR(energy, 1.0, 1e-3);
    EXPECT_NEAR(a, b, 1e-3) << "mm, light at " << in;
    if (in == 0.0F) {
      EXPECT_NEAR(a, 0.0, 1e-3) << "mm";
    }
  }
}

TEST(SkinTable, MoreMelaninOrBloodReflectsLess) {
  for (int c = 0; c < kSkinChannels; ++c) {
    double last = 1.0;
    for (const float melanin : {0.005F, 0.02F, 0.05F, 0.15F, 0.3F}) {
      const double albedo = ShippedTable().Albedo(c, {melanin, 0.004F}, 0.5);
      EXPECT_LT(albedo, last);
      EXPECT_GT(albedo, 0.0);
      last = albedo;
    }
    last = 1.0;
    for (const float blood : {0.0005F, 0.002F, 0.01F, 0.06F}) {
      const double albedo = ShippedTable().Albedo(c, {0.03F, blood}, 0.5);
      EXPECT_LT(albedo, last);
      last = albedo;
    }
    last = 1.0;
    for (const float epidermis : {0.05F, 0.07F, 0.1F, 0.15F}) {
      const double albedo = ShippedTable().Albedo(c, {0.03F, 0.004F, epidermis}, 0.5);
      EXPECT_LT(albedo, last) << "melanin absorbs more than a little blood";
      last = albedo;
    }
  }
}

TEST(SkinTable, IsExactlyReciprocal) {
  for (int in = 0; in < G::kThetas; ++in)
    for (int out = 0; out < in; ++out)
      for (int az = 0; az < G::kAzimuths; ++az) {
        const int node = (in * 7 + out * 3 + az) % ShippedTable().nodes();
        const size_t there = ShippedTable().KernelIndex(2, in, out, az, node),
                     back = ShippedTable().KernelIndex(2, out, in, az, node);
        for (int r = 0; r < G::kRadii; ++r)
          for (int psi = 0; psi < G::kPolar; ++psi)
            ASSERT_EQ(ShippedTable().Cell(there, r, psi), ShippedTable().Cell(back, r, G::ReciprocalPsi(az, psi)));
      }
}

TEST(SkinNodesAround, WeighsTheNodesAndClampsOutsideThem) {
  for (int node = 0; node < G::kNodes; ++node) {
    float own = 0.0F, all = 0.0F;
    for (const SkinNodeWeight& n : SkinNodesAround(G::NodeParameters(node))) {
      all += n.weight;
      if (n.node == node) own += n.weight;
    }
    EXPECT_NEAR(own, 1.0F, 1e-5F) << node;
    EXPECT_NEAR(all, 1.0F, 1e-5F) << node;
  }
  for (const SkinParameters& outside : {SkinParameters{0.0F, 0.0F, 0.01F}, SkinParameters{1.0F, 1.0F, 1.0F}}) {
    float weight = 0.0F;
    for (const SkinNodeWeight& n : SkinNodesAround(outside)) {
      ASSERT_GE(n.node, 0);
      ASSERT_LT(n.node, G::kNodes);
      if (n.node == (outside.melanin == 0.0F ? 0 : G::kNodes - 1)) weight += n.weight;
    }
    EXPECT_EQ(weight, 1.0F);
  }
}

TEST(SkinTable, IsNearMonteCarloBetweenItsNodes) {
  // Halfway between the nodes of melanin, blood and thickness, at incidence angles between those of the bins. The long
  // run and its errors: docs/simulated-rig.md.
  InterpolationCheckOptions options;
  options.photons = 16000;
  options.theta_in_deg = {35.0, 55.0};
  const auto samples = CheckInterpolation(ShippedTable(), options);
  ASSERT_EQ(samples.size(), size_t{3 * 2 * 5 * 3 * 2});
  for (const InterpolationSample& s : samples) {
    const double bound = s.skin.melanin < 0.16F ? 0.06 : 0.12;
    EXPECT_NEAR(s.total.table, s.total.monte_carlo, 3.5 * s.total.standard_error + bound * s.total.monte_carlo)
        << "channel " << s.channel << ", melanin " << s.skin.melanin << ", blood " << s.skin.blood << ", epidermis "
        << s.skin.epidermis_mm << " mm, " << s.theta_in_deg << " degrees";
  }
  for (int c = 0; c < kSkinChannels; ++c) {
    const InterpolationSummary all = Summarise(samples, c, -1, 0.16);
    ASSERT_GT(all.samples, 20);
    EXPECT_LT(all.rms, 0.02) << c;
    for (int ring = 1; ring <= 3; ++ring) {  // where most of the light is
      const InterpolationSummary s = Summarise(samples, c, ring, 0.16);
      if (s.samples > 10) {
        EXPECT_LT(s.rms, 0.06) << c << " ring " << ring;
      }
    }
  }
}

TEST(InterpolationCheck, SeesATableThatIsWrong) {
  // Samples whose table reads 10 % too much: the summary must say so, noise or not.
  std::vector<InterpolationSample> samples(20);
  for (size_t k = 0; k < samples.size(); ++k) samples[k].total = {1.1, k % 2 == 0 ? 1.01 : 0.99, 0.01};
  const InterpolationSummary summary = Summarise(samples, 0, -1, 1.0);
  EXPECT_EQ(summary.samples, 20);
  EXPECT_NEAR(summary.rms, 0.1, 0.005);
  EXPECT_NEAR(summary.largest, 0.111, 0.001);
}

// Loading what is no table.
class SkinTableFile : public ScratchFolderTest {
 protected:
  void SetUp() override {
    bytes_ = Read(SkinTable::DefaultPath());
    ASSERT_GT(bytes_.size(), 1000U);
  }
  static std::vector<char> Read(const std::string& file) {
    const std::string text = ReadText(file);
    return {text.begin(), text.end()};
  }
  Status LoadBytes() {
    std::ofstream(path_, std::ios::binary).write(bytes_.data(), static_cast<std::streamsize>(bytes_.size()));
    const auto table = SkinTable::Load(path_);
    EXPECT_FALSE(table.ok());
    EXPECT_NE(table.status().message().find(path_), std::string::npos)
        << "names the file: " << table.status().message();
    return table.status();
  }
  std::vector<char> bytes_;
  const std::string path_ = (folder_ / "skin-table").string();
};

TEST_F(SkinTableFile, MissingIsNotFound) {
  const auto table = SkinTable::Load(path_ + ".none");
  ASSERT_FALSE(table.ok());
  EXPECT_EQ(table.status().code(), StatusCode::kNotFound);
  EXPECT_NE(table.status().message().find(path_ + ".none"), std::string::npos);
  EXPECT_NE(table.status().message().find("generate"), std::string::npos) << "says how to make one";
}

TEST_F(SkinTableFile, TruncatedIsDamaged) {
  const std::vector<char> whole = bytes_;
  for (const size_t size : {size_t{0}, size_t{7}, size_t{30}, whole.size() / 2, whole.size() - 1}) {
    bytes_.assign(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
    EXPECT_EQ(LoadBytes().code(), StatusCode::kIntegrity) << size << " bytes";
  }
}

TEST_F(SkinTableFile, WrongMagicIsNoTable) {
  bytes_[0] = 'X';
  EXPECT_EQ(LoadBytes().code(), StatusCode::kIntegrity);
}

TEST_F(SkinTableFile, WrongVersionIsANewerSchema) {
  bytes_[7] = '4';
  const Status status = LoadBytes();
  EXPECT_EQ(status.code(), StatusCode::kNewerSchema);
  EXPECT_NE(status.message().find("version 4"), std::string::npos) << status.message();
}

TEST_F(SkinTableFile, AnOlderVersionIsRefusedWithItsRemedy) {
  for (const char version : {'1', '2'}) {
    bytes_[7] = version;
    const Status status = LoadBytes();
    EXPECT_EQ(status.code(), StatusCode::kUsage);
    EXPECT_NE(status.message().find("generate"), std::string::npos) << status.message();
    EXPECT_NE(status.message().find("--wax"), std::string::npos) << status.message();
  }
}

TEST_F(SkinTableFile, AFlippedBitIsDamage) {
  bytes_[bytes_.size() - 100] = static_cast<char>(bytes_[bytes_.size() - 100] ^ 1);
  EXPECT_EQ(LoadBytes().code(), StatusCode::kIntegrity);
}

TEST_F(SkinTableFile, SizesThatOverflowAreDamage) {
  const std::vector<char> whole = bytes_;
  for (int field = 0; field < 5; ++field) {
    bytes_ = whole;
    for (int k = 0; k < 8; ++k) bytes_[8 + field * 8 + k] = static_cast<char>(0xff);
    EXPECT_EQ(LoadBytes().code(), StatusCode::kIntegrity) << "header field " << field;
  }
}

TEST_F(SkinTableFile, IsReadAgainWhenItIsAnother) {
  std::filesystem::copy_file(SkinTable::DefaultPath(), path_, std::filesystem::copy_options::overwrite_existing);
  const auto once = SkinTable::Load(path_), again = SkinTable::Load(path_);
  ASSERT_TRUE(once.ok() && again.ok());
  EXPECT_EQ(once->codes().data(), again->codes().data()) << "read once";
  bytes_.back() = static_cast<char>(bytes_.back() ^ 1);  // of the same length, in its place
  EXPECT_EQ(LoadBytes().code(), StatusCode::kIntegrity);
  EXPECT_EQ(SkinTable::Load(path_).status().code(), StatusCode::kIntegrity) << "nor is a bad one taken the second time";
  std::filesystem::remove(path_);
  EXPECT_EQ(SkinTable::Load(path_).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(once->codes().size(), again->codes().size()) << "whoever has it keeps it";
}

TEST_F(SkinTableFile, SavedAndLoadedIsTheSame) {
  ASSERT_TRUE(ShippedTable().Save(path_, 1).ok());
  const auto again = SkinTable::Load(path_);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->manifest(), ShippedTable().manifest());
  for (size_t kernel = 0; kernel < G::kDirections * ShippedTable().nodes(); kernel += 97)
    for (int r = 0; r < G::kRadii; ++r) EXPECT_EQ(again->Cell(kernel, r, 3), ShippedTable().Cell(kernel, r, 3));
}

// A small table with the axis, made once: noisy, but of the same photons as what it is held against.
const SkinTable& WithScatterings() {
  Logger quiet(LogLevel::kError);
  static const SkinTable table = *GenerateSkinTable({2000, 1, 0}, {0.5, 0.74, 1.0}, {}, quiet);
  return table;
}

TEST(SkinTableScattering, EachNodeIsTheTableOfItsScattering) {
  Logger quiet(LogLevel::kError);
  const SkinTable alone = *GenerateSkinTable({2000, 1, 0}, {0.74}, {}, quiet);
  ASSERT_EQ(WithScatterings().nodes(), 3 * G::kNodes);
  for (int node = 0; node < G::kNodes; node += 7) {
    SkinParameters skin = G::NodeParameters(node);
    skin.scattering = 0.74F;
    EXPECT_EQ(WithScatterings().NodeParameters(G::kNodes + node).scattering, 0.74F);
    SkinKernel one, of_three;
    alone.Interpolate(1, skin, {0.3F, 0.4F, 1.0F}, one);
    WithScatterings().Interpolate(1, skin, {0.3F, 0.4F, 1.0F}, of_three);
    EXPECT_NEAR(of_three.Integral() / one.Integral(), 1.0, 1e-5) << node;
  }
}

TEST(SkinTableScattering, WhatWasMadeBeforeIsTakenOnlyOfTheSameRun) {
  Logger quiet(LogLevel::kError);
  const SkinTableRun run{1000, 3, 0};
  const SkinTable both = *GenerateSkinTable(run, {0.6, 0.9}, {}, quiet);
  const std::vector<SkinTable> made = {*GenerateSkinTable({1000, 4, 0}, {0.9}, {}, quiet),
                                       *GenerateSkinTable(run, {0.9}, {}, quiet)};
  EXPECT_FALSE(made[0].IsOf(run));
  EXPECT_TRUE(made[1].IsOf(run));
  const SkinTable again = *GenerateSkinTable(run, {0.6, 0.9}, made, quiet);
  EXPECT_TRUE(std::ranges::equal(again.codes(), both.codes()));
  EXPECT_EQ(again.manifest(), both.manifest());
}

TEST(SkinTableScattering, WeightsAddUpAndAreClampedOutside) {
  for (const float scattering : {0.2F, 0.5F, 0.6F, 0.74F, 0.9F, 1.0F, 1.1F, 2.0F}) {
    SkinParameters skin;
    skin.scattering = scattering;
    float sum = 0.0F;
    for (const SkinNodeWeight& n : WithScatterings().NodesAround(skin)) {
      ASSERT_LT(n.node, WithScatterings().nodes());
      sum += n.weight;
      if (scattering < 0.5F) {
        EXPECT_LT(n.node, G::kNodes);
      }
    }
    EXPECT_NEAR(sum, 1.0F, 1e-5F) << scattering;
  }
  EXPECT_TRUE(WithScatterings().CheckScattering(0.5).ok());
  EXPECT_EQ(WithScatterings().CheckScattering(0.4).code(), StatusCode::kUsage);
  EXPECT_NE(WithScatterings().CheckScattering(1.1).message().find("0.5 .. 1;"), std::string::npos);
  EXPECT_NE(ShippedTable().CheckScattering(0.4).message().find("generate --scattering"), std::string::npos);
}

// The light that comes back, between the nodes, against fresh photons of that scattering; and that the axis matters.
TEST(SkinTableScattering, IsNearMonteCarloBetweenItsNodes) {
  InterpolationCheckOptions options;
  options.photons = 20000;
  options.theta_in_deg = {35.0};
  for (const double scattering : {0.62, 0.86}) {
    options.scattering = scattering;
    const auto samples = CheckInterpolation(ShippedTable(), options);
    for (int c = 0; c < kSkinChannels; ++c) {
      const InterpolationSummary all = Summarise(samples, c, -1, 0.16);
      ASSERT_GT(all.samples, 20);
      EXPECT_LT(all.rms, 0.03) << c << " at " << scattering;
    }
  }
  SkinParameters skin{0.01F, 0.004F};
  const double samples_scattering = ShippedTable().Albedo(0, skin, 0.6);
  skin.scattering = 0.6F;
  EXPECT_LT(ShippedTable().Albedo(0, skin, 0.6), 0.95 * samples_scattering) << "the axis tells nothing";
}

TEST_F(SkinTableFile, OneWithScatteringsIsSavedAndLoaded) {
  ASSERT_TRUE(WithScatterings().Save(path_, 1).ok());
  const auto again = SkinTable::Load(path_);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_EQ(again->scatterings(), WithScatterings().scatterings());
  EXPECT_TRUE(std::equal(again->codes().begin(), again->codes().end(), WithScatterings().codes().begin()));
  const std::vector<char> whole = Read(path_);
  // The axis is held by the hash, and each field of the header by the file's length.
  for (const size_t at : {size_t{8}, size_t{16}, size_t{24}, size_t{32}, size_t{40}, size_t{48}, size_t{56}}) {
    bytes_ = whole;
    bytes_[at] = static_cast<char>(bytes_[at] ^ 3);
    EXPECT_EQ(LoadBytes().code(), StatusCode::kIntegrity) << "byte " << at;
  }
}

TEST(GenerateSkinTable, RefusesAnAxisThatIsNone) {
  Logger quiet(LogLevel::kError);
  for (const std::vector<double>& axis :
       {std::vector<double>{}, {0.7, 0.5}, {0.5, 0.5}, {0.01}, {5.0}, {std::nan("")}, {0.5, 0.6, 0.7, 0.8, 0.9, 1.0}})
    EXPECT_EQ(GenerateSkinTable({1000, 1, 0}, axis, {}, quiet).status().code(), StatusCode::kUsage);
}

TEST(WaxTable, IsTheMonteCarloOfItsSlab) {
  // Light at 30 degrees: all of it, and its spread, from fresh photons of the slab; the lamp's side is the darker one.
  const SkinTable table = *SkinTable::Load(SkinTable::DefaultWaxPath());
  ASSERT_EQ(table.nodes(), 1);
  for (int c = 0; c < kSkinChannels; ++c) {
    MonteCarloOptions run;
    run.photons = 60000;
    run.seed = 17 + c;
    run.sin2_theta_low = run.sin2_theta_high = Sin2(30.0);
    run.max_radius_mm = 40.0;
    std::mutex mutex;
    Estimate all, near;
    double squares_mm2 = 0.0;  // across the plane of incidence
    TraceLayeredTissue(WaxSlab(c), run, [&](int64_t, std::span<const EscapedPhoton> list) {
      const std::lock_guard lock(mutex);
      for (const EscapedPhoton& e : list) {
        const double r = std::hypot(e.x_mm, e.y_mm);
        if (r >= G::kMaxRadiusMm) continue;
        all.Add(e.weight);
        if (r < 2.0) near.Add(e.weight);
        squares_mm2 += e.weight * e.y_mm * e.y_mm;
      }
    });
    EXPECT_NEAR(table.EffectiveWidthMm(c, {}), std::sqrt(squares_mm2 / all.sum), 0.05 * table.EffectiveWidthMm(c, {}))
        << c;
    const double photons = static_cast<double>(run.photons);
    const double albedo = table.Albedo(c, {}, M_PI / 6.0);
    EXPECT_NEAR(albedo, all.sum / photons, 4.0 * std::sqrt(all.squares) / photons + 0.01 * albedo) << c;
    EXPECT_LT(near.sum, 0.6 * all.sum) << c;
    // Share within 2 mm, by the kernel towards the normal: its angle hardly matters there.
    SkinKernel kernel;
    table.Interpolate(c, {}, {static_cast<float>(M_PI / 6.0), 0.7F, static_cast<float>(M_PI / 2.0)}, kernel);
    const auto within = SkinKernel::WeightsOf([](double r) { return r < 2.0 ? 1.0 : 0.0; });
    EXPECT_NEAR(kernel.Integral(within) / kernel.Integral(), near.sum / all.sum, 0.03) << c;
    double moment = 0.0;
    PlaneIntegral(kernel, &moment);
    EXPECT_LT(moment, 0.0) << "light travels on, away from the lamp";
  }
}

// What is shipped says of itself what one made anew would.
TEST(WaxTable, SaysHowItWasMade) {
  const SkinTable wax = *SkinTable::Load(SkinTable::DefaultWaxPath());
  Logger quiet(LogLevel::kError);
  const auto small = GenerateWaxTable({1000, 1, 0}, quiet);
  ASSERT_TRUE(small.ok()) << small.status().message();
  EXPECT_TRUE(wax.IsOf({1000000, 1, 0}));
  std::string as_shipped = small->manifest();
  as_shipped.replace(as_shipped.find("\"photons_per_run\":1000"), 22, "\"photons_per_run\":1000000");
  EXPECT_EQ(as_shipped, wax.manifest());
}

TEST(WaxTable, KnowsNoSkin) {
  const SkinTable wax = *SkinTable::Load(SkinTable::DefaultWaxPath());
  SkinKernel one, other;
  wax.Interpolate(0, {0.01F, 0.001F}, {0.3F, 0.2F, 1.0F}, one);
  wax.Interpolate(0, {0.20F, 0.050F}, {0.3F, 0.2F, 1.0F}, other);
  EXPECT_EQ(one.Integral(), other.Integral());
}

Outcome Tool(const std::string& arguments) { return Execute("stratalux-skin-table " + arguments); }

TEST(SkinTableTool, ChecksByOtherPhotonsThanTheTables) {
  const std::string table = SkinTable::DefaultPath();
  ASSERT_TRUE(ShippedTable().seed());
  const Outcome own = Tool("check " + table + " --photons 1000 --seed " + std::to_string(*ShippedTable().seed()));
  EXPECT_EQ(own.code, 2);
  EXPECT_THAT(own.out, HasSubstr("use another"));
  EXPECT_EQ(Tool("check " + table + " --channel 2 --photons 20000").code, 0);
}

TEST(SkinTableTool, SaysWhereTooFewPhotonsTellNothing) {
  const Outcome check = Tool("check " + SkinTable::DefaultPath() + " --interpolation --photons 100");
  EXPECT_EQ(check.code, 2);
  EXPECT_THAT(check.out, HasSubstr("--photons 100: too few"));
}

TEST(SkinTableTool, RefusesToWriteWhereItCannotBeforeItsPhotonsRun) {
  const ScratchFolder folder;
  for (const std::string& out : {folder.path().string() + "/not/there.bin", folder.path().string()}) {
    const Outcome run = Tool("generate --photons 1000000 --out " + out);
    EXPECT_EQ(run.code, 1) << run.out;
    EXPECT_THAT(run.out, HasSubstr("cannot write " + out));
    EXPECT_THAT(run.out, Not(HasSubstr("%"))) << "photons ran";
  }
  const Outcome many = Tool("generate --photons 20000000 --out " + folder.path().string() + "/t.bin");
  EXPECT_EQ(many.code, 2);
  EXPECT_THAT(many.out, HasSubstr("allowed: 1000 .. 10000000"));
}

TEST(SkinTableTool, RefusesProfilesOfNoEnd) {
  for (const char* wrong : {"--step-mm 1e-9", "--slit inf", "--half-width-mm 1e9", "--step-mm nan", "--slit 0.5 nan"})
    EXPECT_EQ(Tool(std::string("profiles --photons 1000 ") + wrong).code, 2) << wrong;
}

TEST(SkinTableTool, LightFromTheOtherSideHasPhotonsOfItsOwn) {
  const auto radiances = [](const std::string& incidence, bool backwards) {
    std::istringstream csv(Tool("profiles --photons 20000 --exit 0 --incidence " + incidence).out);
    std::vector<std::string> found;
    for (std::string line; std::getline(csv, line);)
      if (line.front() == 'i') found.push_back(line.substr(line.rfind(',') + 1));
    if (backwards) std::reverse(found.begin(), found.end());
    return found;
  };
  const auto one = radiances("45", false), other = radiances("-45", true);
  ASSERT_EQ(one.size(), other.size());
  ASSERT_GT(one.size(), 50u);
  EXPECT_NE(one, other);
}

}  // namespace
}  // namespace stratalux::rig
