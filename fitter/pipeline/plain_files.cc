// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/plain_files.h"

#include "db/base/memory_folder.h"
#include "db/catalogue/recorded_files.h"
#include "fitter/pipeline/interruption.h"

namespace stratalux::fit {

namespace fs = std::filesystem;

class PlainFiles::Memory {
 public:
  static Result<std::shared_ptr<Memory>> Create() {
    const NotInterrupted whole;  // nothing between the folder and its guard
    SLX_ASSIGN_OR_RETURN(auto folder, db::MemoryFolder::Create());
    return std::make_shared<Memory>(std::move(folder));
  }
  explicit Memory(db::MemoryFolder folder) : folder_(std::move(folder)), guard_(folder_.path()) {}
  [[nodiscard]] const db::MemoryFolder& folder() const { return folder_; }
  [[nodiscard]] Result<fs::path> NewFolder() {
    const std::string name = std::to_string(used_++);
    SLX_RETURN_IF_ERROR(MakeFoldersBelow(folder_.path(), name));
    return folder_.path() / name;
  }

 private:
  const db::MemoryFolder folder_;
  const RemovedOnSignal guard_;
  int used_ = 0;
};

Status PlainFiles::InMemory(const std::function<Status(const fs::path&)>& use) {
  // Before anything is computed that could not be kept.
  SLX_RETURN_IF_ERROR(seal_.RequireKey());
  if (memory_ == nullptr) {
    SLX_ASSIGN_OR_RETURN(memory_, Memory::Create());
  }
  SLX_ASSIGN_OR_RETURN(const fs::path folder, memory_->NewFolder());
  const Status used = memory_->folder().Explained(use(folder));
  std::error_code error;
  fs::remove_all(folder, error);
  return used;
}

Status PlainFiles::Write(const fs::path& folder, const std::string& place, const UseOfFolder& write) {
  if (!seal_.active()) return write(folder);
  return InMemory([&](const fs::path& plain) -> Status {
    SLX_RETURN_IF_ERROR(write(plain));
    return SealFiles(plain, folder, place, {});
  });
}

Status PlainFiles::SealFiles(const fs::path& from, const fs::path& to, const std::string& place,
                             const std::set<std::string>& left_plain) {
  SLX_ASSIGN_OR_RETURN(const auto names, db::NamesOfFiles(from, ""));
  for (const std::string& name : names) {
    if (left_plain.contains(name)) continue;
    SLX_RETURN_IF_ERROR(MakeFoldersBelow(to, fs::path(name).parent_path()));
    SLX_RETURN_IF_ERROR(seal_.Seal(from / name, place + "/" + name, to / name));
  }
  return Status::Ok();
}

Status PlainFiles::Read(const fs::path& folder, const PlacesOf& places, const std::set<std::string>& left_plain,
                        const UseOfFolder& read) {
  if (!seal_.active()) return read(folder);
  return InMemory([&](const fs::path& plain) -> Status {
    SLX_ASSIGN_OR_RETURN(const auto names, db::NamesOfFiles(folder, ""));
    for (const std::string& name : names) {
      if (left_plain.contains(name)) continue;
      SLX_RETURN_IF_ERROR(MakeFoldersBelow(plain, fs::path(name).parent_path()));
      SLX_RETURN_IF_ERROR(seal_.Open(folder / name, places(name), plain / name));
    }
    return read(plain);
  });
}

}  // namespace stratalux::fit
