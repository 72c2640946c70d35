// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/triangulate.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "fitter/reconstruction/components.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

struct View {
  size_t projector = 0;
  Eigen::Vector2d observed;       // column, row
  Eigen::Vector2d inverse_sigma;  // 1 / px; 0 of an axis that was not captured: it weighs nothing
  Eigen::Vector3d ray_in_device;  // the camera ray's direction, projector frame
  Eigen::Vector3d origin;         // the camera centre, projector frame
  const Pinhole* model = nullptr;
};

struct SiteDepth {
  double range_mm = 0.0;
  double sigma_mm = 0.0;
  int rejected_views = 0;
};

enum class SiteOutcome { kGood, kUndecoded, kInconsistent };

// Normalised residuals of one view at range t, and their derivative by t.
struct Residual {
  Eigen::Vector2d value;
  Eigen::Vector2d slope;
};

std::optional<Residual> Evaluate(const View& view, double range) {
  const double step = 1e-4 * range;
  const auto at = view.model->Project(view.origin + range * view.ray_in_device);
  const auto beside = view.model->Project(view.origin + (range + step) * view.ray_in_device);
  if (!at || !beside) return std::nullopt;
  return Residual{(*at - view.observed).cwiseProduct(view.inverse_sigma),
                  (*beside - *at).cwiseProduct(view.inverse_sigma) / step};
}

// Range at which a view's own two equations agree best: the projector's ray (nx, ny, 1) gives, linearly in t,
//   (a_x - nx a_z) t = nx o_z - o_x, the same for y, with a the camera ray and o the camera centre in its frame.
double OwnRange(const View& view) {
  const Eigen::Vector3d ray = view.model->Unproject(view.observed);
  const Eigen::Vector2d n = ray.head<2>() / ray.z();
  const Eigen::Vector2d a = view.ray_in_device.head<2>() - n * view.ray_in_device.z();
  const Eigen::Vector2d b = n * view.origin.z() - view.origin.head<2>();
  const Eigen::Vector2d captured = (view.inverse_sigma.array() > 0.0).cast<double>();
  return a.cwiseProduct(captured).dot(b) / a.cwiseProduct(captured).squaredNorm();
}

class RaySolver {
 public:
  explicit RaySolver(const TriangulateOptions& options) : options_(options) {}

  // What the view's codes weigh at range t, over that of codes without noise.
  [[nodiscard]] double WeightOf(const View& view, double range) const {
    const auto r = Evaluate(view, range);
    if (!r) return 0.0;
    double weight = 0.0;
    int axes = 0;
    for (int k = 0; k < 2; ++k) {
      if (!(view.inverse_sigma[k] > 0.0)) continue;
      ++axes;
      weight += std::pow(Damping(r->value[k]) * view.inverse_sigma[k] * options_.model_sigma_px, 2);
    }
    return axes > 0 ? weight / axes : 0.0;
  }

  [[nodiscard]] std::optional<SiteDepth> Solve(const std::vector<View>& views) const {
    double best_range = 0.0, best_cost = INFINITY;
    for (const View& view : views) {
      const double range = OwnRange(view);
      if (!(range > options_.min_depth_mm) || !(range < options_.max_depth_mm)) continue;
      const double cost = Cost(views, range);
      if (cost < best_cost) {
        best_cost = cost;
        best_range = range;
      }
    }
    if (!std::isfinite(best_cost)) return std::nullopt;
    return Refine(views, best_range);
  }

 private:
  // rho(r) = r^2 / (1 + r^2 / s^2); its weight in iterated least squares is 1 / (1 + r^2 / s^2)^2.
  [[nodiscard]] double Damping(double r) const {
    const double scaled = r / options_.robust_scale;
    return 1.0 / (1.0 + scaled * scaled);
  }

  [[nodiscard]] double Cost(const std::vector<View>& views, double range) const {
    double cost = 0.0;
    for (const View& view : views) {
      const auto r = Evaluate(view, range);
      for (int k = 0; k < 2; ++k)
        cost += r ? r->value[k] * r->value[k] * Damping(r->value[k]) : options_.robust_scale * options_.robust_scale;
    }
    return cost;
  }

