// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/scene/picture_skin.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "firmware-host/simulated/scene/srgb.h"
#include "shared/base/formatted.h"
#include "shared/base/parallel.h"
#include "shared/image/png.h"

namespace stratalux::rig {
namespace {

// As the table interpolates: its log albedo is linear in melanin^0.75 and blood^0.67 between the nodes.
constexpr double kMelaninPower = 0.75, kBloodPower = 0.67;
constexpr double kDarkest = 1e-4;
constexpr size_t kMostTexels = size_t{1} << 26;

Eigen::Vector2d Low() {
  return {std::pow(SkinGrid::kMelanin.front(), kMelaninPower), std::pow(SkinGrid::kBlood.front(), kBloodPower)};
}
Eigen::Vector2d High() {
  return {std::pow(SkinGrid::kMelanin.back(), kMelaninPower), std::pow(SkinGrid::kBlood.back(), kBloodPower)};
}

}  // namespace

SkinOfAlbedo::SkinOfAlbedo(const SkinAlbedo& albedo, const SkinParameters& like) : albedo_(albedo), like_(like) {
  constexpr int kMelanins = 24, kBloods = 16;
  for (int j = 0; j < kBloods; ++j)
    for (int i = 0; i < kMelanins; ++i) {
      const Eigen::Vector2d share((i + 0.5) / kMelanins, (j + 0.5) / kBloods);
      const Eigen::Vector2d at = Low() + share.cwiseProduct(High() - Low());
      starts_.push_back({at, LogAlbedo(at)});
    }
}

SkinParameters SkinOfAlbedo::SkinAt(const Eigen::Vector2d& at) const {
  SkinParameters skin = like_;
  skin.melanin = static_cast<float>(std::pow(at.x(), 1.0 / kMelaninPower));
  skin.blood = static_cast<float>(std::pow(at.y(), 1.0 / kBloodPower));
  return skin;
}

Eigen::Vector3d SkinOfAlbedo::LogAlbedo(const Eigen::Vector2d& at) const {
  const SkinParameters skin = SkinAt(at);
  Eigen::Vector3d logarithm;
  for (int c = 0; c < kSkinChannels; ++c) logarithm[c] = std::log(albedo_(c, skin));
  return logarithm;
}

// Gauss and Newton's steps with Levenberg's damping from the nearest point of the grid; along an end of the range where
// the way down leads out of it.
SolvedSkin SkinOfAlbedo::operator()(const std::array<double, 3>& linear) const {
  Eigen::Vector3d wanted;
  for (int c = 0; c < 3; ++c) wanted[c] = std::log(std::max(linear[c], kDarkest));
  const Start* nearest = starts_.data();
  for (const Start& start : starts_)
    if ((start.log_albedo - wanted).squaredNorm() < (nearest->log_albedo - wanted).squaredNorm()) nearest = &start;
  const Eigen::Vector2d low = Low(), high = High(), range = high - low, step = 1e-3 * range;
  Eigen::Vector2d at = nearest->at;
  Eigen::Vector3d residual = nearest->log_albedo - wanted;
  double damping = 1e-6;
  for (int round = 0; round < 40 && damping < 1e6; ++round) {
    Eigen::Matrix<double, 3, 2> slope;  // over the whole range
    for (int k = 0; k < 2; ++k) {
      Eigen::Vector2d beside = at;
      beside[k] += at[k] + step[k] <= high[k] ? step[k] : -step[k];
      slope.col(k) = (LogAlbedo(beside) - wanted - residual) / ((beside[k] - at[k]) / range[k]);
    }
    const Eigen::Vector2d gradient = slope.transpose() * residual;
    for (int k = 0; k < 2; ++k)
      if ((at[k] <= low[k] && gradient[k] > 0.0) || (at[k] >= high[k] && gradient[k] < 0.0)) slope.col(k).setZero();
    Eigen::Matrix2d normal = slope.transpose() * slope;
    normal.diagonal().array() += damping;
    const Eigen::Vector2d move = -(normal.inverse() * (slope.transpose() * residual));
    const Eigen::Vector2d next = (at + move.cwiseProduct(range)).cwiseMax(low).cwiseMin(high);
    const Eigen::Vector3d there = LogAlbedo(next) - wanted;
    if (there.squaredNorm() < residual.squaredNorm()) {
      const bool done = ((next - at).cwiseQuotient(range)).norm() < 1e-7;
      at = next;
      residual = there;
      damping = std::max(1e-9, 0.1 * damping);
      if (done) break;
    } else {
      damping *= 10.0;
    }
  }
  const Eigen::Vector2d room = (at - low).cwiseMin(high - at).cwiseQuotient(range);
  return {SkinAt(at), room.minCoeff() < 1e-6, static_cast<float>(std::sqrt(residual.squaredNorm() / 3.0))};
}

Result<PictureSkin> PictureSkin::Read(const std::filesystem::path& file, double scale, const SkinAlbedo& albedo,
                                      const SkinParameters& like) {
  int bits = 0;
  const auto picture = ReadPng(file, &bits);
  if (!picture.ok())
    return Status::Usage(picture.status().message() +
                         "; [mesh] albedo takes a PNG file (convert albedo.jpg albedo.png)");
  if (picture->channels() != 3)
    return Status::Usage(file.string() + ": a picture without colours; [mesh] albedo needs R, G and B");
  if (picture->size() / 3 > kMostTexels)
    return Status::Usage(file.string() + Formatted(": %d x %d texels, at most %zu are allowed; make it smaller",
                                                   picture->width(), picture->height(), kMostTexels));
  return PictureSkin(*picture, bits, scale, albedo, like);
}

PictureSkin::PictureSkin(const Image<uint16_t>& picture, int bit_depth, double scale, const SkinAlbedo& albedo,
                         const SkinParameters& like)
    : colour_of_(picture.width(), picture.height()) {
  // Eight bits a channel, which is what a picture of a face has to say: each colour is solved once.
  const int shift = bit_depth == 16 ? 8 : 0;
  std::vector<uint32_t> codes(colour_of_.size());
  for (size_t i = 0; i < codes.size(); ++i) {
    const uint16_t* texel = picture.data() + 3 * i;
    codes[i] = static_cast<uint32_t>(texel[0] >> shift) << 16 | static_cast<uint32_t>(texel[1] >> shift) << 8 |
               static_cast<uint32_t>(texel[2] >> shift);
  }
  std::vector<uint32_t> distinct = codes;
  std::sort(distinct.begin(), distinct.end());
  distinct.erase(std::unique(distinct.begin(), distinct.end()), distinct.end());
  for (size_t i = 0; i < codes.size(); ++i)
    colour_of_.pixels()[i] =
        static_cast<uint32_t>(std::lower_bound(distinct.begin(), distinct.end(), codes[i]) - distinct.begin());
  colours_.resize(distinct.size());
  const SkinOfAlbedo solve(albedo, like);
  ParallelFor(static_cast<int64_t>(distinct.size()), 256, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      std::array<double, 3> linear;
      for (int c = 0; c < 3; ++c) linear[c] = scale * LinearFromSrgb((distinct[i] >> (16 - 8 * c) & 255U) / 255.0);
      colours_[i] = solve(linear);
    }
  });
}

