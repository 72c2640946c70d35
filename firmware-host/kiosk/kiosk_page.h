// SPDX-License-Identifier: Apache-2.0
// The kiosk's page: shows visitors and operators what the machine shows, and tells it what they press
// (docs/kiosk-page.md).
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/kiosk/selfcheck_trend.h"
#include "firmware-host/kiosk/visit_actions.h"
#include "firmware-host/kiosk/visit_events.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/frame_record.h"
#include "shared/image/image.h"
#include "shared/units/time.h"

namespace stratalux::rig {

struct KioskPageOptions {
  std::string address = "127.0.0.1";
  int port = 0;  // 0: any free one
  // Of whoever looks at any of it (http::ReadTokenFile); may be empty on loopback alone.
  std::string token;
  std::string operator_token;  // empty: nobody is an operator
  std::vector<std::string> host_names;
  // Of the page's files and words; empty: those that come with the program (share/stratalux/kiosk).
  std::string page_folder, language_folder;
  std::vector<std::string> languages = {"en", "de", "ja"};  // the first is what every visit begins with
  std::string opens;  // of each day, as a clock says it ("09:30"); empty: always open
  // Whose disk, sessions and calibrations (of `rig`) the operator sees; empty: none.
  std::filesystem::path store;
  std::string rig;
  bool simulated = false;
  // Asked when the next batch is; empty: nobody is. Tests have another one.
  std::string systemctl = "systemctl";
  // Where the day's counts are kept (StateFolder()); empty: they end with the page.
  std::filesystem::path state;
  std::function<WallNs()> wall = WallNow;  // tests set it
  std::string ticket_text = "{code}";  // what a ticket's QR code says: an address with {code} in it, where there is one

  // kUsage names the key and its remedy.
  [[nodiscard]] Status Validate() const;
};

// What is pressed. Called from threads of the server; neither may wait for the page.
struct KioskPageInput {
  std::function<void(const VisitEvent&)> event;
  // Forgets what belongs to a ticket; its Status is shown to the operator. Null: this kiosk has no such command.
  std::function<Status(const std::string& ticket)> withdraw;
};

// Thread-safe. Serves from Start() until it goes.
class KioskPage {
 public:
  // kUsage: options, a language file; kNotFound: the page's files; kBusy: the port is taken. `logger` outlives the
  // page.
  static Result<std::unique_ptr<KioskPage>> Start(const KioskPageOptions& options, KioskPageInput input,
                                                  Logger& logger);
  ~KioskPage();

  void Show(const action::Show& show);
  // Before the screen that thanks: shown on it, and gone with it.
  void ShowTicket(const std::string& code);
  // A visitor's screen has asked for the last one's picture: an operator's, which looks on as well, does not.
  [[nodiscard]] bool TicketFetched() const;
  // A look at whoever sits there, while the screen is kPosition; at most five a second are taken, others ignored.
  void ShowPreview(const FrameRecord& record, ImageView<const uint16_t> frame);
  void Tell(Word word);
  void ShowSelfchecks(const SelfcheckTrend& trend);
  // The machine's loop still turns; /healthz fails ten seconds after the last time.
  void Beat();

  [[nodiscard]] std::string url() const;
  [[nodiscard]] int port() const;
  // The places of `languages`' names, as ConsentChoice counts them.
  [[nodiscard]] const std::vector<std::string>& languages() const;

 private:
  struct Impl;
  explicit KioskPage(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace stratalux::rig
