// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/light_transport.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>
#include <string_view>
#include <utility>

#include "firmware-host/simulated/near_field.h"
#include "firmware-host/simulated/projected_light.h"
#include "firmware-host/simulated/skin/subcutis_table.h"
#include "shared/base/parallel.h"

namespace stratalux::rig {
namespace {

constexpr double kPi = std::numbers::pi;
// Projector pixels nearer than this are integrated over their extent and the camera pixel's footprint.
constexpr float kNearPixels = 4.0F;
// A projector pixel's light further than this from where the tangent plane puts it lies on another part of the face.
constexpr float kLargestBendMm = 1.0F, kLargestBendRelative = 0.75F;
// Zeros around a profile, so that windows that reach over the projector's edge read no light.
constexpr int kPad = 64;
// Values of a blur that differs over the subject.
constexpr int kBlurNodes = 5;
// Blocks per axis of each coarser level's window that the finer level covers.
constexpr int kHole = 5;
// What a pixel's gathering takes, in what its preparing takes.
constexpr int64_t kGatherSteps = 8;
// Of what the cache keeps: raised whenever the same input gives another result.
constexpr int kCacheVersion = 2;
// The compiler and how it was told to round.
constexpr std::string_view kBuild = __VERSION__
#ifdef __OPTIMIZE__
    " optimised"
#endif
#ifdef __FMA__
    " fma"
#endif
#ifdef __FAST_MATH__
    " fast-math"
#endif
    ;

// First block index of the window of each level, for a pixel at projector position c.
std::array<int, kLevels> WindowStart(float c) {
  const int b4 = static_cast<int>(std::floor((c + 0.5F) / 4.0F)),
            b16 = static_cast<int>(std::floor((c + 0.5F) / 16.0F));
  return {(b4 - 2) * 4, (b16 - 2) * 4, b16 - 6};
}

// Blocks between block x and the finer level's window.
int BlocksFrom(int hole, int x) { return x < hole ? hole - x : std::max(0, x - hole - (kHole - 1)); }

std::vector<float> BlockMeans(const std::vector<float>& profile, int block) {
  std::vector<float> means((profile.size() + block - 1) / block, 0.0F);
  for (size_t b = 0; b < means.size(); ++b) {
    const size_t end = std::min(profile.size(), (b + 1) * block);
    for (size_t i = b * block; i < end; ++i) means[b] += profile[i];
    means[b] /= static_cast<float>(end - b * block);
  }
  return means;
}

// In four sums, which the compiler keeps side by side.
float Dot(const float* a, const float* b, int n) {
  std::array<float, 4> sums{};
  int k = 0;
  for (; k + 4 <= n; k += 4)
    for (int j = 0; j < 4; ++j) sums[j] += a[k + j] * b[k + j];
  float rest = 0.0F;
  for (; k < n; ++k) rest += a[k] * b[k];
  return (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest;
}

LightCache::Digest KeyWith(const LightCache::Digest& light, std::string_view what) {
  CacheKey key;
  key.AddAll(std::span<const uint64_t>(light));
  key.AddAll(std::span<const char>(what));
  return key.Digest();
}

}  // namespace

LightTransport::LightTransport(const Scene& scene, const SkinTable& table, const SkinAlbedo& albedo,
                               const RigCalibration& rig, int projector, const std::vector<SubjectPixel>& pixels,
                               const LightTransportOptions& options, WorkWatch* watch)
    : table_(table),
      albedo_(albedo),
      rig_(rig),
      projector_(rig.projectors[projector]),
      pixels_(pixels),
      options_(options),
      at_(pixels.size()) {
  const auto count = static_cast<int64_t>(pixels.size());
  const bool gathers = options_.scattering && std::any_of(pixels.begin(), pixels.end(), [](const SubjectPixel& pixel) {
                         return pixel.material.Translucent();
                       });
  if (watch != nullptr)
    watch->Expect(count + (gathers ? int64_t{projector_.model.width} * projector_.model.height + kGatherSteps * count
                                   : int64_t{0}));
  const bool prepared = WatchedParallelFor(watch, count, 1024, 1, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) PreparePixel(scene, static_cast<size_t>(i));
  });
  ChooseBlurNodes();
  if (!gathers || !prepared) return;
  CastProjector(scene, watch);
  BuildPyramid();
  GatherResponses(watch);
}

