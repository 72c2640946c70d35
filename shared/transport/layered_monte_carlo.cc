// SPDX-License-Identifier: Apache-2.0
#include "shared/transport/layered_monte_carlo.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "shared/base/check.h"
#include "shared/base/parallel.h"
#include "shared/base/random.h"

namespace stratalux {
namespace {

constexpr int64_t kChunk = 2000;          // photons a random stream
constexpr double kRouletteWeight = 1e-4;  // below it a photon survives one time in ten, ten times as heavy
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Photon {
  double x = 0, y = 0, z = 0;
  double ux = 0, uy = 0, uz = 1;
  double weight = 1;
  int layer = 0;
};

struct ChunkSums {
  double specular = 0, reflectance = 0, transmittance = 0, dropped = 0;
  std::array<double, kMaxTissueLayers> absorbed{};
};

// Henyey & Greenstein 1941: cosine of the scattering angle for a uniform number xi.
double SampleHenyeyGreenstein(double g, double xi) {
  if (std::abs(g) < 1e-6) return 2.0 * xi - 1.0;
  const double t = (1.0 - g * g) / (1.0 - g + 2.0 * g * xi);
  return std::clamp((1.0 + g * g - t * t) / (2.0 * g), -1.0, 1.0);
}

void Scatter(Photon& p, double g, Random& random) {
  const double cosine = SampleHenyeyGreenstein(g, random.Uniform());
  const double sine = std::sqrt(std::max(0.0, 1.0 - cosine * cosine));
  // Uniform direction on the circle by rejection: cheaper than a sine and a cosine.
  double a, b, r2;
  do {
    a = 2.0 * random.Uniform() - 1.0;
    b = 2.0 * random.Uniform() - 1.0;
    r2 = a * a + b * b;
  } while (r2 > 1.0 || r2 < 1e-12);
  const double inverse = sine / std::sqrt(r2);
  const double s1 = a * inverse, s2 = b * inverse;
  const double ux = p.ux, uy = p.uy, uz = p.uz;
  const double across2 = 1.0 - uz * uz;
  if (across2 < 1e-10) {
    p.ux = s1;
    p.uy = s2;
    p.uz = uz > 0 ? cosine : -cosine;
    return;
  }
  const double across = std::sqrt(across2);
  p.ux = s1 * (ux * uz) / across - s2 * uy / across + ux * cosine;
  p.uy = s1 * (uy * uz) / across + s2 * ux / across + uy * cosine;
  p.uz = -s1 * across + uz * cosine;
  const double norm = 1.0 / std::sqrt(p.ux * p.ux + p.uy * p.uy + p.uz * p.uz);
  p.ux *= norm;
  p.uy *= norm;
  p.uz *= norm;
}

// One thread's walker over one tissue.
class Walker {
 public:
  Walker(const Tissue& tissue, const MonteCarloOptions& options) : tissue_(tissue), options_(options) {
    double z = 0.0;
    for (const TissueLayer& layer : tissue.layers) {
      top_.push_back(z);
      z += layer.thickness_mm;
      bottom_.push_back(z);
    }
  }

  void Walk(Random& random, ChunkSums& sums, std::vector<EscapedPhoton>& escaped) {
    path_.fill(0.0);
    total_path_ = 0.0;
    Photon p;
    sin2_theta_ = options_.sin2_theta_low + (options_.sin2_theta_high - options_.sin2_theta_low) * random.Uniform();
    const double cos_in = std::sqrt(1.0 - sin2_theta_);
    double cos_t = 1.0;
    const double specular = FresnelReflectance(tissue_.n_outside, tissue_.layers[0].n, cos_in, &cos_t);
    sums.specular += specular;
    p.weight = 1.0 - specular;
    p.ux = -std::sqrt(sin2_theta_) * tissue_.n_outside / tissue_.layers[0].n;
    p.uz = cos_t;
    double free_path = 0.0;  // in units of mean free paths, kept across layer borders
    while (true) {
      if (free_path <= 0.0) free_path = -std::log(1.0 - random.Uniform());
      const TissueLayer& layer = tissue_.layers[p.layer];
      const double border = p.uz > 0.0   ? (bottom_[p.layer] - p.z) / p.uz
                            : p.uz < 0.0 ? (top_[p.layer] - p.z) / p.uz
                                         : kInfinity;
      const double scatter = layer.mu_s_per_mm > 0.0 ? free_path / layer.mu_s_per_mm : kInfinity;
      const bool hits_border = border <= scatter;
      const double step = std::max(0.0, std::min(border, scatter));
      if (!std::isfinite(step)) return Drop(p, sums);  // flies on for ever in a clear last layer
      Advance(p, step, layer, sums);
      if (Lost(p)) return Drop(p, sums);
      if (hits_border) {
        free_path -= step * layer.mu_s_per_mm;
        if (CrossBorder(p, random, sums, escaped)) return;
      } else {
        free_path = 0.0;
        Scatter(p, layer.g, random);
        if (p.weight < kRouletteWeight) {
          if (random.Uniform() >= 0.1) return;  // expected weight is conserved: 0.1 x 10
          p.weight *= 10.0;
        }
      }
    }
  }

