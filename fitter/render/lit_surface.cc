// SPDX-License-Identifier: Apache-2.0
#include "fitter/render/lit_surface.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "fitter/reconstruction/surface_links.h"
#include "shared/base/formatted.h"
#include "shared/base/parallel.h"

namespace stratalux::fit {
namespace {

constexpr int64_t kRowsAtATime = 16;
constexpr double kMargin = 1.05;         // of a lamp's frame
constexpr double kWidestTangent = 10.0;  // from its axis to its edge: 84 degrees
constexpr double kDimmest = 1e-3;        // of the brightest: cos^3 there, what a lamp gives a plane that it looks at

struct Vertex {
  Eigen::Vector2d at;  // projector pixel
  Eigen::Vector3d point, normal;
  double distance = 0.0;  // to the light
};

// Fills the pixels whose centres lie in the triangle, nearest first.
void FillTriangle(const std::array<const Vertex*, 3>& v, Image<LitSample>& samples, Image<float>& nearest) {
  const Eigen::Vector2d a = v[0]->at, ab = v[1]->at - a, ac = v[2]->at - a;
  const double area = ab.x() * ac.y() - ab.y() * ac.x();
  if (std::abs(area) < 1e-9) return;
  const auto [min_x, max_x] = std::minmax({v[0]->at.x(), v[1]->at.x(), v[2]->at.x()});
  const auto [min_y, max_y] = std::minmax({v[0]->at.y(), v[1]->at.y(), v[2]->at.y()});
  if (max_x - min_x > 200 || max_y - min_y > 200) return;  // grazing: lights nothing worth having
  for (int y = std::max(0, static_cast<int>(std::ceil(min_y)));
       y <= std::min(samples.height() - 1, static_cast<int>(max_y)); ++y)
    for (int x = std::max(0, static_cast<int>(std::ceil(min_x)));
         x <= std::min(samples.width() - 1, static_cast<int>(max_x)); ++x) {
      const Eigen::Vector2d p = Eigen::Vector2d(x, y) - a;
      const double s = (p.x() * ac.y() - p.y() * ac.x()) / area, t = (ab.x() * p.y() - ab.y() * p.x()) / area;
      if (s < -1e-9 || t < -1e-9 || s + t > 1.0 + 1e-9) continue;
      const double r = 1.0 - s - t;
      const double distance = r * v[0]->distance + s * v[1]->distance + t * v[2]->distance;
      if (!(distance < nearest(x, y))) continue;
      nearest(x, y) = static_cast<float>(distance);
      samples(x, y).point_mm = (r * v[0]->point + s * v[1]->point + t * v[2]->point).cast<float>();
      samples(x, y).normal = (r * v[0]->normal + s * v[1]->normal + t * v[2]->normal).normalized().cast<float>();
    }
}

// Beyond its edges a row goes on as it ends.
Image<float> BlurRows(const Image<float>& image, double sigma) {
  const int radius = static_cast<int>(std::ceil(4 * sigma)) + 1, width = image.width();
  std::vector<double> kernel(2 * radius + 1), row(width + 2 * radius);
  double sum = 0.0;
  for (int k = -radius; k <= radius; ++k) sum += kernel[k + radius] = std::exp(-0.5 * k * k / (sigma * sigma));
  Image<float> out(image.height(), width);  // transposed: two passes make the full blur
  for (int y = 0; y < image.height(); ++y) {
    for (int x = -radius; x < width + radius; ++x) row[x + radius] = image(std::clamp(x, 0, width - 1), y);
    for (int x = 0; x < width; ++x) {
      double v = 0.0;
      for (size_t k = 0; k < kernel.size(); ++k) v += kernel[k] * row[x + k];
      out(y, x) = static_cast<float>(v / sum);
    }
  }
  return out;
}

Image<float> Blurred(const Image<float>& image, double sigma) {
  return sigma > 0.0 ? BlurRows(BlurRows(image, sigma), sigma) : image;
}

Image<float> Shown(const LitSurface& lit, const Pattern& pattern, double scale) {
  Image<float> shown = pattern.Render(lit.samples.width(), lit.samples.height());
  for (float& v : shown.pixels()) v *= static_cast<float>(scale);
  return shown;
}

// The least window that holds every pixel that is not dark.
BlockWindow LitPixels(const Image<float>& image) {
  BlockWindow lit;
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x)
      if (image(x, y) != 0.0F) lit = lit.With({x, x, y, y});
  return lit;
}

// Sum of up to 2 x 2 samples, weighted by the flux of a colour that the light has.
LitSample Block(const Image<LitSample>& fine, int x, int y, int colour) {
  LitSample sum;
  float weight = 0.0F;
  const int x_end = std::min(x + 2, fine.width()), y_end = std::min(y + 2, fine.height());
  for (int j = y; j < y_end; ++j)
    for (int i = x; i < x_end; ++i) {
      const LitSample& s = fine(i, j);
      weight += s.flux[colour];
      sum.point_mm += s.flux[colour] * s.point_mm;
      sum.normal += s.flux[colour] * s.normal;
      for (int c = 0; c < 3; ++c) sum.flux[c] += s.flux[c];
    }
  if (!(weight > 0.0F)) return sum;
  sum.point_mm /= weight;
  sum.normal /= weight;
  for (int j = y; j < y_end; ++j)
    for (int i = x; i < x_end; ++i) {
      const LitSample& s = fine(i, j);
      if (s.flux[colour] > 0.0F)
        sum.spread_mm2 += s.flux[colour] / weight * (s.spread_mm2 + (s.point_mm - sum.point_mm).squaredNorm());
    }
  return sum;
}

Image<LitSample> Halve(const Image<LitSample>& fine, int colour) {
  Image<LitSample> coarse((fine.width() + 1) / 2, (fine.height() + 1) / 2);
  for (int y = 0; y < coarse.height(); ++y)
    for (int x = 0; x < coarse.width(); ++x) coarse(x, y) = Block(fine, 2 * x, 2 * y, colour);
  return coarse;
}

// `colour`: whose flux the planes hold.
LitPlanes PlanesOf(const Image<LitSample>& blocks, int colour) {
  LitPlanes planes;
  planes.width = blocks.width();
  planes.height = blocks.height();
  planes.stride = blocks.width() + kGatherLanes;
  const size_t size = static_cast<size_t>(planes.stride) * planes.height;
  for (auto* plane :
       {&planes.x, &planes.y, &planes.z, &planes.nx, &planes.ny, &planes.nz, &planes.spread_mm2, &planes.flux})
    plane->assign(size, 0.0F);
  for (int y = 0; y < planes.height; ++y)
    for (int x = 0; x < planes.width; ++x) {
      const LitSample& s = blocks(x, y);
      const size_t at = static_cast<size_t>(y) * planes.stride + x;
      planes.x[at] = s.point_mm.x();
      planes.y[at] = s.point_mm.y();
      planes.z[at] = s.point_mm.z();
      planes.nx[at] = s.normal.x();
      planes.ny[at] = s.normal.y();
      planes.nz[at] = s.normal.z();
      planes.spread_mm2[at] = s.spread_mm2;
      planes.flux[at] = s.flux[colour];
      if (s.flux[colour] > 0.0F) planes.lit = planes.lit.With({x, x, y, y});
    }
  return planes;
}

// The quads that a lamp lights where nothing is in its way, but for those that it hardly lights.
std::vector<Eigen::Vector3d> ReachedFrom(const SurfaceMap& surface, const Eigen::Vector3d& lamp_mm) {
  // cos(theta) / d^2, negative where the quad faces away.
  const auto light_at = [&](int i, int j) {
    const Eigen::Vector3d to_lamp = lamp_mm - surface.Point(i, j);
    return surface.mask(i, j) != 0 ? surface.Normal(i, j).dot(to_lamp) / std::pow(to_lamp.norm(), 3) : 0.0;
  };
  double brightest = 0.0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i) brightest = std::max(brightest, light_at(i, j));
  std::vector<Eigen::Vector3d> reached;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (const double light = light_at(i, j); light > 0.0 && light >= kDimmest * brightest)
        reached.push_back(surface.Point(i, j));
  return reached;
}