void LightTransport::ChooseBlurNodes() {
  blur_px_ = {projector_.line_blur_px};
  if (options_.optics.defocus_px_per_mm == 0.0 || pixels_.empty()) return;
  std::vector<double> blur(pixels_.size());
  for (size_t i = 0; i < pixels_.size(); ++i)
    blur[i] = options_.optics.BlurPx((pixels_[i].point - projector_.CentreInCamera()).norm());
  const auto [least, most] = std::minmax_element(blur.begin(), blur.end());
  const double step = std::max(1e-6, (*most - *least) / (kBlurNodes - 1));
  for (int k = 1; k < kBlurNodes; ++k) blur_px_.push_back(0.0);
  for (int k = 0; k < kBlurNodes; ++k) blur_px_[k] = *least + k * step;
  for (size_t i = 0; i < pixels_.size(); ++i)
    at_[i].blur_node = std::min(static_cast<float>((blur[i] - *least) / step), kBlurNodes - 1.001F);
}

// The surface patch that each projector pixel lights: its flux is intensity times solid angle, whatever the patch's
// tilt.
void LightTransport::CastProjector(const Scene& scene, WorkWatch* watch) {
  const Pinhole& m = projector_.model;
  pyramid_[0] = Image<Block>(m.width, m.height);
  WatchedParallelFor(watch, m.height, 8, m.width, [&](int64_t begin, int64_t end) {
    for (int r = static_cast<int>(begin); r < end; ++r)
      for (int c = 0; c < m.width; ++c) {
        const Eigen::Vector3d ray = m.Unproject({double(c), double(r)});
        const auto hit =
            scene.Intersect({projector_.CentreInCamera(), projector_.camera_from_projector.rotation * ray});
        if (!hit) continue;
        const double solid_angle = (m.Unproject({c + 0.5, double(r)}) - m.Unproject({c - 0.5, double(r)}))
                                       .cross(m.Unproject({double(c), r + 0.5}) - m.Unproject({double(c), r - 0.5}))
                                       .norm();
        const double flux = solid_angle * projector_.Falloff({double(c), double(r)});
        const Material material = scene.MaterialAt(*hit);
        if (!material.Translucent()) continue;  // what it reflects never enters the tissue
        Block& block = pyramid_[0](c, r);
        block.position = hit->cast<float>();
        for (int k = 0; k < 3; ++k)
          block.flux[k] =
              static_cast<float>(flux * projector_.white_dn_mm2_per_ms[k]) * std::sqrt(albedo_.Of(k, material));
      }
  });
}

void LightTransport::BuildPyramid() {
  for (int level = 1; level < kLevels; ++level) {
    const Image<Block>& fine = pyramid_[level - 1];
    Image<Block> coarse((fine.width() + 3) / 4, (fine.height() + 3) / 4);
    for (int y = 0; y < coarse.height(); ++y)
      for (int x = 0; x < coarse.width(); ++x) {
        Block sum;
        float weight = 0.0F;
        for (int j = 4 * y; j < std::min(4 * y + 4, fine.height()); ++j)
          for (int i = 4 * x; i < std::min(4 * x + 4, fine.width()); ++i) {
            const Block& b = fine(i, j);
            sum.position += b.flux[1] * b.position;
            weight += b.flux[1];
            for (int k = 0; k < 3; ++k) sum.flux[k] += b.flux[k];
          }
        if (weight > 0.0F) sum.position /= weight;
        coarse(x, y) = sum;
      }
    pyramid_[level] = std::move(coarse);
  }
}

