// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/fittable.h"

namespace stratalux::fit {

Status RequireFittable(const SessionFrames& frames, const RunOptions& options) {
  const std::string where = "session " + frames.info().id;
  if (!frames.plan() || frames.info().kind != SessionKind::kVisitor)
    return Status::Usage(where + " is not a visitor's capture: only `decode` can work on it");
  if (!frames.calibration()) return Status::Usage(where + " names no calibration");
  if (frames.info().status == SessionStatus::kFailed || frames.info().status == SessionStatus::kRecording)
    return Status::Failed(where + " is " + ToString(frames.info().status) + ": capture the visitor again");
  const int projectors = static_cast<int>(frames.calibration()->projectors.size());
  if (projectors != frames.plan()->projectors)
    return Status::Usage(where + ": its calibration has " + std::to_string(projectors) + " projectors, its plan " +
                         std::to_string(frames.plan()->projectors));
  if (options.until < Stage::kFit) return Status::Ok();  // nothing is held out
  if (projectors < 2)
    return Status::Usage(where +
                         " has one projector only: the layers are fitted on all projectors but the held-out one, so "
                         "at least two are needed (`stratalux-fit srd` works with one)");
  if (options.heldout >= projectors)
    return Status::Usage("held-out projector " + std::to_string(options.heldout) + " does not exist; allowed: 0 .. " +
                         std::to_string(projectors - 1));
  return Status::Ok();
}

}  // namespace stratalux::fit
