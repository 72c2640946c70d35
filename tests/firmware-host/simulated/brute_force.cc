// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/simulated/brute_force.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "shared/base/parallel.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

using Eigen::Vector3d;
constexpr double kPi = std::numbers::pi;
constexpr int64_t kChunk = 100;    // photons a random stream; the scatter of the chunks' means gives the standard error
constexpr double kReachMm = 40.0;  // photons further from the entry are lost
constexpr double kConnectMm = 0.7;  // from deeper no light gets out unscattered: exp(-12)

// One place of the surface and the tissue under it.
struct LocalSkin {
  bool known = false;
  Vector3d normal{0, 0, -1};
  double epidermis_mm = 0.0;
  std::array<double, 3> absorption{};
};

double Transmittance(double n_from, double n_to, double cos_from, double cos_to) {
  const double s = (n_from * cos_from - n_to * cos_to) / (n_from * cos_from + n_to * cos_to);
  const double p = (n_from * cos_to - n_to * cos_from) / (n_from * cos_to + n_to * cos_from);
  return 1.0 - 0.5 * (s * s + p * p);
}

// The rig's surface reflection by other formulas than its own (docs/simulated-rig.md, "Surface"); 1 / sr. GGX facets
// with Smith's shadowing for each of the two directions and Schlick's Fresnel from 0.028.
double GgxBrdf(double alpha, double ci, double co, double ch, double ih) {
  const double alpha2 = alpha * alpha, tan2_h = 1.0 / (ch * ch) - 1.0;
  const double facets = 1.0 / (kPi * alpha2 * std::pow(ch, 4) * std::pow(1.0 + tan2_h / alpha2, 2));
  auto unshadowed = [alpha2](double c) { return 2.0 / (1.0 + std::sqrt(1.0 + alpha2 * (1.0 / (c * c) - 1.0))); };
  const double fresnel = 0.028 + 0.972 * std::pow(1.0 - ih, 5);
  return facets * fresnel * unshadowed(ci) * unshadowed(co) / (4.0 * ci * co);
}

// Facets of Gaussian slopes: their density, and of those that a direction sees the area in its own projection, by
// quadrature over the slope along it.
double BeckmannBrdf(double m, double index, double ci, double co, double ch, double ih) {
  const double slope2 = 1.0 / (ch * ch) - 1.0;
  const double density = std::exp(-slope2 / (m * m)) / (kPi * m * m);  // of slopes
  auto seen = [m](double c) {
    constexpr int kSteps = 200;
    const double s = std::sqrt(1.0 - c * c), step = 12.0 * m / kSteps;
    double sum = 0.0;
    for (int k = 0; k < kSteps; ++k) {
      const double slope = (k + 0.5) * step - 6.0 * m;
      sum += std::exp(-slope * slope / (m * m)) * std::max(0.0, c - s * slope);
    }
    return sum * step / (m * std::sqrt(kPi) * c);
  };
  const double inside = std::sqrt(1.0 - (1.0 - ih * ih) / (index * index));
  return density / std::pow(ch, 4) * (1.0 - Transmittance(1.0, index, ih, inside)) /
         ((seen(ci) + seen(co) - 1.0) * 4.0 * ci * co);
}

double SurfaceBrdf(const SurfaceReflection& surface, const Vector3d& n, const Vector3d& in, const Vector3d& out) {
  const double ci = n.dot(in), co = n.dot(out);
  if (ci <= 0.0 || co <= 0.0) return 0.0;
  const Vector3d half = (in + out).normalized();
  const double ch = n.dot(half), ih = half.dot(in);
  double facets = 0.0;
  if (surface.form == FacetForm::kGgx) {
    facets = GgxBrdf(surface.roughness, ci, co, ch, ih);
  } else {
    facets = (1.0 - surface.wide_share) * BeckmannBrdf(surface.roughness, surface.index, ci, co, ch, ih) +
             surface.wide_share * BeckmannBrdf(surface.wide_roughness, surface.index, ci, co, ch, ih);
  }
  // Hairs, slice by slice of the layer above the facets.
  constexpr int kSlices = 16;
  const double slice = surface.fuzz_depth / kSlices, path = 1.0 / ci + 1.0 / co;
  double fuzz = 0.0;
  for (int k = 0; k < kSlices; ++k) fuzz += slice / (4.0 * kPi * ci * co) * std::exp(-(k + 0.5) * slice * path);
  return surface.strength * facets * std::exp(-surface.fuzz_depth * path) + fuzz;
}

