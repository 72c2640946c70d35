// SPDX-License-Identifier: Apache-2.0
#include "fitter/profiles/profile_model.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <sstream>

#include <nlohmann/json.hpp>

#include "fitter/profiles/profile_em.h"
#include "shared/base/json_number.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr int kSchema = 2;
constexpr double kLeastPeak = 1e-6, kMostRadiance = 1e9;  // what single precision and EM's own zero can bear
constexpr double kLeastShift = 0.02;                      // below, a depth cannot be told (as in FitMixture)

// The angular gain of the exit: by reciprocity that of a lamp at the same angle (BatchOf's cos_in holds the lamp's
// own).
double ExitGain(const LineProfile& profile, const ScatteringModel& model) {
  return AngularGain(model, std::cos(profile.exit_deg * kDegree));
}

// A profile as EM's samples. Every source counts alike, however finely it is sampled: photons per unit of radiance are
// in proportion to the step.
SrdBatch BatchOf(const LineProfile& profile, double shift) {
  SrdBatch b;
  b.samples = profile.samples;
  b.wrapped = false;
  b.sample_box = 1.0F;
  b.y.assign(profile.samples, 0.0F);
  const double counts = 1e4 * profile.step_mm / profile.slit_mm;
  for (size_t k = 0; k < profile.radiance.size(); ++k) b.y[k] = static_cast<float>(profile.radiance[k]);
  b.noise_floor = {static_cast<float>(shift / counts)};
  b.noise_slope = {static_cast<float>(1.0 / counts)};
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

ProfileLight LightOf(const LineProfile& profile, double pedestal, const EmOptions& options) {
  const SrdBatch batch = BatchOf(profile, pedestal);
  ProfileLight light = ProfileLightOf(batch, 0, options);
  ScatteringModel exit = options.scattering;
  exit.tau = 0.0;
  const double fresnel = ExitGain(profile, exit);
  exit.tau = 1.0;
  light.fresnel *= fresnel;
  light.gain_path -= std::log(ExitGain(profile, exit) / fresnel);
  return light;
}

// Rising width reads best, and layers that lost their light say nothing.
LayerSet ByWidth(const LayerSet& layers) {
  std::vector<size_t> order;
  for (size_t l = 0; l < layers.weight.size(); ++l)
    if (layers.weight[l] > 0.0) order.push_back(l);
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return layers.sigma_mm[a] < layers.sigma_mm[b]; });
  LayerSet sorted;
  for (size_t l : order) {
    sorted.weight.push_back(layers.weight[l]);
    sorted.depth_mm.push_back(layers.depth_mm[l]);
    sorted.sigma_mm.push_back(layers.sigma_mm[l]);
  }
  return sorted;
}

ProfileFit Fit(const std::vector<ProfileLight>& lights, const EmOptions& options, SharedParameters shared,
               double shared_prior = kSharedPrior) {
  ProfileFit fit = RunProfileEm(lights, SpreadLayers(lights, options), options, shared, shared_prior);
  fit.layers = ByWidth(fit.layers);
  return fit;
}

// Whether the sources' paths through the skin differ enough for tau or directional weights to mean anything.
bool DirectionsDiffer(const std::vector<ProfileLight>& lights) {
  const auto [least, most] = std::minmax_element(
      lights.begin(), lights.end(),
      [](const ProfileLight& a, const ProfileLight& b) { return a.directions.ExtraPath() < b.directions.ExtraPath(); });
  return most->directions.ExtraPath() - least->directions.ExtraPath() > 0.01;
}

// Samples that count as independent: those under one slit share their photons.
double IndependentSamples(const std::vector<ProfileLight>& lights) {
  double samples = 0.0;
  for (const ProfileLight& light : lights)
    samples += light.samples() / std::max(1.0, light.line.line_width_mm / light.step_mm);
  return samples;
}

ProfileFit FitTied(const std::vector<ProfileLight>& lights, const EmOptions& options, Directional directional) {
  const bool differ = DirectionsDiffer(lights);
  ProfileFit without = Fit(lights, options, differ ? SharedParameters::kTau : SharedParameters::kFixed);
  if (directional == Directional::kOff || (directional == Directional::kAuto && !differ)) return without;
  // A divergence D of N samples is that of N / 2 D photons: in their log likelihood a prior weighs 2 D / N of the
  // light.
  const double samples = IndependentSamples(lights);
  const double prior = std::max(kSharedPrior, 2.0 * without.divergence / samples);
  ProfileFit with = Fit(lights, options, SharedParameters::kTauAndDirectional, prior);
  // Do directional weights earn their three parameters? Twice the gain in log likelihood against the 97.5 % quantile of
  // chi^2 with three degrees of freedom.
  constexpr double kQuantile = 9.35;
  const double gain = samples * (without.divergence - with.divergence);
  return directional == Directional::kOn || gain > kQuantile * with.divergence ? with : without;
}

