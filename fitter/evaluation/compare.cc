// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/compare.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>

#include "fitter/evaluation/direct_light.h"
#include "fitter/evaluation/heldout_takes.h"
#include "fitter/evaluation/metrics_json.h"
#include "fitter/export/exr_file.h"
#include "fitter/image/pixelwise.h"
#include "fitter/render/surface_light.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/check.h"
#include "shared/base/parallel_each.h"
#include "shared/image/finite_at.h"

namespace stratalux::fit {
namespace {

// Quads that every model has fitted, in all colours: the same under any light.
Image<uint8_t> FittedByAll(const std::vector<ComparedModel>& models, const std::string& light, int width, int height) {
  Image<uint8_t> fitted(width, height, 1, 1);
  for (const ComparedModel& model : models) {
    const Image<float>& any = model.prediction.subsurface.at(light);
    for (int j = 0; j < height; ++j)
      for (int i = 0; i < width; ++i)
        if (!FiniteAt(any, i, j)) fitted(i, j) = 0;
  }
  return fitted;
}

// Direct light of the view's quads, as a reflectance; none where no pattern told any.
std::optional<Image<float>> DirectOf(const CompareInput& in) {
  const HeldOutView& view = in.view;
  const auto direct_of = [&view](const SeparationMap& separation) {
    return DirectReflectance(SinusoidsOf(view), view.shape.surface, view.shape.lit[view.projector], separation);
  };
  Image<float> direct = view.home.empty() ? direct_of(in.separation) : direct_of(OnView(view, in.separation));
  const auto values = direct.pixels();
  if (std::none_of(values.begin(), values.end(), [](float v) { return std::isfinite(v); })) return std::nullopt;
  return direct;
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
  const auto by_mask = [&] { return JudgedSkin{OnView(in.view, in.skin.skin), {}}; };
  if (!in.truth) return by_mask();
  SLX_ASSIGN_OR_RETURN(truth.skin, in.truth->Skin());
  SLX_ASSIGN_OR_RETURN(truth.lit, in.truth->LitBy(in.view.projector));
  if (truth.skin.empty() || truth.lit.empty()) return by_mask();  // of an older simulation
  truth.skin = OnView(in.view, truth.skin);
  truth.lit = OnView(in.view, truth.lit);
  const auto skin = truth.skin.pixels();
  if (std::none_of(skin.begin(), skin.end(), [](uint8_t s) { return s != 0; })) std::fill(skin.begin(), skin.end(), 1);
  return truth;
}

struct Masks {
  Image<uint8_t> judged, left_out;
};

// Judged: fitted skin that the light reaches and whose direct light was told. Left out: what was predicted and, as far
// as is known, is lit, and is not judged.
Masks MakeMasks(const CompareInput& in, const Image<uint8_t>& fitted, const std::optional<Image<float>>& direct,
                const JudgedSkin& judged_skin, Coverage& coverage) {
  const Image<uint8_t>& lit = in.view.shape.lit[in.view.projector];
  Masks masks{Image<uint8_t>(lit.width(), lit.height()), Image<uint8_t>(lit.width(), lit.height())};
  for (int j = 0; j < lit.height(); ++j)
    for (int i = 0; i < lit.width(); ++i) {
      const bool surface = in.view.shape.surface.mask(i, j) != 0, reached = lit(i, j) != 0, has_fit = fitted(i, j) != 0;
      const bool skin = judged_skin.skin(i, j) != 0;
      const bool shines = !judged_skin.is_true() || judged_skin.lit(i, j) != 0;
      const bool could_be = surface && reached && has_fit && skin && shines;
      const bool judged = could_be && (!direct || FiniteAt(*direct, i, j));
      masks.judged(i, j) = judged ? 1 : 0;
      masks.left_out(i, j) = surface && has_fit && shines && !judged ? 1 : 0;
      coverage.judged += judged ? 1 : 0;
      coverage.not_separated += could_be && !judged ? 1 : 0;
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

// The light as it was captured, as if at the nominal exposure: the mean of its takes, half their difference, the
// camera's own noise of that mean.
struct Target {
  Image<float> light, noise, variance;
  int takes = 1;
};

Result<Target> ReadTarget(const CompareInput& in, const std::string& light) {
  const CameraCalibration& camera = in.frames.calibration()->camera;
  const Pattern pattern = HeldOutPattern(light, *in.frames.plan());
  const db::FrameRow* row = in.frames.Find(in.view.projector, HeldOutPhase(light), pattern);
  if (row == nullptr) {
    const auto takes = HeldOutTakesOf(in.frames, in.view.projector, light);
    if (takes.empty()) return in.frames.Require(in.view.projector, HeldOutPhase(light), pattern).status();
    row = takes.front();
  }
  SLX_ASSIGN_OR_RETURN(const auto raw, in.frames.ReadLinear(*row));
  Target target;
  target.variance = QuadVariance(raw, camera);
  const auto factor = static_cast<float>(HeldOutFactor(light, *in.frames.plan()));
  for (float& v : target.variance.pixels()) v /= factor * factor;
  auto taken = ReadHeldOutTarget(in.frames, in.view.projector, light);
  if (taken.ok()) {
    target.light = std::move(taken->target);
    target.noise = std::move(taken->noise);
    target.takes = taken->takes;
    for (float& v : target.variance.pixels()) v /= static_cast<float>(target.takes);
    return target;
  }
  if (taken.status().code() != StatusCode::kNotFound) return taken.status();
  SLX_ASSIGN_OR_RETURN(const auto dark, HeldOutBlack(in.frames, in.view.projector, light));
  target.light = QuadSignal(raw, dark, camera);
  for (float& y : target.light.pixels()) y /= factor;
  return target;
}

// NoiseFloor of the takes' difference: its square is as large as the noise's variance, in expectation.
double NoiseOfTakes(const Target& target, const Image<float>& reference, const Image<uint8_t>& mask) {
  if (target.noise.empty()) return NoiseFloor(reference, target.variance, mask);
  return NoiseFloor(reference, Combine(target.noise, target.noise, std::multiplies<>()), mask);
}

// The target's noise as a share of `reference`, which an error is taken of: by its takes, and by the camera's model.
struct NoiseShare {
  double takes = 0.0, camera = 0.0;
};
NoiseShare NoiseOf(const Target& target, const Image<float>& reference, const Image<uint8_t>& mask) {
  return {NoiseOfTakes(target, reference, mask), NoiseFloor(reference, target.variance, mask)};
}

// Every so many-th judged pixel, by colours. `white`: as predicted.
std::vector<std::vector<ErrorSample>> SampleErrors(const CompareInput& in, const Target& target,
                                                   const Image<float>& prediction, const Image<float>& white,
                                                   const Masks& masks, int64_t judged_pixels) {
  const HeldOutView& view = in.view;
  const ErrorCauseMaps causes(view.shape.surface, view.rig.projectors[view.projector].CentreInCamera(), prediction,
                              white);
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

// A light, as it was captured and as what is known of it beside the models.
struct JudgedLight {
  std::string name;
  Target target;
  const Image<float>* irradiance = nullptr;     // of the view
  std::optional<Image<float>> direct;           // separated, under the pattern
  std::optional<Image<float>> true_subsurface;  // where there is truth
  NoiseShare noise;

  // Less the model's own share of it. Only where there is any.
  [[nodiscard]] Image<float> Remaining(const Prediction& p) const {
    return Difference(*direct, p.DirectLight(name, *irradiance));
  }
  [[nodiscard]] Image<float> Predicted(const Prediction& p) const { return p.AllLight(name, *irradiance); }
};

Result<JudgedLight> ReadLight(const CompareInput& in, size_t light,
                              const std::optional<Image<float>>& direct_reflectance, const Image<uint8_t>& mask) {
  JudgedLight judged;
  judged.name = in.view.lights[light];
  SLX_ASSIGN_OR_RETURN(judged.target, ReadTarget(in, judged.name));
  judged.irradiance = &in.view.irradiance[light];
  if (direct_reflectance) judged.direct = ReflectedLight(*direct_reflectance, *judged.irradiance);
  judged.noise = NoiseOf(judged.target, judged.target.light, mask);
  if (in.truth && in.view.home.empty()) {  // it is that of the head where it was at first
    SLX_ASSIGN_OR_RETURN(judged.true_subsurface, in.truth->Subsurface(judged.name, in.view.projector));
  }
  return judged;
}

// A model's figures: of all of the light, by the separated surface and by its own, and of what came from below.
std::vector<HeldOutFigure> FiguresOf(const CompareInput& in, const ComparedModel& model, const JudgedLight& light,
                                     const Image<uint8_t>& mask) {
  const Prediction& p = model.prediction;
  const Image<float>&subsurface = p.subsurface.at(light.name), &captured = light.target.light;
  std::vector<HeldOutFigure> figures;
  const auto add = [&](const char* part, const char* with, const Image<float>& real, const Image<float>& estimate,
                       const NoiseShare& noise) {
    figures.push_back({in.view.projector, light.name, model.name, part, with, in.geometry, in.pool, light.target.takes,
                       CompareImages(real, estimate, mask), noise.takes, noise.camera});
  };
  add("total", "predicted", captured, light.Predicted(p), light.noise);
  if (light.true_subsurface) add("subsurface", "truth", *light.true_subsurface, subsurface, {});
  if (!light.direct) return figures;
  const Image<float> remaining = light.Remaining(p);
  add("total", "separated", captured, Sum(subsurface, remaining), light.noise);
  if (!light.true_subsurface) {
    const Image<float> below = Difference(captured, remaining);
    add("subsurface", "separated", below, subsurface, NoiseOf(light.target, below, mask));
  }
  return figures;
}

// What the report shows, of the first model and of homogeneous layers.
LightComparison PicturesOf(const JudgedLight& light, const std::vector<ComparedModel>& models) {
  const Prediction& first = models.front().prediction;
  const auto surface_of = [&](const Prediction& p) {
    return light.direct ? light.Remaining(p) : p.SurfaceLight(light.name, *light.irradiance);
  };
  LightComparison pictures{light.name, light.target.light, surface_of(first), first.subsurface.at(light.name), {}, {}};
  pictures.total = Sum(pictures.subsurface, pictures.direct);
  for (const ComparedModel& model : models)
    if (model.name == "homogeneous")
      pictures.total_homogeneous = Sum(model.prediction.subsurface.at(light.name), surface_of(model.prediction));
  return pictures;
}

}  // namespace

Result<Comparison> CompareHeldOut(const CompareInput& in, const std::vector<ComparedModel>& models) {
  const HeldOutView& view = in.view;
  const SurfaceMap& surface = view.shape.surface;
  Comparison comparison;
  SLX_ASSIGN_OR_RETURN(const auto skin, ReadSkin(in));
  const Image<uint8_t> fitted = FittedByAll(models, view.lights.front(), surface.width(), surface.height());
  const std::optional<Image<float>> direct = DirectOf(in);
  const Masks masks = MakeMasks(in, fitted, direct, skin, comparison.coverage);
  comparison.coverage.skin_by = skin.is_true() ? "truth" : in.skin.told ? "mask" : "none";
  comparison.coverage.projector = in.view.projector;
  comparison.coverage.geometry = in.geometry;
  comparison.errors = {in.view.projector, view.lights, in.separation.direct.channels(), {}};
  const size_t lights = view.lights.size();
  std::vector<JudgedLight> judged(lights);  // frames and truth are thread-bound
  for (size_t k = 0; k < lights; ++k) {
    SLX_ASSIGN_OR_RETURN(judged[k], ReadLight(in, k, direct, masks.judged));
  }
  std::vector<std::vector<HeldOutFigure>> figures(lights * models.size());
  ParallelEach(figures.size(), [&](size_t i) {
    figures[i] = FiguresOf(in, models[i % models.size()], judged[i / models.size()], masks.judged);
  });
  for (const auto& of_model : figures)
    comparison.figures.insert(comparison.figures.end(), of_model.begin(), of_model.end());
  comparison.pictures.resize(lights);
  std::vector<std::vector<std::vector<ErrorSample>>> samples(lights);
  std::vector<double> left_out(lights);
  const Prediction& first = models.front().prediction;
  const auto white = std::ranges::find(judged, "white", &JudgedLight::name);  // among the lights of every plan
  SLX_CHECK(white != judged.end());
  const Image<float> of_white = white->Predicted(first);
  ParallelEach(lights, [&](size_t k) {
    const JudgedLight& light = judged[k];
    samples[k] = SampleErrors(in, light.target, light.Predicted(first), of_white, masks, comparison.coverage.judged);
    comparison.pictures[k] = PicturesOf(light, models);
    left_out[k] = CompareImages(light.target.light, comparison.pictures[k].total, masks.left_out).nrmse;
  });
  for (size_t k = 0; k < lights; ++k) {
    for (auto& colour : samples[k]) comparison.errors.samples.push_back(std::move(colour));
    comparison.coverage.left_out_nrmse[view.lights[k]] = left_out[k];
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
  }
  SLX_RETURN_IF_ERROR(ParallelTry(comparison.pictures.size() * std::size(kPictures), [&](size_t k) {
    const LightComparison& picture = comparison.pictures[k / std::size(kPictures)];
    const auto& [name, member] = kPictures[k % std::size(kPictures)];
    return (picture.*member).empty()
               ? Status::Ok()
               : WriteExr(folder / (picture.light + name), picture.*member, Colours(picture.measured.channels()));
  }));
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
  SLX_RETURN_IF_ERROR(ParallelTry(comparison.pictures.size() * std::size(kPictures), [&](size_t k) -> Status {
    LightComparison& picture = comparison.pictures[k / std::size(kPictures)];
    const auto& [name, member] = kPictures[k % std::size(kPictures)];
    const std::filesystem::path file = folder / (picture.light + name);
    if (std::error_code error; !std::filesystem::exists(file, error)) return Status::Ok();
    SLX_ASSIGN_OR_RETURN(picture.*member, ReadExr(file, Colours(channels)));
    return Status::Ok();
  }));
  return comparison;
}

}  // namespace stratalux::fit
