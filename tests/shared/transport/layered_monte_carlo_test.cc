// SPDX-License-Identifier: Apache-2.0
// Published numbers: van de Hulst 1980, Giovanelli 1955 and the MCML sample as listed in the MCML manual (Wang &
// Jacques 1992) and its sample outputs; Jensen 2001 Skin1 by an independent Monte Carlo run.
#include "shared/transport/layered_monte_carlo.h"

#include <cmath>
#include <mutex>

#include <gtest/gtest.h>

namespace stratalux {
namespace {

// Inverse centimetres of the tables -> inverse millimetres.
TissueLayer LayerCm(double n, double mua, double mus, double g, double d_cm) {
  return {n, mua / 10.0, mus / 10.0, g, d_cm * 10.0};
}
constexpr double kHalfSpace = std::numeric_limits<double>::infinity();

void ExpectWithin(const MonteCarloTotals::Value& v, double expected, double published_error, const char* what) {
  EXPECT_NEAR(v.mean, expected, 3.0 * std::hypot(v.standard_error, published_error)) << what;
}

TEST(LayeredMonteCarlo, ReproducesVanDeHulstsSlab) {
  const Tissue slab{{LayerCm(1.0, 10, 90, 0.75, 0.02)}, 1.0};
  const auto t = TraceLayeredTissue(slab, {.photons = 200000});
  ExpectWithin(t.reflectance, 0.09739, 0.0, "Rd");
  ExpectWithin(t.transmittance, 0.66096, 0.0, "Tt");
  EXPECT_EQ(t.specular.mean, 0.0);
}

TEST(LayeredMonteCarlo, ReproducesGiovanellisHalfSpaceWithItsSpecularPart) {
  const Tissue half{{LayerCm(1.5, 10, 90, 0.0, kHalfSpace)}, 1.0};
  const auto t = TraceLayeredTissue(half, {.photons = 100000});
  EXPECT_NEAR(t.specular.mean, 0.04, 1e-9);
  EXPECT_NEAR(t.specular.mean + t.reflectance.mean, 0.2600, 3.0 * t.reflectance.standard_error);
}

TEST(LayeredMonteCarlo, ReproducesTheThreeLayerSample) {
  const Tissue tissue{{LayerCm(1.37, 1, 100, 0.9, 0.1), LayerCm(1.37, 1, 10, 0.0, 0.1), LayerCm(1.37, 2, 10, 0.7, 0.2)},
                      1.0};
  const auto t = TraceLayeredTissue(tissue, {.photons = 150000});
  constexpr double kPublished = 0.0005;  // mcml sample, 1e6 photons
  EXPECT_NEAR(t.specular.mean, 0.0243729, 1e-6);
  ExpectWithin(t.reflectance, 0.237544, kPublished, "Rd");
  ExpectWithin(t.transmittance, 0.0964896, kPublished, "Tt");
  const double absorbed[3] = {0.2612, 0.1488, 0.2316};
  for (int l = 0; l < 3; ++l) ExpectWithin(t.absorbed[l], absorbed[l], kPublished, "A_l");
}

TEST(LayeredMonteCarlo, ReproducesJensensSkin1) {
  const double scattering[3] = {0.74, 0.88, 1.01}, absorption[3] = {0.032, 0.17, 0.48};
  const double mc[3] = {0.43184, 0.2095, 0.11377}, error[3] = {0.00039, 0.0003, 0.00017};
  for (int c = 0; c < 3; ++c) {
    const Tissue skin{{{1.3, absorption[c], scattering[c], 0.0, kHalfSpace}}, 1.0};
    const auto t = TraceLayeredTissue(skin, {.photons = 100000, .seed = 5});
    EXPECT_NEAR(t.reflectance.mean / mc[c], 1.0, 3.0 * std::hypot(t.reflectance.standard_error, error[c]) / mc[c]) << c;
  }
}

TEST(LayeredMonteCarlo, StandardErrorsHoldForALastChunkThatIsNotWhole) {
  // Of many runs of the same tissue, by other seeds: their scatter is what each of them says of itself. A single photon
  // more than whole chunks must not make a chunk of its own weight.
  const Tissue slab{{LayerCm(1.0, 10, 90, 0.75, 0.02)}, 1.0};
  for (const int64_t photons : {16001, 19000}) {
    constexpr int kRuns = 60;
    double sum = 0.0, squares = 0.0, said = 0.0;
    for (int k = 0; k < kRuns; ++k) {
      const auto t = TraceLayeredTissue(slab, {.photons = photons, .seed = 100 + static_cast<uint64_t>(k)});
      sum += t.reflectance.mean;
      squares += t.reflectance.mean * t.reflectance.mean;
      said += t.reflectance.standard_error * t.reflectance.standard_error / kRuns;
    }
    const double variance = (squares - sum * sum / kRuns) / (kRuns - 1);
    // Relative error of either: sqrt(2 / 59) of the scatter, sqrt(2 / 8 / 60) of the mean of what nine chunks say.
    EXPECT_NEAR(said / variance, 1.0, 3.5 * std::sqrt(2.0 / 59 + 2.0 / 8 / 60)) << photons;
  }
  EXPECT_TRUE(std::isnan(TraceLayeredTissue(slab, {.photons = 1000}).reflectance.standard_error));
}

TEST(LayeredMonteCarlo, ConservesEnergy) {
  const Tissue tissue{{{1.4, 0.3, 10, 0.8, 0.1}, {1.36, 0.05, 8, 0.7, 1.0}, {1.45, 0.1, 5, 0.8, kHalfSpace}}, 1.0};
  const auto t = TraceLayeredTissue(tissue, {.photons = 50000, .sin2_theta_low = 0.5, .sin2_theta_high = 0.5});
  double sum = t.specular.mean + t.reflectance.mean + t.transmittance.mean + t.dropped.mean;
  for (const auto& a : t.absorbed) sum += a.mean;
  EXPECT_NEAR(sum, 1.0, 2e-3);  // roulette conserves the mean only
}

TEST(LayeredMonteCarlo, PathLengthsReproduceAbsorptionAfterwards) {
  Tissue clear{{{1.4, 0.0, 12, 0.8, 0.08}, {1.4, 0.0, 9, 0.8, kHalfSpace}}, 1.0};
  Tissue absorbing = clear;
  absorbing.layers[0].mu_a_per_mm = 1.5;
  absorbing.layers[1].mu_a_per_mm = 0.1;
  constexpr int64_t kPhotons = 60000;
  std::mutex mutex;
  double sum = 0.0, squares = 0.0;
  TraceLayeredTissue(clear, {.photons = kPhotons, .seed = 3, .max_path_mm = 300},
                     [&](int64_t, std::span<const EscapedPhoton> list) {
                       const std::lock_guard lock(mutex);
                       for (const EscapedPhoton& e : list) {
                         const double w = e.weight * std::exp(-1.5 * e.path_mm[0] - 0.1 * e.path_mm[1]);
                         sum += w;
                         squares += w * w;
                       }
                     });
  const auto direct = TraceLayeredTissue(absorbing, {.photons = kPhotons, .seed = 4});
  const double mean = sum / kPhotons;
  const double error = std::sqrt(std::max(0.0, squares / kPhotons - mean * mean) / kPhotons);
  EXPECT_NEAR(mean, direct.reflectance.mean, 3.0 * std::hypot(error, direct.reflectance.standard_error));
}

TEST(LayeredMonteCarlo, IsReciprocal) {
  // Radiance towards exit band B from light in band A equals that towards A from B (both in Lambertian measure).
  const Tissue tissue{{{1.4, 0.5, 12, 0.8, 0.08}, {1.4, 0.05, 9, 0.8, kHalfSpace}}, 1.0};
  auto exchange = [&](double in_low, double in_high, double out_low, double out_high, uint64_t seed) {
    std::mutex mutex;
    double weight = 0.0, squares = 0.0;
    constexpr int64_t kPhotons = 60000;
    TraceLayeredTissue(tissue,
                       {.photons = kPhotons, .seed = seed, .sin2_theta_low = in_low, .sin2_theta_high = in_high},
                       [&](int64_t, std::span<const EscapedPhoton> list) {
                         const std::lock_guard lock(mutex);
                         for (const EscapedPhoton& e : list) {
                           const double s2 = 1.0 - e.uz * e.uz;
                           if (s2 < out_low || s2 >= out_high) continue;
                           weight += e.weight;
                           squares += e.weight * e.weight;
                         }
                       });
    const double scale = 1.0 / (kPhotons * (out_high - out_low));
    return std::pair(weight * scale, std::sqrt(squares) * scale);
  };
  const auto [a, a_error] = exchange(0.0, 0.2, 0.6, 0.9, 11);
  const auto [b, b_error] = exchange(0.6, 0.9, 0.0, 0.2, 12);
  EXPECT_NEAR(a, b, 3.0 * std::hypot(a_error, b_error));
}

TEST(LayeredMonteCarlo, ShiftsTheDiffuseCentreAsObliqueIncidenceReflectometryHasIt) {
  // Wang & Jacques 1995: the far diffuse light is centred 3 D sin(theta_t) away from the lamp, D = 1 / (3 (mus' + 0.35
  // mua)).
  const double mus_reduced = 1.0, mua = 0.01;
  const Tissue tissue{{{1.4, mua, mus_reduced / 0.2, 0.8, kHalfSpace}}, 1.0};
  const double sin_in = std::sin(M_PI / 4.0);
  std::mutex mutex;
  double weight = 0.0, moment = 0.0, squares = 0.0;
  TraceLayeredTissue(
      tissue, {.photons = 150000, .seed = 8, .sin2_theta_low = sin_in * sin_in, .sin2_theta_high = sin_in * sin_in},
      [&](int64_t, std::span<const EscapedPhoton> list) {
        const std::lock_guard lock(mutex);
        for (const EscapedPhoton& e : list) {
          const double r2 = e.x_mm * e.x_mm + e.y_mm * e.y_mm;
          if (r2 < 9.0 || r2 > 400.0) continue;  // diffuse: beyond three transport lengths
          weight += e.weight;
          // The first moment of an annulus around the wrong centre is twice its shift for slow decay: use the
          // angle-weighted estimator below.
          moment += e.weight * e.x_mm;
          squares += e.weight * e.weight * e.x_mm * e.x_mm;
        }
      });
  const double expected = -sin_in / 1.4 / (mus_reduced + 0.35 * mua);
  const double mean = moment / weight;
  const double error = std::sqrt(squares) / weight;
  EXPECT_LT(mean, 0.0) << "light must move away from the lamp";
  // In an annulus the first moment is the shift times a factor between 1 and 2 that depends on the decay; bound it so.
  EXPECT_LT(mean, 0.8 * expected + 3.0 * error);
  EXPECT_GT(mean, 2.2 * expected - 3.0 * error);
}

TEST(LayeredMonteCarlo, IsTheSameWhateverTheThreads) {
  const Tissue slab{{LayerCm(1.4, 1, 90, 0.75, 0.1)}, 1.0};
  const auto one = TraceLayeredTissue(slab, {.photons = 20000, .seed = 9, .threads = 1});
  const auto three = TraceLayeredTissue(slab, {.photons = 20000, .seed = 9, .threads = 3});
  EXPECT_EQ(one.reflectance.mean, three.reflectance.mean);
  EXPECT_EQ(one.transmittance.mean, three.transmittance.mean);
  const auto other = TraceLayeredTissue(slab, {.photons = 20000, .seed = 10});
  EXPECT_NE(one.reflectance.mean, other.reflectance.mean);
}

TEST(Tissue, RefusesWhatIsNoTissue) {
  EXPECT_FALSE(Tissue{}.Validate().ok());
  EXPECT_FALSE((Tissue{{{1.4, -1, 1, 0, 1}}, 1.0}.Validate().ok()));
  EXPECT_FALSE((Tissue{{{1.4, 0, 1, 0, kHalfSpace}, {1.4, 0, 1, 0, 1}}, 1.0}.Validate().ok()));
}

}  // namespace
}  // namespace stratalux