// Continuous image of a projector: square pixels under a Gaussian blur.
class Projection {
 public:
  Projection(const ProjectorCalibration& projector, const Pattern& pattern)
      : image_(pattern.Render(projector.model.width, projector.model.height)),
        sigma_(projector.line_blur_px),
        reach_(sigma_ > 0.0 ? static_cast<int>(std::ceil(4.0 * sigma_)) + 1 : 0) {
    for (int f = 0; f <= kSteps; ++f)
      for (int k = -reach_; k <= reach_; ++k) shares_.push_back(Share(k, static_cast<double>(f) / kSteps - 0.5));
  }

  [[nodiscard]] double Intensity(const Eigen::Vector2d& at) const {
    const int c = static_cast<int>(std::lround(at.x())), r = static_cast<int>(std::lround(at.y()));
    const double *across = Shares(at.x() - c), *down = Shares(at.y() - r);
    double sum = 0.0;
    for (int j = -reach_; j <= reach_; ++j) {
      const float* row = image_.row(std::clamp(r + j, 0, image_.height() - 1));
      double line = 0.0;
      for (int i = -reach_; i <= reach_; ++i)
        line += across[i + reach_] * row[std::clamp(c + i, 0, image_.width() - 1)];
      sum += down[j + reach_] * line;
    }
    return sum;
  }

 private:
  static constexpr int kSteps = 64;  // a pixel

  // Of a Gaussian at `offset`, the part in pixel k.
  [[nodiscard]] double Share(int k, double offset) const {
    if (sigma_ <= 0.0) return 1.0;
    const double scale = 1.0 / (sigma_ * std::numbers::sqrt2);
    return 0.5 * (std::erf((k + 0.5 - offset) * scale) - std::erf((k - 0.5 - offset) * scale));
  }
  [[nodiscard]] const double* Shares(double offset) const {
    const int step = std::clamp(static_cast<int>(std::lround((offset + 0.5) * kSteps)), 0, kSteps);
    return shares_.data() + static_cast<ptrdiff_t>(step) * (2 * reach_ + 1);
  }

  Image<float> image_;
  double sigma_;
  int reach_;
  std::vector<double> shares_;  // [offset][pixel]
};

struct LampOfPixel {
  Vector3d centre;
  bool check_shadows = false;  // something near the pixel lies in this lamp's shadow
};

struct PixelJob {
  const Scene& scene;
  const RigCalibration& rig;
  int x, y, colour;
  std::vector<Projection> projections;  // one a light
  std::vector<int> lamp_of_light;
  std::vector<LampOfPixel> lamps;  // one a projector
  Vector3d centre{0, 0, 0};        // surface point at the pixel's centre
  double most_absorption = 0.0;    // near there, 1 / mm
};

bool Visible(const Scene& scene, const Vector3d& point, const Vector3d& lamp) {
  const auto hit = scene.Intersect({lamp, (point - lamp).normalized()});
  return hit && (*hit - point).norm() < 0.6;
}

// One thread's walks for one pixel.
class Walker {
 public:
  explicit Walker(const PixelJob& job) : job_(job), skin_(kGrid * kGrid) {
    const SkinParameters skin = job.scene.Skin(job.centre);
    const Tissue clear = ClearSkin(job.colour, {}, skin.scattering, skin.skin_mm);  // skin and subcutis
    g_ = clear.layers[0].g;
    scatter_ = {clear.layers[0].mu_s_per_mm, clear.layers[0].mu_s_per_mm, clear.layers[1].mu_s_per_mm};
    subcutis_absorption_ = SkinAbsorption(job.colour, skin)[2];
    skin_mm_ = skin.skin_mm;
    majorant_ = scatter_[0] + job.most_absorption;
  }

  // Adds one photon's subsurface and direct light, one of each a light.
  void Walk(Random& random, std::vector<double>& subsurface, std::vector<double>& direct) {
    const Eigen::Vector2d at(job_.x + random.Uniform() - 0.5, job_.y + random.Uniform() - 0.5);
    const Vector3d ray = job_.rig.camera.model.Unproject(at);
    const auto hit = job_.scene.Intersect({Vector3d::Zero(), ray});
    if (!hit) return;
    entry_ = *hit;
    const Vector3d n = job_.scene.Normal(entry_);
    const double cos_out = -n.dot(ray);
    if (cos_out <= 0.0) return;
    Reflect(n, -ray, direct);
    const double cos_t = std::sqrt(1.0 - (1.0 - cos_out * cos_out) / (kSkinIndex * kSkinIndex));
    weight_ = Transmittance(1.0, kSkinIndex, cos_out, cos_t);
    direction_ = ((ray + cos_out * n) / kSkinIndex - cos_t * n).normalized();
    position_ = entry_ - 1e-6 * n;
    at_depth_ = 0.0;
    while (Step(random, subsurface)) {
    }
  }