void LightTransport::PreparePixel(const Scene& scene, size_t i) {
  const SubjectPixel& pixel = pixels_[i];
  PixelLight& light = at_[i];
  const auto column_row = projector_.ProjectFromCamera(pixel.point);
  if (!column_row) return;
  light.column_row = column_row->cast<float>();
  const int colour = CfaColour(rig_.camera.cfa, pixel.x, pixel.y);
  const double white = projector_.WhiteTargetDn(pixel.point, pixel.normal, colour, 1.0);
  if (!(white > 0.0)) return;
  // Lit when the projector's ray to the point meets nothing before it.
  const Eigen::Vector3d to_point = (pixel.point - projector_.CentreInCamera()).normalized();
  const auto hit = scene.Intersect({projector_.CentreInCamera(), to_point});
  light.lit = hit && (*hit - pixel.point).norm() < 0.6;
  if (!light.lit) return;
  const Eigen::Vector3d out = -pixel.point.normalized();
  const Material& material = pixel.material;
  double reflectance = ReflectanceOf(material.surface, pixel.normal, -to_point, out);
  if (!options_.scattering || !material.Translucent()) reflectance += albedo_.Of(colour, material);
  light.direct = static_cast<float>(white * reflectance);
  // The pixel's sides on the tangent plane, in projector pixels.
  const auto side = [&](const Eigen::Vector2d& axis, float& column, float& row) {
    const Eigen::Vector3d ray = rig_.camera.model.Unproject(Eigen::Vector2d(pixel.x, pixel.y) + 0.5 * axis);
    const double along = pixel.normal.dot(pixel.point) / pixel.normal.dot(ray);
    if (!(along > 0.0)) return;  // edge-on: half a pixel further the plane lies behind the camera
    const auto at = projector_.ProjectFromCamera(ray * along);
    if (!at) return;
    const Eigen::Vector2d most(projector_.model.width, projector_.model.height);
    const Eigen::Vector2f both = (2.0 * (*at - *column_row)).cwiseMin(most).cwiseMax(-most).cast<float>();
    column = both.x();
    row = both.y();
  };
  side({1, 0}, light.sides.u_column, light.sides.u_row);
  side({0, 1}, light.sides.v_column, light.sides.v_row);
}

bool LightTransport::StepsOnTangentPlane(const SubjectPixel& pixel, const PixelLight& light, const Eigen::Vector3d& tx,
                                         const Eigen::Vector3d& ty, TangentSteps& steps) const {
  auto tangent = [&](const Eigen::Vector3d& origin, const Eigen::Vector3d& ray) -> Eigen::Vector2f {
    const Eigen::Vector3d p = origin + ray * (pixel.normal.dot(pixel.point - origin) / pixel.normal.dot(ray));
    return {static_cast<float>((p - pixel.point).dot(tx)), static_cast<float>((p - pixel.point).dot(ty))};
  };
  const Eigen::Vector2d cr = light.column_row.cast<double>();
  auto projector_ray = [&](double dc, double dr) {
    return tangent(projector_.CentreInCamera(), projector_.camera_from_projector.rotation *
                                                    projector_.model.Unproject(cr + Eigen::Vector2d(dc, dr)));
  };
  auto camera_ray = [&](double du, double dv) {
    return tangent(Eigen::Vector3d::Zero(), rig_.camera.model.Unproject({pixel.x + du, pixel.y + dv}));
  };
  steps = {projector_ray(1, 0), projector_ray(0, 1), camera_ray(1, 0), camera_ray(0, 1)};
  return steps.column.norm() < 8.0F && steps.row.norm() < 8.0F && steps.u.norm() < 8.0F && steps.v.norm() < 8.0F &&
         steps.ProjectorPixelArea() > 0.0F;
}

void LightTransport::DescribeNearSurface(const Eigen::Vector3f& point, const Eigen::Vector3f& tx,
                                         const Eigen::Vector3f& ty, const Eigen::Vector2f& column_row, int first_column,
                                         int first_row, const TangentSteps& steps, NearSurface& surface) const {
  const Image<Block>& blocks = pyramid_[0];
  const float plane_area = steps.ProjectorPixelArea();
  auto at = [&](int c, int r) { return r * kNearWindow + c; };
  for (int r = 0; r < kNearWindow; ++r)
    for (int c = 0; c < kNearWindow; ++c) {
      const int k = at(c, r), x = first_column + c, y = first_row + r;
      surface.bend[k].setZero();
      surface.area[k] = 0.0F;
      if (!blocks.contains(x, y) || blocks(x, y).flux[1] == 0.0F) continue;
      const Eigen::Vector3f d = blocks(x, y).position - point;
      const Eigen::Vector2f on_plane = (static_cast<float>(x) - column_row.x()) * steps.column +
                                       (static_cast<float>(y) - column_row.y()) * steps.row;
      const Eigen::Vector2f bend = Eigen::Vector2f(d.dot(tx), d.dot(ty)) - on_plane;
      if (bend.norm() > std::max(kLargestBendMm, kLargestBendRelative * on_plane.norm())) continue;
      surface.bend[k] = bend;
      surface.area[k] = plane_area;
    }
  // The area that a pixel lights, from its neighbours' places.
  for (int r = 1; r + 1 < kNearWindow; ++r)
    for (int c = 1; c + 1 < kNearWindow; ++c) {
      const int left = at(c - 1, r), right = at(c + 1, r), up = at(c, r - 1), down = at(c, r + 1);
      if (surface.area[at(c, r)] == 0.0F || surface.area[left] == 0.0F || surface.area[right] == 0.0F ||
          surface.area[up] == 0.0F || surface.area[down] == 0.0F)
        continue;
      const Eigen::Vector2f column = steps.column + 0.5F * (surface.bend[right] - surface.bend[left]),
                            row = steps.row + 0.5F * (surface.bend[down] - surface.bend[up]);
      const float area = std::abs(column.x() * row.y() - column.y() * row.x());
      surface.area[at(c, r)] = std::clamp(area, 0.25F * plane_area, 4.0F * plane_area);
    }
}

