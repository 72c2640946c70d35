// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/interreflection.h"

#include <cmath>
#include <numbers>

#include "firmware-host/simulated/projected_light.h"
#include "shared/base/parallel.h"

namespace stratalux::rig {
namespace {

constexpr int kBlockPx = 16;                           // projector pixels a side of a patch
constexpr int kSamples = 4;                            // rays a side of a patch
constexpr double kPatchMm = 25.0, kPatchCosine = 0.8;  // what belongs to one patch
constexpr int kReceiverPx = 12;                        // camera pixels between receivers
constexpr double kDepthStepMm = 12.0;                  // receivers further in depth belong to another part of the face

}  // namespace

Interreflection::Interreflection(const Scene& scene, const SkinAlbedo& albedo, const RigCalibration& rig, int projector,
                                 double gamma, const std::vector<SubjectPixel>& pixels, WorkWatch* watch)
    : rig_(rig), projector_(rig.projectors[projector]), gamma_(gamma), pixels_(pixels) {
  CastPatches(scene, albedo, watch);
  PlaceReceivers(scene, watch);
  for (const SubjectPixel& p : pixels_) albedo_.push_back(albedo.Of(CfaColour(rig_.camera.cfa, p.x, p.y), p.material));
  WeighPixels();
}

void Interreflection::CastPatches(const Scene& scene, const SkinAlbedo& albedo, WorkWatch* watch) {
  const Pinhole& m = projector_.model;
  const int columns = (m.width + kBlockPx - 1) / kBlockPx, rows = (m.height + kBlockPx - 1) / kBlockPx;
  std::vector<std::vector<Patch>> found(rows);
  WatchedParallelFor(watch, rows, 1, 0, [&](int64_t begin, int64_t end) {
    for (int row = static_cast<int>(begin); row < end; ++row)
      for (int column = 0; column < columns; ++column) CastBlock(scene, albedo, column, row, found[row]);
  });
  for (const auto& row : found) patches_.insert(patches_.end(), row.begin(), row.end());
  for (Patch& patch : patches_) {
    patch.point /= patch.rays;
    patch.normal.normalize();
  }
}

void Interreflection::CastBlock(const Scene& scene, const SkinAlbedo& albedo, int column, int row,
                                std::vector<Patch>& patches) const {
  const Pinhole& m = projector_.model;
  const double step = double{kBlockPx} / kSamples;
  const size_t first = patches.size();
  for (int k = 0; k < kSamples * kSamples; ++k) {
    const Eigen::Vector2d at(column * kBlockPx + (k % kSamples + 0.5) * step - 0.5,
                             row * kBlockPx + (k / kSamples + 0.5) * step - 0.5);
    if (at.x() > m.width - 0.5 || at.y() > m.height - 0.5) continue;
    const Eigen::Vector3d ray = projector_.camera_from_projector.rotation * m.Unproject(at);
    const auto hit = scene.Intersect({projector_.CentreInCamera(), ray});
    if (!hit) continue;
    const Eigen::Vector3d normal = scene.Normal(*hit);
    auto along = [&](double dx, double dy) { return m.Unproject(at + 0.5 * step * Eigen::Vector2d(dx, dy)); };
    const double solid_angle = (along(1, 0) - along(-1, 0)).cross(along(0, 1) - along(0, -1)).norm();
    // A block across an edge lights several parts of the subject.
    size_t i = first;
    while (i < patches.size() && ((patches[i].point / patches[i].rays - *hit).norm() > kPatchMm ||
                                  patches[i].normal.normalized().dot(normal) < kPatchCosine))
      ++i;
    if (i == patches.size()) patches.push_back({column, row});
    Patch& patch = patches[i];
    patch.point += *hit;
    patch.normal += normal;
    ++patch.rays;
    patch.area_mm2 +=
        solid_angle * (*hit - projector_.CentreInCamera()).squaredNorm() / std::max(0.1, -normal.dot(ray));
    const double flux = solid_angle * projector_.Falloff(at);
    const Material material = scene.MaterialAt(*hit);
    for (int c = 0; c < 3; ++c)
      patch.leaving[c] += static_cast<float>(flux * projector_.white_dn_mm2_per_ms[c] * albedo.Of(c, material));
  }
}

void Interreflection::PlaceReceivers(const Scene& scene, WorkWatch* watch) {
  const Pinhole& camera = rig_.camera.model;
  grid_width_ = (camera.width + kReceiverPx - 1) / kReceiverPx + 1;
  grid_height_ = (camera.height + kReceiverPx - 1) / kReceiverPx + 1;
  receivers_.resize(static_cast<size_t>(grid_width_) * grid_height_);
  if (watch != nullptr) watch->Expect(static_cast<int64_t>(receivers_.size()));
  WatchedParallelFor(watch, static_cast<int64_t>(receivers_.size()), 16, 1, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      Receiver& receiver = receivers_[i];
      const Eigen::Vector2d at(static_cast<double>(i % grid_width_) * kReceiverPx,
                               static_cast<double>(i / grid_width_) * kReceiverPx);
      const auto hit = scene.Intersect({Eigen::Vector3d::Zero(), camera.Unproject(at)});
      if (!hit) continue;
      receiver.valid = true;
      receiver.depth_mm = hit->z();
      const Eigen::Vector3d normal = scene.Normal(*hit);
      for (size_t p = 0; p < patches_.size(); ++p) {
        const Patch& patch = patches_[p];
        const Eigen::Vector3d line = patch.point - *hit;
        const double here = normal.dot(line), there = -patch.normal.dot(line);
        if (here <= 0.0 || there <= 0.0) continue;
        const double d2 = line.squaredNorm();
        // Lambertian patches; one that touches the receiver cannot give more than it has.
        const double factor = std::min(here * there / (std::numbers::pi * d2 * d2), 1.0 / patch.area_mm2);
        if (factor < 1e-9 || scene.Hides(*hit, patch.point)) continue;
        receiver.links.push_back({static_cast<int>(p), static_cast<float>(factor)});
      }
    }
  });
}