 private:
  void Advance(Photon& p, double step, const TissueLayer& layer, ChunkSums& sums) {
    p.x += p.ux * step;
    p.y += p.uy * step;
    p.z += p.uz * step;
    path_[p.layer] += step;
    total_path_ += step;
    if (layer.mu_a_per_mm > 0.0) {
      const double kept = p.weight * std::exp(-layer.mu_a_per_mm * step);
      sums.absorbed[p.layer] += p.weight - kept;
      p.weight = kept;
    }
  }

  [[nodiscard]] bool Lost(const Photon& p) const {
    if (total_path_ > options_.max_path_mm) return true;
    const double r = options_.max_radius_mm;
    return p.x * p.x + p.y * p.y + p.z * p.z > r * r;
  }

  static void Drop(const Photon& p, ChunkSums& sums) { sums.dropped += p.weight; }

  // Reflects or refracts at the border that the photon stands on; true when it left the tissue.
  bool CrossBorder(Photon& p, Random& random, ChunkSums& sums, std::vector<EscapedPhoton>& escaped) {
    const bool down = p.uz > 0.0;
    const int next = p.layer + (down ? 1 : -1);
    const bool outside = next < 0 || next >= static_cast<int>(tissue_.layers.size());
    const double n1 = tissue_.layers[p.layer].n;
    const double n2 = outside ? tissue_.n_outside : tissue_.layers[next].n;
    p.z = down ? bottom_[p.layer] : top_[p.layer];
    double cos2 = std::abs(p.uz);
    if (n1 != n2) {
      const double reflectance = FresnelReflectance(n1, n2, std::abs(p.uz), &cos2);
      if (random.Uniform() < reflectance) {
        p.uz = -p.uz;
        return false;
      }
      p.ux *= n1 / n2;
      p.uy *= n1 / n2;
    }
    p.uz = down ? cos2 : -cos2;
    if (!outside) {
      p.layer = next;
      return false;
    }
    if (down) {
      sums.transmittance += p.weight;
      return true;
    }
    sums.reflectance += p.weight;
    EscapedPhoton e{static_cast<float>(p.x),         static_cast<float>(p.y),
                    static_cast<float>(p.ux),        static_cast<float>(p.uy),
                    static_cast<float>(p.uz),        static_cast<float>(p.weight),
                    static_cast<float>(sin2_theta_), {}};
    for (int l = 0; l < kMaxTissueLayers; ++l) e.path_mm[l] = static_cast<float>(path_[l]);
    escaped.push_back(e);
    return true;
  }