template <typename Visit>
void LightTransport::ForEachBlock(size_t i, SkinKernel& kernel, const Visit& visit) const {
  const SubjectPixel& pixel = pixels_[i];
  const PixelLight& light = at_[i];
  const int colour = CfaColour(rig_.camera.cfa, pixel.x, pixel.y);
  const Eigen::Vector3d in = (projector_.CentreInCamera() - pixel.point).normalized();
  const Eigen::Vector3d out = -pixel.point.normalized();
  const double cos_in = std::clamp(pixel.normal.dot(in), 0.0, 1.0),
               cos_out = std::clamp(pixel.normal.dot(out), 0.0, 1.0);
  // Tangent frame of the kernel: +x towards the lamp, +y on the camera's side.
  Eigen::Vector3d tx = in - pixel.normal.dot(in) * pixel.normal;
  tx = tx.norm() > 1e-6 ? tx.normalized() : Eigen::Vector3d(pixel.normal.unitOrthogonal());
  Eigen::Vector3d ty = pixel.normal.cross(tx);
  const Eigen::Vector3d out_t = out - cos_out * pixel.normal;
  if (out_t.dot(ty) < 0.0) ty = -ty;
  const double azimuth = out_t.norm() > 1e-6 ? std::acos(std::clamp(out_t.normalized().dot(tx), -1.0, 1.0)) : 0.0;
  table_.Interpolate(
      colour, pixel.material.skin,
      {static_cast<float>(std::acos(cos_in)), static_cast<float>(std::acos(cos_out)), static_cast<float>(azimuth)},
      kernel);
  const Eigen::Vector3f fx = tx.cast<float>(), fy = ty.cast<float>(), point = pixel.point.cast<float>();
  // Radiance to digital numbers: a white target of irradiance E reads E in this unit, its radiance being E / pi.
  const float exit = static_cast<float>(kPi) / std::sqrt(std::max(albedo_.Of(colour, pixel.material), 1e-6F));

  const auto start_c = WindowStart(light.column_row.x()), start_r = WindowStart(light.column_row.y());
  TangentSteps steps{};
  NearField near;
  NearSurface surface;
  const bool fine = light.lit && StepsOnTangentPlane(pixel, light, tx, ty, steps);
  if (fine) {
    DescribeNearSurface(point, fx, fy, light.column_row, start_c[0], start_r[0], steps, surface);
    IntegrateSpike(kernel, steps, surface, light.column_row, start_c[0], start_r[0], near);
  }
  const std::array<Extent, 2> extents = {ExtentOf(steps, kBlock[0]), ExtentOf(steps, kBlock[1])};
  // Across a fold the tangent-plane offset can be short while the points are far apart: keep the distance in space.
  auto plain_offset = [&](const Block& b) {
    const Eigen::Vector3f d = point - b.position;
    const Eigen::Vector2f offset(d.dot(fx), d.dot(fy));
    return Eigen::Vector2f(offset * (d.norm() / (offset.norm() + 1e-6F)));
  };
  auto plain = [&](const Block& b) {
    const Eigen::Vector2f offset = plain_offset(b);
    return kernel(offset.x(), offset.y());
  };
  // Near enough that the kernel bends over the block: the mean over block and footprint, without the spike.
  auto plain_mean = [&](const Block& b, const Extent& extent) {
    return MeanOver(extent, plain_offset(b),
                    [&](const Eigen::Vector2f& at) { return kernel(at.x(), at.y()) * (1.0F - SpikeShare(at.norm())); });
  };
  // A projector pixel of the finest level: its share of the spike, and the rest of the kernel.
  auto integrated = [&](const Block& b, int c, int r) {
    const int k = (r - start_r[0]) * kNearWindow + c - start_c[0];
    if (surface.area[k] == 0.0F) return plain(b);  // another part of the face
    const Eigen::Vector2f offset(static_cast<float>(c) - light.column_row.x(),
                                 static_cast<float>(r) - light.column_row.y());
    const float rest = offset.cwiseAbs().maxCoeff() < kNearPixels ? MeanBesideSpike(kernel, steps, -plain_offset(b))
                                                                  : plain_mean(b, extents[0]);
    return rest + near[k];
  };

  for (int level = 0; level < kLevels; ++level) {
    const Image<Block>& blocks = pyramid_[level];
    // The hole that the finer level fills, in blocks of this level.
    const int hole_c = level == 0 ? 1 << 28 : start_c[level - 1] / 4,
              hole_r = level == 0 ? 1 << 28 : start_r[level - 1] / 4;
    for (int y = std::max(0, start_r[level]); y < std::min(blocks.height(), start_r[level] + kWindow[level]); ++y)
      for (int x = std::max(0, start_c[level]); x < std::min(blocks.width(), start_c[level] + kWindow[level]); ++x) {
        if (x >= hole_c && x < hole_c + kHole && y >= hole_r && y < hole_r + kHole) continue;
        const Block& b = blocks(x, y);
        if (b.flux[1] == 0.0F) continue;
        const bool beside_hole = level == 1 && BlocksFrom(hole_c, x) < 3 && BlocksFrom(hole_r, y) < 3;
        const float value = fine && level == 0    ? integrated(b, x, y)
                            : fine && beside_hole ? plain_mean(b, extents[1])
                                                  : plain(b);
        visit(level, x, y, exit * b.flux[colour] * value);
      }
  }
}