 private:
  static constexpr int kGrid = 256;
  static constexpr double kGridMm = 0.1;

  // Light of a projector at a surface point: what a white target reads, and where on the projector's image it lies.
  struct Falling {
    double white_dn = 0.0;
    Eigen::Vector2d column_row{0, 0};
  };
  [[nodiscard]] Falling FallingLight(int p, const Vector3d& point, const Vector3d& n) const {
    const ProjectorCalibration& projector = job_.rig.projectors[p];
    const LampOfPixel& lamp = job_.lamps[p];
    Falling light{projector.WhiteTargetDn(point, n, job_.colour, 1.0), {0, 0}};
    if (!(light.white_dn > 0.0) || (lamp.check_shadows && !Visible(job_.scene, point, lamp.centre))) return {};
    light.column_row = *projector.ProjectFromCamera(point);
    return light;
  }

  void Reflect(const Vector3d& n, const Vector3d& out, std::vector<double>& direct) const {
    const SurfaceReflection surface = job_.scene.MaterialAt(entry_).surface;
    for (size_t l = 0; l < direct.size(); ++l) {
      const int p = job_.lamp_of_light[l];
      const Falling light = FallingLight(p, entry_, n);
      if (light.white_dn > 0.0)
        direct[l] += kPi * SurfaceBrdf(surface, n, (job_.lamps[p].centre - entry_).normalized(), out) * light.white_dn *
                     job_.projections[l].Intensity(light.column_row);
    }
  }

  // Surface at (x, y): nearest point of a grid of 0.1 mm around the pixel. Its normal is a fraction of a degree off, to
  // either side alike.
  const LocalSkin& SkinAt(double x, double y) {
    const int i = static_cast<int>(std::lround((x - job_.centre.x()) / kGridMm)) + kGrid / 2;
    const int j = static_cast<int>(std::lround((y - job_.centre.y()) / kGridMm)) + kGrid / 2;
    const int u = std::clamp(i, 0, kGrid - 1), v = std::clamp(j, 0, kGrid - 1);
    LocalSkin& skin = skin_[static_cast<size_t>(v) * kGrid + u];
    if (!skin.known) {
      const Vector3d offset((u - kGrid / 2) * kGridMm, (v - kGrid / 2) * kGridMm, 0.0);
      Vector3d point = job_.centre + offset;
      if (const double z = job_.scene.Height(point.x(), point.y()); !std::isnan(z)) point.z() = z;
      const SkinParameters parameters = job_.scene.Skin(point);
      skin = {true, job_.scene.Normal(point), parameters.epidermis_mm, SkinAbsorption(job_.colour, parameters)};
      for (double& a : skin.absorption) a = std::min(a, job_.most_absorption);
    }
    return skin;
  }

  [[nodiscard]] double Gap(const Vector3d& p) const { return p.z() - job_.scene.Height(p.x(), p.y()); }

  // A flight to the next collision or to the surface; false when the photon is done. Delta tracking: collisions come
  // at the rate of the majorant wherever the photon is, and are real with the local share of it.
  bool Step(Random& random, std::vector<double>& subsurface) {
    const double length = -std::log(1.0 - random.Uniform()) / majorant_;
    const Vector3d to = position_ + length * direction_;
    if ((to - entry_).squaredNorm() > kReachMm * kReachMm) return false;
    at_depth_ -= length;
    int layer = 2;
    double absorption = subcutis_absorption_;
    if (at_depth_ < skin_mm_) {  // else too deep to have left the subcutis, whatever the flight
      const double gap = Gap(to);
      if (std::isnan(gap)) return false;
      if (gap < 0.0) return HitSurface(to, random);
      at_depth_ = 0.5 * gap;  // a lower bound of the distance to the surface on slopes below 60 degrees
      position_ = to;
      const LocalSkin& skin = SkinAt(to.x(), to.y());
      const double depth = gap * -skin.normal.z();
      layer = depth < skin.epidermis_mm ? 0 : depth < skin_mm_ ? 1 : 2;
      absorption = skin.absorption[layer];
      if (depth < kConnectMm) Connect(depth, skin, scatter_[layer], subsurface);
    }
    position_ = to;
    weight_ *= 1.0 - absorption / majorant_;
    if (random.Uniform() * (majorant_ - absorption) < scatter_[layer]) Scatter(random);
    if (weight_ < 0.02) {
      if (random.Uniform() >= 0.2) return false;
      weight_ *= 5.0;
    }
    return true;
  }

