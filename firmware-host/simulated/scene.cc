// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "shared/base/random.h"
#include "shared/units/angle.h"

namespace stratalux::rig {
namespace {

constexpr double kExtentMm = 170.0;  // half-size of the tabulated square
constexpr double kCellMm = 0.5;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

double DistanceToPolyline(const std::vector<Eigen::Vector2d>& line, const Eigen::Vector2d& p) {
  double best = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i + 1 < line.size(); ++i) {
    const Eigen::Vector2d d = line[i + 1] - line[i];
    const double t = std::clamp((p - line[i]).dot(d) / d.squaredNorm(), 0.0, 1.0);
    best = std::min(best, (p - line[i] - t * d).norm());
  }
  return best;
}

double Sum(const std::vector<Bump>& bumps, double x, double y) {
  double sum = 0.0;
  for (const Bump& b : bumps) sum += b.At(x, y);
  return sum;
}

}  // namespace

double Bump::At(double x, double y) const {
  const double u = (x - cx) / sx, v = (y - cy) / sy;
  const double q = u * u + v * v;
  return q > 30.0 ? 0.0 : amplitude * std::exp(-q);
}

Result<Scene> Scene::Create(const std::string& name, uint64_t seed) {
  Scene scene;
  scene.name_ = name;
  if (name == "head") {
    scene.BuildHead(seed);
  } else if (name != "plane" && name != "sphere") {
    return Status::Usage("scene '" + name + "' is unknown; allowed: head, plane, sphere");
  }
  scene.BuildSkin(seed);
  scene.Tabulate();
  return scene;
}

// Proportions of an adult face in mm, nose root at the origin; every length and height varies by seed.
void Scene::BuildHead(uint64_t seed) {
  Random random(seed, 1);
  auto vary = [&](double v) { return v * random.Uniform(0.9, 1.1); };
  radius_x_ = vary(76);
  radius_y_ = vary(102);
  radius_z_ = vary(85);
  auto add = [&](double cx, double cy, double sx, double sy, double amplitude) {
    bumps_.push_back({cx, cy, sx, sy, amplitude});
  };
  auto add_pair = [&](double cx, double cy, double sx, double sy, double amplitude) {
    add(cx, cy, sx, sy, amplitude);
    add(-cx, cy, sx, sy, amplitude);
  };
  const double nose = vary(1.0), tip_y = vary(19);
  add(0, vary(-2), vary(9), vary(24), 11 * nose);                // bridge
  add(0, tip_y, vary(11), vary(11), 15 * nose);                  // tip
  add_pair(vary(13), tip_y + 3, vary(7), vary(7), 6 * nose);     // wings
  add_pair(vary(31), vary(-20), vary(17), vary(12), vary(-10));  // eye sockets
  add_pair(vary(31), vary(-19), vary(10), vary(8), vary(5));     // lids over the eyes
  add(0, vary(-38), vary(52), vary(11), vary(4.5));              // brow ridge
  add_pair(vary(43), vary(12), vary(22), vary(19), vary(6));     // cheekbones
  add(0, vary(43), vary(22), vary(5), vary(4.5));                // upper lip
  add(0, vary(53), vary(18), vary(6), vary(5));                  // lower lip
  add(0, vary(63), vary(22), vary(6), vary(-3.5));               // fold above the chin
  add(0, vary(79), vary(19), vary(14), vary(9));                 // chin
}

void Scene::BuildSkin(uint64_t seed) {
  Random random(seed, 2);
  melanin_ = 0.012 * std::pow(8.0, random.Uniform());  // 1.2 % (light) to 10 % (dark)
  blood_ = random.Uniform(0.003, 0.008);
  // Patches of a few centimetres.
  for (int i = 0; i < 24; ++i) {
    const double x = random.Uniform(-80, 80), y = random.Uniform(-100, 100), s = random.Uniform(12, 35);
    melanin_bumps_.push_back({x, y, s, s, random.Uniform(-0.2, 0.25)});
    blood_bumps_.push_back({y * 0.8, x, s, s, random.Uniform(-0.2, 0.3)});
  }
  // Freckles and moles: small, strong.
  const int freckles = 30 + static_cast<int>(random.Uniform() * 60);
  for (int i = 0; i < freckles; ++i) {
    const double s = random.Uniform(0.7, 1.8);
    melanin_bumps_.push_back({55 * random.Normal(), 25 + 40 * random.Normal(), s, s, random.Uniform(0.4, 2.5)});
  }
  for (double side : {-1.0, 1.0}) blood_bumps_.push_back({side * 42, 16, 22, 18, random.Uniform(0.6, 1.4)});
  blood_bumps_.push_back({0, 20, 13, 12, random.Uniform(0.3, 0.9)});
  blood_bumps_.push_back({0, 44, 21, 5, 2.0});
  blood_bumps_.push_back({0, 53, 18, 5.5, 2.2});
  // One vessel across forehead and temple.
  Eigen::Vector2d at(random.Uniform(-20, 10), -78);
  for (int i = 0; i < 14; ++i) {
    vessel_.push_back(at);
    at += Eigen::Vector2d(random.Uniform(1, 7), random.Uniform(1.5, 6));
  }
}