CacheKey LightTransport::KeyOfLight() const {
  CacheKey key;
  key.Add(kCacheVersion);
  // Builds that round otherwise keep apart: a kept result is the computed one, to the bit.
  key.AddAll(std::span<const char>(kBuild));
  key.Add(rig_.camera.cfa);
  for (const Pinhole* m : {&rig_.camera.model, &projector_.model}) {
    for (const double v : {m->fx, m->fy, m->cx, m->cy}) key.Add(v);
    key.AddAll(std::span<const double>(m->distortion));
    key.Add(m->width);
    key.Add(m->height);
  }
  key.AddAll(std::span<const double>(projector_.camera_from_projector.rotation.coeffs().data(), 4));
  key.AddAll(std::span<const double>(projector_.camera_from_projector.translation_mm.data(), 3));
  key.Add(table_.nodes());
  key.AddAll(table_.codes());
  key.Add(pixels_.size());
  for (size_t i = 0; i < pixels_.size(); ++i) {
    const SubjectPixel& p = pixels_[i];
    const std::array<double, 6> place = {p.point.x(),  p.point.y(),  p.point.z(),
                                         p.normal.x(), p.normal.y(), p.normal.z()};
    const std::array<float, 10> rest = {
        static_cast<float>(p.x),       static_cast<float>(p.y), static_cast<float>(p.material.Translucent()),
        p.material.skin.melanin,       p.material.skin.blood,   p.material.skin.epidermis_mm,
        p.material.skin.scattering,    at_[i].column_row.x(),   at_[i].column_row.y(),
        static_cast<float>(at_[i].lit)};
    key.AddBytes(std::as_bytes(std::span(place)));
    key.AddBytes(std::as_bytes(std::span(rest)));
  }
  for (const Block& block : pyramid_[0].pixels()) {
    const std::array<float, 6> lit = {block.position.x(), block.position.y(), block.position.z(),
                                      block.flux[0],      block.flux[1],      block.flux[2]};
    key.AddBytes(std::as_bytes(std::span(lit)));
  }
  AddSubcutis(key);
  return key;
}

// Nothing where all of it is the skin table's.
void LightTransport::AddSubcutis(CacheKey& key) const {
  bool usual = true;
  for (size_t i = 0; i < pixels_.size(); ++i) {
    const SkinParameters& skin = pixels_[i].material.skin;
    if (skin.UsualSubcutis()) continue;
    usual = false;
    key.Add(i);
    key.Add(skin.subcutis_absorption);
    key.Add(skin.skin_mm);
  }
  if (!usual && table_.subcutis() != nullptr) key.AddAll(table_.subcutis()->codes());
}

