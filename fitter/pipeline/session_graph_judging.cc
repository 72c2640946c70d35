// SPDX-License-Identifier: Apache-2.0
// SessionGraph's stages that judge fits: predictions of held-out light by fits and baselines, and their comparison.
#include <algorithm>
#include <numeric>

#include <nlohmann/json.hpp>

#include "fitter/evaluation/compare.h"
#include "fitter/pipeline/session_graph.h"
#include "fitter/scattering/baselines.h"
#include "fitter/stages/layers.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using SortedJson = nlohmann::json;

bool IsBaseline(const std::string& model) { return model == "homogeneous" || model == "dipole"; }

}  // namespace

Status SessionGraph::KeepPrediction(const std::string& predict, const fs::path& folder, Prediction prediction) {
  SLX_RETURN_IF_ERROR(SavePrediction(folder, prediction));
  predictions_[predict] = std::move(prediction);
  return Status::Ok();
}

Result<Prediction> SessionGraph::TakePrediction(const std::string& predict) {
  auto kept = predictions_.extract(predict);
  if (kept) return std::move(kept.mapped());
  return stages_.Load(predict, LoadPrediction);
}

Result<std::vector<uint8_t>> SessionGraph::Apart(const std::string& skin, const FittedLayers& layers) {
  SLX_ASSIGN_OR_RETURN(const SkinMask* mask, Mask(skin));
  return ApartProfiles(*mask, layers.map.width, layers.map.height, layers.pool, layers.map.channels);
}

Result<MixtureMap> SessionGraph::DipoleBaseline(const MixtureMap& fit, const SrdKeys& keys, int heldout) {
  SLX_ASSIGN_OR_RETURN(const SrdSet* srds, Srds(keys, FitKind::kJudged, heldout));
  SLX_ASSIGN_OR_RETURN(const auto lights, TrainingLightsOf(*srds, heldout));
  std::vector<Dipole> dipoles(static_cast<size_t>(fit.channels));
  ParallelEach(dipoles.size(), [&](size_t c) {
    const int colour = static_cast<int>(c);
    dipoles[c] = FitDipole(lights.batches, colour, fit.channels, fit.scattering.eta,
                           MeanSurfaceReflectance(fit, colour, lights.batches.front()->apart));
  });
  srds_.Drop();
  return DipoleMap(fit, dipoles);
}

std::string SessionGraph::Predict(const std::string& model, GeometrySource source, int heldout) {
  if (model == "homogeneous_local_albedo") return PredictLocalAlbedo(source, heldout);
  const std::string fit = FitOf(model, source, heldout), shape = PlacedShape(source, heldout, KindOf(model)),
                    judged = PlacedShape(source, heldout);
  const SrdKeys from = SrdsOf(source, heldout);
  SortedJson options = {
      {"projector", heldout}, {"lights", HeldOutLights(plan_)}, {"plan", SortedJson::parse(PlanOptionsToJson(plan_))}};
  std::map<std::string, std::string> inputs = {{"fit", fit}, {"shape", shape}};
  std::vector<std::string> upstream = {fit, shape};
  const std::string skin = Skin();
  if (IsBaseline(model)) options["baseline"] = model;
  if (model == "homogeneous") {
    inputs["skin"] = skin;
    upstream.push_back(skin);
  }
  if (model == "dipole") {
    inputs.merge(from.Inputs());
    for (const std::string& key : from.Upstream()) upstream.push_back(key);
  }
  const db::ArtifactIdentity identity = {"predict", kPredictVersion, options.dump(), inputs, isa_};
  return Add({identity, LabelOf("predict, " + model, source, heldout), upstream,
              [=, this, key = stages_.KeyOf(identity)](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(const FittedLayers* fitted, Layers(fit));
                std::optional<MixtureMap> baseline;
                if (model == "homogeneous") {
                  SLX_ASSIGN_OR_RETURN(const auto apart, Apart(skin, *fitted));
                  baseline = Homogeneous(fitted->map, apart);
                }
                if (model == "dipole") {
                  SLX_ASSIGN_OR_RETURN(baseline, DipoleBaseline(fitted->map, from, heldout));
                }
                SLX_ASSIGN_OR_RETURN(const HeldOutView* view, View(shape, heldout));
                Prediction prediction = fit::Predict(baseline ? *baseline : fitted->map, fitted->pool, *view);
                if (shape != judged)
                  for (size_t k = 0; k < view->lights.size(); ++k)
                    prediction.own_irradiance[view->lights[k]] = view->irradiance[k];
                return KeepPrediction(key, folder, std::move(prediction));
              }});
}

