// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/board_stage.h"

#include <algorithm>
#include <map>
#include <set>

#include "fitter/session/quad_signal.h"
#include "fitter/stages/decode.h"

namespace stratalux::fit {
namespace {

constexpr Pattern kWhite{.kind = PatternKind::kWhite};
constexpr Pattern kBlack{.kind = PatternKind::kBlack};

// Projectors that show codes.
int CountProjectors(const SessionFrames& frames) {
  int count = 0;
  for (const db::FrameRow& row : frames.rows())
    if (row.record.pattern.kind == PatternKind::kGray) count = std::max(count, row.record.projector + 1);
  return count;
}

// The poses of a session: numbered ones, or the whole session as one.
std::vector<int> NumberedPoses(const SessionFrames& frames) {
  std::vector<int> poses = frames.poses();
  if (poses.size() > 1) std::erase(poses, -1);  // pre-roll frames belong to none
  return poses;
}

// Mean of the last code pair that the projector shows: together, all of it is white once more, at half the light.
// Empty where the pair was not captured.
Result<Image<uint16_t>> MeanOfLastCodes(const SessionFrames& frames, int projector, int pose, int rows) {
  const int bits = GrayBits(rows);
  Pattern code{.kind = PatternKind::kGray, .axis = PatternAxis::kRows, .bit = bits - 1, .bits = bits};
  Pattern inverted = code;
  inverted.inverse = true;
  for (const Pattern& pattern : {code, inverted})
    if (frames.Find(projector, CapturePhase::kCorrespondence, pattern, pose) == nullptr) return Image<uint16_t>();
  SLX_ASSIGN_OR_RETURN(auto mean, frames.Read(projector, CapturePhase::kCorrespondence, code, pose));
  SLX_ASSIGN_OR_RETURN(const auto inverse, frames.Read(projector, CapturePhase::kCorrespondence, inverted, pose));
  for (size_t i = 0; i < mean.size(); ++i)
    mean.pixels()[i] = static_cast<uint16_t>((uint32_t{mean.pixels()[i]} + inverse.pixels()[i]) / 2);
  return mean;
}

// A corner's place in a projector is a column and a row.
Status RequireBothAxes(const SessionFrames& frames, int projector, int pose) {
  const CodedAxes coded = CodedAxesOf(frames, projector, pose);
  if (coded.columns && coded.rows) return Status::Ok();
  const std::string name = "projector " + std::to_string(projector);
  if (!coded.columns && !coded.rows)
    return Status::NotFound(name + " shows no codes; capture those of columns and rows");
  return Status::NotFound(name + " has codes of " + (coded.columns ? "columns" : "rows") +
                          " alone; boards need both axes: capture the codes of " +
                          (coded.columns ? "rows" : "columns") + ", too");
}

Result<ProjectorPictures> PicturesOf(const SessionFrames& frames, int projector, int pose, int rows,
                                     double saturation_dn) {
  SLX_RETURN_IF_ERROR(RequireBothAxes(frames, projector, pose));
  const db::FrameRow* row = frames.Find(projector, CapturePhase::kReference, kWhite, pose);
  SLX_ASSIGN_OR_RETURN(const auto white, frames.Read(projector, CapturePhase::kReference, kWhite, pose));
  SLX_ASSIGN_OR_RETURN(const auto black, frames.Read(projector, CapturePhase::kReference, kBlack, pose));
  SLX_ASSIGN_OR_RETURN(const auto codes, MeanOfLastCodes(frames, projector, pose, rows));
  Image<float> dark(black.width(), black.height());
  ProjectorPictures pictures{projector, {}, {}, Image<uint8_t>(white.width(), white.height())};
  for (size_t i = 0; i < dark.size(); ++i) {
    dark.pixels()[i] = black.pixels()[i];
    pictures.saturated.pixels()[i] = white.pixels()[i] >= saturation_dn;
  }
  pictures.white_light = BoardLight(white, dark, row->record.cfa);
  if (!codes.empty()) pictures.codes_light = BoardLight(codes, dark, row->record.cfa);
  return pictures;
}

Result<PoseObservation> ObservePose(const SessionFrames& frames, int pose, const std::string& pose_name,
                                    const CalibrationObservations& known, const BoardStageOptions& options,
                                    Logger& logger) {
  const SensorNoise noise = NoiseOf(frames);
  const CodeSize code = CodeSizeOf(frames);
  const int projectors = static_cast<int>(known.projectors.size());
  std::vector<ProjectorPictures> pictures;
  for (int p = 0; p < projectors; ++p) {
    SLX_ASSIGN_OR_RETURN(auto of_projector, PicturesOf(frames, p, pose, code.rows, noise.saturation_dn));
    if (of_projector.codes_light.empty())
      logger.Warning(
          pose_name + ": projector " + std::to_string(p) +
          "'s finest row code was captured without its inverse: only the white frames tell whether the board held "
          "still");
    pictures.push_back(std::move(of_projector));
  }
  SLX_ASSIGN_OR_RETURN(const auto corners, FindStillBoard(pictures, options.board, options.observe));
  pictures.clear();
  const FrameRecord& record = frames.Find(0, CapturePhase::kReference, kWhite, pose)->record;
  PoseObservation observation{pose, pose_name, {}};
  for (const BoardCorner& corner : corners)
    observation.corners.push_back({corner.corner, corner.pixel_px + Eigen::Vector2d(record.crop_x, record.crop_y),
                                   std::vector<std::optional<Eigen::Vector2d>>(known.projectors.size())});
  for (int p = 0; p < projectors; ++p) {
    const std::string name = "projector " + std::to_string(p);
    if (const std::string note = UnreadPatterns(frames, p, pose); !note.empty()) logger.Warning(note);
    SLX_ASSIGN_OR_RETURN(const auto decoded, DecodeProjector(frames, p, pose, code.columns, code.rows, noise));
    auto seen = LookUpCorners(decoded.map, corners, {code.columns, code.rows}, options.observe);
    if (!seen.ok()) return seen.status().WithContext(name);
    if (!seen->seen) logger.Warning(pose_name + ": " + name + " lights too few corners; it is left out of this pose");
    for (size_t i = 0; seen->seen && i < corners.size(); ++i)
      observation.corners[i].projector_px[p] = seen->column_row[i];
  }
  return observation;
}

DeviceSize CameraSize(const SessionFrames& frames, const BoardStageOptions& options) {
  if (options.camera_size) return *options.camera_size;
  if (frames.calibration())
    return {frames.calibration()->camera.model.width, frames.calibration()->camera.model.height};
  const SessionDevices& devices = frames.info().devices;
  if (devices.camera_width > 0 && devices.camera_height > 0) return {devices.camera_width, devices.camera_height};
  DeviceSize size;
  for (const db::FrameRow& row : frames.rows()) {
    size.width = std::max(size.width, row.record.crop_x + row.record.width);
    size.height = std::max(size.height, row.record.crop_y + row.record.height);
  }
  return size;
}

DeviceSize ProjectorSize(const SessionFrames& frames, const BoardStageOptions& options, Logger& logger) {
  if (options.projector_size) return *options.projector_size;
  const CodeSize code = CodeSizeOf(frames);
  const SessionDevices& devices = frames.info().devices;
  if (!frames.plan() && (devices.projector_width == 0 || devices.projector_height == 0))
    logger.Warning("session " + frames.info().id + " does not say how large its projectors are: taken as " +
                   std::to_string(code.columns) + "x" + std::to_string(code.rows) +
                   ", the largest size that their codes can number; give --projector-size");
  return {code.columns, code.rows};
}

// What all sessions must agree in.
Status CheckSession(const SessionFrames& frames, const BoardStageOptions& options, BoardPoses& boards, Logger& logger) {
  const std::string name = "session " + frames.info().id;
  const int projectors = CountProjectors(frames);
  if (projectors == 0)
    return Status::Usage(name + " (" + ToString(frames.info().kind) +
                         ") has no codes; capture with --kind calibration");
  const CodeSize code = CodeSizeOf(frames);
  const DeviceSize camera = CameraSize(frames, options);
  CalibrationObservations& o = boards.observations;
  if (o.projectors.empty()) {
    o.board = options.board;
    o.camera = camera;
    o.projectors.assign(static_cast<size_t>(projectors), ProjectorSize(frames, options, logger));
    boards.code = code;
  }
  // Of imports, one may say how large its projectors are and another not: a size that is given stands for both.
  const auto agree = [&](int a, int b) { return a == b || (options.projector_size && GrayBits(a) == GrayBits(b)); };
  const bool same = o.camera.width == camera.width && o.camera.height == camera.height &&
                    o.projectors.size() == static_cast<size_t>(projectors) &&
                    agree(boards.code.columns, code.columns) && agree(boards.code.rows, code.rows);
  return same ? Status::Ok()
              : Status::Usage(name + " has another camera or other projectors than session " + boards.sessions[0] +
                              "; calibrate sessions of one rig together");
}

// Oldest first, whatever order they are given in: of two attempts at a pose the younger counts.
Result<std::vector<std::string>> ByTime(const std::string& folder, const std::vector<std::string>& sessions) {
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(folder, db::AccessMode::kReadOnly));
  std::map<std::pair<int64_t, size_t>, std::string> by_time;  // as given, of one time
  std::set<std::string> seen;
  for (const std::string& selector : sessions) {
    SLX_ASSIGN_OR_RETURN(const auto session, store.FindSession(selector));
    const SessionInfo& info = session.info;
    if (!seen.insert(info.id).second) return Status::Usage("session " + info.id + " is given twice");
    by_time[{info.started_wall.ns, by_time.size()}] = info.id;
  }
  std::vector<std::string> ids;
  for (const auto& [time, id] : by_time) ids.push_back(id);
  return ids;
}

// A pose that could not be used. `attempt`: its number, where its session holds it alone; -1.
struct LeftOut {
  int attempt = -1;
  std::string why;
};

}  // namespace

