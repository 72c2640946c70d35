// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/session_report.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "fitter/export/pictures.h"
#include "fitter/mixture/fit_mixture.h"
#include "fitter/report/figures_section.h"
#include "fitter/report/html_report.h"
#include "fitter/report/layer_pictures.h"
#include "fitter/report/page_text.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/diffuse_normals.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/formatted.h"
#include "shared/image/png.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

Image<float> Channel(const Image<float>& map, int channel) {
  Image<float> out(map.width(), map.height());
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) out(x, y) = map(x, y, channel);
  return out;
}

Result<Image<float>> Captured(const ReportInput& in, const db::FrameRow& row) {
  SLX_ASSIGN_OR_RETURN(const auto raw, in.frames.ReadLinear(row));
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
    const db::FrameRow* row = in.frames.FindWhite(p);
    if (row == nullptr) continue;
    SLX_ASSIGN_OR_RETURN(const auto image, Captured(in, *row));
    section.images.push_back({"projector " + std::to_string(p) + ", white", ToSrgb(image, white)});
  }
  const int bits = GrayBits(o.projector_width);
  const std::vector<std::pair<CapturePhase, Pattern>> samples = {
      {CapturePhase::kCorrespondence, o.PlaneOf(PatternAxis::kColumns, std::min(5, bits - 1), false)},
      {CapturePhase::kSeparation,
       {.kind = PatternKind::kSinusoid, .period = o.separation_period, .shift = 0, .shifts = o.separation_shifts}},
      {CapturePhase::kSweep, {.kind = PatternKind::kComb, .period = o.comb_period, .width = o.comb_width, .shift = 0}}};
  for (const auto& [phase, pattern] : samples) {
    const db::FrameRow* row = in.frames.Find(in.heldout, phase, pattern);
    if (row == nullptr) continue;
    SLX_ASSIGN_OR_RETURN(const auto image, Captured(in, *row));
    section.images.push_back({"projector " + std::to_string(in.heldout) + ", " + pattern.ToString(),
                              ToSrgb(image, phase == CapturePhase::kSweep ? 0.35 * white : white)});
  }
  return section;
}

