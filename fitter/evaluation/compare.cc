// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/compare.h"

#include <algorithm>
#include <cmath>
#include <span>

#include "fitter/evaluation/direct_light.h"
#include "fitter/evaluation/heldout_takes.h"
#include "fitter/evaluation/metrics_json.h"
#include "fitter/export/exr_file.h"
#include "fitter/render/surface_light.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/parallel.h"
#include "shared/image/finite_at.h"

namespace stratalux::fit {
namespace {

template <typename Operation>
Image<float> Combine(const Image<float>& a, const Image<float>& b, Operation operation) {
  Image<float> result = a;
  for (size_t i = 0; i < result.size(); ++i) result.pixels()[i] = operation(a.pixels()[i], b.pixels()[i]);
  return result;
}
Image<float> Sum(const Image<float>& a, const Image<float>& b) { return Combine(a, b, std::plus<>()); }
Image<float> Difference(const Image<float>& a, const Image<float>& b) { return Combine(a, b, std::minus<>()); }

// Quads that every model has fitted, in all colours.
Image<uint8_t> FittedByAll(const std::vector<ComparedModel>& models, int width, int height) {
  Image<uint8_t> fitted(width, height, 1, 1);
  for (const ComparedModel& model : models)
    for (const auto& [light, prediction] : model.predictions)
      for (int j = 0; j < height; ++j)
        for (int i = 0; i < width; ++i)
          if (!FiniteAt(prediction.surface, i, j)) fitted(i, j) = 0;
  return fitted;
}

// What is skin, and what of it the light truly reaches: by the truth of a simulation, else by the mask of the skin
// stage, and nothing is known of the light. A scene without any skin (a sphere of wax) is judged wherever the light
// reaches it.
struct JudgedSkin {
  Image<uint8_t> skin, lit;  // on quads; lit is empty where there is no truth
  [[nodiscard]] bool is_true() const { return !lit.empty(); }
};

Result<JudgedSkin> ReadSkin(const CompareInput& in) {
  JudgedSkin truth;
  if (!in.truth) return JudgedSkin{in.skin.skin, {}};
  SLX_ASSIGN_OR_RETURN(truth.skin, in.truth->Skin());
  SLX_ASSIGN_OR_RETURN(truth.lit, in.truth->LitBy(in.view.projector));
  if (truth.skin.empty() || truth.lit.empty()) return JudgedSkin{in.skin.skin, {}};  // of an older simulation
  const auto skin = truth.skin.pixels();
  if (std::none_of(skin.begin(), skin.end(), [](uint8_t s) { return s != 0; })) std::fill(skin.begin(), skin.end(), 1);
  return truth;
}

struct Masks {
  Image<uint8_t> judged, left_out;
};

// Judged: fitted skin that the light reaches. Left out: what was predicted and, as far as is known, is lit, and is not
// judged.
Masks MakeMasks(const CompareInput& in, const Image<uint8_t>& fitted, const JudgedSkin& judged_skin,
                Coverage& coverage) {
  const Image<uint8_t>& lit = in.view.shape.lit[in.view.projector];
  Masks masks{Image<uint8_t>(lit.width(), lit.height()), Image<uint8_t>(lit.width(), lit.height())};
  for (int j = 0; j < lit.height(); ++j)
    for (int i = 0; i < lit.width(); ++i) {
      const bool surface = in.view.shape.surface.mask(i, j) != 0, reached = lit(i, j) != 0, has_fit = fitted(i, j) != 0;
      const bool skin = judged_skin.skin(i, j) != 0;
      const bool shines = !judged_skin.is_true() || judged_skin.lit(i, j) != 0;
      const bool judged = surface && reached && has_fit && skin && shines;
      masks.judged(i, j) = judged ? 1 : 0;
      masks.left_out(i, j) = surface && has_fit && shines && !judged ? 1 : 0;
      coverage.judged += judged ? 1 : 0;
      coverage.not_skin += surface && reached && has_fit && !skin ? 1 : 0;
      coverage.in_shadow += surface && reached && has_fit && skin && !shines ? 1 : 0;
      if (!(skin && shines)) continue;
      coverage.lit_skin += judged_skin.is_true() ? 1 : 0;
      coverage.no_surface += judged_skin.is_true() && !surface ? 1 : 0;
      coverage.unlit += surface && !reached ? 1 : 0;
      coverage.not_fitted += surface && reached && !has_fit ? 1 : 0;
    }
  return masks;
}

// The light as it was captured: the mean of its takes, half their difference, the camera's own noise of that mean.
struct Target {
  Image<float> light, noise, variance;
  int takes = 1;
};

Result<Target> ReadTarget(const CompareInput& in, const std::string& light) {
  const CameraCalibration& camera = in.frames.calibration()->camera;
  SLX_ASSIGN_OR_RETURN(
      const auto raw, in.frames.Read(in.view.projector, HeldOutPhase(light), HeldOutPattern(light, *in.frames.plan())));
  Target target;
  target.variance = QuadVariance(raw, camera);
  auto taken = ReadHeldOutTarget(in.frames, in.view.projector, light);
  if (taken.ok()) {
    target.light = std::move(taken->target);
    target.noise = std::move(taken->noise);
    target.takes = taken->takes;
    for (float& v : target.variance.pixels()) v /= static_cast<float>(target.takes);
    return target;
  }
  if (taken.status().code() != StatusCode::kNotFound) return taken.status();
  SLX_ASSIGN_OR_RETURN(const auto dark, in.frames.MeanBlack(in.view.projector));
  target.light = QuadSignal(raw, dark, camera);
  return target;
}

// NoiseFloor of the takes' difference: its square is as large as the noise's variance, in expectation.
double NoiseOfTakes(const Target& target, const Image<uint8_t>& mask) {
  if (target.noise.empty()) return NoiseFloor(target.light, target.variance, mask);
  return NoiseFloor(target.light, Combine(target.noise, target.noise, std::multiplies<>()), mask);
}

// Every so many-th judged pixel, by colours.
std::vector<std::vector<ErrorSample>> SampleErrors(const CompareInput& in, const Target& target,
                                                   const Image<float>& prediction, const Masks& masks,
                                                   int64_t judged_pixels) {
  const HeldOutView& view = in.view;
  const ErrorCauseMaps causes(view.shape.surface, view.rig.projectors[view.projector].CentreInCamera(), prediction);
  const int64_t stride = ErrorSampleStride(judged_pixels);
  std::vector<std::vector<ErrorSample>> samples(prediction.channels());
  int64_t pixel = 0;
  for (int j = 0; j < prediction.height(); ++j)
    for (int i = 0; i < prediction.width(); ++i) {
      if (masks.judged(i, j) == 0 || pixel++ % stride != 0) continue;
      for (int c = 0; c < prediction.channels(); ++c) {
        const float residual = target.light(i, j, c) - prediction(i, j, c), variance = target.variance(i, j, c);
        if (!std::isfinite(residual) || !std::isfinite(variance)) continue;
        const float noise = target.noise.empty() ? std::sqrt(variance) : target.noise(i, j, c);
        samples[c].push_back({causes.At(i, j, c), residual, residual * residual - noise * noise, variance});
      }
    }
  return samples;
}

// The images of a figure.
struct Judged {
  size_t figure = 0;
  Image<float> real, estimate;
};

}  // namespace

Result<Comparison> CompareHeldOut(const CompareInput& in, const std::vector<ComparedModel>& models) {
  const HeldOutView& view = in.view;
  const SurfaceMap& surface = view.shape.surface;
  Comparison comparison;
  SLX_ASSIGN_OR_RETURN(const auto skin, ReadSkin(in));
  const Image<uint8_t> fitted = FittedByAll(models, surface.width(), surface.height());
  const Masks masks = MakeMasks(in, fitted, skin, comparison.coverage);
  comparison.coverage.skin_by = skin.is_true() ? "truth" : in.skin.told ? "mask" : "none";
  comparison.coverage.projector = in.view.projector;
  comparison.coverage.geometry = in.geometry;
  comparison.errors = {in.view.projector, view.lights, in.separation.direct.channels(), {}};
  const Image<float> direct_reflectance =
      DirectReflectance({view.rig, view.projector, view.exposure_ms, view.separation_period}, surface, in.separation);
  for (size_t k = 0; k < view.lights.size(); ++k) {
    const std::string& light = view.lights[k];
    SLX_ASSIGN_OR_RETURN(const Target target, ReadTarget(in, light));
    const Image<float> direct = ReflectedLight(direct_reflectance, view.irradiance[k]);
    std::optional<Image<float>> true_subsurface;
    if (in.truth) {
      SLX_ASSIGN_OR_RETURN(true_subsurface, in.truth->Subsurface(light, in.view.projector));
    }
    const double noise = NoiseOfTakes(target, masks.judged),
                 camera_noise = NoiseFloor(target.light, target.variance, masks.judged);
    LightComparison picture{light, target.light, {}, {}, {}, {}};
    std::vector<Judged> judged;
    for (const ComparedModel& model : models) {
      const Prediction& p = model.predictions.at(light);
      auto add = [&](const char* part, const char* with, const Image<float>& real, Image<float> estimate,
                     bool captured) {
        judged.push_back({comparison.figures.size(), real, std::move(estimate)});
        comparison.figures.push_back({in.view.projector,
                                      light,
                                      model.name,
                                      part,
                                      with,
                                      in.geometry,
                                      in.pool,
                                      target.takes,
                                      {},
                                      captured ? noise : 0.0,
                                      captured ? camera_noise : 0.0});
      };
      const Image<float> remaining = Difference(direct, p.direct_part), total = Sum(p.subsurface, remaining);
      add("total", "separated", target.light, total, true);
      add("total", "predicted", target.light, Sum(p.subsurface, p.surface), true);
      if (true_subsurface)
        add("subsurface", "truth", *true_subsurface, p.subsurface, false);
      else
        add("subsurface", "separated", Difference(target.light, remaining), p.subsurface, true);
      if (model.name == "homogeneous") picture.total_homogeneous = total;
      if (&model != &models[0]) continue;
      picture.direct = remaining;
      picture.subsurface = p.subsurface;
      picture.total = total;
      for (auto& colour : SampleErrors(in, target, Sum(p.subsurface, p.surface), masks, comparison.coverage.judged))
        comparison.errors.samples.push_back(std::move(colour));
      comparison.coverage.left_out_nrmse[light] = CompareImages(target.light, total, masks.left_out).nrmse;
    }
    ParallelFor(static_cast<int64_t>(judged.size()), 1, [&](int64_t begin, int64_t end) {
      for (const Judged& one : std::span(judged).subspan(begin, end - begin))
        comparison.figures[one.figure].error = CompareImages(one.real, one.estimate, masks.judged);
    });
    comparison.pictures.push_back(std::move(picture));
  }
  return comparison;
}

namespace {

using PictureFile = std::pair<const char*, Image<float> LightComparison::*>;
constexpr PictureFile kPictures[] = {{"_measured.exr", &LightComparison::measured},
                                     {"_direct.exr", &LightComparison::direct},
                                     {"_subsurface.exr", &LightComparison::subsurface},
                                     {"_total.exr", &LightComparison::total},
                                     {"_total_homogeneous.exr", &LightComparison::total_homogeneous}};

}  // namespace

Status SaveComparison(const std::filesystem::path& folder, const Comparison& comparison) {
  nlohmann::ordered_json json = {{"figures", comparison.figures}, {"coverage", comparison.coverage}};
  json["lights"] = nlohmann::ordered_json::array();
  SLX_RETURN_IF_ERROR(SaveErrors(folder, comparison.errors));
  for (const LightComparison& picture : comparison.pictures) {
    json["lights"].push_back(picture.light);
    json["channels"] = picture.measured.channels();
    for (const auto& [name, member] : kPictures)
      if (!(picture.*member).empty())
        SLX_RETURN_IF_ERROR(
            WriteExr(folder / (picture.light + name), picture.*member, Colours(picture.measured.channels())));
  }
  return WriteJson(folder / "compare.json", json);
}

Result<Comparison> LoadComparison(const std::filesystem::path& folder) {
  Comparison comparison;
  int channels = 1;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "compare.json", [&](const nlohmann::json& json) {
    json.at("figures").get_to(comparison.figures);
    json.at("coverage").get_to(comparison.coverage);
    if (json.contains("channels")) json.at("channels").get_to(channels);
    for (const auto& light : json.at("lights")) comparison.pictures.push_back({light, {}, {}, {}, {}, {}});
  }));
  comparison.errors = {comparison.coverage.projector, {}, channels, {}};
  for (const LightComparison& picture : comparison.pictures) comparison.errors.lights.push_back(picture.light);
  SLX_RETURN_IF_ERROR(LoadErrors(folder, comparison.errors));
  for (LightComparison& picture : comparison.pictures)
    for (const auto& [name, member] : kPictures) {
      const std::filesystem::path file = folder / (picture.light + name);
      if (std::error_code error; !std::filesystem::exists(file, error)) continue;
      SLX_ASSIGN_OR_RETURN(picture.*member, ReadExr(file, Colours(channels)));
    }
  return comparison;
}

}  // namespace stratalux::fit