const SolvedSkin& PictureSkin::Texel(int64_t column, int64_t row) const {
  const int64_t width = colour_of_.width(), height = colour_of_.height();
  return colours_[colour_of_(static_cast<int>((column % width + width) % width),
                             static_cast<int>((row % height + height) % height))];
}

const SolvedSkin& PictureSkin::TexelAt(const Eigen::Vector2d& uv) const {
  return Texel(static_cast<int64_t>(std::floor(uv.x() * colour_of_.width())),
               static_cast<int64_t>(std::floor((1.0 - uv.y()) * colour_of_.height())));
}

SkinParameters PictureSkin::At(const Eigen::Vector2d& uv) const {
  // Texel centres lie at half-integers.
  const double x = uv.x() * colour_of_.width() - 0.5, y = (1.0 - uv.y()) * colour_of_.height() - 0.5;
  const auto column = static_cast<int64_t>(std::floor(x)), row = static_cast<int64_t>(std::floor(y));
  const auto fx = static_cast<float>(x - static_cast<double>(column)),
             fy = static_cast<float>(y - static_cast<double>(row));
  SkinParameters skin = Texel(column, row).skin;
  skin.melanin = skin.blood = 0.0F;
  for (int k = 0; k < 4; ++k) {
    const SkinParameters& texel = Texel(column + k % 2, row + k / 2).skin;
    const float weight = (k % 2 == 0 ? 1 - fx : fx) * (k / 2 == 0 ? 1 - fy : fy);
    skin.melanin += weight * texel.melanin;
    skin.blood += weight * texel.blood;
  }
  return skin;
}

}  // namespace stratalux::rig
