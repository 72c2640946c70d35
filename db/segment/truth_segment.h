// SPDX-License-Identifier: Apache-2.0
// Reader of truth.seg: what the simulated rig knows of its own scene. Only fitter/evaluation (and tests) may open it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::db {

class TruthSegment {
 public:
  // kNotFound when the file is not there; kIntegrity when damaged.
  static Result<TruthSegment> Open(const std::filesystem::path& file);
  [[nodiscard]] std::vector<std::string> names() const;
  // kNotFound for an unknown name; kIntegrity on a hash mismatch.
  [[nodiscard]] Result<Image<float>> Read(const std::string& name) const;

 private:
  struct Entry {
    std::string name;
    int64_t offset = 0;
  };
  std::filesystem::path file_;
  std::vector<Entry> entries_;
};

}  // namespace stratalux::db
