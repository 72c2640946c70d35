// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_staging.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>

#include "db/base/durable_file.h"
#include "db/privacy/export_marker.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

Status RefuseUsedFolder(const fs::path& out) {
  std::error_code error;
  const fs::file_status status = fs::symlink_status(out, error);
  if (!fs::exists(status)) return Status::Ok();
  if (!fs::is_directory(status))
    return Status::Usage(out.string() + " exists and is not a folder; choose another name");
  if (!fs::is_empty(out, error) || error)
    return Status::Usage(out.string() + " is not empty; a crate needs a folder of its own, choose another name");
  return Status::Ok();
}

// True where the descriptor is still of the folder that bears the name.
bool IsStill(int fd, const fs::path& folder) {
  struct stat held {
  }, named{};
  return fstat(fd, &held) == 0 && lstat(folder.c_str(), &named) == 0 && held.st_dev == named.st_dev &&
         held.st_ino == named.st_ino;
}

Status Clear(const fs::path& folder) {
  std::error_code error;
  if (fs::is_empty(folder, error) && !error) return Status::Ok();
  // A mark that was being written is one of ours as well.
  const bool marks_alone =
      std::all_of(fs::directory_iterator(folder, error), fs::directory_iterator(),
                  [](const auto& e) { return e.path().filename().string().starts_with(".stratalux-export-"); });
  if (error || (!marks_alone && ExportsIn(folder).empty()))
    return Status::Usage(folder.string() +
                         " exists and is not an interrupted export; move it away or choose another name");
  // The marks go last: what breaks off here is known as an export's remains.
  std::vector<fs::path> names, marks;
  for (const auto& entry : fs::directory_iterator(folder, error))
    (entry.path().filename().string().starts_with(".stratalux-export-") ? marks : names).push_back(entry.path());
  names.insert(names.end(), marks.begin(), marks.end());
  for (const fs::path& name : names) {
    if (!error) fs::remove_all(name, error);
  }
  return error ? Status::Failed("cannot remove the remains in " + folder.string() + ": " + error.message())
               : Status::Ok();
}

}  // namespace

Result<CrateStaging> CrateStaging::Take(const fs::path& out) {
  CrateStaging staging;
  std::error_code error;
  staging.out_ = fs::absolute(out, error).lexically_normal();
  if (!staging.out_.has_filename()) staging.out_ = staging.out_.parent_path();
  if (error || !staging.out_.has_filename())
    return Status::Usage("'" + out.string() + "' is not a valid name for a crate");
  SLX_RETURN_IF_ERROR(RefuseUsedFolder(staging.out_));
  staging.folder_ = staging.out_;
  staging.folder_ += ".partial";
  SLX_RETURN_IF_ERROR(MakeFolder(staging.folder_));
  staging.lock_ = UniqueFd(open(staging.folder_.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
  if (!staging.lock_.ok())
    return Status::Failed("cannot open " + staging.folder_.string() + ": " + std::strerror(errno));
  if (flock(staging.lock_.get(), LOCK_EX | LOCK_NB) != 0 || !IsStill(staging.lock_.get(), staging.folder_))
    return Status::Busy("another export to " + staging.out_.string() +
                        " is running; wait for it or choose another name");
  SLX_RETURN_IF_ERROR(Clear(staging.folder_));
  staging.mine_ = true;
  return staging;
}

CrateStaging::CrateStaging(CrateStaging&& other) noexcept
    : out_(std::move(other.out_)),
      folder_(std::move(other.folder_)),
      lock_(std::move(other.lock_)),
      mine_(std::exchange(other.mine_, false)) {}

CrateStaging::~CrateStaging() {
  std::error_code error;
  if (mine_) fs::remove_all(folder_, error);
}

Status CrateStaging::Keep() {
  SLX_RETURN_IF_ERROR(SyncTree(folder_));
  std::error_code error;
  fs::rename(folder_, out_, error);  // onto an empty folder, or none
  if (error)
    return Status::Failed("cannot rename " + folder_.string() + " to " + out_.string() + ": " + error.message());
  mine_ = false;
  return SyncFolder(out_.parent_path());
}

}  // namespace stratalux::db
