// SPDX-License-Identifier: Apache-2.0
// A crate of ours, checked from its checksums to the last row. Internal to db/interchange.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/interchange/crate_files.h"
#include "db/interchange/crate_session.h"
#include "shared/base/log.h"

namespace stratalux::db {

class CrateReader {
 public:
  // Format, names, every checksum, the description; see ImportCrate() for what is refused.
  [[nodiscard]] static Result<CrateReader> Open(const std::filesystem::path& crate, Logger& logger);

  [[nodiscard]] const std::vector<std::string>& sessions() const { return sessions_; }
  [[nodiscard]] std::filesystem::path SessionFolder(const std::string& id) const;
  // Facts, plan and calibration of a session, and every row of its table against the files that are there.
  [[nodiscard]] Result<CrateSession> ReadSession(const std::string& id) const;
  // Paths of the crate below "sessions/<id>/fits/", relative to it.
  [[nodiscard]] std::vector<std::string> FitFilesOf(const std::string& id) const;

 private:
  CrateReader() = default;
  [[nodiscard]] Status ReadFormat();
  [[nodiscard]] Status CheckTable(const std::string& id, int64_t frames) const;
  std::filesystem::path crate_;
  CrateFiles files_;
  std::vector<std::string> sessions_;
};

}  // namespace stratalux::db
