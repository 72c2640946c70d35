// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/calibration_page.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>

#include "fitter/report/calibration_drawings.h"
#include "fitter/report/light_sections.h"
#include "fitter/report/page_text.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

// Digits after the point that show a parameter's standard deviation on a good rig.
int DigitsOf(int parameter) {
  if (parameter < 4) return 2;                 // px
  if (parameter < kIntrinsics) return 4;       // distortion
  return parameter < kIntrinsics + 3 ? 5 : 3;  // rad, mm
}

std::vector<std::string> DeviceHeader(const GeometryReport& g) {
  std::vector<std::string> header{""};
  for (size_t d = 0; d < g.sigma_px.size(); ++d) header.push_back(DeviceName(d));
  return header;
}

ReportBanner BannerOf(const CalibrationPage& page) {
  const auto refusals = std::count_if(page.findings.begin(), page.findings.end(),
                                      [](const Finding& f) { return f.severity == Severity::kRefusal; });
  const auto warnings = static_cast<std::ptrdiff_t>(page.findings.size()) - refusals;
  if (page.geometry == nullptr && !page.light) return {Tone::kBad, "No calibration: the reasons are below."};
  if (refusals > 0)
    return {Tone::kBad, "Refused: do not use this calibration. Reasons and remedies: " + std::to_string(refusals) +
                            ", below. Earlier calibrations stay as they are."};
  if (warnings > 0) return {Tone::kDoubtful, "Accepted, with " + std::to_string(warnings) + " warnings (below)."};
  const bool kept = page.light && !page.light->carried_over.empty();
  return {Tone::kGood, std::string("Accepted: no fault was found in this calibration.") +
                           (kept ? " Parts that no session measured stay as before (end of the page)." : "")};
}

ReportSection Verdict(const CalibrationPage& page) {
  ReportSection section{"Verdict", "", {}, {}, {}};
  if (page.findings.empty()) {
    section.text = "All checks passed.";
    return section;
  }
  ReportTable table{"", {"", "what was found", "what to do"}, {}};
  for (const Finding& f : page.findings)
    table.rows.push_back({f.severity == Severity::kRefusal ? "refused" : "warning", f.what, f.remedy});
  std::stable_sort(table.rows.begin(), table.rows.end(),
                   [](const auto& a, const auto& b) { return a[0] == "refused" && b[0] != "refused"; });
  section.tables = {std::move(table)};
  return section;
}

int CornersOf(const GeometryReport& g, size_t device) { return g.training_total.counts[device]; }

ReportSection Accuracy(const GeometryReport& g) {
  ReportSection section{
      "How well the corners are explained",
      "RMS is the distance between where a corner was seen and where the calibration puts it. Held out: the same for "
      "poses that the calibration did not use; a little above RMS is good, far above means too few poses, or poses "
      "that are all alike. Epipolar: how far camera and projector miss each other, whatever the board; more than 0.1 "
      "px means that something moved.",
      {},
      {},
      {}};
  ReportTable devices{
      "Pixels of each device.", {"device", "RMS", "held out", "noise", "epipolar", "corners", "covered"}, {}};
  for (size_t d = 0; d < g.sigma_px.size(); ++d)
    devices.rows.push_back({DeviceName(d), Fixed(g.training_total.Rms(d), 3), Fixed(g.held_out_total.Rms(d), 3),
                            Fixed(g.sigma_px[d], 3), d > 0 ? Fixed(g.epipolar.Rms(d), 3) : "-",
                            std::to_string(CornersOf(g, d)), Fixed(100.0 * g.coverage[d], 0) + " %"});
  devices.rows.push_back({"all", Fixed(g.training_total.JointRms(), 3), Fixed(g.held_out_total.JointRms(), 3), "", "",
                          std::to_string(g.corners) + " + " + std::to_string(g.rejected.size()) + " left out", ""});
  ReportTable poses{"A pose that stands out was moved, reflected glare, or lies where no other does: capture it again.",
                    {"pose", "tilt", "RMS, px", "held out, px", "held out, sd", "corners"},
                    {}};
  for (size_t k = 0; k < g.training.size(); ++k)
    poses.rows.push_back({g.used.poses[k].name, Fixed(g.tilt_deg[k], 1) + "°", Fixed(g.training[k].JointRms(), 3),
                          Fixed(g.held_out[k].errors.JointRms(), 3), Fixed(g.held_out[k].surprise, 2),
                          std::to_string(g.used.poses[k].corners.size())});
  section.tables = {std::move(devices), std::move(poses)};
  return section;
}

