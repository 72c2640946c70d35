// SPDX-License-Identifier: Apache-2.0
#include "fitter/profiles/profile_model.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include <nlohmann/json.hpp>

#include "fitter/mixture/shift_law.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kLeastShift = 0.02;  // below, a depth cannot be told (as in FitMixture)

// A profile as EM's samples. Every source counts alike, however finely it is sampled: photons per unit of radiance are
// in proportion to the step.
SrdBatch BatchOf(const LineProfile& profile, double shift) {
  SrdBatch b;
  b.samples = profile.samples;
  b.wrapped = false;
  b.sample_box = 1.0F;
  b.y.assign(profile.samples, 0.0F);
  b.variance.assign(profile.samples, 1.0F);
  const double counts = 1e4 * profile.step_mm / profile.slit_mm;
  for (size_t k = 0; k < profile.radiance.size(); ++k) {
    b.y[k] = static_cast<float>(profile.radiance[k]);
    b.variance[k] = static_cast<float>((std::max(profile.radiance[k], 0.0) + shift) / counts);
  }
  b.first_u_mm = {static_cast<float>(profile.first_u_mm)};
  b.step_mm = {static_cast<float>(profile.step_mm)};
  b.line_width_mm = {static_cast<float>(profile.slit_mm)};
  b.blur_mm = {0.0F};
  // EM's s is T(in) - T(out) for u of the line seen from the pixel; here u is the observed position seen from the line
  // and both angles turn towards +u: s = T(incidence) + T(exit).
  b.slope_in = {static_cast<float>(std::tan(profile.incidence_deg * kDegree))};
  b.slope_out = {static_cast<float>(-std::tan(profile.exit_deg * kDegree))};
  b.slope_in_across = {0.0F};
  b.slope_out_across = {0.0F};
  b.cos_in = {static_cast<float>(std::cos(profile.incidence_deg * kDegree))};
  b.cos_out = {static_cast<float>(std::cos(profile.exit_deg * kDegree))};
  b.valid = {1};
  return b;
}

// Pedestal of the shifted Poisson: as much as keeps the most negative sample from being clipped.
double PedestalOf(const std::vector<LineProfile>& profiles) {
  double lowest = 0.0;
  for (const LineProfile& p : profiles)
    for (double y : p.radiance) lowest = std::min(lowest, y);
  return -1.5 * lowest;
}

double Nrmse(const std::vector<double>& data, const std::vector<double>& model) {
  double error = 0.0, power = 0.0;
  for (size_t k = 0; k < data.size(); ++k) {
    error += (model[k] - data[k]) * (model[k] - data[k]);
    power += data[k] * data[k];
  }
  return power > 0.0 ? std::sqrt(error / power) : 0.0;
}

struct Fitted {
  LayerSet layers;
  double background = 0.0, divergence = 0.0;
  int iterations = 0;
  bool depth_estimable = true;
};

Result<Fitted> FitBatches(const std::vector<SrdBatch>& batches, const EmOptions& options) {
  std::vector<const SrdBatch*> lights;
  std::vector<int> numbers;
  for (const SrdBatch& b : batches) {
    numbers.push_back(static_cast<int>(lights.size()));
    lights.push_back(&b);
  }
  SLX_ASSIGN_OR_RETURN(const auto map, FitMixture(lights, numbers, 1, 1, 1, options));
  if (!map.Fitted(0))
    return Status::Usage(std::string("the profiles cannot be fitted: ") +
                         ToString(static_cast<FitReason>(map.reason[0])));
  Fitted fitted{LayersOf(map, 0), map.background[0], map.divergence[0], map.iterations[0],
                static_cast<FitReason>(map.reason[0]) != FitReason::kDepthNotEstimable};
  // Rising width reads best, and layers that lost their light say nothing.
  std::vector<size_t> order(fitted.layers.weight.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return fitted.layers.sigma_mm[a] < fitted.layers.sigma_mm[b]; });
  LayerSet sorted;
  for (size_t l : order) {
    sorted.weight.push_back(fitted.layers.weight[l]);
    sorted.depth_mm.push_back(fitted.layers.depth_mm[l]);
    sorted.sigma_mm.push_back(fitted.layers.sigma_mm[l]);
  }
  fitted.layers = std::move(sorted);
  return fitted;
}