// Its layers are the homogeneous ones but for each pixel's total weight, in which light is linear: nothing is rendered.
std::string SessionGraph::PredictLocalAlbedo(GeometrySource source, int heldout) {
  const std::string fit = Fit(source, heldout, FitKind::kJudged), predicted = Predict("homogeneous", source, heldout),
                    skin = Skin(), shape = PlacedShape(source, heldout);
  const db::ArtifactIdentity identity = {"predict",
                                         kPredictVersion,
                                         SortedJson({{"baseline", "homogeneous_local_albedo"}}).dump(),
                                         {{"fit", fit}, {"predict", predicted}, {"skin", skin}},
                                         isa_};
  return Add({identity,
              LabelOf("predict, homogeneous_local_albedo", source, heldout),
              {fit, predicted, skin, shape},
              [=, this, key = stages_.KeyOf(identity)](const fs::path& folder) -> Status {
                SLX_ASSIGN_OR_RETURN(auto prediction, TakePrediction(predicted));
                predictions_[predicted] = prediction;
                SLX_ASSIGN_OR_RETURN(const FittedLayers* fitted, Layers(fit));
                SLX_ASSIGN_OR_RETURN(const auto apart, Apart(skin, *fitted));
                const std::vector<double> of = TotalWeights(Homogeneous(fitted->map, apart)),
                                          to = TotalWeights(HomogeneousLocalAlbedo(fitted->map, apart));
                SLX_ASSIGN_OR_RETURN(const HeldOutView* view, View(shape, heldout));
                const auto on_view = ProfilesOnView(*view, fitted->pool, fitted->map.channels);
                return KeepPrediction(
                    key, folder, ScaledPrediction(std::move(prediction), fitted->map, of, to, fitted->pool, on_view));
              }});
}

std::string SessionGraph::Compare(const std::vector<std::string>& models, GeometrySource source, int heldout) {
  const std::string shape = PlacedShape(source, heldout), separate = SeparateAll(), skin = Skin();
  std::vector<std::string> predictions, fits;
  for (const std::string& model : models)
    if (!stages_.Has(Predict(model, source, heldout))) fits.push_back(FitOf(model, source, heldout));
  std::map<std::string, std::string> inputs = {
      {"frames", all_frames_hash_}, {"shape", shape}, {"separate", separate}, {"skin", skin}};
  if (has_truth()) inputs["truth"] = truth_hash_;
  for (const std::string& model : models) {
    predictions.push_back(Predict(model, source, heldout));
    inputs["predict:" + model] = predictions.back();
  }
  // What stays in memory is used up before it makes room: SRDs by the fits, the judged one last, then by the prediction
  // that reads them, too; the judged layers by their predictions; what all are lit by by all predictions.
  const std::string judged = FitOf(models.front(), source, heldout);
  std::stable_partition(fits.begin(), fits.end(), [&](const std::string& fit) { return fit != judged; });
  std::vector<size_t> order(models.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::ranges::stable_sort(order, {}, [&](size_t m) {
    return models[m] == "dipole" ? 0 : FitOf(models[m], source, heldout) == judged ? 1 : 2;
  });
  std::vector<std::string> upstream = {shape, separate, skin};
  upstream.insert(upstream.end(), fits.begin(), fits.end());
  for (const size_t m : order) upstream.push_back(predictions[m]);
  return Add({{"compare", kCompareVersion,
               SortedJson({{"models", models},
                           {"projector", heldout},
                           {"geometry", fit::ToString(source)},
                           {"pool", options_.srd.pool},
                           {"lights", HeldOutLights(plan_)}})
                   .dump(),
               inputs, ""},
              LabelOf("compare", source, heldout),
              upstream,
              [=, this](const fs::path& folder) -> Status {
                layers_.Drop();
                SLX_ASSIGN_OR_RETURN(const HeldOutView* view, View(shape, heldout));
                SLX_ASSIGN_OR_RETURN(const auto* maps, Separation(separate));
                SLX_ASSIGN_OR_RETURN(const SessionFrames* frames, AllFrames(view->shape.record));
                SLX_ASSIGN_OR_RETURN(const auto truth, SceneTruth::Open(frames->folder()));
                SLX_ASSIGN_OR_RETURN(const SkinMask* mask, Mask(skin));
                std::vector<ComparedModel> compared;
                for (size_t m = 0; m < models.size(); ++m) {
                  SLX_ASSIGN_OR_RETURN(auto taken, TakePrediction(predictions[m]));
                  compared.push_back({models[m], std::move(taken)});
                }
                const CompareInput input{
                    *frames, *view, (*maps)[heldout], truth, *mask, options_.srd.pool, fit::ToString(source)};
                SLX_ASSIGN_OR_RETURN(auto comparison, CompareHeldOut(input, compared));
                // The separated light lies on the judged surface: to a model on another one it is no yardstick.
                std::erase_if(comparison.figures, [](const HeldOutFigure& figure) {
                  return figure.model == ToString(FitKind::kDirectionBlindPlaced) && figure.direct == "separated";
                });
                predictions_.clear();
                view_.Drop();
                return SaveComparison(folder, comparison);
              }});
}

}  // namespace stratalux::fit