int64_t CountOutside(const ProjectorCalibration& light, const std::vector<Eigen::Vector3d>& points) {
  return std::count_if(points.begin(), points.end(), [&](const Eigen::Vector3d& point) {
    const auto pixel = light.ProjectFromCamera(point);
    return !pixel || !light.model.Contains(*pixel);
  });
}

// Axis of the narrowest cone around `directions`: through the centre of the least ball around these unit vectors, to
// which steps of 1 / (k + 1) towards the farthest one lead (Badoiu, Clarkson: Smaller core-sets for balls, 2003).
Eigen::Vector3d ConeAxis(const std::vector<Eigen::Vector3d>& directions) {
  constexpr int kSteps = 200;
  Eigen::Vector3d centre = directions.front();
  for (int k = 1; k <= kSteps; ++k) {
    const auto farthest = std::max_element(directions.begin(), directions.end(), [&](const auto& a, const auto& b) {
      return (a - centre).squaredNorm() < (b - centre).squaredNorm();
    });
    centre += (*farthest - centre) / (k + 1.0);
  }
  return centre.normalized();
}

// Turns the lamp to the middle of `points`, with a frame that holds them as far as one pinhole can.
void AimAt(ProjectorCalibration& light, const std::vector<Eigen::Vector3d>& points) {
  const Eigen::Vector3d lamp = light.CentreInCamera();
  std::vector<Eigen::Vector3d> directions;
  directions.reserve(points.size());
  for (const Eigen::Vector3d& point : points) directions.push_back((point - lamp).normalized());
  const Eigen::Vector3d axis = ConeAxis(directions);
  double least_cosine = 1.0;
  for (const Eigen::Vector3d& direction : directions) least_cosine = std::min(least_cosine, axis.dot(direction));
  const double tangent = std::sqrt(1.0 - least_cosine * least_cosine) / std::max(least_cosine, 1e-6);
  light.camera_from_projector = LookAt(lamp, lamp + axis);
  light.model.fx = light.model.fy = 0.5 * light.model.width / (kMargin * std::min(tangent, kWidestTangent));
}

}  // namespace

