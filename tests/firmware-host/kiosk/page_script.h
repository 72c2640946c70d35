// SPDX-License-Identifier: Apache-2.0
// The real machine under the real page, in a world that happens as it is told: no rig, no store, no clock.
#pragma once

#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "firmware-host/kiosk/kiosk_page.h"
#include "firmware-host/kiosk/visit_machine.h"

namespace stratalux::rig {

inline constexpr const char* kScriptedTicket = "7K2M-9QXD-4";

class ScriptedKiosk {
 public:
  static Result<std::unique_ptr<ScriptedKiosk>> Start(const KioskPageOptions& options, Logger& logger);

  // From the world. False for a name that is none of TableEvents (visit_cases.h).
  bool Happen(const std::string& name);
  void Happen(const VisitEvent& event);
  // All is good, nobody there.
  void Open();

  [[nodiscard]] VisitState state() const;
  // From the page, in the order in which it came.
  [[nodiscard]] std::vector<VisitEvent> pressed() const;
  [[nodiscard]] KioskPage& page() const { return *page_; }

 private:
  ScriptedKiosk() = default;
  void StepOn(const VisitEvent& event);

  mutable std::mutex mutex_;
  VisitRules rules_;
  VisitState state_;
  std::vector<VisitEvent> pressed_;
  std::unique_ptr<KioskPage> page_;  // before the rest goes, so that nobody presses any more
};

// A picture file as the camera's frame: linear, 12 bits, grey.
struct ScriptedFrame {
  FrameRecord record;
  Image<uint16_t> pixels;
};
[[nodiscard]] Result<ScriptedFrame> FrameOf(const std::filesystem::path& png);

}  // namespace stratalux::rig