ReportSection Shape(const ReportInput& in) {
  const Image<float> depth = Channel(in.shape.surface.point_mm, 2);
  ReportSection section{
      "Shape",
      "Depth from all projectors together; normals of the surface, of photometric stereo, and two for rendering. The "
      "specular normal is the surface's with photometric detail and holds for the light that the surface itself "
      "reflects. The diffuse normal is filtered by how far the layers spread light and holds for the light that they "
      "scatter.",
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
  section.images.push_back({"specular normals", NormalColours(in.normals.fused)});
  section.images.push_back({"diffuse normals" + std::string(in.diffuse_normals.channels() > 3 ? ", green light" : ""),
                            NormalColours(OneDiffuseNormal(in.diffuse_normals))});
  return section;
}

// Where the surface was placed.
ReportTable PlacementTable(const Metrics& m) {
  ReportTable table{
      "Depth below the skin's surface at which the codes are seen, found by the sweeps; the surface is placed above "
      "them by the displacement that this causes. In a simulation also the bias of the depth against the truth, and "
      "the RMS about that bias",
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
        {o.model, o.offset.IsFound() ? Fixed(o.offset.code_depth_mm) : "not found, nothing is moved",
         o.offset.IsFound() ? Fixed(o.offset.sigma_mm) : "", std::to_string(o.offset.pixels)},
        o.truth);
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
                        "Skin is what looks like most of the face, judged by the light that goes through it (global) "
                        "and by that light's share of all light, with all projectors together. " +
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
                        "Samples of the comb sweep (dots) over the distance between line and pixel, and what the fit "
                        "says of them: layers, surface and floor (line), red channel.",
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
    const auto predicted = PredictSamples(layers, UnlayeredOf(map, profile, p, b, 0), b, 0, map.scattering);
    const bool is_trained = std::ranges::find(map.training_projectors, p) != map.training_projectors.end();
    std::vector<std::array<double, 3>> points;
    const double period = double(b.step_mm[0]) * b.samples;
    for (int k = 0; k < b.samples; ++k)
      points.push_back(
          {std::remainder(b.first_u_mm[0] + k * double(b.step_mm[0]), period), b.Samples(0)[k], predicted[k]});
    std::sort(points.begin(), points.end());
    ReportSeries measured{"measured", {}, {}, true}, fitted{is_trained ? "fitted" : "predicted", {}, {}, false};
    for (const auto& point : points) {
      if (std::abs(point[0]) > 12.0) continue;
      measured.x.push_back(point[0]);
      measured.y.push_back(point[1]);
      fitted.x.push_back(point[0]);
      fitted.y.push_back(point[2]);
    }
    section.plots.push_back({"projector " + std::to_string(p) + (is_trained ? "" : " (held out)"),
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

// Whether the rig still stands as it was calibrated.
ReportSection CalibrationSection(const RigCalibration& rig, const DriftReport& drift) {
  ReportSection section{"Calibration",
                        Describe(drift) + ". Used: " + (rig.source.empty() ? "no source named" : rig.source) +
                            (rig.made_wall.ns != 0 ? ", made " + ToIso8601(rig.made_wall) : "") + ".",
                        {},
                        {},
                        {}};
  ReportTable table{"Displacement of each projector's light on the face against the calibration: below 0.5 px is good",
                    {"projector", "columns px", "rows px", "together px", "as if turned by deg", "spread px",
                     "spread expected of the codes px", "points"},
                    {}};
  for (const ProjectorDrift& d : drift.projectors) {
    // An axis that was not captured is not displaced by nothing.
    const auto figure = [&](double value) { return d.judged() && value != 0.0 ? Fixed(value) : "not judged"; };
    table.rows.push_back({std::to_string(d.projector), figure(d.shift_columns), figure(d.shift_rows),
                          figure(d.shift_px), figure(d.turned_deg), figure(d.spread_px), figure(d.expected_px),
                          std::to_string(d.points)});
  }
  section.tables.push_back(table);
  return section;
}

// How the visitor moved, and what of it is left.
ReportSection MotionSection(const FaceMotion& face) {
  const HeadMotion& motion = face.head;
  ReportSection section{"Motion of the head", "", {}, {}, {}};
  if (motion.poses.empty()) {
    section.text = "Unknown: " + WhyUnknown(face) + ".";
    return section;
  }
  section.text =
      Formatted("Moved by %.3f mm at most (root mean square over the face; noise of the white frames: %.3f mm)%s.",
                motion.largest_mm, motion.sigma_mm,
                motion.moved ? ": codes, lights and SRDs are those of the moment of the first white frame"
                             : ", which cannot be told from a head that held still: nothing is moved");
  section.text += Formatted(
      " Detail of the white frames differs by %.2f %% as they are, by %.2f %% after the motion that was found.",
      100.0 * motion.detail_before, 100.0 * motion.detail_after);
  const char* const kAxes[] = {"x (right)", "y (down)", "z (away)"};
  ReportPlot shift{"Shift of the middle of the face since the first white frame", "s", "mm", {}},
      turn{"Turn about it", "s", "degrees", {}};
  for (int axis = 0; axis < 3; ++axis) {
    ReportSeries mm{kAxes[axis], {}, {}, false}, degrees{kAxes[axis], {}, {}, false};
    for (const HeadPose& pose : motion.poses) {
      mm.x.push_back(pose.seconds);
      mm.y.push_back(pose.motion.shift_mm[axis]);
      degrees.x.push_back(pose.seconds);
      degrees.y.push_back(DegFromRad(pose.motion.turn_rad[axis]));
    }
    shift.series.push_back(mm);
    turn.series.push_back(degrees);
  }
  section.plots = {shift, turn};
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
  const db::FrameRow* white_row = in.frames.FindWhite(in.heldout);
  if (white_row == nullptr)
    return in.frames.Require(in.heldout, CapturePhase::kReference, {.kind = PatternKind::kWhite}).status();
  SLX_ASSIGN_OR_RETURN(const auto lit, Captured(in, *white_row));
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
          ", captured " + ToIso8601(info.started_wall) + ", " +
          std::to_string(in.frames.rows().size() + in.frames.replaced().size()) + " frames, " + ToString(info.status) +
          ". Layers fitted on all projectors but " + std::to_string(in.heldout) + ", which judges them; layer maps " +
          in.shown.provenance + ".",
      {}};
  SLX_ASSIGN_OR_RETURN(auto samples, CapturedSamples(in, white));
  report.sections.push_back(std::move(samples));
  report.sections.push_back(Shape(in));
  if (!metrics.offsets.empty()) report.sections.back().tables.push_back(PlacementTable(metrics));
  report.sections.push_back(CalibrationSection(*in.frames.calibration(), metrics.drift));
  report.sections.push_back(MotionSection(in.shape.motion));
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
  report.sections.push_back(FiguresSection(metrics));
  SLX_ASSIGN_OR_RETURN(const ReportPictures pictures, EncodePictures(report, known));
  SLX_RETURN_IF_ERROR(WriteText(folder / "report" / "index.html", RenderHtml(report, pictures)));
  return SavePictures(folder / "report", pictures);
}

}  // namespace stratalux::fit
