// SPDX-License-Identifier: Apache-2.0
// What a simulated capture knows of the truth, as .npy arrays of a crate: truth/NNN-name.npy, truth/maps.csv and
// truth/truth_calibration.json. Internal to db/interchange.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "db/segment/truth_segment.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::db {

class CrateTruth {
 public:
  // None of it for a session without truth; kIntegrity where it is damaged.
  [[nodiscard]] static Result<CrateTruth> Open(const std::filesystem::path& session_folder);
  // Relative to the session's folder in the crate.
  [[nodiscard]] std::vector<std::string> Files() const;
  // Makes all of Files() below the session's folder in the crate.
  [[nodiscard]] Status Write(const std::filesystem::path& crate_session) const;

 private:
  CrateTruth() = default;
  std::filesystem::path session_;
  std::optional<TruthSegment> segment_;
  std::vector<std::string> names_;
};

struct CrateTruthMap {
  std::string name, file;
  int width = 0, height = 0, channels = 1;
};
// The rows of truth/maps.csv; empty where there is none. kIntegrity with file:line.
[[nodiscard]] Result<std::vector<CrateTruthMap>> ReadTruthMaps(const std::filesystem::path& crate_session);
// A .npy file as Write() makes it: float32, little-endian, rows top to bottom. kIntegrity for any other.
[[nodiscard]] Result<Image<float>> ReadTruthMap(const std::filesystem::path& crate_session, const CrateTruthMap& map);

}  // namespace stratalux::db
