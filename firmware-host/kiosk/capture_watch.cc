// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/capture_watch.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace stratalux::rig {

CaptureWatch::CaptureWatch(Foreground before, ExposureRule rule, int steps,
                           std::function<void(int done, int of)> progress)
    : before_(std::move(before)), rule_(rule), steps_(steps), progress_(std::move(progress)) {
  lit_.columns = before_.columns;
  lit_.rows = before_.rows;
  lit_.lit.resize(before_.lit.size());
}

void CaptureWatch::OnStepDone(const PlanStep& /*step*/) {
  const int percent = 100 * done_ / steps_;
  ++done_;
  if (100 * done_ / steps_ != percent) progress_(done_, steps_);
}

// One that is shot again comes again; what it was refused for, another picture or the room's light, says nothing.
void CaptureWatch::OnFrame(const FrameRecord& record, const Image<uint16_t>& pixels) {
  if (record.phase != CapturePhase::kReference || record.bracket != 0 || record.projector < 0) return;
  if (record.level_check == LevelCheck::kFailed) return;
  Reference& reference = waiting_[record.projector];
  if (record.pattern.kind == PatternKind::kWhite) reference.white = pixels;
  if (record.pattern.kind == PatternKind::kBlack) reference.black = pixels;
  if (!reference.white || !reference.black) return;
  Look({*reference.white, *reference.black});
  waiting_.erase(record.projector);
}

void CaptureWatch::Look(const PreScan& scan) {
  int64_t samples = 0, saturated = 0;
  for (const LitBlock& block : LitBlocks(scan, rule_.read_noise_dn)) {
    const size_t at = static_cast<size_t>(block.y / kLitBlock * lit_.columns + block.x / kLitBlock);
    if (at < lit_.lit.size()) lit_.lit[at] = 1;
    samples += int64_t{kLitBlock} * kLitBlock;
    for (int j = 0; j < kLitBlock; ++j)
      for (int i = 0; i < kLitBlock; ++i)
        saturated += scan.white(block.x + i, block.y + j) >= rule_.saturation_dn ? 1 : 0;
  }
  if (samples > 0) saturated_ = std::max(saturated_, static_cast<double>(saturated) / static_cast<double>(samples));
}

CaptureFacts CaptureWatch::Facts(const CaptureReport& report, bool taken) const {
  CaptureFacts facts;
  facts.worth = report.status == SessionStatus::kComplete   ? CaptureFacts::Worth::kComplete
                : report.status == SessionStatus::kDegraded ? CaptureFacts::Worth::kDegraded
                                                            : CaptureFacts::Worth::kFailed;
  facts.light_taken = taken;
  for (const Finding& finding : report.findings) switch (finding.kind) {
      case FindingKind::kPreroll:
      case FindingKind::kSilentRig:
      case FindingKind::kNoProof:
      case FindingKind::kWrongPattern:
      case FindingKind::kProofReused:
      case FindingKind::kTriggersUnmatched:
        facts.unproven = true;
        break;
      case FindingKind::kLamp:
      case FindingKind::kBlink:
        facts.lamp = true;
        break;
      case FindingKind::kMixedUp:
        facts.mixed_up = true;
        break;
      case FindingKind::kMoved:
        facts.moved = true;
        break;
      default:
        break;
    }
  facts.saturated_permille = static_cast<int>(std::lround(1000.0 * saturated_));
  if (!before_.lit.empty()) facts.coverage_permille = CoveragePermille(before_, lit_);
  return facts;
}

}  // namespace stratalux::rig