bool LightTransport::LoadResponses(const LightCache::Digest& columns, const LightCache::Digest& rows) {
  const size_t count = pixels_.size() * kResponses;
  auto column_response = options_.cache->Load(columns, count);
  auto row_response = column_response ? options_.cache->Load(rows, count) : std::nullopt;
  if (!row_response) return false;
  column_response_ = std::move(*column_response);
  row_response_ = std::move(*row_response);
  return true;
}

void LightTransport::GatherResponses(WorkWatch* watch) {
  if (watch != nullptr && watch->stopped()) return;
  LightCache::Digest columns_key{}, rows_key{};
  if (options_.cache != nullptr) {
    light_key_ = KeyOfLight().Digest();
    columns_key = KeyWith(light_key_, "columns");
    rows_key = KeyWith(light_key_, "rows");
    if (LoadResponses(columns_key, rows_key)) return;
  }
  column_response_.assign(pixels_.size() * kResponses, 0.0F);
  row_response_.assign(pixels_.size() * kResponses, 0.0F);
  constexpr std::array<int, kLevels> kFirst = {0, 20, 40};
  const auto count = static_cast<int64_t>(pixels_.size());
  const bool whole = WatchedParallelFor(watch, count, 512, kGatherSteps, [&](int64_t begin, int64_t end) {
    SkinKernel kernel;
    for (int64_t i = begin; i < end; ++i) {
      if (!pixels_[i].material.Translucent()) continue;
      const auto start_c = WindowStart(at_[i].column_row.x()), start_r = WindowStart(at_[i].column_row.y());
      float* columns = column_response_.data() + i * kResponses;
      float* rows = row_response_.data() + i * kResponses;
      ForEachBlock(static_cast<size_t>(i), kernel, [&](int level, int x, int y, float response) {
        columns[kFirst[level] + x - start_c[level]] += response;
        rows[kFirst[level] + y - start_r[level]] += response;
      });
    }
  });
  if (!whole || options_.cache == nullptr) return;
  options_.cache->Keep(columns_key, column_response_);
  options_.cache->Keep(rows_key, row_response_);
}

void LightTransport::Render(const Pattern& pattern, std::vector<float>& subsurface, std::vector<float>& direct,
                            WorkWatch* watch) const {
  if (pattern.kind == PatternKind::kBlack) return;
  if (pattern.IsOneDimensional()) {
    RenderOneDimensional(pattern, subsurface, direct);
  } else {
    RenderTwoDimensional(pattern, subsurface, direct, watch);
  }
}

LightTransport::Profiles LightTransport::ProfilesOf(const Pattern& pattern, double blur_px) const {
  std::vector<float> shown =
      pattern.Profile(pattern.axis == PatternAxis::kColumns ? projector_.model.width : projector_.model.height);
  ApplyGamma(shown, options_.optics.gamma);
  Profiles profiles{LightAlongAxis(shown, blur_px), {SharedOut(shown, blur_px), {}, {}}};
  profiles.levels[1] = BlockMeans(profiles.levels[0], 4);
  profiles.levels[2] = BlockMeans(profiles.levels[0], 16);
  for (auto& level : profiles.levels) {
    level.insert(level.begin(), kPad, 0.0F);
    level.insert(level.end(), kPad, 0.0F);
  }
  return profiles;
}

LightTransport::Split LightTransport::LightOf(size_t i, int axis, const Profiles& profiles) const {
  const PixelLight& light = at_[i];
  const float position = light.column_row[axis];
  Split split;
  if (light.lit) {
    const PixelSides& s = light.sides;
    const float u = axis == 0 ? s.u_column : s.u_row, v = axis == 0 ? s.v_column : s.v_row;
    split.direct = light.direct * profiles.on_surface.Mean(position, 0.5F * std::abs(u), 0.5F * std::abs(v));
  }
  const std::vector<float>& response = axis == 0 ? column_response_ : row_response_;
  if (response.empty()) return split;
  const auto start = WindowStart(position);
  const float* r = response.data() + i * kResponses;
  for (int level = 0; level < kLevels; ++level) {
    const int from = start[level] + kPad;
    if (from >= 0 && from + kWindow[level] <= static_cast<int>(profiles.levels[level].size())) {
      split.subsurface += Dot(r, profiles.levels[level].data() + from, kWindow[level]);
    }
    r += kWindow[level];
  }
  return split;
}

