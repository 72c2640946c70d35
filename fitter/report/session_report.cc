// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/session_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "fitter/export/pictures.h"
#include "fitter/mixture/fit_mixture.h"
#include "fitter/report/html_report.h"
#include "fitter/report/layer_pictures.h"
#include "fitter/report/page_text.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/colours.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/formatted.h"
#include "shared/image/png.h"

namespace stratalux::fit {
namespace {

Image<float> Channel(const Image<float>& map, int channel) {
  Image<float> out(map.width(), map.height());
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) out(x, y) = map(x, y, channel);
  return out;
}

Result<Image<float>> Captured(const ReportInput& in, int projector, CapturePhase phase, const Pattern& pattern) {
  SLX_ASSIGN_OR_RETURN(const auto raw, in.frames.Read(projector, phase, pattern));
  const CameraCalibration& camera = in.frames.calibration()->camera;
  const Image<float> dark(raw.width(), raw.height(), 1, static_cast<float>(camera.black_level_dn));
  return QuadSignal(raw, dark, camera);
}

Result<ReportSection> CapturedSamples(const ReportInput& in, double white) {
  const PlanOptions& o = *in.frames.plan();
  ReportSection section{"Captured samples (figure 4)",
                        "The face under all-white light, a column code, a sinusoid and one comb frame.",
                        {},
                        {},
                        {}};
  for (int p = 0; p < o.projectors; ++p) {
    SLX_ASSIGN_OR_RETURN(const auto image, Captured(in, p, CapturePhase::kReference, {.kind = PatternKind::kWhite}));
    section.images.push_back({"projector " + std::to_string(p) + ", white", ToSrgb(image, white)});
  }
  const int bits = GrayBits(o.projector_width);
  const std::vector<std::pair<CapturePhase, Pattern>> samples = {
      {CapturePhase::kCorrespondence, {.kind = PatternKind::kGray, .bit = std::min(5, bits - 1), .bits = bits}},
      {CapturePhase::kSeparation,
       {.kind = PatternKind::kSinusoid, .period = o.separation_period, .shift = 0, .shifts = o.separation_shifts}},
      {CapturePhase::kSweep, {.kind = PatternKind::kComb, .period = o.comb_period, .width = o.comb_width, .shift = 0}}};
  for (const auto& [phase, pattern] : samples) {
    SLX_ASSIGN_OR_RETURN(const auto image, Captured(in, in.heldout, phase, pattern));
    section.images.push_back({"projector " + std::to_string(in.heldout) + ", " + pattern.ToString(),
                              ToSrgb(image, phase == CapturePhase::kSweep ? 0.35 * white : white)});
  }
  return section;
}

ReportSection Shape(const ReportInput& in) {
  const Image<float> depth = Channel(in.shape.surface.point_mm, 2);
  ReportSection section{
      "Shape",
      "Depth from all projectors together; normals of the surface, of photometric stereo, and both fused.",
      {},
      {},
      {}};
  const double low = Percentile(depth, 0.01), high = Percentile(depth, 0.99);
  Image<float> nearness = depth;  // near is light
  for (float& v : nearness.pixels()) v = -v;
  section.images.push_back({"depth, " + Fixed(low, 0) + " mm (light) to " + Fixed(high, 0) + " mm (dark)",
                            ToColourScale(nearness, -high, -low)});
  const Image<float>& disagreement = in.shape.disagreement_mm;
  if (const double most = Percentile(disagreement, 0.99); most > 0.0)
    section.images.push_back({"disagreement of the projectors' own depths: median " +
                                  Fixed(Percentile(disagreement, 0.5), 3) + " mm, 0 (dark) to " + Fixed(most, 2) +
                                  " mm (light)",
                              ToColourScale(disagreement, 0.0, most)});
  section.images.push_back({"normals of the surface", NormalColours(in.shape.surface.normal)});
  section.images.push_back({"normals, photometric", NormalColours(in.normals.photometric.normal)});
  section.images.push_back({"normals, fused", NormalColours(in.normals.fused)});
  return section;
}

// Where the surface was placed.
ReportTable PlacementTable(const Metrics& m) {
  ReportTable table{
      "At which depth below the skin its codes are seen, by the sweeps; the surface is placed above them by as much as "
      "that displaces it. Bias of depth against the truth of a simulation, and RMS about it",
      {"by the sweeps of", "layers", "code depth mm", "its error mm", "pixels", "bias mm", "RMS mm"},
      {}};
  const auto add = [&](const std::string& what, std::vector<std::string> row, const auto& truth) {
    row.insert(row.begin(), what);
    row.push_back(truth ? Fixed(truth->depth_bias_mm) : "");
    row.push_back(truth ? Fixed(truth->depth_rms_mm) : "");
    table.rows.push_back(std::move(row));
  };
  add("none: by the codes alone", {"", "", "", ""}, m.unplaced);
  for (const OffsetFigure& o : m.offsets)
    add(o.heldout ? "all but projector " + std::to_string(*o.heldout) : "all projectors",
        {o.model, Fixed(o.offset.code_depth_mm), Fixed(o.offset.sigma_mm), std::to_string(o.offset.pixels)}, o.truth);
  return table;
}

ReportSection DirectAndGlobal(const ReportInput& in, double white) {
  ReportSection section{"Direct and global light",
                        "Separated with high-frequency sinusoids, per projector; both on the same scale.",
                        {},
                        {},
                        {}};
  for (size_t p = 0; p < in.separation.size(); ++p) {
    section.images.push_back({"direct, projector " + std::to_string(p), ToSrgb(in.separation[p].direct, 0.6 * white)});
    section.images.push_back({"global, projector " + std::to_string(p), ToSrgb(in.separation[p].global, 0.6 * white)});
  }
  return section;
}

// What of the picture is left out, in the scale's colours of certainty on a grey face.
Image<uint8_t> SkinPicture(const Image<uint8_t>& face, const SkinMask& mask) {
  Image<uint8_t> picture(face.width(), face.height(), 3);
  constexpr std::array<int, 3> kLeftOut = {30, 120, 220};
  for (int y = 0; y < face.height(); ++y)
    for (int x = 0; x < face.width(); ++x) {
      const bool surface = mask.reason(x, y) != static_cast<uint8_t>(SkinReason::kNoSurface);
      for (int c = 0; c < 3; ++c) {
        const int light = face(x, y, std::min(c, face.channels() - 1));
        const int shown = !surface ? light / 4 : mask.skin(x, y) != 0 ? light : (light + 2 * kLeftOut[c]) / 3;
        picture(x, y, c) = static_cast<uint8_t>(shown);
      }
    }
  return picture;
}

ReportSection Skin(const ReportInput& in, const Image<float>& lit, double white, const SkinFigure& figure) {
  ReportSection section{"Skin",
                        "Skin is what most of the face is, by the light that goes through it (global) and its share of "
                        "all light, of all projectors together. " +
                            Describe(in.skin) + ".",
                        {},
                        {},
                        {}};
  section.images.push_back({"skin; in blue " + std::to_string(in.skin.left_out()) + " of " +
                                std::to_string(in.skin.surface_quads()) +
                                " quads of the surface, which are left out; dark: no surface",
                            SkinPicture(ToSrgb(lit, white), in.skin)});
  section.images.push_back({"how likely each quad is skin", ToColourScale(in.skin.probability, 0.0, 1.0), "0", "1"});
  if (figure.truth)
    section.tables.push_back(
        {"Against the simulated truth, quads of the surface; stubble counts as skin",
         {"intersection over union", "skin in both", "in the mask alone", "in the truth alone"},
         {{Fixed(figure.truth->IntersectionOverUnion(), 4), std::to_string(figure.truth->both),
           std::to_string(figure.truth->only_estimate), std::to_string(figure.truth->only_reference)}}});
  return section;
}

// The fitted pixel nearest to the cheek beside the image's centre.
int64_t ChosenProfile(const MixtureMap& map) {
  int64_t best = -1;
  double best_distance = 1e300;
  for (int y = 0; y < map.height; ++y)
    for (int x = 0; x < map.width; ++x) {
      const int64_t i = map.ProfileIndex(x, y, 0);
      if (map.reason[i] != 0) continue;
      const double d = std::hypot(x - 0.43 * map.width, y - 0.53 * map.height);
      if (d < best_distance) {
        best_distance = d;
        best = i;
      }
    }
  return best;
}

ReportSection SrdOfPixel(const ReportInput& in) {
  ReportSection section{"Spatial radiance distribution of a pixel (figure 5)",
                        "Samples of the comb sweep (dots) over the distance between line and pixel, and the fitted "
                        "layers (line), red channel.",
                        {},
                        {},
                        {}};
  const MixtureMap& map = in.layers.map;
  const int64_t profile = in.chosen_profile;
  if (profile < 0) return section;
  const LayerSet layers = LayersOf(map, profile);
  for (int p = 0; p < static_cast<int>(in.chosen_srds.size()); ++p) {
    const SrdBatch& b = in.chosen_srds[p];
    if (b.valid[0] == 0) continue;
    const auto predicted = PredictSamples(layers, b, 0, map.scattering);
    const auto trained = std::find(map.training_projectors.begin(), map.training_projectors.end(), p);
    std::vector<std::array<double, 3>> points;
    const double period = double(b.step_mm[0]) * b.samples;
    const size_t light = static_cast<size_t>(trained - map.training_projectors.begin());
    const bool is_trained = trained != map.training_projectors.end();
    const double floor = is_trained ? map.background[profile * map.training_projectors.size() + light] : 0.0;
    for (int k = 0; k < b.samples; ++k)
      points.push_back(
          {std::remainder(b.first_u_mm[0] + k * double(b.step_mm[0]), period), b.Samples(0)[k], predicted[k] + floor});
    std::sort(points.begin(), points.end());
    ReportSeries measured{"measured", {}, {}, true},
        fitted{trained == map.training_projectors.end() ? "predicted" : "fitted", {}, {}, false};
    for (const auto& point : points) {
      if (std::abs(point[0]) > 12.0) continue;
      measured.x.push_back(point[0]);
      measured.y.push_back(point[1]);
      fitted.x.push_back(point[0]);
      fitted.y.push_back(point[2]);
    }
    section.plots.push_back(
        {"projector " + std::to_string(p) + (trained == map.training_projectors.end() ? " (held out)" : ""),
         "line minus pixel, mm",
         "reflectance per line",
         {measured, fitted}});
  }
  ReportTable table{"Layers of this pixel", {"layer", "depth mm", "sigma mm", "weight"}, {}};
  for (size_t l = 0; l < layers.weight.size(); ++l)
    if (layers.weight[l] > 1e-4)
      table.rows.push_back(
          {std::to_string(l), Fixed(layers.depth_mm[l]), Fixed(layers.sigma_mm[l]), Fixed(layers.weight[l], 4)});
  section.tables.push_back(table);
  return section;
}

ReportSection LightSection(const std::string& title, const LightComparison& c, double white) {
  ReportSection section{title, "The held-out projector: nothing of its sweep entered the fit.", {}, {}, {}};
  section.images.push_back({"(a) subsurface, rendered", ToSrgb(c.subsurface, white)});
  section.images.push_back({"(b) direct, measured", ToSrgb(c.direct, white)});
  section.images.push_back({"(c) sum", ToSrgb(c.total, white)});
  section.images.push_back({"(d) real", ToSrgb(c.measured, white)});
  return section;
}

ReportPlot RowProfile(const ReportInput& in, const LightComparison& c) {
  const int y = static_cast<int>(0.53 * c.measured.height());
  ReportPlot plot{"Red channel along image row " + std::to_string(y) + " (figure 8)", "quad", "digital numbers", {}};
  ReportSeries real{"real", {}, {}, false}, total{"sum", {}, {}, false}, subsurface{"subsurface", {}, {}, false};
  for (int x = 0; x < c.measured.width(); ++x) {
    if (in.shape.surface.mask(x, y) == 0) continue;
    for (auto* s : {&real, &total, &subsurface}) s->x.push_back(x);
    real.y.push_back(c.measured(x, y, 0));
    total.y.push_back(c.total(x, y, 0));
    subsurface.y.push_back(c.subsurface(x, y, 0));
  }
  plot.series = {real, total, subsurface};
  return plot;
}

// One table for each way of judging: a row a model, a column a light and part.
std::vector<ReportTable> HeldOutTables(const Metrics& m) {
  struct Column {
    const char *title, *light, *part, *direct;
  };
  constexpr std::array<Column, 9> kColumns = {{{"stripe, total", "stripe", "total", "separated"},
                                               {"stripe, surface predicted", "stripe", "total", "predicted"},
                                               {"stripe, subsurface", "stripe", "subsurface", nullptr},
                                               {"white, total", "white", "total", "separated"},
                                               {"white, surface predicted", "white", "total", "predicted"},
                                               {"white, subsurface", "white", "subsurface", nullptr},
                                               {"spot, total", "spot", "total", "separated"},
                                               {"spot, surface predicted", "spot", "total", "predicted"},
                                               {"spot, subsurface", "spot", "subsurface", nullptr}}};
  std::vector<ReportTable> tables;
  std::vector<std::pair<int, std::string>> views;
  for (const HeldOutFigure& f : m.heldout)
    if (std::find(views.begin(), views.end(), std::pair(f.projector, f.geometry)) == views.end())
      views.emplace_back(f.projector, f.geometry);
  for (const auto& [projector, geometry] : views) {
    auto find = [&, p = projector, g = geometry](const std::string& model, const Column& c) -> const HeldOutFigure* {
      for (const HeldOutFigure& f : m.heldout)
        if (f.projector == p && f.geometry == g && f.model == model && f.light == c.light && f.part == c.part &&
            (c.direct == nullptr || f.direct == c.direct))
          return &f;
      return nullptr;
    };
    ReportTable table{"Projector " + std::to_string(projector) + " held out, " + geometry +
                          " geometry: NRMSE (total: also without the measured light's own noise, PSNR in dB, SSIM; " +
                          "surface predicted: its light, too, from the training lights; subsurface: and bias)",
                      {"model"},
                      {}};
    std::vector<std::string> models;
    for (const HeldOutFigure& f : m.heldout)
      if (f.projector == projector && f.geometry == geometry &&
          std::find(models.begin(), models.end(), f.model) == models.end())
        models.push_back(f.model);
    std::vector<Column> shown;
    for (const Column& c : kColumns)
      if (std::any_of(models.begin(), models.end(), [&](const auto& model) { return find(model, c) != nullptr; })) {
        shown.push_back(c);
        table.header.push_back(c.title);
      }
    for (const std::string& model : models) {
      std::vector<std::string> row = {model};
      for (const Column& c : shown) {
        const HeldOutFigure* f = find(model, c);
        if (f == nullptr) {
          row.emplace_back("");
        } else if (f->part == "total") {
          row.push_back(Fixed(f->error.nrmse, 4) + " (" + Fixed(f->WithoutNoise(), 4) + ", " +
                        Fixed(f->error.psnr_db, 1) + ", " + Fixed(f->error.ssim, 3) + ")");
        } else {
          row.push_back(Fixed(f->error.nrmse, 4) + " (" + Fixed(f->error.bias, 4) + ")");
        }
      }
      table.rows.push_back(std::move(row));
    }
    tables.push_back(std::move(table));
  }
  return tables;
}

// Which quads the figures speak of.
ReportTable CoverageTable(const Metrics& m) {
  ReportTable table{
      "Coverage, quads: with a truth, of the skin that the light truly reaches; else of the reconstructed "
      "surface, and skin is what the skin stage found. Left out: NRMSE of the fit (total) over what it predicts and is "
      "not judged",
      {"projector", "geometry", "lit skin", "judged", "no surface", "unlit", "not fitted", "not skin", "in shadow",
       "left out"},
      {}};
  for (const Coverage& c : m.coverage) {
    std::string left_out;
    for (const auto& [light, nrmse] : c.left_out_nrmse)
      left_out += (left_out.empty() ? "" : ", ") + light + " " + Fixed(nrmse, 4);
    const double share = 100.0 * static_cast<double>(c.judged) / static_cast<double>(std::max<int64_t>(c.lit_skin, 1));
    table.rows.push_back({std::to_string(c.projector), c.geometry, c.lit_skin > 0 ? std::to_string(c.lit_skin) : "",
                          std::to_string(c.judged) + (c.lit_skin > 0 ? " (" + Fixed(share, 1) + " %)" : ""),
                          std::to_string(c.no_surface), std::to_string(c.unlit), std::to_string(c.not_fitted),
                          std::to_string(c.not_skin), std::to_string(c.in_shadow), left_out});
  }
  return table;
}

// What a prediction of other light may be off by, and whether what some hold-outs say of that holds for another.
std::vector<ReportTable> IntervalTables(const Metrics& m) {
  std::vector<ReportTable> tables;
  if (m.intervals.colours.empty()) return tables;
  ReportTable parts{
      "Error of light that the fit has not seen, by colour: four parts that add up in squares, and how many "
      "of that standard deviation leave 5 % of the pixels outside",
      {"colour", "albedo", "normal, degrees", "placement, quads", "light around", "half a 95 % interval"},
      {}};
  const auto colours = Colours(static_cast<int>(m.intervals.colours.size()));
  for (size_t c = 0; c < colours.size(); ++c) {
    const PredictionError& e = m.intervals.colours[c];
    parts.rows.push_back({colours[c], Fixed(100.0 * e.albedo, 2) + " %",
                          Fixed(e.normal_rad * 180.0 / std::numbers::pi, 2), Fixed(e.placement_quads, 3),
                          Fixed(100.0 * e.spread, 2) + " %", Fixed(e.interval, 2)});
  }
  tables.push_back(std::move(parts));
  if (m.intervals.covered.empty()) return tables;
  ReportTable covered{
      "95 % intervals of a light by what the other hold-outs say: how much of it they hold (widened by the "
      "capture's own noise), and how wide they are, RMS of half of them over RMS of the light",
      {"projector", "light", "within", "half-width", "pixels and colours"},
      {}};
  for (const auto& c : m.intervals.covered)
    covered.rows.push_back({std::to_string(c.projector), c.light, Fixed(100.0 * c.share, 1) + " %",
                            Fixed(100.0 * c.half_width, 1) + " %", std::to_string(c.samples)});
  tables.push_back(std::move(covered));
  return tables;
}

ReportTable SweepTable(const Metrics& m) {
  ReportTable table{
      "Sweeps: profiles by what became of them, and whether the frames of a cycle add up to the white ones",
      {"projector", "axis", "profiles", "cycle over white", "95 % within", "frames missing"},
      {}};
  for (const SweepFigure& s : m.sweeps) {
    std::string profiles;
    for (const auto& [reason, count] : s.profiles_by_reason)
      profiles += (profiles.empty() ? "" : ", ") + reason + " " + std::to_string(count);
    table.rows.push_back(
        {std::to_string(s.projector), s.axis, profiles, s.energy_profiles > 0 ? Fixed(s.energy_median, 4) : "",
         s.energy_profiles > 0 ? Fixed(100.0 * s.energy_p95_error, 1) + " %" : "", std::to_string(s.missing_frames)});
  }
  return table;
}

ReportSection Figures(const Metrics& m) {
  ReportSection section{
      "Figures",
      "NRMSE over skin that the held-out light reaches and every model of a table has fitted. Total: the separated "
      "direct "
      "light, which depends on no model, and each model's light less its own share of that. All figures are in "
      "metrics.json.",
      {},
      {},
      HeldOutTables(m)};
  section.tables.push_back(CoverageTable(m));
  for (ReportTable& table : IntervalTables(m)) section.tables.push_back(std::move(table));
  ReportTable ablations{"Ablations: each must be worse than the fit it spoils, on the same mask",
                        {"model", "projector", "light", "part", "NRMSE"},
                        {}};
  for (const HeldOutFigure& a : m.ablations)
    if (a.direct != "predicted")
      ablations.rows.push_back({a.model, std::to_string(a.projector), a.light, a.part, Fixed(a.error.nrmse, 4)});
  if (!ablations.rows.empty()) section.tables.push_back(ablations);
  ReportTable centroids{"Direction: how far an SRD's centroid moves with its shift coefficient, mm (held-out light)",
                        {"projector", "geometry", "measured", "predicted", "rms of single pixels", "profiles"},
                        {}};
  for (const CentroidFigure& c : m.centroids)
    centroids.rows.push_back({std::to_string(c.projector), c.geometry, Fixed(c.error.measured_mm, 3),
                              Fixed(c.error.predicted_mm, 3), Fixed(c.error.rms_mm, 3),
                              std::to_string(c.error.profiles)});
  if (!centroids.rows.empty()) section.tables.push_back(centroids);
  if (m.truth)
    section.tables.push_back({"Against the simulated truth",
                              {"depth rms mm", "depth bias mm", "normal median deg", "quads"},
                              {{Fixed(m.truth->depth_rms_mm), Fixed(m.truth->depth_bias_mm),
                                Fixed(m.truth->normal_median_deg, 2), std::to_string(m.truth->pixels)}}});
  ReportTable fit{"Fit",
                  {"profiles", "prior, photons", "weaker profiles", "median divergence", "median sweeps", "tau",
                   "surface over Fresnel's", "its roughness", "weight in layers wider than a line"},
                  {}};
  fit.rows.push_back({std::to_string(m.summary.pixels), Fixed(m.summary.prior_photons, 0),
                      std::to_string(m.summary.weak_pixels), Fixed(m.summary.divergence, 6),
                      std::to_string(m.summary.iterations_median), Fixed(m.summary.tau),
                      m.summary.reflection.Known() ? Fixed(m.summary.reflection.strength) : "-",
                      m.summary.reflection.Known() ? Fixed(m.summary.reflection.roughness) : "-",
                      Fixed(m.summary.wide_weight_fraction)});
  section.tables.push_back(fit);
  ReportTable masked{"Profiles without (or with doubtful) layers", {"reason", "profiles"}, {}};
  for (const auto& [reason, count] : m.summary.masked_by_reason) masked.rows.push_back({reason, std::to_string(count)});
  section.tables.push_back(masked);
  section.tables.push_back(SweepTable(m));
  ReportTable stages{"Where the time goes: processor seconds are those of all threads, memory is the peak so far",
                     {"stage", "seconds", "share", "processor seconds", "peak memory GiB"},
                     {}};
  double all = 0.0;
  for (const StageFigure& s : m.stages) all += s.seconds;
  for (const StageFigure& s : m.stages)
    stages.rows.push_back({s.name, Fixed(s.seconds, 1), Fixed(100.0 * s.seconds / std::max(all, 1e-9), 0) + " %",
                           Fixed(s.cpu_seconds, 1), Fixed(static_cast<double>(s.peak_rss_bytes) / (1 << 30), 2)});
  section.tables.push_back(stages);
  return section;
}

// Whether the rig still stands as it was calibrated.
ReportSection CalibrationSection(const RigCalibration& rig, const DriftReport& drift) {
  ReportSection section{
      "Calibration",
      (drift.warning.empty() ? "The projectors' light falls where the calibration says" : "Warning: " + drift.warning) +
          ". Used: " + (rig.source.empty() ? "no source named" : rig.source) +
          (rig.made_wall.ns != 0 ? ", made " + ToIso8601(rig.made_wall) : "") + ".",
      {},
      {},
      {}};
  ReportTable table{"Displacement of each projector's light on the face against the calibration: below 0.5 px is well",
                    {"projector", "columns px", "rows px", "together px", "as if turned by deg", "spread px",
                     "spread expected of the codes px", "points"},
                    {}};
  for (const ProjectorDrift& d : drift.projectors)
    table.rows.push_back({std::to_string(d.projector), Fixed(d.shift_columns), Fixed(d.shift_rows), Fixed(d.shift_px),
                          Fixed(d.turned_deg), Fixed(d.spread_px), Fixed(d.expected_px), std::to_string(d.points)});
  section.tables.push_back(table);
  return section;
}

Status SavePictures(const std::filesystem::path& folder, const ReportPictures& pictures) {
  int number = 0;
  for (const auto& picture : pictures)
    SLX_RETURN_IF_ERROR(WriteText(folder / Formatted("%02d.png", number++), {picture.begin(), picture.end()}));
  return Status::Ok();
}

}  // namespace