void Interreflection::WeighPixels() {
  neighbours_.resize(pixels_.size());
  for (size_t i = 0; i < pixels_.size(); ++i) {
    const SubjectPixel& pixel = pixels_[i];
    const int x = pixel.x / kReceiverPx, y = pixel.y / kReceiverPx;
    const float fx = static_cast<float>(pixel.x % kReceiverPx) / kReceiverPx,
                fy = static_cast<float>(pixel.y % kReceiverPx) / kReceiverPx;
    Neighbours& n = neighbours_[i];
    float sum = 0.0F;
    for (int k = 0; k < 4; ++k) {
      n.receiver[k] = (y + k / 2) * grid_width_ + x + k % 2;
      const Receiver& receiver = receivers_[n.receiver[k]];
      if (!receiver.valid || std::abs(receiver.depth_mm - pixel.point.z()) > kDepthStepMm) continue;
      n.weight[k] = (k % 2 == 0 ? 1 - fx : fx) * (k / 2 == 0 ? 1 - fy : fy);
      sum += n.weight[k];
    }
    for (float& w : n.weight) w = sum > 0.0F ? w / sum : 0.0F;
  }
}

template <typename Level>
std::vector<std::array<float, 3>> Interreflection::Irradiance(const Level& level) const {
  std::vector<float> shown(patches_.size());
  for (size_t p = 0; p < patches_.size(); ++p) shown[p] = level(patches_[p].column, patches_[p].row);
  std::vector<std::array<float, 3>> irradiance(receivers_.size());
  for (size_t r = 0; r < receivers_.size(); ++r)
    for (const Link& link : receivers_[r].links) {
      const float share = link.factor * shown[link.patch];
      for (int c = 0; c < 3; ++c) irradiance[r][c] += share * patches_[link.patch].leaving[c];
    }
  return irradiance;
}

float Interreflection::At(size_t pixel, const std::vector<std::array<float, 3>>& irradiance) const {
  const SubjectPixel& p = pixels_[pixel];
  const int colour = CfaColour(rig_.camera.cfa, p.x, p.y);
  const Neighbours& n = neighbours_[pixel];
  float sum = 0.0F;
  for (int k = 0; k < 4; ++k) sum += n.weight[k] * irradiance[n.receiver[k]][colour];
  return sum;
}

void Interreflection::Render(const Pattern& pattern, std::vector<float>& indirect) const {
  if (pattern.kind == PatternKind::kBlack) return;
  const Pinhole& m = projector_.model;
  Image<float> image = pattern.Render(m.width, m.height);
  ApplyGamma(image.pixels(), gamma_);
  const auto irradiance = Irradiance([&](int column, int row) {
    const int right = std::min(m.width, (column + 1) * kBlockPx), bottom = std::min(m.height, (row + 1) * kBlockPx);
    float sum = 0.0F;
    for (int y = row * kBlockPx; y < bottom; ++y)
      for (int x = column * kBlockPx; x < right; ++x) sum += image(x, y);
    return sum / static_cast<float>((right - column * kBlockPx) * (bottom - row * kBlockPx));
  });
  ParallelFor(static_cast<int64_t>(pixels_.size()), 8192, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) indirect[i] += albedo_[i] * At(static_cast<size_t>(i), irradiance);
  });
}

float Interreflection::WhiteIrradiance(size_t i) const {
  return At(i, Irradiance([](int, int) { return 1.0F; }));
}

}  // namespace stratalux::rig
