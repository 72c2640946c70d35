// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/verdict.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <compare>
#include <map>
#include <string>

#include "shared/base/formatted.h"
#include "shared/base/median.h"
#include "shared/units/angle.h"

namespace stratalux::fit {
namespace {

const Pinhole& ModelOf(const RigGeometry& rig, size_t device) {
  return device == 0 ? rig.camera : rig.projectors[device - 1].model;
}

class Findings {
 public:
  void Refuse(std::string what, std::string remedy) {
    list.push_back({Severity::kRefusal, std::move(what), std::move(remedy)});
  }
  void Warn(std::string what, std::string remedy) {
    list.push_back({Severity::kWarning, std::move(what), std::move(remedy)});
  }
  std::vector<Finding> list;
};

// Largest displacement by distortion over a lattice of the picture, over half its diagonal; infinity where the model
// folds over, so that a pixel has no ray.
double Displacement(const Pinhole& m) {
  constexpr int kSteps = 8;
  Pinhole straight = m;
  straight.distortion = {};
  double largest = 0.0;
  for (int j = 0; j <= kSteps; ++j)
    for (int i = 0; i <= kSteps; ++i) {
      const Eigen::Vector2d pixel((m.width - 1.0) * i / kSteps, (m.height - 1.0) * j / kSteps);
      const Eigen::Vector3d ray = m.Unproject(pixel);
      const auto back = m.Project(ray);
      const auto plain = straight.Project(ray);
      if (!back || !plain || !((*back - pixel).norm() < 0.1)) return INFINITY;
      largest = std::max(largest, (*plain - pixel).norm());
    }
  return largest / (0.5 * std::hypot(m.width, m.height));
}

void JudgeModel(const Pinhole& m, const std::string& name, const VerdictOptions& options, Findings& findings) {
  const double aspect = std::abs(m.fx / m.fy - 1.0);
  if (!(aspect <= options.max_aspect))
    findings.Refuse(
        Formatted("%s: fx = %.1f and fy = %.1f px differ by %.1f %%", name.c_str(), m.fx, m.fy, 100.0 * aspect),
        "real pixels are square; capture more poses, tilted in different ways");
  const double displacement = Displacement(m);
  if (!(displacement <= options.max_displacement))
    findings.Refuse(name + ": absurd distortion" +
                        (std::isinf(displacement) ? std::string(": the model folds over inside the picture")
                                                  : Formatted(", %.0f %% of half the picture", 100.0 * displacement)),
                    "bring the board into the corners of the picture, or fix the model with --distortion k1");
}

void JudgeTilts(const GeometryReport& report, const VerdictOptions& options, Findings& findings) {
  const auto tilted = std::count_if(report.tilt_deg.begin(), report.tilt_deg.end(),
                                    [&](double tilt) { return tilt >= options.min_tilt_deg; });
  if (tilted < options.min_tilted) {
    findings.Refuse(Formatted("only %d of %zu poses are tilted by %.0f degrees or more", static_cast<int>(tilted),
                              report.tilt_deg.size(), options.min_tilt_deg),
                    "boards that face the camera do not fix the focal length: tilt the board by 15 to 35 degrees, each "
                    "pose in another direction");
    return;
  }
  Eigen::MatrixXd tilts(report.bundle.camera_from_board.size(), 2);
  for (size_t k = 0; k < report.bundle.camera_from_board.size(); ++k) {
    Eigen::Vector3d normal = report.bundle.camera_from_board[k].rotation * Eigen::Vector3d::UnitZ();
    if (normal.z() < 0.0) normal = -normal;
    tilts.row(static_cast<Eigen::Index>(k)) << normal.x(), normal.y();
  }
  const Eigen::MatrixXd second = tilts.transpose() * tilts / static_cast<double>(tilts.rows());
  const double spread =
      DegFromRad(std::sqrt(std::max(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(second).eigenvalues()[0], 0.0)));
  if (spread < options.min_tilt_spread_deg)
    findings.Refuse(Formatted("all boards are tilted about one axis (%.1f degrees about the other)", spread),
                    "tilt the board to the left, to the right, up and down");
}

void JudgeHeldOut(const GeometryReport& report, const VerdictOptions& options, Findings& findings) {
  bool placed = true;
  for (const HeldOutPose& pose : report.held_out) {
    if (std::isfinite(pose.surprise)) continue;
    placed = false;
    findings.Refuse(pose.name + ": no place of the board fits what the other poses say", "capture this pose again");
  }
  if (!placed) return;  // the figures are infinite
  for (size_t d = 0; d < report.sigma_px.size(); ++d) {
    const double training = report.training_total.Rms(d), held_out = report.held_out_total.Rms(d);
    if (held_out <= options.max_held_out_ratio * training + options.negligible_px) continue;
    findings.Refuse(Formatted("%s: a pose that was left out is predicted to within %.3f px, those that were used fit "
                              "to within %.3f px",
                              DeviceName(d).c_str(), held_out, training),
                    "the poses do not determine the model: capture more of them, spread over the picture and tilted; a "
                    "simpler one (--distortion k1) needs fewer");
  }
}

void JudgeSpread(const GeometryReport& report, const VerdictOptions& options, Findings& findings) {
  if (report.covariances.empty()) {
    findings.Refuse("the corners do not determine all parameters",
                    "capture more poses, tilted in different ways, that every projector lights");
    return;
  }
  for (size_t d = 0; d < report.covariances.size(); ++d)
    for (int i : {0, 1}) {
      const Pinhole& m = ModelOf(report.bundle.rig, d);
      const double sd = std::sqrt(report.covariances[d](i, i)), value = i == 0 ? m.fx : m.fy;
      if (sd <= options.max_focal_sd * value) continue;
      findings.Refuse(
          Formatted("%s: %s = %.1f px is known to %.1f px only", DeviceName(d).c_str(), ParameterName(i), value, sd),
          "capture more poses, tilted in different ways");
    }
}

// The pose with the most rejected corners; of those alike, the one whose worst corner is worse.
std::string WorstPose(const std::vector<RejectedCorner>& rejected) {
  struct Amount {
    int corners = 0;
    double sigmas = 0.0;
    auto operator<=>(const Amount&) const = default;
  };
  std::map<std::string, Amount> poses;
  for (const RejectedCorner& corner : rejected) {
    Amount& amount = poses[corner.pose];
    ++amount.corners;
    amount.sigmas = std::max(amount.sigmas, corner.sigmas);
  }
  const auto worst =
      std::max_element(poses.begin(), poses.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  return worst == poses.end() ? "" : worst->first;
}

void JudgeAmounts(const GeometryReport& report, const VerdictOptions& options, Findings& findings) {
  const int poses = static_cast<int>(report.used.poses.size());
  if (poses < options.min_poses)
    findings.Refuse(Formatted("%d poses", poses), Formatted("capture at least %d, better 12", options.min_poses));
  else if (poses < options.advised_poses)
    findings.Warn(Formatted("%d poses", poses), "12 are advised");
  const double rejected = static_cast<double>(report.rejected.size()) /
                          std::max<double>(report.corners + static_cast<double>(report.rejected.size()), 1.0);
  if (rejected > options.max_rejected)
    findings.Refuse(Formatted("%.0f %% of the corners contradict the others; the worst lie in %s", 100.0 * rejected,
                              WorstPose(report.rejected).c_str()),
                    "capture these poses again: the board moved, is bent, or shines");
  for (size_t d = 0; d < report.coverage.size(); ++d)
    if (report.coverage[d] < options.advised_coverage)
      findings.Warn(
          Formatted("%s: corners in %.0f %% of the picture", DeviceName(d).c_str(), 100.0 * report.coverage[d]),
          "bring the board to where there are no corners yet (coverage map)");
}

// How many times farther our projectors stand from the camera.
std::vector<double> DistanceRatios(const RigGeometry& known, const RigGeometry& ours) {
  std::vector<double> ratios;
  for (size_t p = 0; p < ours.projectors.size(); ++p)
    ratios.push_back(ours.projectors[p].camera_from_projector.translation_mm.norm() /
                     known.projectors[p].camera_from_projector.translation_mm.norm());
  return ratios;
}

}  // namespace

bool IsRefused(const std::vector<Finding>& findings) {
  return std::any_of(findings.begin(), findings.end(),
                     [](const Finding& f) { return f.severity == Severity::kRefusal; });
}

std::vector<Finding> JudgeCalibration(const GeometryReport& report, const VerdictOptions& options) {
  Findings findings;
  JudgeAmounts(report, options, findings);
  JudgeTilts(report, options, findings);
  for (size_t d = 0; d < report.sigma_px.size(); ++d)
    JudgeModel(ModelOf(report.bundle.rig, d), DeviceName(d), options, findings);
  JudgeHeldOut(report, options, findings);
  JudgeSpread(report, options, findings);
  return std::move(findings.list);
}

std::vector<Finding> JudgeGiven(const RigGeometry& given, const GeometryReport& report, const VerdictOptions& options) {
  Findings findings;
  if (given.projectors.size() != report.bundle.rig.projectors.size()) {
    findings.Refuse(Formatted("%zu projectors, but the corners come from %zu", given.projectors.size(),
                              report.bundle.rig.projectors.size()),
                    "use a calibration of this rig");
    return std::move(findings.list);
  }
  DeviceErrors total(report.sigma_px.size());
  for (const PoseObservation& pose : report.used.poses) {
    const auto fitted = FitPose(given, report.sigma_px, report.used.board, pose);
    if (!fitted) findings.Refuse(pose.name + ": no position of the board fits", "calibrate again");
    if (fitted) total.Add(fitted->errors);
  }
  for (size_t d = 0; d < report.sigma_px.size(); ++d) {
    const Pinhole &theirs = ModelOf(given, d), &ours = ModelOf(report.bundle.rig, d);
    JudgeModel(theirs, DeviceName(d), options, findings);
    for (const auto& [name, f, g] : {std::tuple{"fx", theirs.fx, ours.fx}, std::tuple{"fy", theirs.fy, ours.fy}})
      if (std::abs(f / g - 1.0) > options.max_focal)
        findings.Refuse(Formatted("%s: %s = %.1f px, but the corners say %.1f", DeviceName(d).c_str(), name, f, g),
                        "a low training error does not make it right: calibrate again");
    if (total.Rms(d) > options.max_held_out_ratio * report.training_total.Rms(d) + options.negligible_px)
      findings.Refuse(Formatted("%s: explains the corners to within %.3f px, but %.3f px is possible",
                                DeviceName(d).c_str(), total.Rms(d), report.training_total.Rms(d)),
                      "calibrate again");
  }
  return std::move(findings.list);
}

std::vector<Finding> CompareWithKnownRig(const RigGeometry& known, const GeometryReport& report,
                                         const VerdictOptions& options) {
  Findings findings;
  const RigGeometry& ours = report.bundle.rig;
  if (known.projectors.size() != ours.projectors.size()) {
    findings.Warn(Formatted("%zu projectors, but the earlier calibration has %zu", ours.projectors.size(),
                            known.projectors.size()),
                  "nothing to do if the rig was changed");
    return std::move(findings.list);
  }
  const std::vector<double> ratios = DistanceRatios(known, ours);
  const double scale = Median(ratios);
  const auto [least, most] = std::minmax_element(ratios.begin(), ratios.end());
  // Which known projector stands where ours does, sizes apart.
  bool exchanged = false;
  for (size_t p = 0; p < ours.projectors.size(); ++p) {
    const Eigen::Vector3d place = ours.projectors[p].camera_from_projector.translation_mm / scale;
    size_t nearest = p;
    auto distance = [&](size_t q) { return (known.projectors[q].camera_from_projector.translation_mm - place).norm(); };
    for (size_t q = 0; q < known.projectors.size(); ++q)
      if (distance(q) < 0.3 * distance(nearest)) nearest = q;
    if (nearest == p) continue;
    exchanged = true;
    findings.Refuse(Formatted("projector %zu stands where projector %zu stood", p, nearest),
                    "exchange their cables, or renumber them on purpose");
  }
  if (exchanged) return std::move(findings.list);
  if (*most / *least > 1.0 + 2.0 * options.max_scale)
    findings.Warn(Formatted("the projectors stand %.3f to %.3f times as far from the camera as before", *least, *most),
                  "nothing to do if the rig was changed");
  else if (std::abs(scale - 1.0) > options.max_scale)
    findings.Refuse(Formatted("the whole box is %.3f times as large as before", scale),
                    Formatted("measure the board's squares: %.3f mm would fit, %.3f mm were given",
                              report.used.board.square_mm / scale, report.used.board.square_mm));
  return std::move(findings.list);
}

}  // namespace stratalux::fit
