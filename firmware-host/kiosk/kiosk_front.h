// SPDX-License-Identifier: Apache-2.0
// KioskFront: what shows the kiosk's screens and brings in what visitors and operators do. A page, or a script.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "firmware-host/kiosk/selfcheck_trend.h"
#include "firmware-host/kiosk/visit_actions.h"
#include "firmware-host/kiosk/visit_events.h"
#include "shared/base/result.h"
#include "shared/capture/frame_record.h"
#include "shared/image/image.h"

namespace stratalux::rig {

using Withdrawal = std::function<Status(const std::string& visitor)>;

// Used by the kiosk's loop, but for Preview.
class KioskFront {
 public:
  virtual ~KioskFront() = default;
  // Readable when there is something to take.
  [[nodiscard]] virtual int fd() const = 0;
  // What happened, in order. Only Start, NotSensitive, Sensitive, Agree, Refuse, Leave, Operator, PageLost, PageBack
  // and Shutdown are heard; an operator was recognised before.
  virtual std::vector<VisitEvent> Take() = 0;
  virtual void Show(const action::Show& screen) = 0;
  // False: nobody has it, or nobody yet. True says no more than that nothing failed.
  [[nodiscard]] virtual bool GiveTicket(const std::string& code) = 0;
  // After GiveTicket said false, until the next ticket: whether somebody has it by now.
  [[nodiscard]] virtual bool TicketTaken() { return false; }
  virtual void TellOperator(Word word) = 0;
  // A frame of whoever sits there, while the screen is `position`; by the thread that works the rig, which waits
  // meanwhile. It must neither be stored nor leave the machine.
  virtual void Preview(const FrameRecord& /*record*/, const Image<uint16_t>& /*pixels*/) {}
  // What self-checks measured, as it stands now; before anything is shown, and by the thread that works the rig after
  // each check.
  virtual void ShowSelfchecks(const SelfcheckTrend& /*trend*/) {}
  // How to forget a visitor (by pseudonym) whose ticket an operator has, from any thread: RigWorker::Withdraw. Given
  // before anything is shown; null when the kiosk ends: nobody is in it when this returns.
  virtual void ServeWithdrawals(Withdrawal /*withdraw*/) {}
};

}  // namespace stratalux::rig
