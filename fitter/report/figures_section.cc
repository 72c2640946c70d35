// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/figures_section.h"

#include <algorithm>
#include <numbers>

#include "fitter/report/page_text.h"
#include "fitter/stages/colours.h"

namespace stratalux::fit {
namespace {

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
                          "surface predicted: the surface's light, too, is predicted from the training lights; "
                          "subsurface: also bias)",
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
      "Coverage, quads. With a truth: of the skin that the light truly reaches; without: of the reconstructed "
      "surface, where skin is what the skin stage found. Left out: NRMSE of the fit (total) over quads that it "
      "predicts but that are not judged",
      {"projector", "geometry", "lit skin", "judged", "no surface", "unlit", "not fitted", "not skin", "in shadow",
       "not separated", "left out"},
      {}};
  for (const Coverage& c : m.coverage) {
    std::string left_out;
    for (const auto& [light, nrmse] : c.left_out_nrmse)
      left_out += (left_out.empty() ? "" : ", ") + light + " " + Fixed(nrmse, 4);
    const double share = 100.0 * static_cast<double>(c.judged) / static_cast<double>(std::max<int64_t>(c.lit_skin, 1));
    table.rows.push_back({std::to_string(c.projector), c.geometry, c.lit_skin > 0 ? std::to_string(c.lit_skin) : "",
                          std::to_string(c.judged) + (c.lit_skin > 0 ? " (" + Fixed(share, 1) + " %)" : ""),
                          std::to_string(c.no_surface), std::to_string(c.unlit), std::to_string(c.not_fitted),
                          std::to_string(c.not_skin), std::to_string(c.in_shadow), std::to_string(c.not_separated),
                          left_out});
  }
  return table;
}

// What a prediction of other light may be off by, and whether what some hold-outs say of that holds for another.
std::vector<ReportTable> IntervalTables(const Metrics& m) {
  std::vector<ReportTable> tables;
  if (m.intervals.colours.empty()) return tables;
  ReportTable parts{
      "Error of light that the fit has not seen, by colour: four parts whose squares add up to that of a standard "
      "deviation. 1.96 of them leave 5 % of the pixels outside",
      {"colour", "albedo", "normal, degrees", "placement of a pattern, quads", "spread of a pattern"},
      {}};
  const auto colours = Colours(static_cast<int>(m.intervals.colours.size()));
  for (size_t c = 0; c < colours.size(); ++c) {
    const PredictionError& e = m.intervals.colours[c];
    parts.rows.push_back({colours[c], Fixed(100.0 * e.albedo, 2) + " %",
                          Fixed(e.normal_rad * 180.0 / std::numbers::pi, 2), Fixed(e.placement_quads, 3),
                          Fixed(100.0 * e.spread, 2) + " %"});
  }
  tables.push_back(std::move(parts));
  if (m.intervals.covered.empty()) return tables;
  ReportTable covered{
      "95 % intervals of a light, from what the other hold-outs say: how much of the light lies within (intervals "
      "widened by the capture's own noise), and their half-width, RMS over the RMS of the light",
      {"projector", "light", "within", "half-width", "pixels and colours"},
      {}};
  for (const auto& c : m.intervals.covered)
    covered.rows.push_back({std::to_string(c.projector), c.light, Fixed(100.0 * c.share, 1) + " %",
                            Fixed(100.0 * c.half_width, 1) + " %", std::to_string(c.samples)});
  tables.push_back(std::move(covered));
  return tables;
}

// Each diffuse normal, and the specular one in its place: what filtering is worth.
ReportTable NormalTable(const NormalFigures& n) {
  ReportTable table{
      "Normals against the simulated truth, on skin: the specular ones against the true surface's, the diffuse ones "
      "against those filtered by how far the true skin spreads light",
      {"normal", "median deg", "rms deg", "quads", "layers' width mm", "true width mm"},
      {}};
  const auto add = [&](const std::string& name, const AngleError& e, const std::string& width = "",
                       const std::string& true_width = "") {
    table.rows.push_back(
        {name, Fixed(e.median_deg, 2), Fixed(e.rms_deg, 2), std::to_string(e.quads), width, true_width});
  };
  add("specular", n.specular);
  add("of the surface, without photometric detail", n.surface);
  add("photometric, of light alone", n.photometric);
  for (const NormalFigures::Diffuse& d : n.diffuse) {
    add("diffuse, " + d.colour, d.filtered, Fixed(d.width_mm, 2), Fixed(d.true_width_mm, 2));
    add("specular in its place, " + d.colour, d.unfiltered);
  }
  return table;
}

ReportTable SweepTable(const Metrics& m) {
  ReportTable table{"Sweeps: what became of the profiles, and whether the frames of a cycle add up to the white ones",
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

}  // namespace

ReportSection FiguresSection(const Metrics& m) {
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
  if (m.truth) {
    section.tables.push_back({"Against the simulated truth",
                              {"depth rms mm", "depth bias mm", "normal median deg", "quads"},
                              {{Fixed(m.truth->depth_rms_mm), Fixed(m.truth->depth_bias_mm),
                                Fixed(m.truth->normal_median_deg, 2), std::to_string(m.truth->pixels)}}});
    ReportTable columns{"Columns at which SRDs are read, against the simulated truth",
                        {"projector", "mean px", "rms about it px", "quads"},
                        {}};
    for (const ColumnError& c : m.truth->columns)
      columns.rows.push_back({std::to_string(c.projector), Fixed(c.mean_px), Fixed(c.rms_px), std::to_string(c.quads)});
    if (!columns.rows.empty()) section.tables.push_back(columns);
  }
  if (m.normals) section.tables.push_back(NormalTable(*m.normals));
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

}  // namespace stratalux::fit
