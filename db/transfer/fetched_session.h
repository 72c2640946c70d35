// SPDX-License-Identifier: Apache-2.0
// A session's folder as a pull fetched it, before it is adopted. What is no part of the session, and fits that are not
// whole, stay out and keep out nothing else.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::db {

struct LeftOut {
  std::vector<std::string> problems;  // fits that are damaged
  std::vector<std::string> notes;     // segments that the manifest does not name, as a transcode leaves them; fits
                                      // without a record
};

// Removes from `folder`, the copy of a finished session named as it: segments that its manifest does not name, fits
// that their fit.json does not prove (ReadProvenFit), and fits that the source has not registered yet. Later pulls ask
// for these fits again.
[[nodiscard]] Result<LeftOut> LeaveOutUnproven(const std::filesystem::path& folder);

// What `verify` (headers, rows, plan, proofs; db/care/verify.h) says of the session that was adopted: not damage of the
// copy, and not the source's to be refused for.
[[nodiscard]] Result<std::vector<std::string>> DoubtsAbout(const std::filesystem::path& store,
                                                           const std::string& session_id);

}  // namespace stratalux::db
