// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/lit_quads.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "fitter/render/lit_surface.h"
#include "fitter/structured_light/sensor_noise.h"
#include "shared/base/parallel.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

// Light over what white would give there, all colours together.
struct Share {
  double value = 0.0;
  double sigma = 0.0;
  bool known = false;
};

// Columns (of a capture that has but rows: rows) between what was decoded and where the surface says.
double Off(const DecodedMap& decoded, int x, int y, const Eigen::Vector2d& at) {
  const float column = decoded.column(x, y);
  return std::isnan(column) ? std::abs(decoded.row(x, y) - at.y()) : std::abs(column - at.x());
}

// Of one projector.
class Reach {
 public:
  Reach(const DecodedMap& decoded, const SeparationMap* separation, const SurfaceMap& surface,
        const RigCalibration& rig, int projector, const LitOptions& options)
      : decoded_(decoded),
        separation_(separation),
        surface_(surface),
        projector_(rig.projectors[static_cast<size_t>(projector)]),
        options_(options),
        noise_(SensorNoise::From(rig.camera)),
        step_(QuadStep(rig.camera.cfa)),
        nearest_mm_(projector_.model.width, projector_.model.height) {
    const LitSurface lit = BuildLitSurface(surface, projector_, 1.0);
    for (size_t i = 0; i < nearest_mm_.size(); ++i) {
      const LitSample& sample = lit.samples.pixels()[i];
      if (sample.normal.isZero()) continue;  // nothing is lit there
      nearest_mm_.pixels()[i] =
          static_cast<float>((projector_.CentreInCamera() - sample.point_mm.cast<double>()).norm());
    }
  }

  // Whether the joint surface lets light through, as far as it is known.
  [[nodiscard]] bool IsFaced(int i, int j) const {
    if (surface_.mask(i, j) == 0) return false;
    const Eigen::Vector3d x = surface_.Point(i, j), to_light = projector_.CentreInCamera() - x;
    const double distance = to_light.norm(), cosine = surface_.Normal(i, j).dot(to_light) / distance;
    const auto at = projector_.ProjectFromCamera(x);
    if (!(cosine > 0.0) || !at || !projector_.model.Contains(*at)) return false;
    const int column = std::clamp(static_cast<int>(std::lround(at->x())), 0, nearest_mm_.width() - 1),
              row = std::clamp(static_cast<int>(std::lround(at->y())), 0, nearest_mm_.height() - 1);
    const double pixel_mm = distance / projector_.model.fx, tangent = std::sqrt(1.0 / (cosine * cosine) - 1.0);
    const double margin_mm = options_.sigmas * M_SQRT2 * surface_.depth_sigma_mm(i, j) + pixel_mm * tangent;
    const double nearest_mm = nearest_mm_(column, row);
    return nearest_mm == 0.0 || nearest_mm > distance - margin_mm;
  }

  // Of direct light; of all light where that is too faint to be told apart. Not known where it saturates or nothing was
  // captured.
  [[nodiscard]] Share ShareAt(int i, int j) const {
    if (separation_ == nullptr) return {};
    const auto reason = static_cast<SeparationReason>(separation_->reason(i, j));
    double light = 0.0, variance = 0.0, white = 0.0;
    for (int c = 0; c < separation_->white.channels(); ++c) {
      const bool is_direct = reason == SeparationReason::kValid;
      const double all = separation_->white(i, j, c);
      light += is_direct ? separation_->direct(i, j, c) : all;
      variance += is_direct ? separation_->direct_variance(i, j, c) : VarianceOfWhite(all, c);
      white += projector_.WhiteTargetDn(surface_.Point(i, j), surface_.Normal(i, j), c, 1.0);
    }
    if (!std::isfinite(light) || !std::isfinite(variance) || !(white > 0.0)) return {};
    return {light / white, std::sqrt(variance) / white, true};
  }