  [[nodiscard]] std::optional<SiteDepth> Refine(const std::vector<View>& views, double range) const {
    for (int i = 0; i < options_.iterations; ++i) {
      double information = 0.0, gradient = 0.0;
      for (const View& view : views) {
        const auto r = Evaluate(view, range);
        if (!r) continue;
        for (int k = 0; k < 2; ++k) {
          const double weight = std::pow(Damping(r->value[k]), 2);
          information += weight * r->slope[k] * r->slope[k];
          gradient += weight * r->slope[k] * r->value[k];
        }
      }
      if (!(information > 0.0)) return std::nullopt;
      const double step = gradient / information;
      range -= step;
      if (std::abs(step) < 1e-5) break;
    }
    return Assess(views, range);
  }

  // Covariance from the inlying residuals, widened where they scatter more than their sigmas say.
  [[nodiscard]] std::optional<SiteDepth> Assess(const std::vector<View>& views, double range) const {
    double information = 0.0, chi2 = 0.0;
    int used = 0, rejected = 0;
    for (const View& view : views) {
      const auto r = Evaluate(view, range);
      if (!r || r->value.cwiseAbs().maxCoeff() > options_.reject_sigmas) {
        ++rejected;
        continue;
      }
      information += r->slope.squaredNorm();
      chi2 += r->value.squaredNorm();
      used += static_cast<int>((view.inverse_sigma.array() > 0.0).count());
    }
    if (used == 0 || !(information > 0.0)) return std::nullopt;
    const double sigma = std::sqrt(std::max(1.0, chi2 / std::max(used - 1, 1)) / information);
    if (!(range > options_.min_depth_mm) || !(range < options_.max_depth_mm) || sigma > options_.max_depth_sigma_mm)
      return std::nullopt;
    return SiteDepth{range, sigma, rejected};
  }

  const TriangulateOptions& options_;
};

class SurfaceBuilder {
 public:
  SurfaceBuilder(std::span<const DecodedMap> decoded, const RigCalibration& rig, const TriangulateOptions& options)
      : decoded_(decoded), rig_(rig), options_(options), solver_(options) {
    for (const ProjectorCalibration& p : rig.projectors)
      projector_from_camera_.push_back(p.camera_from_projector.Inverse());
  }

  void BuildRow(int j, Triangulation& out, TriangulationCounts& counts) const {
    for (int i = 0; i < out.surface.width(); ++i) BuildQuad(i, j, out, counts);
  }

 private:
  SiteOutcome SolveSite(int x, int y, const Eigen::Vector3d& ray, std::vector<View>& views, SiteDepth& depth) const {
    views.clear();
    for (size_t p = 0; p < decoded_.size(); ++p) {
      const DecodedMap& map = decoded_[p];
      if (map.reason(x, y) != static_cast<uint8_t>(DecodeReason::kValid)) continue;
      Eigen::Vector2d observed(map.column(x, y), map.row(x, y)), inverse_sigma;
      const std::array<float, 2> decoded_sigma = {map.column_sigma(x, y), map.row_sigma(x, y)};
      for (int k = 0; k < 2; ++k) {
        const bool captured = !std::isnan(observed[k]);
        inverse_sigma[k] = captured ? 1.0 / std::hypot(decoded_sigma[k], options_.model_sigma_px) : 0.0;
        if (!captured) observed[k] = 0.0;
      }
      const Rigid3& t = projector_from_camera_[p];
      views.push_back({p, observed, inverse_sigma, t.rotation * ray, t.translation_mm, &rig_.projectors[p].model});
    }
    if (views.empty()) return SiteOutcome::kUndecoded;
    const auto solved = solver_.Solve(views);
    if (!solved) return SiteOutcome::kInconsistent;
    depth = *solved;
    return SiteOutcome::kGood;
  }