// Neighbouring samples at exactly the greatest radiance: the camera's ceiling, or a line far wider than its step.
int LongestPlateau(const LineProfile& profile) {
  const double most = *std::max_element(profile.radiance.begin(), profile.radiance.end());
  int run = 0, longest = 0;
  for (double y : profile.radiance) {
    run = y == most ? run + 1 : 0;
    longest = std::max(longest, run);
  }
  return longest;
}

Status CheckSource(const LineProfile& profile) {
  const auto [least, most] = std::minmax_element(profile.radiance.begin(), profile.radiance.end());
  const std::string source = "source '" + profile.source + "' ";
  if (!(std::accumulate(profile.radiance.begin(), profile.radiance.end(), 0.0) > 0.0))
    return Status::Usage(source + "carries no light: its radiances sum to <= 0");
  if (const double largest = std::max(*most, -*least); !(*most >= kLeastPeak && largest <= kMostRadiance)) {
    std::ostringstream message;
    message << source << "has radiances from " << *least << " to " << *most << ", allowed: a peak of " << kLeastPeak
            << " .. " << kMostRadiance << "; scale them so that 1 is a white target";
    return Status::Usage(message.str());
  }
  if (*most - *least <= 1e-9 * *most)
    return Status::Usage(source + "has the same radiance at every u: there is no line in it");
  return Status::Ok();
}

std::vector<std::string> WarningsOf(const std::vector<LineProfile>& profiles, const ProfileModel& model) {
  std::vector<std::string> warnings;
  for (const LineProfile& p : profiles) {
    const std::string source = "source '" + p.source + "': ";
    if (const int plateau = LongestPlateau(p); plateau >= 4)
      warnings.push_back(source + std::to_string(plateau) +
                         " neighbouring samples share its greatest radiance; if they are saturated, expose less");
    const double most = *std::max_element(p.radiance.begin(), p.radiance.end());
    if (std::max(p.radiance.front(), p.radiance.back()) > 0.2 * most)
      warnings.push_back(
          source + "still has " +
          std::to_string(static_cast<int>(100.0 * std::max(p.radiance.front(), p.radiance.back()) / most)) +
          " % of its peak at the end of u; the window is too narrow to tell wide layers from the floor");
    if (p.step_mm > 2.0 * p.slit_mm + 0.5)
      warnings.push_back(source + "is sampled more coarsely than its line; layers narrower than the step are guesses");
  }
  if (!model.depth_estimable)
    warnings.emplace_back(
        "no source shifts the layers (incidence and exit cancel or are 0): their depths mean nothing; add an oblique "
        "one");
  return warnings;
}

Json LayersToJson(const LayerSet& layers) {
  Json list = Json::array();
  for (size_t l = 0; l < layers.weight.size(); ++l)
    list.push_back({{"depth_mm", layers.depth_mm[l]}, {"sigma_mm", layers.sigma_mm[l]}, {"weight", layers.weight[l]}});
  return list;
}

Json EffectiveToJson(const EffectiveParameters& effective, bool depth_estimable) {
  auto one = [](const Estimate& e) { return Json{{"value", e.value}, {"standard_error", e.standard_error}}; };
  return {{"total_weight", one(effective.total_weight)},
          {"mean_depth_mm", depth_estimable ? one(effective.mean_depth_mm) : Json()},
          {"effective_width_mm", one(effective.effective_width_mm)}};
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

}  // namespace

EmOptions ProfileOptions() {
  EmOptions options;
  options.surface_term = false;
  options.background_term = options.shared_background = true;  // an open window sees the lamp's halo, too
  options.scattering.shift_law = ShiftLaw::kRefractedSine;
  options.max_cell_mm = 0.04;
  options.min_sigma_mm = 0.01;
  options.max_iterations = 200;
  options.tolerance = 1e-6;
  return options;
}

