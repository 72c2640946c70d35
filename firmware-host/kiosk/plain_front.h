// SPDX-License-Identifier: Apache-2.0
// PlainFront: the kiosk without a page. A line of JSON for each screen on one descriptor, a line of words for each
// command from another (docs/kiosk.md, "Without a page").
#pragma once

#include <string>
#include <vector>

#include "firmware-host/config/kiosk_config.h"
#include "firmware-host/kiosk/kiosk_front.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// "agree fit,research de", "operator reset", "start": one line without its end. The languages and texts are those of
// `kiosk`. kUsage names what there is.
[[nodiscard]] Result<VisitEvent> ParseCommand(const std::string& line, const KioskConfig& kiosk);

// {"screen": "gate", "word": "moved", ...}, without the line's end.
[[nodiscard]] std::string ScreenAsJson(const action::Show& screen);

class PlainFront final : public KioskFront {
 public:
  // Descriptors are borrowed. The end of `in` is no command: a kiosk may have no terminal.
  PlainFront(int in, int out, const KioskConfig& kiosk, Logger& logger)
      : in_(in), out_(out), kiosk_(kiosk), logger_(logger) {}

  [[nodiscard]] int fd() const override { return in_; }
  std::vector<VisitEvent> Take() override;
  void Show(const action::Show& screen) override;
  bool GiveTicket(const std::string& code) override;
  void TellOperator(Word word) override;

 private:
  // Given up where nobody reads: a screen that is not seen stops no visit.
  [[nodiscard]] bool Print(const std::string& line);

  int in_;  // -1: at its end
  const int out_;
  const KioskConfig& kiosk_;
  Logger& logger_;
  std::string begun_;  // of the next line
};

}  // namespace stratalux::rig