  void BuildQuad(int i, int j, Triangulation& out, TriangulationCounts& counts) const {
    const int step = QuadStep(rig_.camera.cfa);
    SurfaceMap& surface = out.surface;
    std::vector<View> views;
    std::vector<double> of_projector(decoded_.size());
    double weight = 0.0, depth = 0.0;
    int good = 0;
    for (int y = step * j; y < step * (j + 1); ++y)
      for (int x = step * i; x < step * (i + 1); ++x) {
        const Eigen::Vector3d ray = rig_.camera.model.Unproject(Eigen::Vector2d(x, y));
        SiteDepth site;
        const SiteOutcome outcome = SolveSite(x, y, ray, views, site);
        counts.undecoded += outcome == SiteOutcome::kUndecoded;
        counts.inconsistent += outcome == SiteOutcome::kInconsistent;
        if (outcome != SiteOutcome::kGood) continue;
        ++counts.sites;
        counts.rejected_views += site.rejected_views;
        const double w = 1.0 / (site.sigma_mm * site.sigma_mm);
        weight += w;
        depth += w * site.range_mm * ray.z();
        for (const View& view : views) of_projector[view.projector] += solver_.WeightOf(view, site.range_mm);
        ++good;
      }
    if (good < std::min(options_.min_sites, step * step)) return;
    const Eigen::Vector3d ray = rig_.camera.model.Unproject(QuadCentre(rig_.camera.cfa, i, j));
    const Eigen::Vector3d point = ray * (depth / weight / ray.z());
    for (int k = 0; k < 3; ++k) surface.point_mm(i, j, k) = static_cast<float>(point[k]);
    surface.depth_sigma_mm(i, j) = static_cast<float>(1.0 / std::sqrt(weight));
    surface.mask(i, j) = 1;
    for (size_t p = 0; p < of_projector.size(); ++p)
      out.weights[p](i, j) = static_cast<float>(of_projector[p] / (step * step));
  }

  std::span<const DecodedMap> decoded_;
  const RigCalibration& rig_;
  const TriangulateOptions& options_;
  RaySolver solver_;
  std::vector<Rigid3> projector_from_camera_;
};

Status CheckInput(std::span<const DecodedMap> decoded, const RigCalibration& rig) {
  if (decoded.size() != rig.projectors.size())
    return Status::Usage("triangulate: " + std::to_string(decoded.size()) + " decoded maps, but the calibration has " +
                         std::to_string(rig.projectors.size()) + " projectors");
  for (size_t p = 0; p < decoded.size(); ++p)
    if (decoded[p].reason.width() != rig.camera.model.width || decoded[p].reason.height() != rig.camera.model.height)
      return Status::Usage("triangulate: the map of projector " + std::to_string(p) + " is " +
                           std::to_string(decoded[p].reason.width()) + "x" +
                           std::to_string(decoded[p].reason.height()) + ", the calibrated camera " +
                           std::to_string(rig.camera.model.width) + "x" + std::to_string(rig.camera.model.height));
  return Status::Ok();
}

}  // namespace

Status TriangulateOptions::Validate() const {
  if (!(model_sigma_px >= 0.0) || !(robust_scale > 0.0) || !(reject_sigmas > 0.0) || !(max_depth_sigma_mm > 0.0))
    return Status::Usage("triangulate: sigmas and scales must be positive");
  if (!(min_depth_mm > 0.0) || !(max_depth_mm > min_depth_mm))
    return Status::Usage("triangulate: the depth range is empty");
  return Status::Ok();
}

Result<Triangulation> Triangulate(std::span<const DecodedMap> decoded, const RigCalibration& rig,
                                  const TriangulateOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckInput(decoded, rig));
  const int step = QuadStep(rig.camera.cfa);
  const int width = rig.camera.model.width / step, height = rig.camera.model.height / step;
  const float nan = std::nanf("");
  Triangulation out{{Image<float>(width, height, 3, nan), Image<float>(width, height, 3, nan),
                     Image<float>(width, height, 1, nan), Image<uint8_t>(width, height)},
                    std::vector<Image<float>>(decoded.size(), Image<float>(width, height)),
                    {}};
  const SurfaceBuilder builder(decoded, rig, options);
  std::vector<TriangulationCounts> counts(static_cast<size_t>(height));
  ParallelFor(height, 4, [&](int64_t begin, int64_t end) {
    for (int64_t j = begin; j < end; ++j) builder.BuildRow(static_cast<int>(j), out, counts[j]);
  });
  for (const TriangulationCounts& row : counts) {
    out.counts.sites += row.sites;
    out.counts.undecoded += row.undecoded;
    out.counts.inconsistent += row.inconsistent;
    out.counts.rejected_views += row.rejected_views;
  }
  out.counts.islands = RemoveIslands(out.surface, options.max_step_mm, options.min_component);
  return out;
}

}  // namespace stratalux::fit