Result<BoardPoses> ObserveBoards(const std::string& store, const std::vector<std::string>& sessions,
                                 const BoardStageOptions& options, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.board.Validate());
  BoardPoses boards;
  SLX_ASSIGN_OR_RETURN(boards.sessions, ByTime(store, sessions));
  std::map<int, std::string> attempts;  // observed poses that have a session to themselves: their names
  std::vector<LeftOut> left_out;
  for (const std::string& id : boards.sessions) {
    SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(store, id));
    for (const std::string& note : frames.store().notes()) logger.Warning(note);
    SLX_RETURN_IF_ERROR(CheckSession(frames, options, boards, logger));
    boards.saturation_dn = frames.record() ? frames.info().devices.saturation_dn : SaturationOf(frames);
    if (frames.record()) boards.calibration = frames.record();
    const std::vector<int> poses = NumberedPoses(frames);
    for (const int pose : poses) {
      const std::string name = pose >= 0 ? "pose " + std::to_string(pose) + " (session " + id + ")" : "session " + id;
      const int attempt = poses.size() == 1 ? pose : -1;
      auto observed = ObservePose(frames, pose, name, boards.observations, options, logger);
      if (!observed.ok()) {
        // What the disk or the store has to say ends the work; what the board has to say, this pose.
        if (observed.status().code() == StatusCode::kIntegrity) return observed.status();
        left_out.push_back({attempt, name + ": " + observed.status().message()});
        logger.Warning(left_out.back().why);
        continue;
      }
      if (attempt >= 0) {
        std::string& earlier = attempts[attempt];
        if (!earlier.empty()) logger.Info(earlier + " is replaced by session " + id);
        std::erase_if(boards.observations.poses, [&](const PoseObservation& o) { return o.name == earlier; });
        earlier = name;
      }
      boards.observations.poses.push_back(std::move(observed).value());
      logger.Info(name + ": " + std::to_string(boards.observations.poses.back().corners.size()) + " corners");
    }
  }
  for (LeftOut& pose : left_out)
    if (!attempts.contains(pose.attempt)) boards.left_out.push_back(std::move(pose.why));
  if (boards.observations.poses.empty())
    return Status::Failed(boards.left_out.empty() ? "no board pose in the sessions" : boards.left_out.front());
  return boards;
}

}  // namespace stratalux::fit