  // Next-event estimate: scattering here towards the direction that refracts to the lamp. With the power J per solid
  // angle inside that reaches the surface, the radiance outside integrates to J T / (n^2 cos theta_t) over the area.
  void Connect(double depth, const LocalSkin& skin, double scattering, std::vector<double>& subsurface) const {
    const Vector3d& n = skin.normal;
    const Vector3d above = position_ + depth * n;
    int last = -1;
    double value = 0.0;
    Falling light;
    for (size_t l = 0; l < subsurface.size(); ++l) {
      const int p = job_.lamp_of_light[l];
      if (p != last) {
        last = p;
        value = 0.0;
        const Vector3d in = (job_.lamps[p].centre - above).normalized();
        const double cos_in = n.dot(in);
        if (cos_in <= 0.0) continue;
        const double cos_t = std::sqrt(1.0 - (1.0 - cos_in * cos_in) / (kSkinIndex * kSkinIndex));
        const Vector3d up = ((in - cos_in * n) / kSkinIndex + cos_t * n).normalized();
        light = FallingLight(p, position_ + depth / cos_t * up, n);
        if (!(light.white_dn > 0.0)) continue;
        const double epidermis = std::min(depth, skin.epidermis_mm);
        const double optical_depth =
            (scatter_[0] * depth + skin.absorption[0] * epidermis + skin.absorption[1] * (depth - epidermis)) / cos_t;
        const double phase =
            (1.0 - g_ * g_) / (4.0 * kPi) * std::pow(1.0 + g_ * g_ - 2.0 * g_ * direction_.dot(up), -1.5);
        value = kPi * weight_ * scattering / majorant_ * phase * std::exp(-optical_depth) *
                Transmittance(1.0, kSkinIndex, cos_in, cos_t) / (kSkinIndex * kSkinIndex * cos_t) * light.white_dn;
      }
      if (value > 0.0) subsurface[l] += value * job_.projections[l].Intensity(light.column_row);
    }
  }

  // The flight to `outside` crosses the surface: reflect there, or leave.
  bool HitSurface(const Vector3d& outside, Random& random) {
    double inside_t = 0.0, outside_t = 1.0;
    for (int k = 0; k < 24; ++k) {
      const double t = 0.5 * (inside_t + outside_t);
      (Gap(position_ + t * (outside - position_)) >= 0.0 ? inside_t : outside_t) = t;
    }
    position_ += inside_t * (outside - position_);
    const Vector3d n = job_.scene.Normal(position_);
    const double c = direction_.dot(n);
    if (c > 0.0) {
      const double sin2 = (1.0 - c * c) * kSkinIndex * kSkinIndex;
      if (sin2 < 1.0 && random.Uniform() < Transmittance(kSkinIndex, 1.0, c, std::sqrt(1.0 - sin2))) return false;
      direction_ -= 2.0 * c * n;
    }
    position_ -= 1e-6 * n;
    at_depth_ = 0.0;
    return true;
  }

  // Henyey and Greenstein, about the direction of flight.
  void Scatter(Random& random) {
    const double f = (1.0 - g_ * g_) / (1.0 - g_ + 2.0 * g_ * random.Uniform());
    const double cosine = std::clamp((1.0 + g_ * g_ - f * f) / (2.0 * g_), -1.0, 1.0);
    const double turn = 2.0 * kPi * random.Uniform(), sine = std::sqrt(1.0 - cosine * cosine);
    const Vector3d a = direction_.unitOrthogonal(), b = direction_.cross(a);
    direction_ = (cosine * direction_ + sine * (std::cos(turn) * a + std::sin(turn) * b)).normalized();
  }