  const Tissue& tissue_;
  const MonteCarloOptions& options_;
  std::vector<double> top_, bottom_;
  std::array<double, kMaxTissueLayers> path_{};
  double total_path_ = 0.0;
  double sin2_theta_ = 0.0;
};

int64_t PhotonsOf(int64_t chunk, const MonteCarloOptions& options) {
  return std::min(kChunk, options.photons - chunk * kChunk);
}

// Mean over all photons, and its standard error by the scatter of the chunks' means about it, each with the weight of
// its photons (the last has fewer); one chunk tells none.
MonteCarloTotals::Value Summarise(const std::vector<ChunkSums>& chunks, const MonteCarloOptions& options,
                                  const std::function<double(const ChunkSums&)>& pick) {
  double sum = 0.0;
  for (const ChunkSums& c : chunks) sum += pick(c);
  const double mean = sum / static_cast<double>(options.photons);
  double squares = 0.0;
  for (size_t c = 0; c < chunks.size(); ++c) {
    const double d = pick(chunks[c]) - static_cast<double>(PhotonsOf(static_cast<int64_t>(c), options)) * mean;
    squares += d * d;
  }
  const double count = static_cast<double>(chunks.size());
  if (count < 2.0) return {mean, std::numeric_limits<double>::quiet_NaN()};
  return {mean, std::sqrt(squares * count / (count - 1.0)) / static_cast<double>(options.photons)};
}

}  // namespace

Status Tissue::Validate() const {
  if (layers.empty() || layers.size() > kMaxTissueLayers)
    return Status::Usage("tissue: " + std::to_string(layers.size()) + " layers, allowed: 1 .. " +
                         std::to_string(kMaxTissueLayers));
  for (size_t i = 0; i < layers.size(); ++i) {
    const TissueLayer& l = layers[i];
    const std::string where = "tissue: layer " + std::to_string(i) + ": ";
    if (!(l.n >= 1.0) || !(l.mu_a_per_mm >= 0.0) || !(l.mu_s_per_mm >= 0.0) || !(std::abs(l.g) < 1.0))
      return Status::Usage(where + "needs n >= 1, mu_a >= 0, mu_s >= 0, |g| < 1");
    if (!(l.thickness_mm > 0.0) || (std::isinf(l.thickness_mm) && i + 1 < layers.size()))
      return Status::Usage(where + "thickness must be positive, and finite in all but the last layer");
  }
  return Status::Ok();
}

double FresnelReflectance(double n1, double n2, double cos1, double* cos2) {
  const double sin2 = n1 / n2 * std::sqrt(std::max(0.0, 1.0 - cos1 * cos1));
  if (sin2 >= 1.0) {
    if (cos2 != nullptr) *cos2 = 0.0;
    return 1.0;
  }
  const double c2 = std::sqrt(1.0 - sin2 * sin2);
  if (cos2 != nullptr) *cos2 = c2;
  const double s = (n1 * cos1 - n2 * c2) / (n1 * cos1 + n2 * c2);
  const double p = (n1 * c2 - n2 * cos1) / (n1 * c2 + n2 * cos1);
  return 0.5 * (s * s + p * p);
}

int64_t MonteCarloChunks(const MonteCarloOptions& options) { return (options.photons + kChunk - 1) / kChunk; }

MonteCarloTotals TraceLayeredTissue(const Tissue& tissue, const MonteCarloOptions& options, const EscapeSink& sink) {
  SLX_CHECK(tissue.Validate().ok() && options.photons > 0);
  std::vector<ChunkSums> chunks(static_cast<size_t>(MonteCarloChunks(options)));
  ParallelFor(
      static_cast<int64_t>(chunks.size()), 1,
      [&](int64_t begin, int64_t end) {
        Walker walker(tissue, options);
        std::vector<EscapedPhoton> escaped;
        for (int64_t chunk = begin; chunk < end; ++chunk) {
          escaped.clear();
          Random random(options.seed, static_cast<uint64_t>(chunk));
          const int64_t count = PhotonsOf(chunk, options);
          for (int64_t i = 0; i < count; ++i) walker.Walk(random, chunks[chunk], escaped);
          if (sink) sink(chunk, escaped);
        }
      },
      options.threads);
  MonteCarloTotals totals;
  totals.specular = Summarise(chunks, options, [](const ChunkSums& c) { return c.specular; });
  totals.reflectance = Summarise(chunks, options, [](const ChunkSums& c) { return c.reflectance; });
  totals.transmittance = Summarise(chunks, options, [](const ChunkSums& c) { return c.transmittance; });
  totals.dropped = Summarise(chunks, options, [](const ChunkSums& c) { return c.dropped; });
  for (size_t l = 0; l < tissue.layers.size(); ++l)
    totals.absorbed.push_back(Summarise(chunks, options, [l](const ChunkSums& c) { return c.absorbed[l]; }));
  return totals;
}

}  // namespace stratalux