ReportSection Residuals(const GeometryReport& g) {
  ReportSection section{"Residuals",
                        "What the calibration leaves unexplained at each corner. Errors of finding corners in the "
                        "camera's picture move all devices alike; what a projector adds of its own is its noise in "
                        "the table above.",
                        {},
                        {},
                        {}};
  for (size_t d = 0; d < g.sigma_px.size(); ++d) section.drawings.push_back(DrawResiduals(g, d));
  return section;
}

ReportSection Coverage(const GeometryReport& g) {
  ReportSection section{
      "Where the boards were",
      "Distortion is a guess where no corner was. Good: 40 % of each picture and more; bring the board "
      "to the empty parts, tilted.",
      {},
      {},
      {}};
  for (size_t d = 0; d < g.sigma_px.size(); ++d) section.drawings.push_back(DrawCoverage(g, d));
  section.drawings.push_back(DrawTilts(g));
  return section;
}

ReportSection Rig(const GeometryReport& g) {
  ReportSection section{"The rig", "Camera, projectors and boards, to scale.", {}, {}, {}};
  for (const RigView view : {RigView::kTop, RigView::kSide, RigView::kOblique})
    section.drawings.push_back(DrawRig(g, view));
  ReportTable table{"Check these with a ruler: one wrong size of the squares makes all of them wrong alike.",
                    {"", "from the camera, mm", "to the right", "down", "forward", "angle to the camera's axis"},
                    {}};
  for (size_t p = 0; p < g.bundle.rig.projectors.size(); ++p) {
    const Rigid3& pose = g.bundle.rig.projectors[p].camera_from_projector;
    const Eigen::Vector3d& t = pose.translation_mm;
    const double cosine = std::clamp((pose.rotation * Eigen::Vector3d::UnitZ()).z(), -1.0, 1.0);
    table.rows.push_back({DeviceName(1 + p), Fixed(t.norm(), 1), Fixed(t.x(), 1), Fixed(t.y(), 1), Fixed(t.z(), 1),
                          Fixed(DegFromRad(std::acos(cosine)), 1) + "°"});
  }
  section.tables = {std::move(table)};
  return section;
}

double StandardDeviation(const GeometryReport& g, size_t device, int parameter) {
  return g.covariances.empty() ? NAN : std::sqrt(g.covariances[device](parameter, parameter));
}

ReportTable Parameters(const GeometryReport& g) {
  ReportTable table{
      "Value ± standard deviation. Focal lengths and principal points in px, rotations in rad, translations in mm. "
      "Good: focal lengths known to 0.1 %; if not, capture more poses with more tilt.",
      DeviceHeader(g),
      {}};
  for (int i = 0; i < kIntrinsics + kPoseParameters; ++i) {
    std::vector<std::string> row{ParameterName(i)};
    for (size_t d = 0; d < g.sigma_px.size(); ++d) {
      const std::vector<double> values = DeviceParameters(g.bundle.rig, d);
      const auto k = static_cast<size_t>(i);
      if (k >= values.size())
        row.emplace_back("");
      else
        row.push_back(PlusMinus(values[k], StandardDeviation(g, d, i), DigitsOf(i)));
    }
    table.rows.push_back(std::move(row));
  }
  return table;
}

ReportTable Trials(const GeometryReport& g) {
  ReportTable table{
      "Distortion models tried. Of those that predict held-out poses as well as the best, the richest is "
      "taken. If `full` is far better than the others, the lens is odd: look at the arrows.",
      {"model", "held out, sd", "held out, px", ""},
      {}};
  for (const ModelTrial& trial : g.trials)
    table.rows.push_back({ToString(trial.model), Fixed(trial.held_out_sigmas, 3), Fixed(trial.held_out_px, 4),
                          trial.model == g.distortion ? "taken" : ""});
  return table;
}

// Variance of parameter i in a record's upper triangle (row by row); 0 where the record has none.
double RecordVariance(const std::vector<double>& upper, size_t parameters, size_t i) {
  const size_t at = i * parameters - i * (i + 1) / 2 + i;
  return upper.size() == parameters * (parameters + 1) / 2 ? upper[at] : 0.0;
}