  const PixelJob& job_;
  std::vector<LocalSkin> skin_;
  double g_ = 0.0, subcutis_absorption_ = 0.0, skin_mm_ = kSkinMm, majorant_ = 0.0;
  std::array<double, 3> scatter_{};  // epidermis, dermis, subcutis
  Vector3d entry_, position_, direction_;
  double weight_ = 0.0;
  double at_depth_ = 0.0;  // the surface is at least this far away
};

bool ShadowsNear(const Scene& scene, const Vector3d& centre, const Vector3d& lamp) {
  for (double r = 2.0; r <= 24.0; r += 2.0)
    for (int k = 0; k < 24; ++k) {
      const double x = centre.x() + r * std::cos(k * kPi / 12), y = centre.y() + r * std::sin(k * kPi / 12);
      const double z = scene.Height(x, y);
      if (!std::isnan(z) && !Visible(scene, {x, y, z}, lamp)) return true;
    }
  return false;
}

// Strongest absorption of the skin within 6 mm; the few photons that stray further into darker skin see no more.
double MostAbsorption(const Scene& scene, const Vector3d& centre, int colour) {
  double most = 0.0;
  for (double dy = -6.0; dy <= 6.0; dy += 0.25)
    for (double dx = -6.0; dx <= 6.0; dx += 0.25) {
      Vector3d point = centre + Vector3d(dx, dy, 0.0);
      if (const double z = scene.Height(point.x(), point.y()); !std::isnan(z)) point.z() = z;
      const auto a = SkinAbsorption(colour, scene.Skin(point));
      most = std::max({most, a[0], a[1], a[2]});
    }
  return 1.05 * most;
}

}  // namespace

std::vector<BruteForceEstimate> TracePixel(const Scene& scene, const RigCalibration& rig, int x, int y,
                                           std::span<const ProjectedLight> lights, const BruteForceOptions& options) {
  PixelJob job{scene, rig, x, y, CfaColour(rig.camera.cfa, x, y), {}, {}, {}};
  std::vector<BruteForceEstimate> estimates(lights.size());
  const auto centre = scene.Intersect({Vector3d::Zero(), rig.camera.model.Unproject({double(x), double(y)})});
  if (!centre) return estimates;
  job.centre = *centre;
  job.most_absorption = MostAbsorption(scene, *centre, job.colour);
  for (const ProjectorCalibration& p : rig.projectors)
    job.lamps.push_back({p.CentreInCamera(), ShadowsNear(scene, *centre, p.CentreInCamera())});
  for (const ProjectedLight& light : lights) {
    job.projections.emplace_back(rig.projectors[light.projector], light.pattern);
    job.lamp_of_light.push_back(light.projector);
  }
  const int64_t chunks = (options.photons + kChunk - 1) / kChunk;
  struct Sums {
    std::vector<double> subsurface, direct;
  };
  std::vector<Sums> sums(static_cast<size_t>(chunks),
                         {std::vector<double>(lights.size()), std::vector<double>(lights.size())});
  ParallelFor(
      chunks, 8,
      [&](int64_t begin, int64_t end) {
        Walker walker(job);
        for (int64_t chunk = begin; chunk < end; ++chunk) {
          Random random(options.seed + (static_cast<uint64_t>(y) << 40) + (static_cast<uint64_t>(x) << 20),
                        static_cast<uint64_t>(chunk));
          for (int64_t k = 0; k < kChunk; ++k) walker.Walk(random, sums[chunk].subsurface, sums[chunk].direct);
        }
      },
      options.threads);
  auto summarise = [&](auto pick, double& mean, double& error) {
    double sum = 0.0, squares = 0.0;
    for (const Sums& s : sums) sum += pick(s) / kChunk;
    mean = sum / static_cast<double>(chunks);
    for (const Sums& s : sums) squares += std::pow(pick(s) / kChunk - mean, 2);
    error = std::sqrt(squares / (static_cast<double>(chunks) * static_cast<double>(chunks - 1)));
  };
  for (size_t l = 0; l < lights.size(); ++l) {
    BruteForceEstimate& e = estimates[l];
    summarise([l](const Sums& s) { return s.subsurface[l]; }, e.subsurface, e.subsurface_error);
    summarise([l](const Sums& s) { return s.direct[l]; }, e.direct, e.direct_error);
  }
  return estimates;
}

double IncidenceDeg(const Scene& scene, const Vector3d& point, const Vector3d& device) {
  const double c = scene.Normal(point).dot((device - point).normalized());
  return std::acos(std::clamp(c, -1.0, 1.0)) * 180.0 / kPi;
}

}  // namespace stratalux::rig
