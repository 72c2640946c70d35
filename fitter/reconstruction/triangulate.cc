// SPDX-License-Identifier: Apache-2.0
#include "fitter/reconstruction/triangulate.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "fitter/reconstruction/components.h"
#include "fitter/reconstruction/one_surface.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

struct View {
  size_t projector = 0;
  Eigen::Vector2d observed;       // column, row
  Eigen::Vector2d inverse_sigma;  // 1 / px; 0 of an axis that was not captured: it weighs nothing
  Eigen::Vector2d noise_share;    // of the variance: what decoding left; the rest is the model's
  Eigen::Vector3d ray_in_device;  // the camera ray's direction, projector frame
  Eigen::Vector3d origin;         // the camera centre, projector frame
  const Pinhole* model = nullptr;
  // Of the solved site.
  double weight = 0.0;         // of its codes in the range, over that of codes without noise
  double information = 0.0;    // 1 / mm^2; 0 of an outlier
  double own_offset_mm = 0.0;  // its own range less the joint one
};

struct SiteDepth {
  double range_mm = 0.0;
  double sigma_mm = 0.0;
  double noise_sigma_mm = 0.0;  // of that, what decoding left
  int rejected_views = 0;
};

enum class SiteOutcome { kGood, kUndecoded, kInconsistent, kUncertain };

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

  // The range and, in the views, what each had in it.
  [[nodiscard]] SiteOutcome Solve(std::vector<View>& views, SiteDepth& site) const {
    double best_range = 0.0, best_cost = INFINITY;
    for (const View& view : views) {
      const double range = OwnRange(view);
      if (!(range > 0.0)) continue;
      const double cost = Cost(views, range);
      if (cost < best_cost) {
        best_cost = cost;
        best_range = range;
      }
    }
    if (!std::isfinite(best_cost) || !Refine(views, best_range)) return SiteOutcome::kInconsistent;
    return Assess(views, best_range, site);
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

  [[nodiscard]] bool Refine(const std::vector<View>& views, double& range) const {
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
      if (!(information > 0.0)) return false;
      const double step = gradient / information;
      range -= step;
      if (std::abs(step) < 1e-5) break;
    }
    return true;
  }

  // Covariance from the inlying residuals, widened where they scatter more than their sigmas say.
  [[nodiscard]] SiteOutcome Assess(std::vector<View>& views, double range, SiteDepth& site) const {
    double information = 0.0, noise = 0.0, chi2 = 0.0;
    int used = 0, rejected = 0;
    for (View& view : views) {
      const auto r = Evaluate(view, range);
      const Eigen::Array2d captured = (view.inverse_sigma.array() > 0.0).cast<double>();
      if (r) {
        const Eigen::Array2d damped = {Damping(r->value[0]), Damping(r->value[1])};
        view.weight = (damped * view.inverse_sigma.array() * options_.model_sigma_px).square().sum() / captured.sum();
      }
      if (!r || r->value.cwiseAbs().maxCoeff() > options_.reject_sigmas) {
        ++rejected;
        continue;
      }
      view.information = r->slope.squaredNorm();
      view.own_offset_mm = -r->slope.dot(r->value) / view.information;
      information += view.information;
      noise += r->slope.cwiseAbs2().dot(view.noise_share);
      chi2 += r->value.squaredNorm();
      used += static_cast<int>(captured.sum());
    }
    if (used == 0 || !(information > 0.0) || !(range > 0.0)) return SiteOutcome::kInconsistent;
    const double sigma = std::sqrt(std::max(1.0, chi2 / std::max(used - 1, 1)) / information);
    if (!(sigma <= options_.max_relative_sigma * range)) return SiteOutcome::kUncertain;
    site = {range, sigma, std::sqrt(noise) / information, rejected};
    return SiteOutcome::kGood;
  }

  const TriangulateOptions& options_;
};

// The sites of a quad, put together.
struct QuadSum {
  explicit QuadSum(size_t projectors) : code_weights(projectors), information(projectors), own_offsets_mm(projectors) {}
  double weight = 0.0, noise = 0.0, model = 0.0, inverse_depth = 0.0;
  Eigen::Vector2d image = Eigen::Vector2d::Zero();  // x/z, y/z
  std::vector<double> code_weights, information, own_offsets_mm;
  std::vector<Eigen::Vector3d> points_mm;
  double sigma_mm = 0.0;  // the largest of a site

