// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/recorded_files.h"

#include <algorithm>
#include <fstream>
#include <memory>

#include <xxhash.h>

#include "db/base/paths.h"
#include "db/segment/segment.h"

namespace stratalux::db {

namespace fs = std::filesystem;

Result<std::string> HashOfFile(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) return Status::Failed("cannot read " + file.string());
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(), XXH3_freeState);
  XXH3_128bits_reset(state.get());
  std::vector<char> buffer(1 << 20);
  while (in.read(buffer.data(), static_cast<std::streamsize>(buffer.size())) || in.gcount() > 0)
    XXH3_128bits_update(state.get(), buffer.data(), static_cast<size_t>(in.gcount()));
  if (in.bad()) return Status::Failed("cannot read " + file.string());
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits_digest(state.get()));
  return HashText(canonical.digest);
}

Result<std::vector<std::string>> NamesOfFiles(const fs::path& folder, const std::string& record) {
  std::vector<std::string> names;
  std::error_code error;
  for (auto entry = fs::recursive_directory_iterator(folder, error); !error && entry != fs::end(entry);
       entry.increment(error)) {
    const std::string name = entry->path().lexically_relative(folder).string();
    if (fs::is_regular_file(entry->symlink_status(error)) && name != record && name != record + ".new")
      names.push_back(name);
  }
  if (error) return Status::Failed("cannot read " + folder.string() + ": " + error.message());
  std::sort(names.begin(), names.end());
  return names;
}

Result<std::vector<RecordedFile>> ListFiles(const fs::path& folder, const std::string& record) {
  SLX_ASSIGN_OR_RETURN(const auto names, NamesOfFiles(folder, record));
  std::vector<RecordedFile> files;
  for (const std::string& name : names) {
    std::error_code error;
    const auto bytes = fs::file_size(folder / name, error);
    if (error) return Status::Failed("cannot read " + (folder / name).string() + ": " + error.message());
    SLX_ASSIGN_OR_RETURN(std::string hash, HashOfFile(folder / name));
    files.push_back({name, static_cast<int64_t>(bytes), std::move(hash)});
  }
  return files;
}

Status CheckRecordedFile(const fs::path& folder, const std::string& record, const RecordedFile& listed,
                         FileDepth depth) {
  const auto& [name, bytes, hash] = listed;
  if (!StaysInside(name))
    return Status::Integrity((folder / record).string() + ": '" + name + "' is not a file of its folder");
  const fs::path file = folder / name;
  std::error_code error;
  fs::path at = folder;  // no part of the name may be a link: it could lead out of the folder
  for (const fs::path& part : fs::path(name)) {
    at /= part;
    const auto type = fs::symlink_status(at, error).type();
    if (type == fs::file_type::not_found) return Status::Integrity(file.string() + " is missing");
    if (type != fs::file_type::directory && type != fs::file_type::regular)
      return Status::Integrity(at.string() + " is a link or not a regular file");
  }
  const auto size = fs::file_size(file, error);
  if (error || static_cast<int64_t>(size) != bytes)
    return Status::Integrity(file.string() + " has " + (error ? "no" : std::to_string(size)) + " bytes, " + record +
                             " says " + std::to_string(bytes));
  if (depth == FileDepth::kSizes) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const std::string found, HashOfFile(file));
  if (found != hash) return Status::Integrity(file.string() + " is not the file that " + record + " names");
  return Status::Ok();
}

}  // namespace stratalux::db
