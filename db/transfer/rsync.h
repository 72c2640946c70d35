// SPDX-License-Identifier: Apache-2.0
// rsync, which neither asks nor hangs: unattended pulls end with an error that names the remedy.
#pragma once

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::db {

struct RsyncLimits {
  std::chrono::seconds timeout{60};                                    // without a byte from the other side
  std::optional<std::chrono::steady_clock::time_point> deadline = {};  // for all of it
};

struct RsyncOptions {
  std::vector<std::string> arguments;
  RsyncLimits limits = {};
};

// Copies `source` (host:path or a local path, a folder with its slash) into the folder `target`; returns what rsync
// printed. kIntegrity where single files could not be read or vanished; the others are there then. kFailed: no contact,
// no space and the like. kTryAgain: the deadline; what was copied of a file stays for the next time. kNotFound where
// rsync is missing, with the package's name. ssh is run with BatchMode (no questions), ConnectTimeout and
// ServerAliveInterval, unless $RSYNC_RSH says how to run it.
[[nodiscard]] Result<std::string> Rsync(const RsyncOptions& options, const std::string& source,
                                        const std::filesystem::path& target);

}  // namespace stratalux::db