  void Add(const std::vector<View>& views, const SiteDepth& site, const Eigen::Vector3d& ray) {
    const double w = 1.0 / (site.sigma_mm * site.sigma_mm);
    weight += w;
    const double noise_variance = site.noise_sigma_mm * site.noise_sigma_mm;
    noise += w * w * noise_variance;
    model += w * std::max(site.sigma_mm * site.sigma_mm - noise_variance, 0.0);
    inverse_depth += w / (site.range_mm * ray.z());
    image += w * ray.head<2>() / ray.z();
    for (const View& view : views) {
      code_weights[view.projector] += view.weight;
      information[view.projector] += view.information;
      own_offsets_mm[view.projector] += view.information * view.own_offset_mm;
    }
    points_mm.emplace_back(site.range_mm * ray);
    sigma_mm = std::max(sigma_mm, site.sigma_mm);
  }
  // A plane's inverse depth is linear in the image, so this point lies on it, wherever in the quad its sites are.
  [[nodiscard]] Eigen::Vector3d MeanPoint() const {
    return Eigen::Vector3d(image.x() / weight, image.y() / weight, 1.0) * (weight / inverse_depth);
  }
  // What decoding left is independent from site to site. What the model left is common to neighbours: it stays.
  [[nodiscard]] double NoiseSigmaMm() const { return std::sqrt(noise) / weight; }
  [[nodiscard]] double SigmaMm() const { return std::hypot(NoiseSigmaMm(), std::sqrt(model / weight)); }
  // A quad across an edge sees two surfaces; between them there is none.
  [[nodiscard]] bool Mixed() const {
    for (size_t a = 0; a < points_mm.size(); ++a)
      for (size_t b = 0; b < a; ++b)
        if (!OnOneSurface(points_mm[a], points_mm[b], M_SQRT2 * sigma_mm)) return true;
    return false;
  }
  [[nodiscard]] double DisagreementMm() const {
    double squares = 0.0, all = 0.0;
    int projectors = 0;
    for (size_t p = 0; p < information.size(); ++p) {
      if (!(information[p] > 0.0)) continue;
      squares += own_offsets_mm[p] * own_offsets_mm[p] / information[p];
      all += information[p];
      ++projectors;
    }
    return projectors > 1 ? std::sqrt(squares / all) : std::nan("");
  }
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
      Eigen::Vector2d observed(map.column(x, y), map.row(x, y)), inverse_sigma, noise_share;
      const std::array<float, 2> decoded_sigma = {map.column_sigma(x, y), map.row_sigma(x, y)};
      for (int k = 0; k < 2; ++k) {
        const bool captured = !std::isnan(observed[k]);
        inverse_sigma[k] = captured ? 1.0 / std::hypot(decoded_sigma[k], options_.model_sigma_px) : 0.0;
        noise_share[k] = captured ? std::pow(decoded_sigma[k] * inverse_sigma[k], 2) : 0.0;
        if (!captured) observed[k] = 0.0;
      }
      const Rigid3& t = projector_from_camera_[p];
      views.push_back({.projector = p,
                       .observed = observed,
                       .inverse_sigma = inverse_sigma,
                       .noise_share = noise_share,
                       .ray_in_device = t.rotation * ray,
                       .origin = t.translation_mm,
                       .model = &rig_.projectors[p].model});
    }
    return views.empty() ? SiteOutcome::kUndecoded : solver_.Solve(views, depth);
  }

  void BuildQuad(int i, int j, Triangulation& out, TriangulationCounts& counts) const {
    const int step = QuadStep(rig_.camera.cfa);
    SurfaceMap& surface = out.surface;
    std::vector<View> views;
    QuadSum sum(decoded_.size());
    for (int y = step * j; y < step * (j + 1); ++y)
      for (int x = step * i; x < step * (i + 1); ++x) {
        const Eigen::Vector3d ray = rig_.camera.model.Unproject(Eigen::Vector2d(x, y));
        SiteDepth site;
        const SiteOutcome outcome = SolveSite(x, y, ray, views, site);
        counts.undecoded += outcome == SiteOutcome::kUndecoded;
        counts.inconsistent += outcome == SiteOutcome::kInconsistent;
        counts.uncertain += outcome == SiteOutcome::kUncertain;
        if (outcome != SiteOutcome::kGood) continue;
        ++counts.sites;
        counts.rejected_views += site.rejected_views;
        sum.Add(views, site, ray);
      }
    if (sum.points_mm.empty()) return;
    if (std::ssize(sum.points_mm) < std::min(options_.min_sites, step * step)) {
      ++counts.lone;
      return;
    }
    if (sum.Mixed()) {
      ++counts.mixed;
      return;
    }
    const Eigen::Vector3d point = sum.MeanPoint();
    for (int k = 0; k < 3; ++k) surface.point_mm(i, j, k) = static_cast<float>(point[k]);
    surface.depth_sigma_mm(i, j) = static_cast<float>(sum.SigmaMm());
    out.noise_sigma_mm(i, j) = static_cast<float>(sum.NoiseSigmaMm());
    surface.mask(i, j) = 1;
    for (size_t p = 0; p < decoded_.size(); ++p)
      out.weights[p](i, j) = static_cast<float>(sum.code_weights[p] / (step * step));
    out.disagreement_mm(i, j) = static_cast<float>(sum.DisagreementMm());
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
  if (!(model_sigma_px >= 0.0) || !(robust_scale > 0.0) || !(reject_sigmas > 0.0) || !(max_relative_sigma > 0.0))
    return Status::Usage("triangulate: sigmas and scales must be positive");
  return Status::Ok();
}

