// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig plan show|render`.
#pragma once

#include <filesystem>
#include <string>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/sequence/deadlines.h"
#include "firmware-host/sequence/visit_time.h"
#include "firmware-host/simulated/device_options.h"
#include "shared/base/result.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

// The rig's own delays: as configured, else as `learnt` (may be null), else the defaults.
[[nodiscard]] VisitTiming TimingOf(const RigConfig& config, const RigDelays* learnt = nullptr);
// Of a capture on the simulated rig: its devices' timing in place of the configured one.
[[nodiscard]] VisitTiming TimingOf(const RigConfig& config, const RigTiming& simulated);

// A table for people: one line a step, then frames and duration, then the deadlines and where they come from.
[[nodiscard]] std::string PlanAsText(const CapturePlan& plan, const VisitTiming& timing, const RigDeadlines& deadlines);
// {"options": {...}, "frames": n, "seconds": s, "steps": [{"step", "projector", "phase", "pattern", "exposure_ms",
// "bracket"}], "deadlines": {"source": "default|learnt|configured|flag", "longest_ms", "learnt_at", "sync_ms": [...],
// "frame_ms", "refused"}}; those of what was learnt where it is used, `refused` where what was kept is not.
[[nodiscard]] std::string PlanAsJson(const CapturePlan& plan, const VisitTiming& timing, const RigDeadlines& deadlines);
// Each distinct pattern once as an 8-bit PNG of the projector's size (255 = white, linear light), "000-white.png"; once
// more as bit planes for pattern memories, patterns-1bit.bin and, of grey ones, patterns-8bit.bin
// (pattern_memory_file.h); and plan.json, whose steps name their files and whose sequences say what each TRIGGER pulse
// of a projector shows. Creates `folder`; fails where a file cannot be written.
Status RenderPlan(const CapturePlan& plan, const VisitTiming& timing, const std::filesystem::path& folder);

}  // namespace stratalux::rig