// The epidermis' optical depth: the divergence of the tied fit is smooth in tau, so a coarse scan and a golden section
// find its least. 0 where the incidences do not tell.
Result<double> FindTau(const std::vector<LineProfile>& profiles, const std::vector<SrdBatch>& batches,
                       EmOptions options) {
  double low_cos = 1.0, high_cos = 0.0;
  for (const LineProfile& p : profiles) {
    const double c = std::cos(p.incidence_deg * kDegree);
    low_cos = std::min(low_cos, c);
    high_cos = std::max(high_cos, c);
  }
  if (high_cos - low_cos < 0.02) return 0.0;
  options.max_iterations = std::min(options.max_iterations, 60);
  Status failed;
  auto divergence = [&](double tau) {
    options.tau = tau;
    const auto fitted = FitBatches(batches, options);
    if (!fitted.ok()) failed = fitted.status();
    return fitted.ok() ? fitted->divergence : 0.0;
  };
  constexpr double kStep = 0.25, kMost = 2.0;
  double best = 0.0, least = divergence(0.0);
  for (double tau = kStep; tau <= kMost && failed.ok(); tau += kStep)
    if (const double d = divergence(tau); d < least) {
      least = d;
      best = tau;
    }
  SLX_RETURN_IF_ERROR(failed);
  constexpr double kGolden = 0.6180339887498949;
  double a = std::max(0.0, best - kStep), b = best + kStep;
  double x1 = b - kGolden * (b - a), x2 = a + kGolden * (b - a), f1 = divergence(x1), f2 = divergence(x2);
  while (b - a > 0.01) {
    if (f1 < f2) {
      b = x2;
      x2 = x1;
      f2 = f1;
      f1 = divergence(x1 = b - kGolden * (b - a));
    } else {
      a = x1;
      x1 = x2;
      f1 = f2;
      f2 = divergence(x2 = a + kGolden * (b - a));
    }
  }
  SLX_RETURN_IF_ERROR(failed);
  return 0.5 * (a + b);
}

Json LayersToJson(const LayerSet& layers) {
  Json list = Json::array();
  for (size_t l = 0; l < layers.weight.size(); ++l)
    list.push_back({{"depth_mm", layers.depth_mm[l]}, {"sigma_mm", layers.sigma_mm[l]}, {"weight", layers.weight[l]}});
  return list;
}

// Free layers: the displacement along u, and the depth that it means where the geometry shifts at all.
Json LayersToJson(const LayerSet& layers, double s) {
  Json list = Json::array();
  for (size_t l = 0; l < layers.weight.size(); ++l) {
    const double mean = layers.depth_mm[l];
    list.push_back({{"mean_mm", mean},
                    {"depth_mm", std::abs(s) < kLeastShift ? Json() : Json(mean / s)},
                    {"sigma_mm", layers.sigma_mm[l]},
                    {"weight", layers.weight[l]}});
  }
  return list;
}

LayerSet LayersFrom(const Json& list, const char* displacement) {
  LayerSet layers;
  for (const Json& layer : list) {
    layers.depth_mm.push_back(layer.at(displacement).get<double>());
    layers.sigma_mm.push_back(layer.at("sigma_mm").get<double>());
    layers.weight.push_back(layer.at("weight").get<double>());
    if (!(layers.sigma_mm.back() > 0.0) || !std::isfinite(layers.weight.back()) ||
        !std::isfinite(layers.depth_mm.back()))
      throw nlohmann::json::other_error::create(501, "a layer needs finite numbers and sigma_mm > 0", &layer);
  }
  return layers;
}

EmOptions OptionsOf(const ProfileModel& model) {
  EmOptions options = ProfileOptions();
  options.mode = model.mode;
  options.shift_law = model.shift_law;
  options.eta = model.eta;
  options.gain_model = model.gain_model;
  options.tau = model.tau;
  return options;
}

}  // namespace

EmOptions ProfileOptions() {
  EmOptions options;
  options.surface_term = false;
  options.shared_background = true;
  options.max_cell_mm = 0.08;
  options.min_sigma_mm = 0.03;
  options.max_iterations = 200;
  options.tolerance = 1e-6;
  return options;
}

Result<ProfileModel> FitProfiles(const std::vector<LineProfile>& profiles, const EmOptions& em) {
  SLX_RETURN_IF_ERROR(em.Validate());
  if (profiles.empty()) return Status::Usage("no profiles to fit");
  for (const LineProfile& p : profiles) {
    double sum = 0.0;
    for (double y : p.radiance) sum += y;
    if (!(sum > 0.0)) return Status::Usage("source '" + p.source + "' carries no light: its radiances sum to <= 0");
  }
  const double pedestal = PedestalOf(profiles);
  std::vector<SrdBatch> batches;
  for (const LineProfile& p : profiles) batches.push_back(BatchOf(p, pedestal));

  EmOptions options = em;
  ProfileModel model;
  model.mode = options.mode;
  model.shift_law = options.shift_law;
  model.eta = options.eta;
  model.gain_model = options.gain_model;
  for (const LineProfile& p : profiles)
    model.sources.push_back({p.source, p.incidence_deg, p.exit_deg, p.slit_mm, {}, 0.0, 0.0, 0, 0.0});
  if (options.mode == FitMode::kTied) {
    if (options.gain_model) {
      SLX_ASSIGN_OR_RETURN(options.tau, FindTau(profiles, batches, options));
    }
    SLX_ASSIGN_OR_RETURN(auto fitted, FitBatches(batches, options));
    model.tau = options.tau;
    model.layers = std::move(fitted.layers);
    model.background = fitted.background;
    model.divergence = fitted.divergence;
    model.iterations = fitted.iterations;
    model.depth_estimable = fitted.depth_estimable;
  } else {
    for (size_t i = 0; i < batches.size(); ++i) {
      SLX_ASSIGN_OR_RETURN(auto fitted, FitBatches({batches[i]}, options));
      SourceFit& s = model.sources[i];
      s.layers = std::move(fitted.layers);
      s.background = fitted.background;
      s.divergence = fitted.divergence;
      s.iterations = fitted.iterations;
      model.divergence += fitted.divergence / static_cast<double>(batches.size());
      model.iterations = std::max(model.iterations, fitted.iterations);
    }
  }
  for (size_t i = 0; i < profiles.size(); ++i) {
    SLX_ASSIGN_OR_RETURN(const auto predicted, PredictProfile(model, profiles[i]));
    model.sources[i].nrmse = Nrmse(profiles[i].radiance, predicted);
  }
  return model;
}