std::string WhyNoSurface(const TriangulationCounts& counts, int64_t unsmoothed) {
  std::vector<std::pair<int64_t, std::string>> gates = {
      {counts.undecoded, "pixels that no projector's code reached"},
      {counts.inconsistent, "pixels whose projectors contradict each other (is this the rig's calibration?)"},
      {counts.uncertain, "pixels whose depth is too uncertain (projector and camera too close, codes too coarse)"},
      {counts.lone, "lone pixels"},
      {counts.mixed, "quads across an edge"},
      {counts.islands, "quads in islands"},
      {unsmoothed, "quads without neighbours"}};
  std::stable_sort(gates.begin(), gates.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::string text;
  for (const auto& [count, what] : gates)
    if (count > 0) text += (text.empty() ? "" : ", ") + std::to_string(count) + " " + what;
  return text;
}

Result<Triangulation> Triangulate(std::span<const DecodedMap> decoded, const RigCalibration& rig,
                                  const TriangulateOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckInput(decoded, rig));
  const int step = QuadStep(rig.camera.cfa);
  const int width = rig.camera.model.width / step, height = rig.camera.model.height / step;
  const float nan = std::nanf("");
  const Image<float> unknown(width, height, 1, nan);
  Triangulation out{.surface = {Image<float>(width, height, 3, nan), Image<float>(width, height, 3, nan), unknown,
                                Image<uint8_t>(width, height)},
                    .noise_sigma_mm = unknown,
                    .weights = std::vector<Image<float>>(decoded.size(), Image<float>(width, height)),
                    .disagreement_mm = unknown,
                    .counts = {}};
  const SurfaceBuilder builder(decoded, rig, options);
  std::vector<TriangulationCounts> counts(static_cast<size_t>(height));
  ParallelFor(height, 4, [&](int64_t begin, int64_t end) {
    for (int64_t j = begin; j < end; ++j) builder.BuildRow(static_cast<int>(j), out, counts[j]);
  });
  for (const TriangulationCounts& row : counts) {
    out.counts.sites += row.sites;
    out.counts.undecoded += row.undecoded;
    out.counts.inconsistent += row.inconsistent;
    out.counts.uncertain += row.uncertain;
    out.counts.lone += row.lone;
    out.counts.mixed += row.mixed;
    out.counts.rejected_views += row.rejected_views;
  }
  out.counts.islands = RemoveIslands(out.surface, options.min_component);
  return out;
}

}  // namespace stratalux::fit