void Scene::UseUniformSkin(const SkinParameters& skin) {
  melanin_ = skin.melanin;
  blood_ = skin.blood;
  melanin_bumps_.clear();
  blood_bumps_.clear();
  vessel_.clear();
}

double Scene::Height(double x, double y) const {
  if (name_ == "plane") return 700.0 + x * std::tan(RadFromDeg(10.0));
  if (name_ == "sphere") {
    constexpr double kRadius = 80.0;
    const double q = kRadius * kRadius - x * x - y * y;
    return q > 0.0 ? 760.0 - std::sqrt(q) : kNaN;
  }
  const double u = x / radius_x_, v = y / radius_y_;
  // A superellipse keeps the forehead and cheeks fuller than an ellipsoid.
  const double q = 1.0 - std::pow(u * u, 1.15) - std::pow(v * v, 1.25);
  if (!(q > 0.0)) return kNaN;
  return centre_z_ - radius_z_ * std::sqrt(q) - Sum(bumps_, x, y);
}

void Scene::Tabulate() {
  const int size = static_cast<int>(2 * kExtentMm / kCellMm) + 1;
  table_ = Image<float>(size, size);
  for (int j = 0; j < size; ++j)
    for (int i = 0; i < size; ++i)
      table_(i, j) = static_cast<float>(Height(-kExtentMm + i * kCellMm, -kExtentMm + j * kCellMm));
}

double Scene::Tabulated(double x, double y) const {
  const double u = (x + kExtentMm) / kCellMm, v = (y + kExtentMm) / kCellMm;
  if (!(u >= 0 && v >= 0 && u < table_.width() - 1 && v < table_.height() - 1)) return kNaN;
  const int i = static_cast<int>(u), j = static_cast<int>(v);
  const double a = u - i, b = v - j;
  return (1 - a) * (1 - b) * table_(i, j) + a * (1 - b) * table_(i + 1, j) + (1 - a) * b * table_(i, j + 1) +
         a * b * table_(i + 1, j + 1);
}

std::optional<Eigen::Vector3d> Scene::Intersect(const Ray3& ray) const {
  constexpr double kNear = 560.0, kFar = 800.0;  // the subject lies between these depths
  if (ray.direction.z() <= 0.0) return std::nullopt;
  double t = std::max(0.0, (kNear - ray.origin_mm.z()) / ray.direction.z());
  const double t_end = (kFar - ray.origin_mm.z()) / ray.direction.z();
  double before = t;
  // March: the gap to the surface, over the steepest slope that matters, bounds the step.
  while (t < t_end) {
    const Eigen::Vector3d p = ray.origin_mm + t * ray.direction;
    const double gap = Tabulated(p.x(), p.y()) - p.z();
    if (gap <= 0.0) break;
    before = t;
    t += std::isnan(gap) ? 1.0 : std::clamp(0.3 * gap, 0.25, 20.0);
  }
  if (t >= t_end) return std::nullopt;
  double low = std::max(0.0, before - 0.5), high = t + 0.5;
  auto below = [&](double s) {
    const Eigen::Vector3d p = ray.origin_mm + s * ray.direction;
    return p.z() >= Height(p.x(), p.y());
  };
  if (!below(high)) return std::nullopt;
  if (below(low)) low = before - 4.0;
  for (int i = 0; i < 34; ++i) {
    const double middle = 0.5 * (low + high);
    (below(middle) ? high : low) = middle;
  }
  return ray.origin_mm + high * ray.direction;
}

Eigen::Vector3d Scene::Normal(const Eigen::Vector3d& point) const {
  constexpr double kStep = 0.02;
  auto slope = [&](double dx, double dy) {
    const double plus = Height(point.x() + dx, point.y() + dy), minus = Height(point.x() - dx, point.y() - dy);
    if (!std::isnan(plus) && !std::isnan(minus)) return (plus - minus) / (2 * kStep);
    const double here = Height(point.x(), point.y());
    if (!std::isnan(plus)) return (plus - here) / kStep;
    return std::isnan(minus) ? 0.0 : (here - minus) / kStep;
  };
  return Eigen::Vector3d(slope(kStep, 0), slope(0, kStep), -1.0).normalized();
}

SkinParameters Scene::Skin(const Eigen::Vector3d& point) const {
  const double x = point.x(), y = point.y();
  const double melanin = melanin_ * std::max(0.3, 1.0 + Sum(melanin_bumps_, x, y));
  const double distance = DistanceToPolyline(vessel_, {x, y});
  const double vessel = distance < 5.0 ? 3.0 * std::exp(-distance * distance / (2 * 0.9 * 0.9)) : 0.0;
  const double blood = blood_ * (std::max(0.3, 1.0 + Sum(blood_bumps_, x, y)) + vessel);
  return {static_cast<float>(std::min(melanin, 0.3)), static_cast<float>(std::min(blood, 0.06))};
}

}  // namespace stratalux::rig