int64_t ProfileToShow(const MixtureMap& map) { return ChosenProfile(map); }

Status WriteReport(const std::filesystem::path& folder, const ReportInput& in, const Metrics& metrics,
                   KnownPictures& known) {
  SLX_ASSIGN_OR_RETURN(const auto lit,
                       Captured(in, in.heldout, CapturePhase::kReference, {.kind = PatternKind::kWhite}));
  Image<float> face = lit;
  for (int y = 0; y < face.height(); ++y)
    for (int x = 0; x < face.width(); ++x)
      for (int c = 0; c < face.channels(); ++c)
        if (in.shape.surface.mask(x, y) == 0) face(x, y, c) = std::nanf("");
  const double white = 1.05 * Percentile(face, 0.985);
  const SessionInfo& info = in.frames.info();
  Report report{
      "Stratalux: session " + info.id,
      std::string(info.simulated ? "Simulated visitor, seed " + std::to_string(info.seed) : "Visitor " + info.visitor) +
          ", captured " + ToIso8601(info.started_wall) + ", " + std::to_string(in.frames.rows().size()) + " frames, " +
          ToString(info.status) + ". Layers fitted on all projectors but " + std::to_string(in.heldout) +
          ", by which they are judged; layer maps " + in.shown.provenance + ".",
      {}};
  SLX_ASSIGN_OR_RETURN(auto samples, CapturedSamples(in, white));
  report.sections.push_back(std::move(samples));
  report.sections.push_back(Shape(in));
  if (!metrics.offsets.empty()) report.sections.back().tables.push_back(PlacementTable(metrics));
  report.sections.push_back(CalibrationSection(*in.frames.calibration(), metrics.drift));
  report.sections.push_back(DirectAndGlobal(in, white));
  report.sections.push_back(Skin(in, lit, white, metrics.skin));
  report.sections.push_back(SrdOfPixel(in));
  for (const LightComparison& c : in.comparisons) {
    if (c.light == "stripe") {
      report.sections.push_back(LightSection("Stripe light (figure 7)", c, 0.3 * white));
      report.sections.back().plots.push_back(RowProfile(in, c));
    } else if (c.light == "white") {
      report.sections.push_back(LightSection("Point light at the held-out projector (figure 9)", c, white));
      if (!c.total_homogeneous.empty())
        report.sections.back().images.push_back(
            {"(e) homogeneous: the mean layers everywhere, sum", ToSrgb(c.total_homogeneous, white)});
    }
  }
  report.sections.push_back(LayerPictures(in.shown));
  report.sections.push_back(Figures(metrics));
  SLX_ASSIGN_OR_RETURN(const ReportPictures pictures, EncodePictures(report, known));
  SLX_RETURN_IF_ERROR(WriteText(folder / "report" / "index.html", RenderHtml(report, pictures)));
  return SavePictures(folder / "report", pictures);
}

}  // namespace stratalux::fit
