// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/srd.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "fitter/motion/carried.h"
#include "fitter/motion/moved_surface.h"
#include "shared/base/formatted.h"
#include "shared/geometry/quad.h"

namespace stratalux::fit {
namespace {

// Frames that are decoded before they are handed on: enough to fill the cache lines of the batches.
constexpr int kFramesAtATime = 16;

struct Sweep {
  const SessionFrames& frames;
  int projector = 0;
  CombCycle cycle;

  [[nodiscard]] Pattern PatternOf(int k) const {
    return {.kind = PatternKind::kComb,
            .axis = cycle.axis,
            .period = cycle.period,
            .width = cycle.width,
            .shift = k * cycle.step};
  }
  [[nodiscard]] const db::FrameRow* Find(int k, int bracket) const {
    return frames.Find(projector, CapturePhase::kSweep, PatternOf(k), -1, bracket);
  }
  [[nodiscard]] bool Has(int k) const {
    for (size_t b = 0; b < frames.plan()->brackets.size(); ++b)
      if (Find(k, static_cast<int>(b)) != nullptr) return true;
    return false;
  }
  // Exposure of a bracket over the nominal one: planned. The proof of the frames holds the camera to it within 2 %;
  // what it reports of both is more exact.
  [[nodiscard]] double Factor(int k, int bracket) const {
    const double planned = frames.plan()->brackets[bracket];
    const db::FrameRow* nominal = Find(k, 0);
    const double nominal_ms = nominal != nullptr ? nominal->record.exposure_ms : 0.0;
    const double reported_ms = Find(k, bracket)->record.exposure_ms;
    return nominal_ms > 0.0 && reported_ms > 0.0 ? frames.plan()->brackets[0] * reported_ms / nominal_ms : planned;
  }
};

// Reads the shots of cycle positions [first, last) and hands them to the extractor. `darks`: by exposure factor of the
// plan.
Status AddBlock(const Sweep& sweep, int first, int last, const std::vector<Image<float>>& darks,
                SrdExtractor& extractor) {
  struct Shot {
    int k = 0, bracket = 0;
  };
  std::vector<Shot> shots;
  std::vector<const db::FrameRow*> rows;
  for (int k = first; k < last; ++k)
    for (int b = 0; b < static_cast<int>(darks.size()); ++b)
      if (const db::FrameRow* row = sweep.Find(k, b); row != nullptr) {
        shots.push_back({k, b});
        rows.push_back(row);
      }
  SLX_ASSIGN_OR_RETURN(const auto images, sweep.frames.ReadAll(rows));
  std::vector<CombFrame> combs;
  for (size_t i = 0; i < images.size(); ++i) {
    const auto [k, b] = shots[i];
    const Image<uint16_t>& image = images[i];
    if (image.width() != darks[b].width() || image.height() != darks[b].height())
      return Status::Integrity("session " + sweep.frames.info().id + ": frame '" + sweep.PatternOf(k).ToString() +
                               "' of projector " + std::to_string(sweep.projector) +
                               " differs in size from the black frames");
    if (combs.empty() || combs.back().k != k) combs.push_back({k, {}});
    combs.back().shots.push_back({image, darks[b], sweep.cycle.exposure_ms * sweep.Factor(k, b)});
  }
  extractor.AddFrames(combs);
  return Status::Ok();
}

std::string Describe(const SweepFigure& figure) {
  std::string text = "SRDs of projector " + std::to_string(figure.projector) + ", " + figure.axis + ":";
  const char* separator = " ";
  for (const auto& [reason, count] : figure.profiles_by_reason) {
    text += separator + reason + " " + std::to_string(count);
    separator = ", ";
  }
  if (figure.energy_profiles > 0) {
    text +=
        Formatted("; cycle over white: median %.4f, 95 %% within %.3f", figure.energy_median, figure.energy_p95_error);
  }
  return text;
}

// The scatter reading samples the picture beside the line: too coarse a picture cannot show the profile. Quads per comb
// step on the skin, median.
double QuadsPerStep(const SrdBatch& batch, const SurfaceMap& surface, const RigCalibration& rig, int pool) {
  std::vector<double> ratios;
  const int step = QuadStep(rig.camera.cfa) * pool, width = surface.width() / pool;
  const int channels = QuadChannels(rig.camera.cfa);
  for (int64_t i = 0; i < batch.profiles(); i += channels) {
    const int x = static_cast<int>(i / channels % width) * pool, y = static_cast<int>(i / channels / width) * pool;
    if (batch.valid[i] != 0 && surface.mask(x, y) != 0)
      ratios.push_back(batch.step_mm[i] * rig.camera.model.fx / (step * surface.Point(x, y).z()));
  }
  if (ratios.empty()) return 1.0;
  std::nth_element(ratios.begin(), ratios.begin() + static_cast<int64_t>(ratios.size() / 2), ratios.end());
  return ratios[ratios.size() / 2];
}

// The surface while the sweep passed over it, and whose profiles are whose.
struct SweptSurface {
  SurfaceMap surface;
  Image<uint8_t> lit;
  std::vector<int64_t> profiles;  // of the shape's own pixels: which of these; -1: none
};

// Poses of the head at the cycle's positions; where a frame is missing, as at the one before.
std::vector<Rigid3> PosesOf(const Sweep& sweep, const FaceMotion& motion) {
  std::vector<Rigid3> poses;
  double seconds = motion.projectors[static_cast<size_t>(sweep.projector)].sweep_s;
  for (int k = 0; k < sweep.cycle.frames(); ++k) {
    if (const db::FrameRow* row = sweep.Find(k, 0); row != nullptr)
      seconds = motion.SecondsOf(row->record.trigger_time);
    poses.push_back(motion.head.At(seconds));
  }
  return poses;
}

SweptSurface SweptSurfaceOf(const Sweep& sweep, const FaceShape& shape, const SrdOptions& options, int channels) {
  const RigCalibration& rig = *sweep.frames.calibration();
  const auto p = static_cast<size_t>(sweep.projector);
  const CombCycle& cycle = sweep.cycle;
  const std::vector<Rigid3> poses = PosesOf(sweep, shape.motion);
  const Rigid3 middle = shape.motion.head.At(shape.motion.projectors[p].sweep_s);
  const ProjectorCalibration& projector = rig.projectors[p];
  const Rigid3 projector_from_camera = projector.camera_from_projector.Inverse();
  // Line k lies over columns [k step, k step + width): its middle passes a point whose column that is.
  const PoseOf when_lit = [&](const Eigen::Vector3d& point) {
    const auto at = projector.model.Project(projector_from_camera * (middle * point));
    if (!at) return middle;
    const double column = cycle.axis == PatternAxis::kColumns ? at->x() : at->y();
    const auto k = static_cast<int64_t>(std::floor((column + 0.5 - 0.5 * (cycle.width - cycle.step)) / cycle.step));
    const int64_t frames = cycle.frames();
    return poses[static_cast<size_t>(((k % frames) + frames) % frames)];
  };
  auto moved = MoveSurface(shape.surface, rig.camera, when_lit);
  SweptSurface swept{{}, Carried(shape.lit[p], moved.home), {}};
  swept.surface = std::move(moved.surface);
  swept.profiles = CarriedProfiles(PlacesNow(shape.surface, rig.camera, when_lit), options.pool, channels);
  const Image<uint8_t> known = PoolSurface(shape.surface, options.pool).mask;
  for (size_t i = 0; i < swept.profiles.size(); ++i)
    if (known.pixels()[i / static_cast<size_t>(channels)] == 0) swept.profiles[i] = -1;
  return swept;
}

// On the shape's own pixels; those that come from nowhere are not valid.
SrdBatch OnShape(const SrdBatch& batch, std::vector<int64_t> profiles) {
  std::vector<uint8_t> from_nowhere(profiles.size());
  for (size_t i = 0; i < profiles.size(); ++i)
    if (profiles[i] < 0) {
      from_nowhere[i] = 1;
      profiles[i] = static_cast<int64_t>(i);
    }
  SrdBatch carried = ProfilesOf(batch, profiles);
  carried.place = {};  // these are the whole map
  for (size_t i = 0; i < profiles.size(); ++i)
    if (from_nowhere[i] != 0) carried.valid[i] = 0;
  carried.KeepValidRows();
  return carried;
}

Result<SrdBatch> ExtractSweep(const Sweep& sweep, const FaceShape& shape, const SrdOptions& options, Logger& logger,
                              SrdSet& set, SweepFigure& figure) {
  const PlanOptions& plan = *sweep.frames.plan();
  const int p = sweep.projector;
  figure.projector = p;
  figure.axis = sweep.cycle.axis == PatternAxis::kRows ? "rows" : "columns";
  for (int k = 0; k < sweep.cycle.frames(); ++k) figure.missing_frames += sweep.Has(k) ? 0 : 1;
  const bool made_up = options.reading == SrdReading::kGather && sweep.cycle.LightsAllAlike();
  const bool left_out = figure.missing_frames > (made_up ? 1 : 0);
  if (figure.missing_frames > 0)
    logger.Warning("projector " + std::to_string(p) + ": " + std::to_string(figure.missing_frames) + " of " +
                   std::to_string(sweep.cycle.frames()) + " frames of the sweep are missing (`stratalux-db show`); " +
                   (left_out ? "it is left out of the fit. Capture the visitor again with nothing moving"
                             : "the missing one is computed from the white frames, less all others"));
  SweptSurface swept;
  const bool moved = shape.motion.moved();
  if (moved) swept = SweptSurfaceOf(sweep, shape, options, set.channels);
  const SurfaceMap& surface = moved ? swept.surface : shape.surface;
  const Image<uint8_t>& lit = moved ? swept.lit : shape.lit[static_cast<size_t>(p)];
  // A projector that is left out has profiles, none of them lit.
  const Image<uint8_t> nothing(lit.width(), lit.height());
  SrdExtractor extractor(surface, left_out ? nothing : lit, *sweep.frames.calibration(), p, sweep.cycle, options);
  set.width = extractor.width();
  set.height = extractor.height();
  if (!left_out) {
    std::vector<Image<float>> darks;
    for (double factor : plan.brackets) {
      SLX_ASSIGN_OR_RETURN(auto dark, sweep.frames.MeanBlack(p, factor));
      darks.push_back(std::move(dark));
    }
    const int at_a_time = std::max(1, kFramesAtATime / static_cast<int>(darks.size()));
    for (int k = 0; k < sweep.cycle.frames(); k += at_a_time)
      SLX_RETURN_IF_ERROR(AddBlock(sweep, k, std::min(k + at_a_time, sweep.cycle.frames()), darks, extractor));
    if (options.reading == SrdReading::kGather) {
      int whites = 0;
      SLX_ASSIGN_OR_RETURN(const auto white, sweep.frames.MeanWhite(p, whites));
      SLX_ASSIGN_OR_RETURN(const auto dark, sweep.frames.MeanBlack(p));
      extractor.SetWhite(white, whites, dark);
    }
  }
  SrdBatch batch = extractor.Take();
  for (int r = 0; r < kSrdReasons; ++r)
    if (extractor.counts()[r] > 0)
      figure.profiles_by_reason[ToString(static_cast<SrdReason>(r))] = extractor.counts()[r];
  figure.energy_profiles = extractor.energy().profiles;
  figure.energy_median = extractor.energy().median_ratio;
  figure.energy_p95_error = extractor.energy().p95_error;
  logger.Info(Describe(figure));
  if (options.reading == SrdReading::kScatter) {
    const double quads = QuadsPerStep(batch, surface, *sweep.frames.calibration(), options.pool);
    if (quads < 1.0) {
      logger.Warning(Formatted(
          "projector %d: the camera has %.2f quads per step of the comb; the scatter reading needs at least one (a "
          "finer camera, --pool 1, or the gather reading)",
          p, quads));
    }
  }
  return moved ? OnShape(batch, std::move(swept.profiles)) : std::move(batch);
}

}  // namespace

Status CheckReading(int width, int step, const SrdOptions& options) {
  if (width % step == 0) return Status::Ok();
  if (options.reading == SrdReading::kGather && options.distance == SrdDistance::kTangentPlane) return Status::Ok();
  return Status::Usage("srd: each sweep keeps only combs that move by " + std::to_string(step) +
                       " columns, but lines are " + std::to_string(width) +
                       " wide: reading 'scatter' and distance 'surface' need all of them (--frames)");
}

Result<SrdSet> ExtractSrds(const SessionFrames& frames, const FaceShape& shape, const SrdOptions& options,
                           Logger& logger, std::vector<SweepFigure>& figures) {
  SLX_RETURN_IF_ERROR(options.Validate());
  const PlanOptions& plan = *frames.plan();
  SrdSet set;
  set.pool = options.pool;
  set.spacing_mm = QuadSpacingMm(shape.surface) * options.pool;
  set.channels = QuadChannels(frames.calibration()->camera.cfa);
  bool any = false;
  for (PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    if (axis == PatternAxis::kRows && !frames.row_sweep()) continue;
    const CombCycle cycle{plan.comb_period, plan.comb_width, plan.comb_step * frames.comb_every(), plan.exposure_ms,
                          axis};
    SLX_RETURN_IF_ERROR(cycle.Validate());
    SLX_RETURN_IF_ERROR(CheckReading(cycle.width, cycle.step, options));
    for (int p = 0; p < static_cast<int>(frames.calibration()->projectors.size()); ++p) {
      SweepFigure figure;
      SLX_ASSIGN_OR_RETURN(auto batch, ExtractSweep({frames, p, cycle}, shape, options, logger, set, figure));
      any = any || figure.profiles_by_reason.contains(ToString(SrdReason::kValid));
      (axis == PatternAxis::kColumns ? set.batches : set.row_batches).push_back(std::move(batch));
      figures.push_back(figure);
    }
  }
  if (!any && std::any_of(figures.begin(), figures.end(), [](const SweepFigure& f) { return f.missing_frames > 0; }))
    return Status::Failed(
        "session " + frames.info().id +
        " lacks frames of its sweeps, and what is there shows no profile (its reasons: `stratalux-db show`); capture "
        "the visitor again");
  return set;
}

}  // namespace stratalux::fit
