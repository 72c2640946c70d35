// SPDX-License-Identifier: Apache-2.0
// Holds each frame of a store's latest session against the loop's scene (loop_scene.h), which the capture knows nothing
// of.
//   rig-vm-judge STORE
// Prints "FRAMES MISASSOCIATED": frames that count as proven, and those among them that do not show their pattern.
// A step's last shot counts, unless its level check failed: that is said, not mistaken. Exit 1 where one is mistaken.
#include <cmath>
#include <iostream>
#include <map>

#include "db/catalogue/session_store.h"
#include "shared/capture/plan.h"
#include "tests/rig-vm/loop_scene.h"

namespace stratalux::rig {
namespace {

Result<bool> ShowsItsPattern(const Image<uint16_t>& pixels, const FrameRecord& record, const PlanOptions& plan) {
  if (pixels.width() != kLoopWidth || pixels.height() != kLoopHeight) return Status::Failed("a frame of another size");
  std::vector<double> expected(pixels.size(), kLoopBlack_dn);
  for (int p = 0; p < plan.projectors; ++p) {
    if (record.projector >= 0 && p != record.projector) continue;
    const std::vector<float> light = LoopLight(record.pattern, p, plan.projector_width, plan.projector_height);
    for (size_t i = 0; i < light.size(); ++i) expected[i] += light[i];
  }
  double sum = 0.0;
  for (size_t i = 0; i < expected.size(); ++i) {
    const double off = pixels.data()[i] - expected[i];
    sum += off * off;
  }
  // Twice the noise: the smallest wrong pattern, a comb moved by one step, is several times that.
  return std::sqrt(sum / static_cast<double>(expected.size())) < 2.0 * kLoopNoise_dn;
}

Result<int> Judge(const std::string& folder) {
  SLX_ASSIGN_OR_RETURN(const db::SessionStore store, db::SessionStore::Open(folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const std::vector<db::SessionSummary> sessions, store.ListSessions());
  if (sessions.empty()) {  // a capture that ended before its first frame leaves none
    std::cout << "0 0\n";
    return 0;
  }
  SLX_ASSIGN_OR_RETURN(const db::SessionRow session, store.FindSession(sessions.front().info.id));
  SLX_ASSIGN_OR_RETURN(const PlanOptions plan, PlanOptionsFromJson(session.info.plan_json));
  SLX_ASSIGN_OR_RETURN(const std::vector<db::FrameRow> rows, store.ListFrames(session.info.id));
  std::map<int, const db::FrameRow*> last;  // by step
  for (const db::FrameRow& row : rows) {
    const db::FrameRow*& known = last[row.record.step];
    if (known == nullptr || row.record.retry >= known->record.retry) known = &row;
  }
  int proven = 0, mistaken = 0;
  for (const auto& [step, row] : last) {
    if (row->record.level_check == LevelCheck::kFailed) continue;
    SLX_ASSIGN_OR_RETURN(const Image<uint16_t> pixels, store.ReadFrame(session.info.id, *row));
    SLX_ASSIGN_OR_RETURN(const bool shows, ShowsItsPattern(pixels, row->record, plan));
    ++proven;
    if (shows) continue;
    ++mistaken;
    std::cerr << "step " << step << " does not show " << row->record.pattern.ToString() << "\n";
  }
  std::cout << proven << " " << mistaken << "\n";
  return mistaken;
}

}  // namespace
}  // namespace stratalux::rig

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: rig-vm-judge STORE\n";
    return 2;
  }
  const auto mistaken = stratalux::rig::Judge(argv[1]);
  if (!mistaken.ok()) std::cerr << "rig-vm-judge: " << mistaken.status().message() << "\n";
  return mistaken.ok() && *mistaken == 0 ? 0 : 1;
}
