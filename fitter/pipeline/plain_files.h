// SPDX-License-Identifier: Apache-2.0
// Where programs write and read the files of a session: of a plain one in their very place; of an encrypted one in
// memory (db/base/memory_folder.h), from where they are sealed into their place, and unsealed into for as long as they
// are read.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include "db/segment/sealed_file.h"

namespace stratalux::fit {

using UseOfFolder = std::function<Status(const std::filesystem::path& folder)>;
// Of a file below a folder, by its name there: the places that it may have been sealed for.
using PlacesOf = std::function<std::set<std::string>(const std::string& name)>;

// Its folder in memory is made at the first use, and removed with the last copy of this that was made since, or when
// the program is interrupted. Thread-bound.
class PlainFiles {
 public:
  explicit PlainFiles(db::FileSeal seal) : seal_(std::move(seal)) {}

  [[nodiscard]] const db::FileSeal& seal() const { return seal_; }
  // Files that `write` puts into the folder it is given are files of `folder`, which is there; sealed as `place`/NAME.
  Status Write(const std::filesystem::path& folder, const std::string& place, const UseOfFolder& write);
  // `read` finds the files of `folder` in the folder it is given, but for those that `left_plain` names: of an
  // encrypted session all others are sealed, else kIntegrity.
  Status Read(const std::filesystem::path& folder, const PlacesOf& places, const std::set<std::string>& left_plain,
              const UseOfFolder& read);
  // Seals the plain files of `from`, but for `left_plain`, into `to`, as `place`/NAME.
  Status SealFiles(const std::filesystem::path& from, const std::filesystem::path& to, const std::string& place,
                   const std::set<std::string>& left_plain);

 private:
  class Memory;
  Status InMemory(const std::function<Status(const std::filesystem::path&)>& use);

  db::FileSeal seal_;
  std::shared_ptr<Memory> memory_;
};

}  // namespace stratalux::fit