Result<std::vector<double>> PredictProfile(const ProfileModel& model, const LineProfile& profile) {
  const LayerSet* layers = &model.layers;
  double background = model.background;
  if (model.mode == FitMode::kFree) {
    const auto source = std::find_if(model.sources.begin(), model.sources.end(),
                                     [&](const SourceFit& s) { return s.source == profile.source; });
    if (source == model.sources.end())
      return Status::Usage("source '" + profile.source +
                           "': this free model has no layers for it (a tied model predicts any source)");
    layers = &source->layers;
    background = source->background;
  }
  auto y = PredictSamples(*layers, BatchOf(profile, 0.0), 0, OptionsOf(model));
  for (double& v : y) v += background;
  return y;
}

std::string ProfileModel::ToJson() const {
  const bool tied = mode == FitMode::kTied;
  Json json = {{"schema", 1}, {"mode", tied ? "tied" : "free"},        {"shift_law", fit::ToString(shift_law)},
               {"eta", eta},  {"gain", gain_model ? "model" : "none"}, {"tau", tau}};
  if (tied) {
    json["layers"] = LayersToJson(layers);
    json["background"] = background;
    json["depth_estimable"] = depth_estimable;
  }
  json["divergence"] = divergence;
  json["iterations"] = iterations;
  Json& list = json[tied ? "training" : "sources"] = Json::array();
  for (const SourceFit& s : sources) {
    Json entry = {{"source", s.source},
                  {"incidence_deg", s.incidence_deg},
                  {"exit_deg", s.exit_deg},
                  {"slit_mm", s.slit_mm},
                  {"nrmse", s.nrmse}};
    if (!tied) {
      const double shift = TangentialShift(shift_law, std::tan(s.incidence_deg * kDegree), 0.0, eta) +
                           TangentialShift(shift_law, std::tan(s.exit_deg * kDegree), 0.0, eta);
      entry["layers"] = LayersToJson(s.layers, shift);
      entry["background"] = s.background;
      entry["divergence"] = s.divergence;
      entry["iterations"] = s.iterations;
    }
    list.push_back(std::move(entry));
  }
  return json.dump(1) + "\n";
}

Result<ProfileModel> ProfileModel::FromJson(const std::string& text, const std::string& origin) {
  try {
    const Json json = Json::parse(text);
    if (const int schema = json.at("schema").get<int>(); schema > 1)
      return Status(StatusCode::kNewerSchema,
                    origin + ": schema " + std::to_string(schema) + ", this program reads up to 1");
    ProfileModel model;
    const std::string mode = json.at("mode"), gain = json.at("gain");
    if (mode != "tied" && mode != "free")
      return Status::Usage(origin + ": mode '" + mode + "' is neither tied nor free");
    if (gain != "model" && gain != "none")
      return Status::Usage(origin + ": gain '" + gain + "' is neither model nor none");
    model.mode = mode == "tied" ? FitMode::kTied : FitMode::kFree;
    model.gain_model = gain == "model";
    SLX_ASSIGN_OR_RETURN(model.shift_law, ParseShiftLaw(json.at("shift_law")));
    model.eta = json.at("eta");
    model.tau = json.at("tau");
    if (!(model.eta >= 1.0 && model.eta <= 3.0))
      return Status::Usage(origin + ": eta = " + std::to_string(model.eta) + ", allowed: 1 .. 3");
    if (model.mode == FitMode::kTied) {
      model.layers = LayersFrom(json.at("layers"), "depth_mm");
      model.background = json.at("background");
      return model;
    }
    for (const Json& entry : json.at("sources")) {
      SourceFit s;
      s.source = entry.at("source");
      s.layers = LayersFrom(entry.at("layers"), "mean_mm");
      s.background = entry.at("background");
      model.sources.push_back(std::move(s));
    }
    return model;
  } catch (const nlohmann::json::exception& error) {
    return Status::Usage(origin + ": not a profile model: " + error.what());
  }
}

}  // namespace stratalux::fit
