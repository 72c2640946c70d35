// SPDX-License-Identifier: Apache-2.0
// [kiosk] of the rig's configuration file (docs/kiosk.md).
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux {
class TomlTable;
}

namespace stratalux::rig {

// Minutes since midnight, local time. From `opens` to before `closes`; over midnight where that is the earlier one.
struct OpeningHours {
  int opens = 0, closes = 0;

  [[nodiscard]] bool IsOpenAt(int minute) const {
    return opens <= closes ? opens <= minute && minute < closes : opens <= minute || minute < closes;
  }
};

// [kiosk.page]: what visitors and operators see in a browser (docs/kiosk-page.md).
struct KioskPageConfig {
  std::string address = "127.0.0.1";
  int port = 8080;
  std::string token_file;           // of all who look at it; none: loopback alone
  std::string operator_token_file;  // none: nobody is an operator
  std::vector<std::string> host_names;
  std::string ticket_text = "{code}";        // what the ticket's QR code says
  std::string page_folder, language_folder;  // others than those that come with the program
};

struct KioskConfig {
  std::optional<OpeningHours> hours;  // nullopt: always open
  // What the visitor is shown; the consent of each visit names one of both.
  std::vector<std::string> languages = {"en", "de", "ja"};
  std::vector<std::string> consent_texts = {"1"};  // versions, the newest first
  std::string paper_scope;                         // "fit,research": the text was agreed to on paper; empty: it was not
  std::string retention = "standard";
  int attempts = 3;  // of a visit
  int countdown_s = 3;
  int steady_looks = 2;  // pre-scans in a row that find the face in its place
  // Longest that each may take.
  int question_s = 60, consent_s = 180, position_s = 120, capture_s = 90, gate_s = 30, thanks_s = 60;
  int forgetting_s = 120, selfcheck_s = 120;
  int calibration_days = 0;  // an older calibration closes the kiosk; 0: one that the store holds is good enough
  // Of the face, by the pre-scan: shares of the frame; distances from the camera, 0: not asked, not measured.
  double margin = 0.01, height = 0.25, off_centre = 0.12;
  double nearest_mm = 0.0, furthest_mm = 0.0;
  double snr = 0.5;                     // of the wanted signal-to-noise ratio: below, nothing is captured
  double most_saturated = 0.01;         // of the lit samples of a capture
  double least_coverage = 0.7;          // of what the pre-scan lit
  std::optional<KioskPageConfig> page;  // nullopt: lines on stdin and stdout
};

// kUsage with file:line where hours or scope are none; other keys by TomlTable::Finish.
[[nodiscard]] Result<KioskConfig> ReadKiosk(TomlTable kiosk);

}  // namespace stratalux::rig