void LightTransport::RenderOneDimensional(const Pattern& pattern, std::vector<float>& subsurface,
                                          std::vector<float>& direct) const {
  const int axis = pattern.axis == PatternAxis::kColumns ? 0 : 1;
  std::vector<Profiles> nodes;
  for (const double blur : blur_px_) nodes.push_back(ProfilesOf(pattern, blur));
  ParallelFor(static_cast<int64_t>(pixels_.size()), 8192, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const auto node = static_cast<size_t>(at_[i].blur_node);
      const float share = at_[i].blur_node - static_cast<float>(node);
      Split light = LightOf(static_cast<size_t>(i), axis, nodes[node]);
      if (share > 0.0F) {
        const Split next = LightOf(static_cast<size_t>(i), axis, nodes[node + 1]);
        light.direct += share * (next.direct - light.direct);
        light.subsurface += share * (next.subsurface - light.subsurface);
      }
      direct[i] += light.direct;
      subsurface[i] += light.subsurface;
    }
  });
}

void LightTransport::RenderTwoDimensional(const Pattern& pattern, std::vector<float>& subsurface,
                                          std::vector<float>& direct, WorkWatch* watch) const {
  // Two-dimensional patterns take the blur of the subject's middle.
  Image<float> shown = pattern.Render(projector_.model.width, projector_.model.height);
  ApplyGamma(shown.pixels(), options_.optics.gamma);
  const double blur = blur_px_[blur_px_.size() / 2];
  AddDirect(shown, blur, direct);
  if (column_response_.empty()) return;  // nothing scatters
  std::array<Image<float>, kLevels> levels = {SharedOut(shown, blur), {}, {}};
  const Image<float>& image = levels[0];
  for (int level = 1; level < kLevels; ++level) {
    const Image<Block>& size = pyramid_[level];
    levels[level] = Image<float>(size.width(), size.height());
    const int block = kBlock[level];
    for (int y = 0; y < size.height(); ++y)
      for (int x = 0; x < size.width(); ++x) {
        const int right = std::min((x + 1) * block, image.width()), bottom = std::min((y + 1) * block, image.height());
        float sum = 0.0F;
        for (int j = y * block; j < bottom; ++j)
          for (int i = x * block; i < right; ++i) sum += image(i, j);
        levels[level](x, y) = sum / static_cast<float>((right - x * block) * (bottom - y * block));
      }
  }
  const std::vector<float> light = GatherImage(levels, watch);
  for (size_t i = 0; i < light.size(); ++i) subsurface[i] += light[i];
}

void LightTransport::AddDirect(const Image<float>& shown, double blur_px, std::vector<float>& direct) const {
  const BlurredBoxes boxes(blur_px);
  ParallelFor(static_cast<int64_t>(pixels_.size()), 8192, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const PixelLight& light = at_[i];
      if (!light.lit) continue;
      direct[i] += light.direct * MeanLight(shown, boxes, light.column_row.x(), light.column_row.y(), light.sides);
    }
  });
}

std::vector<float> LightTransport::GatherImage(const std::array<Image<float>, kLevels>& levels,
                                               WorkWatch* watch) const {
  LightCache::Digest key{};
  if (options_.cache != nullptr) {
    const auto bytes = std::as_bytes(levels[0].pixels());
    key = KeyWith(light_key_, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
    if (auto kept = options_.cache->Load(key, pixels_.size())) return std::move(*kept);
  }
  std::vector<float> gathered(pixels_.size(), 0.0F);
  const auto count = static_cast<int64_t>(pixels_.size());
  if (watch != nullptr) watch->Expect(count);
  const bool whole = WatchedParallelFor(watch, count, 512, 1, [&](int64_t begin, int64_t end) {
    SkinKernel kernel;
    for (int64_t i = begin; i < end; ++i) {
      if (!pixels_[i].material.Translucent()) continue;
      float sum = 0.0F;
      ForEachBlock(static_cast<size_t>(i), kernel,
                   [&](int level, int x, int y, float response) { sum += response * levels[level](x, y); });
      gathered[i] = sum;
    }
  });
  if (!whole) return {};
  if (options_.cache != nullptr) options_.cache->Keep(key, gathered);
  return gathered;
}

}  // namespace stratalux::rig