std::string Change(const GeometryReport& g, const RigCalibration& earlier, size_t device, size_t i) {
  const double now = DeviceParameters(g.bundle.rig, device)[i];
  const double before = DeviceParameters(RigGeometry::From(earlier), device)[i];
  const auto& upper =
      device == 0 ? earlier.camera.geometry_covariance : earlier.projectors[device - 1].geometry_covariance;
  const size_t parameters = device == 0 ? kIntrinsics : kIntrinsics + kPoseParameters;
  const double sd =
      std::hypot(StandardDeviation(g, device, static_cast<int>(i)), std::sqrt(RecordVariance(upper, parameters, i)));
  return Signed(now - before, DigitsOf(static_cast<int>(i))) +
         (sd > 0.0 ? " (" + Signed((now - before) / sd, 1) + " sd)" : "");
}

ReportSection BeforeAndAfter(const GeometryReport& g, const RigCalibration& earlier) {
  ReportSection section{
      "Before and after",
      "Against the earlier calibration (" + earlier.source +
          "): change, and the change in standard deviations of both together. Good: within 3. One "
          "projector alone that moved was knocked: fasten it; all of them moved alike: the squares' size "
          "or the camera.",
      {},
      {},
      {}};
  if (earlier.projectors.size() != g.bundle.rig.projectors.size()) {
    section.text = "The earlier calibration (" + earlier.source + ") has " + std::to_string(earlier.projectors.size()) +
                   " projectors, this one " + std::to_string(g.bundle.rig.projectors.size()) +
                   ": nothing to compare. If the rig was not changed, a projector is missing.";
    return section;
  }
  ReportTable table{"", DeviceHeader(g), {}};
  std::vector<std::string> moved{"moved, mm", "-"}, turned{"turned", "-"};
  for (size_t p = 0; p < earlier.projectors.size(); ++p) {
    const Rigid3 &now = g.bundle.rig.projectors[p].camera_from_projector,
                 &before = earlier.projectors[p].camera_from_projector;
    moved.push_back(Fixed((now.translation_mm - before.translation_mm).norm(), 2));
    turned.push_back(Fixed(DegFromRad(now.rotation.angularDistance(before.rotation)), 3) + "°");
  }
  table.rows = {std::move(moved), std::move(turned)};
  for (size_t i = 0; i < kIntrinsics + kPoseParameters; ++i) {
    std::vector<std::string> row{ParameterName(static_cast<int>(i))};
    for (size_t d = 0; d < g.sigma_px.size(); ++d)
      row.push_back(d == 0 && i >= kIntrinsics ? "" : Change(g, earlier, d, i));
    table.rows.push_back(std::move(row));
  }
  section.tables = {std::move(table)};
  return section;
}

std::string Subtitle(const CalibrationPage& page) {
  std::string text;
  if (page.geometry != nullptr) {
    const BoardDescription& b = page.geometry->used.board;
    text = std::to_string(page.geometry->used.poses.size()) + " poses of a " + ToString(b.kind) + " board of " +
           std::to_string(b.columns) + " x " + std::to_string(b.rows) + " squares of " + Fixed(b.square_mm, 3) +
           " mm; ";
  }
  if (page.sessions.empty()) return text + "no session";
  text += page.sessions.size() == 1 ? "session " : "sessions " + page.sessions.front() + " to ";
  return text + page.sessions.back();
}

}  // namespace

Report CalibrationReport(const CalibrationPage& page) {
  Report report{"Calibration", Subtitle(page), {Verdict(page)}, BannerOf(page)};
  if (page.geometry != nullptr) {
    const GeometryReport& g = *page.geometry;
    report.sections.push_back(Accuracy(g));
    report.sections.push_back(Residuals(g));
    report.sections.push_back(Coverage(g));
    report.sections.push_back(Rig(g));
    report.sections.push_back({"Parameters", "", {}, {}, {Trials(g), Parameters(g)}});
    if (page.earlier) report.sections.push_back(BeforeAndAfter(g, *page.earlier));
  }
  if (page.light) {
    auto light = LightSections(*page.light, page.record);
    std::move(light.begin(), light.end(), std::back_inserter(report.sections));
  }
  return report;
}

}  // namespace stratalux::fit