  // More than noise, as in a hole of the surface within lit skin.
  [[nodiscard]] bool IsBright(int i, int j) const {
    if (separation_ == nullptr) return HasWhite(i, j);
    for (int c = 0; c < separation_->white.channels(); ++c) {
      const double white = separation_->white(i, j, c);
      if (!std::isfinite(white) || white > options_.sigmas * std::sqrt(VarianceOfWhite(white, c))) return true;
    }
    return false;
  }

  // Nothing is known of its light but by the codes' reasons, and these say that there is none.
  [[nodiscard]] bool IsDark(int i, int j) const {
    return (separation_ == nullptr || !std::isfinite(separation_->white(i, j, 0))) && !HasWhite(i, j);
  }

  // Shares of the quad's sites with codes of this surface, and of another.
  struct Codes {
    float agreeing = 0.0F, contradicting = 0.0F;
  };
  [[nodiscard]] Codes CodesAt(int i, int j) const {
    Codes codes;
    const auto at = projector_.ProjectFromCamera(surface_.Point(i, j));
    const float one = 1.0F / static_cast<float>(step_ * step_);
    ForEachSite(i, j, [&](int x, int y) {
      if (decoded_.reason(x, y) != static_cast<uint8_t>(DecodeReason::kValid)) return;
      const bool agrees = at && Off(decoded_, x, y, *at) < options_.max_code_columns;
      (agrees ? codes.agreeing : codes.contradicting) += one;
    });
    return codes;
  }

 private:
  template <typename Visit>
  void ForEachSite(int i, int j, const Visit& visit) const {
    for (int y = j * step_; y < (j + 1) * step_; ++y)
      for (int x = i * step_; x < (i + 1) * step_; ++x) visit(x, y);
  }

  // Of the mean over the colour's sites, the black frames' mean without noise.
  [[nodiscard]] double VarianceOfWhite(double white_dn, int colour) const {
    const double sites = step_ == 1 ? 1.0 : colour == 1 ? 2.0 : 1.0;
    return noise_.VarianceDn2(white_dn + noise_.black_level_dn) / sites;
  }

  [[nodiscard]] bool HasWhite(int i, int j) const {
    int lit = 0;
    ForEachSite(i, j, [&](int x, int y) {
      lit += decoded_.reason(x, y) != static_cast<uint8_t>(DecodeReason::kUnlit) ? 1 : 0;
    });
    return 2 * lit >= step_ * step_;
  }

  const DecodedMap& decoded_;
  const SeparationMap* separation_;
  const SurfaceMap& surface_;
  const ProjectorCalibration& projector_;
  const LitOptions& options_;
  SensorNoise noise_;
  int step_;
  Image<float> nearest_mm_;  // by pixel of the projector: the surface that it meets first; 0: none
};

// What a quad reflects of an unshadowed light, by all of its lights: the largest share but for one, which may be a
// highlight; of two the larger one.
Share ExpectedShare(std::vector<Share> shares) {
  if (shares.size() < 2) return {};
  std::ranges::sort(shares, std::greater<>(), &Share::value);
  return shares.size() == 2 ? shares[0] : shares[1];
}

// Every projector at one quad.
void JudgeQuad(const std::vector<Reach>& reaches, const LitOptions& options, int i, int j,
               std::vector<Image<QuadLight>>& light) {
  std::vector<Share> shares(reaches.size()), known;
  std::vector<uint8_t> faced(reaches.size());
  for (size_t p = 0; p < reaches.size(); ++p) {
    faced[p] = reaches[p].IsFaced(i, j) ? 1 : 0;
    if (faced[p] != 0) shares[p] = reaches[p].ShareAt(i, j);
    if (shares[p].known) known.push_back(shares[p]);
  }
  const Share expected = ExpectedShare(std::move(known));
  for (size_t p = 0; p < reaches.size(); ++p) {
    const double least = options.min_share * expected.value,
                 sigma = std::hypot(shares[p].sigma, options.min_share * expected.sigma);
    const bool lacks = shares[p].known && expected.known && shares[p].value + options.sigmas * sigma < least;
    const auto codes = reaches[p].CodesAt(i, j);
    const bool lit = faced[p] != 0 && !lacks && !reaches[p].IsDark(i, j) && codes.contradicting <= codes.agreeing;
    light[p](i, j) = lit ? QuadLight::kLit : QuadLight::kShadow;
  }
}

