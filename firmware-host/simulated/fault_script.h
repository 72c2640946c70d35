// SPDX-License-Identifier: Apache-2.0
// Faults of the simulated devices, by script and by random seed: the same script and seed, the same faults.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "shared/base/random.h"
#include "shared/base/result.h"

namespace stratalux {
class TomlTable;
}

namespace stratalux::rig {

enum class FaultKind {
  // At camera exposure `at` (0-based, as triggered).
  kFrameLost,      // the driver counts it, nothing arrives
  kFrameDoubled,   // arrives twice
  kFrameExtra,     // followed by one nobody asked for, with a number of its own
  kFrameLate,      // starts `value` ms late (default 200)
  kFrameStale,     // the buffer of the exposure before arrives instead, with its old number and time
  kFrameFrozen,    // old pixels under the new number and time: only the picture tells
  kFrameCorrupt,   // a torn picture, flagged by the driver
  kFrameGarbled,   // rows moved sideways from one row on, not flagged
  kFrameTorn,      // from one row on, the rows of the frame before; not flagged
  kExposureLatch,  // a change of exposure takes effect one frame late
  kSubjectMoved,   // by `value` mm to the side, from then on (default 2)
  kSubjectSwayed,  // out and back over `count` exposures, half a sine in steps of its half; `value` mm `along`
                   // (default 0.5)
  kLampDrift,      // the projectors' light is `value` times what it was, from then on (default 0.9)
  kLampBlink,      // the projectors' light is `value` times what it was, in `count` exposures alone (default 0.8)
  kCameraGone,     // the driver reports an error for `count` frames
  kFrameSlow,      // comes `value` ms later than it was read out (default 60), of the right number and time
  // At projector TRIGGER pulse `at` (0-based).
  kEdgeLost,       // the SYNC edge does not come; the pattern does
  kEdgeDoubled,    // the SYNC edge comes twice
  kSyncStuck,      // no SYNC edge for `count` pulses
  kProjectorLag,   // the pattern stays, the SYNC edge comes: one step behind from then on
  kProjectorSkip,  // two patterns on at once
  kLinesGone,      // the chip reports an error for `count` pulses
  kEmergencyStop,  // the button is pressed after the pulse: the lines drop every ENABLE, and the interlock opens
  kDoorOpen,       // as the door
};
inline constexpr int kFaultKinds = 24;

[[nodiscard]] const char* ToString(FaultKind kind);  // "frame_lost", ...
[[nodiscard]] Result<FaultKind> ParseFaultKind(const std::string& text);
[[nodiscard]] constexpr bool IsLineFault(FaultKind kind) { return kind >= FaultKind::kEdgeLost; }

struct Fault {
  FaultKind kind = FaultKind::kFrameLost;
  int64_t at = 0;
  int64_t count = 1;                              // from `at` on, that many in a row
  double value = 0.0;                             // 0: the kind's default
  std::array<double, 3> along = {1.0, 0.0, 0.0};  // of a sway, in the rig's frame; any length but 0
};

struct FaultOptions {
  std::vector<Fault> script;
  uint64_t seed = 1;
  double rate = 0.0;             // chance of a random fault at each exposure and each pulse
  std::vector<FaultKind> kinds;  // of the random faults; empty: all that do not end a session
  // Of the random faults: they come in runs of 1 to `burst` exposures or pulses, each of its own kind, and with the
  // chance `pair` a second kind comes at once.
  int burst = 1;
  double pair = 0.0;
};

// "frame_lost@17", "lamp_drift@40=0.95", "edge_lost@3x2".
[[nodiscard]] Result<Fault> ParseFault(const std::string& text);
// [[fault]] kind, at, count, value, along; [faults] seed, rate, kinds.
[[nodiscard]] Result<FaultOptions> ReadFaults(TomlTable& root);

// What a script and a seed say. Reentrant.
class FaultScript {
 public:
  explicit FaultScript(FaultOptions options) : options_(std::move(options)) {}
  [[nodiscard]] std::vector<Fault> AtExposure(int64_t number) const { return At(number, Where::kExposure); }
  [[nodiscard]] std::vector<Fault> AtPulse(int64_t number) const { return At(number, Where::kPulse); }

 private:
  enum class Where { kExposure, kPulse };
  [[nodiscard]] std::vector<Fault> At(int64_t number, Where where) const;
  [[nodiscard]] Random DrawsAt(int64_t number, Where where) const;
  [[nodiscard]] bool InBurst(int64_t number, Where where) const;
  FaultOptions options_;
};

// A fault that happened.
struct InjectedFault {
  FaultKind kind;
  int64_t number;  // of the exposure or pulse
  double seconds;  // on the rig's clock
};

}  // namespace stratalux::rig
