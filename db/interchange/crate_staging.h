// SPDX-License-Identifier: Apache-2.0
// The folder beside OUT in which a crate grows, OUT.partial: whole under its final name or not at all. Internal to
// db/interchange.
#pragma once

#include <filesystem>

#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {

class CrateStaging {
 public:
  // Empty and ours alone: the remains of a broken-off export are removed. kUsage where OUT holds something already, or
  // OUT.partial something that no export of ours wrote; kBusy while another process writes it.
  [[nodiscard]] static Result<CrateStaging> Take(const std::filesystem::path& out);
  // Not kept: removed with all that is in it.
  ~CrateStaging();
  CrateStaging(CrateStaging&& other) noexcept;
  CrateStaging& operator=(CrateStaging&&) = delete;

  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }
  [[nodiscard]] const std::filesystem::path& out() const { return out_; }
  // Synced, then renamed to OUT.
  Status Keep();

 private:
  CrateStaging() = default;
  std::filesystem::path out_, folder_;
  UniqueFd lock_;
  bool mine_ = false;
};

}  // namespace stratalux::db
