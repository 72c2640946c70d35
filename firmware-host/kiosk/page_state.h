// SPDX-License-Identifier: Apache-2.0
// What the visitors' screens are told, and which presses of them count. No socket, no clock of its own.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/kiosk/visit_actions.h"
#include "firmware-host/kiosk/visit_events.h"

namespace stratalux::rig {

// A press as it came.
struct PagePress {
  std::string verb;
  std::string nonce, screen;  // of the state that the presser saw
  std::string language;       // of the verb "language"
  bool research = false, publication = false;
};

struct PressVerdict {
  int status = 204;    // 403 another visit's nonce, 404 no such verb, 409 not on this screen or pressed twice, 400
  std::string reason;  // for a person
  std::optional<VisitEvent> event;
  bool changed = false;  // what screens are told
};

class PageState {
 public:
  using Moment = std::chrono::steady_clock::time_point;
  // `languages`: ids; the first is what a visit begins with. `opens`: KioskPageOptions.
  explicit PageState(std::vector<std::string> languages, std::string opens = "")
      : languages_(std::move(languages)), opens_(std::move(opens)) {}

  // `fresh_nonce` takes the old one's place where a visit begins or ends. False: a step of a progress that comes too
  // soon after the one that was told to be worth telling.
  bool Show(const action::Show& show, const std::string& fresh_nonce, Moment now);
  // True: worth telling.
  bool SetTicket(const std::string& code);
  // Another picture is there, until the screen is another one.
  void NextPreview() {
    ++preview_;
    seen_ = true;
  }
  // Now and then: a step that was not told is, and a while after a visit the next one is greeted in the first language
  // again. True: worth telling.
  bool Rest(Moment now);

  // Of two presses on one screen within a second the second does not count, but for Leave.
  [[nodiscard]] PressVerdict Press(const PagePress& press, Moment now);

  [[nodiscard]] const action::Show& shown() const { return shown_; }
  [[nodiscard]] const std::string& ticket() const { return ticket_; }
  [[nodiscard]] const std::vector<std::string>& languages() const { return languages_; }
  // For the event "state": one line of JSON (docs/kiosk-page.md).
  [[nodiscard]] std::string Json() const;

 private:
  [[nodiscard]] PressVerdict PressLanguage(const PagePress& press, Moment now);

  std::vector<std::string> languages_;
  std::string opens_;
  action::Show shown_{Phase::kClosed, Word::kNone, {}, 0, 0, {}, false};
  std::string nonce_, ticket_;
  size_t language_ = 0;
  bool untold_ = false, seen_ = false;
  int64_t visit_ = 0, preview_ = 0;
  std::optional<Moment> told_, pressed_;
  Moment touched_;
};

}  // namespace stratalux::rig
