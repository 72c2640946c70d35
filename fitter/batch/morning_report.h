// SPDX-License-Identifier: Apache-2.0
// The morning's report of a night: a page, and the same as text for a mail.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include "fitter/batch/morning_facts.h"
#include "fitter/report/html_report.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct MorningReport {
  Report page;
  std::string text;  // lines of at most 100 characters where words allow, no control characters
};

// Pictures of faces only of visits that are not encrypted (`store` has them); of all others no pixel leaves its seal.
[[nodiscard]] MorningReport ReportOf(const MorningFacts& facts, const std::filesystem::path& store);

// report.html and report.txt in the night's folder; the page's path. Wiped and made again for whoever is forgotten
// meanwhile; where that cannot be asked once it is made, wiped: an error.
// `gathered`: called before the files are replaced (tests forget somebody there).
[[nodiscard]] Result<std::filesystem::path> WriteMorningReport(const std::filesystem::path& store,
                                                               const std::string& night,
                                                               const std::function<void()>& gathered = {});

}  // namespace stratalux::fit