LitSurface BuildLitSurface(const SurfaceMap& surface, const ProjectorCalibration& light, double exposure_ms) {
  LitSurface lit{light, exposure_ms, Image<LitSample>(light.model.width, light.model.height)};
  const int width = surface.width(), height = surface.height();
  std::vector<Vertex> vertices(static_cast<size_t>(width) * height);
  std::vector<uint8_t> known(vertices.size(), 0);
  ParallelFor(height, kRowsAtATime, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < width; ++i) {
        if (surface.mask(i, j) == 0) continue;
        const size_t at = static_cast<size_t>(j) * width + i;
        const Eigen::Vector3d point = surface.Point(i, j);
        const auto pixel = light.ProjectFromCamera(point);
        if (!pixel) continue;
        vertices[at] = {*pixel, point, surface.Normal(i, j), (point - light.CentreInCamera()).norm()};
        known[at] = 1;
      }
  });
  Image<float> nearest(light.model.width, light.model.height, 1, std::numeric_limits<float>::infinity());
  const SurfaceLinks links(surface);
  auto linked = [&](size_t a, size_t b) {
    const int i = static_cast<int>(a) % width, k = static_cast<int>(b) % width;
    return links.Linked(i, static_cast<int>(a) / width, k, static_cast<int>(b) / width);
  };
  auto fill = [&](size_t a, size_t b, size_t c) {
    if (known[a] == 0 || known[b] == 0 || known[c] == 0) return;
    if (linked(a, b) && linked(b, c) && linked(c, a))
      FillTriangle({&vertices[a], &vertices[b], &vertices[c]}, lit.samples, nearest);
  };
  for (int j = 0; j + 1 < height; ++j)
    for (int i = 0; i + 1 < width; ++i) {
      const size_t at = static_cast<size_t>(j) * width + i;
      fill(at, at + 1, at + width);
      fill(at + 1, at + width + 1, at + width);
    }
  ParallelFor(lit.samples.height(), kRowsAtATime, [&](int64_t begin, int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y)
      for (int x = 0; x < lit.samples.width(); ++x) {
        LitSample& s = lit.samples(x, y);
        if (!std::isfinite(nearest(x, y))) continue;
        const Eigen::Vector3d to_light = light.CentreInCamera() - s.point_mm.cast<double>();
        if (s.normal.cast<double>().dot(to_light) <= 0.0) continue;
        // Flux = intensity times the pixel's solid angle, whatever the tilt of the patch: cos^3 over fx fy.
        const double cosine = light.model.Unproject({double(x), double(y)}).z();
        const double solid_angle = cosine * cosine * cosine / (light.model.fx * light.model.fy);
        for (int c = 0; c < 3; ++c)
          s.flux[c] = static_cast<float>(light.white_dn_mm2_per_ms[c] * exposure_ms *
                                         light.Falloff({double(x), double(y)}) * solid_angle);
      }
  });
  return lit;
}

