// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/words.h"

#include <array>
#include <cstddef>

namespace stratalux::rig {
namespace {

template <size_t kSize, typename E>
const char* NameIn(const std::array<const char*, kSize>& names, E value) {
  const auto index = static_cast<size_t>(value);
  return index < kSize ? names[index] : "?";
}

}  // namespace

const char* ToString(Phase phase) {
  static constexpr std::array<const char*, kPhases> kNames = {"safe",    "closed",   "idle",       "question",
                                                              "consent", "position", "countdown",  "capture",
                                                              "gate",    "thanks",   "forgetting", "selfcheck"};
  return NameIn(kNames, phase);
}

const char* ToString(Closure closure) {
  static constexpr std::array<const char*, kClosures> kNames = {
      "hours", "space", "calibration", "cleaning", "out_of_order", "device", "fault", "unforgotten", "shutdown"};
  return NameIn(kNames, closure);
}

const char* ToString(Interlock interlock) { return interlock == Interlock::kDoor ? "door" : "emergency_stop"; }
const char* ToString(Device device) { return device == Device::kLines ? "lines" : "camera"; }

const char* ToString(Word word) {
  static constexpr std::array<const char*, kWords> kNames = {"none",           "no_face",
                                                             "closer",         "back",
                                                             "centre",         "brighter",
                                                             "hold",           "moved",
                                                             "saturated",      "lamp",
                                                             "coverage",       "proof",
                                                             "mixed_up",       "light",
                                                             "emergency_stop", "door",
                                                             "stuck",          "device",
                                                             "refused",        "left",
                                                             "time_out",       "sensitive",
                                                             "given_up",       "fault",
                                                             "unforgotten",    "selfcheck_failed",
                                                             "clock_jumped",   "closed",
                                                             "shutdown",       "leftover",
                                                             "drift"};
  return NameIn(kNames, word);
}

const char* ToString(Deadline deadline) {
  static constexpr std::array<const char*, kDeadlines> kNames = {"none",       "question",  "consent", "position",
                                                                 "countdown",  "capture",   "gate",    "thanks",
                                                                 "forgetting", "selfcheck", "reopen"};
  return NameIn(kNames, deadline);
}

const char* ToString(OperatorCommand command) {
  static constexpr std::array<const char*, kOperatorCommands> kNames = {"clean", "out_of_order", "open", "selfcheck",
                                                                        "reset"};
  return NameIn(kNames, command);
}

}  // namespace stratalux::rig