Status CheckSizes(std::span<const DecodedMap> decoded, std::span<const SeparationMap> separation,
                  const SurfaceMap& surface, const RigCalibration& rig) {
  if (decoded.size() != rig.projectors.size())
    return Status::Usage("lit quads: " + std::to_string(decoded.size()) + " decoded maps for " +
                         std::to_string(rig.projectors.size()) + " projectors");
  if (!separation.empty() && separation.size() != rig.projectors.size())
    return Status::Usage("lit quads: " + std::to_string(separation.size()) + " separations for " +
                         std::to_string(rig.projectors.size()) + " projectors; needs one each, or none");
  const int step = QuadStep(rig.camera.cfa);
  for (const DecodedMap& map : decoded)
    if (map.reason.width() / step != surface.width() || map.reason.height() / step != surface.height())
      return Status::Usage("lit quads: a decoded map is not of the surface's size");
  for (const SeparationMap& map : separation)
    if (map.reason.width() != surface.width() || map.reason.height() != surface.height())
      return Status::Usage("lit quads: a separation is not of the surface's size");
  return Status::Ok();
}

}  // namespace

Status LitOptions::Validate() const {
  if (!(sigmas >= 0.0) || !(min_share >= 0.0) || !(min_share < 1.0) || !(max_code_columns > 0.0))
    return Status::Usage("lit quads: limits must not be negative, and a share is below 1");
  return Status::Ok();
}

Image<uint8_t> AwayFromShadow(const Image<QuadLight>& light) {
  Image<uint8_t> lit(light.width(), light.height());
  for (int j = 1; j + 1 < light.height(); ++j)
    for (int i = 1; i + 1 < light.width(); ++i) {
      bool inside = light(i, j) == QuadLight::kLit;
      for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x) inside = inside && light(i + x, j + y) != QuadLight::kShadow;
      lit(i, j) = inside ? 1 : 0;
    }
  return lit;
}

Result<std::vector<Image<uint8_t>>> LitQuads(std::span<const DecodedMap> decoded,
                                             std::span<const SeparationMap> separation, const SurfaceMap& surface,
                                             const RigCalibration& rig, const LitOptions& options) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_RETURN_IF_ERROR(CheckSizes(decoded, separation, surface, rig));
  std::vector<Reach> reaches;
  for (size_t p = 0; p < decoded.size(); ++p)
    reaches.emplace_back(decoded[p], separation.empty() ? nullptr : &separation[p], surface, rig, static_cast<int>(p),
                         options);
  std::vector<Image<QuadLight>> light(decoded.size(), Image<QuadLight>(surface.width(), surface.height()));
  ParallelFor(surface.height(), 8, [&](int64_t begin, int64_t end) {
    for (int j = static_cast<int>(begin); j < end; ++j)
      for (int i = 0; i < surface.width(); ++i) {
        if (surface.mask(i, j) != 0) {
          JudgeQuad(reaches, options, i, j, light);
          continue;
        }
        // A hole of the surface within lit skin is no edge.
        for (size_t p = 0; p < reaches.size(); ++p)
          light[p](i, j) = reaches[p].IsBright(i, j) ? QuadLight::kUnknown : QuadLight::kShadow;
      }
  });
  std::vector<Image<uint8_t>> lit;
  for (const Image<QuadLight>& map : light) lit.push_back(AwayFromShadow(map));
  return lit;
}

}  // namespace stratalux::fit