LitPyramid LightWith(const LitSurface& lit, const Pattern& pattern, double pattern_scale) {
  LitPyramid pyramid;
  pyramid.shown = Shown(lit, pattern, pattern_scale);
  pyramid.shown_lit = LitPixels(pyramid.shown);
  pyramid.pattern = Blurred(pyramid.shown, lit.light.line_blur_px);
  const auto& white = lit.light.white_dn_mm2_per_ms;
  pyramid.colour = static_cast<int>(std::max_element(white.begin(), white.end()) - white.begin());
  Image<LitSample> blocks = lit.samples;
  for (size_t i = 0; i < blocks.size(); ++i)
    for (float& f : blocks.pixels()[i].flux) f *= pyramid.pattern.pixels()[i];
  pyramid.levels.push_back(PlanesOf(blocks, pyramid.colour));
  for (int level = 1; level <= 6; ++level) {
    blocks = Halve(blocks, pyramid.colour);
    pyramid.levels.push_back(PlanesOf(blocks, pyramid.colour));
  }
  return pyramid;
}

Result<ProjectorCalibration> MakePointLight(const SurfaceMap& surface, const Eigen::Vector3d& position_mm,
                                            const std::array<double, 3>& dn, int resolution) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  int count = 0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0) {
        centre += surface.Point(i, j);
        ++count;
      }
  centre /= std::max(count, 1);
  double radius = 1.0;
  for (int j = 0; j < surface.height(); ++j)
    for (int i = 0; i < surface.width(); ++i)
      if (surface.mask(i, j) != 0) radius = std::max(radius, (surface.Point(i, j) - centre).norm());
  const std::vector<Eigen::Vector3d> reached = ReachedFrom(surface, position_mm);
  ProjectorCalibration light;
  light.name = "point light";
  light.camera_from_projector = LookAt(position_mm, centre);
  const double distance = (position_mm - centre).norm();
  const double f = 0.5 * resolution * std::max(distance - radius, 0.3 * distance) / (kMargin * radius);
  light.model = {resolution, resolution, f, f, 0.5 * (resolution - 1), 0.5 * (resolution - 1), {}};
  for (int c = 0; c < 3; ++c) light.white_dn_mm2_per_ms[c] = dn[c] * distance * distance;
  if (CountOutside(light, reached) == 0) return light;
  AimAt(light, reached);
  if (const int64_t dark = CountOutside(light, reached); dark > 0)
    return Status::Usage(
        Formatted("the light at %g,%g,%g mm stands among the face: %lld of %zu quads that face it "
                  "would stay dark; move it away from the face",
                  position_mm.x(), position_mm.y(), position_mm.z(), static_cast<long long>(dark), reached.size()));
  return light;
}

}  // namespace stratalux::fit
