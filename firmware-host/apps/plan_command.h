// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig plan show|render`.
#pragma once

#include <filesystem>
#include <string>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/projector/memory_layout.h"
#include "firmware-host/sequence/deadlines.h"
#include "firmware-host/sequence/visit_time.h"
#include "firmware-host/simulated/device_options.h"
#include "shared/base/result.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

// With the pattern memories' way from their rest to the section of the configuration's plan. The rig's own delays: as
// configured, else as `learnt` (may be null), else the defaults.
[[nodiscard]] VisitTiming TimingOf(const RigConfig& config, const RigDelays* learnt = nullptr);
// Of a capture on the simulated rig: its devices' timing in place of the configured one.
[[nodiscard]] VisitTiming TimingOf(const RigConfig& config, const RigTiming& simulated);

// Tables for people: one line a step, then frames and duration, the deadlines and where they come from; one line a
// section of each pattern memory.
[[nodiscard]] std::string PlanAsText(const CapturePlan& plan, const VisitTiming& timing, const MemoryLayout& layout,
                                     const RigDeadlines& deadlines);
// {"options": {...}, "frames": n, "seconds": s, "memory": {...}, "steps": [{"step", "projector", "phase", "pattern",
// "exposure_ms", "bracket"}]}. "memory": {"capacity": n or null, "projectors": [{"projector", "patterns", "sections":
// [{"section", "first", "count"}]}], "left_out": [{"section", "why"}]}. "deadlines": {"source":
// "default|learnt|configured|flag", "longest_ms", "learnt_at", "sync_ms": [...], "frame_ms", "refused"}; those of what
// was learnt where it is used, `refused` where what was kept is not.
[[nodiscard]] std::string PlanAsJson(const CapturePlan& plan, const VisitTiming& timing, const MemoryLayout& layout,
                                     const RigDeadlines& deadlines);
// Each distinct pattern of plan and layout once as an 8-bit PNG of the projector's size (255 = white, linear light),
// "000-white.png"; once more as bit planes for pattern memories, patterns-1bit.bin and, of grey ones, patterns-8bit.bin
// (pattern_memory_file.h); and plan.json: that of PlanAsJson, its steps with their files, "patterns" [{"pattern",
// "file", "memory": {"file", "index"}}], and each projector's "sequence": the places in "patterns" that its TRIGGER
// pulses show. Creates `folder`; fails where a file cannot be written.
Status RenderPlan(const CapturePlan& plan, const VisitTiming& timing, const MemoryLayout& layout,
                  const std::filesystem::path& folder);

}  // namespace stratalux::rig
