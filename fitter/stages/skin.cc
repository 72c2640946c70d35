// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/skin.h"

#include <cmath>

#include "fitter/export/exr_file.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

const std::vector<std::string> kSkinChannels = {"probability", "skin", "reason"};

nlohmann::ordered_json JsonOf(const SkinTrait& trait) { return {{"centre", trait.centre}, {"scale", trait.scale}}; }

SkinTrait TraitOf(const nlohmann::json& json) {
  return {json.at("centre").get<double>(), json.at("scale").get<double>()};
}

}  // namespace

std::vector<uint8_t> ApartProfiles(const SkinMask& mask, int width, int height, int pool, int channels) {
  std::vector<uint8_t> apart;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      int skin = 0;
      for (int j = y * pool; j < (y + 1) * pool; ++j)
        for (int i = x * pool; i < (x + 1) * pool; ++i) skin += mask.skin(i, j);
      apart.insert(apart.end(), static_cast<size_t>(channels), 2 * skin < pool * pool ? 1 : 0);
    }
  return apart;
}

Status SetApart(SrdSet& srds, const SkinMask& mask) {
  if (mask.skin.width() / srds.pool != srds.width || mask.skin.height() / srds.pool != srds.height)
    return Status::Usage("skin: the mask is not of the SRDs' size");
  const auto profiles = ApartProfiles(mask, srds.width, srds.height, srds.pool, srds.channels);
  bool any_shares = false;
  for (auto* batches : {&srds.batches, &srds.row_batches})
    for (SrdBatch& batch : *batches) {
      batch.apart = profiles;
      for (int64_t i = 0; i < batch.profiles() && !any_shares; ++i) any_shares = batch.Shares(i);
    }
  if (any_shares) return Status::Ok();
  for (auto* batches : {&srds.batches, &srds.row_batches})
    for (SrdBatch& batch : *batches) batch.apart.clear();
  return Status::Ok();
}

Result<SkinMask> JudgeFaceSkin(const FaceShape& shape, std::span<const SeparationMap> separation,
                               const RigCalibration& rig, double exposure_ms) {
  if (separation.empty()) return AllSkin(shape.surface.mask);
  SLX_ASSIGN_OR_RETURN(const auto light, MeasureSkinLight(separation, shape.lit, shape.surface, rig, exposure_ms));
  return JudgeSkin(light);
}

std::string Describe(const SkinMask& mask) {
  const auto surface = static_cast<long long>(mask.surface_quads()), skin = static_cast<long long>(mask.skin_quads);
  if (!mask.told)
    return Formatted("no separated light tells skin from hair and eyes: all %lld quads of the surface count as skin",
                     surface);
  return Formatted("%lld of %lld quads of the surface are skin; %lld are hair, eyes or something else and are left out",
                   skin, surface, surface - skin);
}

Status SaveSkin(const std::filesystem::path& folder, const SkinMask& mask) {
  Image<float> map(mask.skin.width(), mask.skin.height(), 3);
  for (int j = 0; j < map.height(); ++j)
    for (int i = 0; i < map.width(); ++i) {
      map(i, j, 0) = mask.probability(i, j);
      map(i, j, 1) = mask.skin(i, j);
      map(i, j, 2) = mask.reason(i, j);
    }
  SLX_RETURN_IF_ERROR(WriteExr(folder / "skin.exr", map, kSkinChannels));
  nlohmann::ordered_json counts;
  for (int r = 0; r < kSkinReasons; ++r) counts[ToString(static_cast<SkinReason>(r))] = mask.counts[r];
  return WriteJson(folder / "skin.json", {{"told", mask.told},
                                          {"surface", mask.surface_quads()},
                                          {"skin", mask.skin_quads},
                                          {"quads_by_reason", counts},
                                          {"colour", mask.colour},
                                          {"log_reflectance", JsonOf(mask.log_reflectance)},
                                          {"share", JsonOf(mask.share)}});
}

Result<SkinMask> LoadSkin(const std::filesystem::path& folder) {
  SkinMask mask;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "skin.json", [&](const nlohmann::json& json) {
    json.at("told").get_to(mask.told);
    json.at("skin").get_to(mask.skin_quads);
    for (int r = 0; r < kSkinReasons; ++r)
      json.at("quads_by_reason").at(ToString(static_cast<SkinReason>(r))).get_to(mask.counts[r]);
    json.at("colour").get_to(mask.colour);
    mask.log_reflectance = TraitOf(json.at("log_reflectance"));
    mask.share = TraitOf(json.at("share"));
  }));
  SLX_ASSIGN_OR_RETURN(const auto map, ReadExr(folder / "skin.exr", kSkinChannels));
  mask.probability = Image<float>(map.width(), map.height());
  mask.skin = mask.reason = Image<uint8_t>(map.width(), map.height());
  for (int j = 0; j < map.height(); ++j)
    for (int i = 0; i < map.width(); ++i) {
      const float reason = map(i, j, 2);
      if (!(reason >= 0.0F) || reason >= static_cast<float>(kSkinReasons))
        return Status::Integrity((folder / "skin.exr").string() + ": not a reason that the skin stage knows");
      mask.probability(i, j) = map(i, j, 0);
      mask.skin(i, j) = map(i, j, 1) != 0.0F ? 1 : 0;
      mask.reason(i, j) = static_cast<uint8_t>(reason);
    }
  return mask;
}

}  // namespace stratalux::fit