Result<ProfileModel> FitProfiles(const std::vector<LineProfile>& profiles, const EmOptions& options,
                                 Directional directional) {
  SLX_RETURN_IF_ERROR(options.Validate());
  if (profiles.empty()) return Status::Usage("no profiles to fit");
  for (const LineProfile& p : profiles) SLX_RETURN_IF_ERROR(CheckSource(p));
  const double pedestal = PedestalOf(profiles);
  std::vector<ProfileLight> lights;
  for (const LineProfile& p : profiles) lights.push_back(LightOf(p, pedestal, options));

  ProfileModel model;
  model.scattering = options.scattering;
  for (const LineProfile& p : profiles)
    model.sources.push_back({p.source, p.incidence_deg, p.exit_deg, p.slit_mm, {}, 0.0, 0.0, 0, 0.0});
  if (options.scattering.mode == FitMode::kTied) {
    const ProfileFit fit = FitTied(lights, options, directional);
    model.scattering.tau = fit.tau;
    model.scattering.directional = fit.directional;
    model.layers = fit.layers;
    model.background = fit.background[0];
    model.divergence = fit.divergence;
    model.iterations = fit.iterations;
    model.depth_estimable = std::any_of(lights.begin(), lights.end(),
                                        [](const ProfileLight& light) { return std::abs(light.s) >= kLeastShift; });
    model.effective = EffectiveParametersOf(fit, lights, NoiseScale::kFromResiduals);
  } else {
    for (size_t i = 0; i < lights.size(); ++i) {
      const ProfileFit fit = Fit({lights[i]}, options, SharedParameters::kFixed);
      SourceFit& s = model.sources[i];
      s.layers = fit.layers;
      s.background = fit.background[0];
      s.divergence = fit.divergence;
      s.iterations = fit.iterations;
      model.divergence += fit.divergence / static_cast<double>(lights.size());
      model.iterations = std::max(model.iterations, fit.iterations);
    }
  }
  for (size_t i = 0; i < profiles.size(); ++i) {
    SLX_ASSIGN_OR_RETURN(const auto predicted, PredictProfile(model, profiles[i]));
    model.sources[i].nrmse = Nrmse(profiles[i].radiance, predicted);
  }
  model.warnings = WarningsOf(profiles, model);
  return model;
}

Result<std::vector<double>> PredictProfile(const ProfileModel& model, const LineProfile& profile) {
  const LayerSet* layers = &model.layers;
  double background = model.background;
  if (model.scattering.mode == FitMode::kFree) {
    const auto source = std::find_if(model.sources.begin(), model.sources.end(),
                                     [&](const SourceFit& s) { return s.source == profile.source; });
    if (source == model.sources.end())
      return Status::Usage("source '" + profile.source +
                           "': this free model has no layers for it (a tied model predicts any source)");
    layers = &source->layers;
    background = source->background;
  }
  const double exit_gain = ExitGain(profile, model.scattering);
  auto y = PredictSamples(*layers, BatchOf(profile, 0.0), 0, model.scattering);
  for (double& v : y) v = exit_gain * v + background;
  return y;
}

std::string ProfileModel::ToJson() const {
  const auto& [mode, shift_law, eta, gain_model, tau, directional, reflection] = scattering;
  const bool tied = mode == FitMode::kTied;
  Json json = {{"schema", kSchema}, {"mode", tied ? "tied" : "free"},        {"shift_law", fit::ToString(shift_law)},
               {"eta", eta},        {"gain", gain_model ? "model" : "none"}, {"tau", tau}};
  if (tied) {
    json["directional"] = {{"kappa_per_mm", directional.kappa_per_mm},
                           {"phase_slope", directional.phase_slope},
                           {"sigma_0_mm", directional.sigma_0_mm}};
    json["layers"] = LayersToJson(layers);
    if (effective) json["effective"] = EffectiveToJson(*effective, depth_estimable);
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
    if (const auto schema = WholeAt<int64_t>(json, "schema"); schema > kSchema)
      return Status(StatusCode::kNewerSchema,
                    origin + ": schema " + std::to_string(schema) + ", this program reads " + std::to_string(kSchema));
    else if (schema < kSchema)
      return Status::Usage(origin + ": schema " + std::to_string(schema) +
                           " has no gain for the exit; fit the profiles again");
    ProfileModel model;
    ScatteringModel& light = model.scattering;
    const std::string mode = json.at("mode"), gain = json.at("gain");
    if (mode != "tied" && mode != "free")
      return Status::Usage(origin + ": mode '" + mode + "' is neither tied nor free");
    if (gain != "model" && gain != "none")
      return Status::Usage(origin + ": gain '" + gain + "' is neither model nor none");
    light.mode = mode == "tied" ? FitMode::kTied : FitMode::kFree;
    light.gain_model = gain == "model";
    SLX_ASSIGN_OR_RETURN(light.shift_law, ParseShiftLaw(json.at("shift_law")));
    light.eta = json.at("eta");
    light.tau = json.at("tau");
    if (!(light.eta >= 1.0 && light.eta <= 3.0))
      return Status::Usage(origin + ": eta = " + std::to_string(light.eta) + ", allowed: 1 .. 3");
    if (light.mode == FitMode::kTied) {
      const Json& d = json.at("directional");
      light.directional = {d.at("kappa_per_mm"), d.at("phase_slope"), d.at("sigma_0_mm")};
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
