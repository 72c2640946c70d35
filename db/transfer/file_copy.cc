// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/file_copy.h"

#include <cerrno>
#include <cstring>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include "db/base/descriptor.h"
#include "db/base/durable_file.h"
#include "db/segment/segment.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
constexpr size_t kBlock = size_t{1} << 20;

Status Trouble(const char* what, const fs::path& file) {
  return Status::Failed(std::string("cannot ") + what + " " + file.string() + ": " + std::strerror(errno));
}

Status Unreadable(const fs::path& file) {
  if (errno == ENOENT) return Status::NotFound(file.string() + " is not there");
  return Status::Integrity("cannot read " + file.string() + ": " + std::strerror(errno) +
                           "; check its disk and permissions");
}

Result<std::string> HashAndHand(const fs::path& file, const std::function<Status(std::span<const uint8_t>)>& hand) {
  const UniqueFd in = OpenDescriptor(file, O_RDONLY);
  if (in.get() < 0) return Unreadable(file);
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(), &XXH3_freeState);
  XXH3_128bits_reset(state.get());
  std::vector<uint8_t> block(kBlock);
  while (true) {
    const ssize_t got = read(in.get(), block.data(), block.size());
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return Unreadable(file);
    if (got == 0) break;
    XXH3_128bits_update(state.get(), block.data(), static_cast<size_t>(got));
    SLX_RETURN_IF_ERROR(hand(std::span(block).first(static_cast<size_t>(got))));
  }
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits_digest(state.get()));
  uint8_t digest[16];
  std::memcpy(digest, canonical.digest, sizeof digest);
  return HashText(digest);
}

}  // namespace

Result<std::string> HashFile(const fs::path& file) {
  return HashAndHand(file, [](std::span<const uint8_t>) { return Status::Ok(); });
}

Result<int64_t> ModifiedNs(const fs::path& file) {
  struct stat info {};
  if (stat(file.c_str(), &info) != 0) return Unreadable(file);
  return int64_t{info.st_mtim.tv_sec} * 1'000'000'000 + info.st_mtim.tv_nsec;
}

Result<std::string> CopyFileHashed(const fs::path& from, const fs::path& to, const std::string& expected) {
  SLX_RETURN_IF_ERROR(MakeFolder(to.parent_path()));
  const fs::path part = to.string() + ".part";
  std::error_code error;
  Result<std::string> hash = Status::Ok();
  {
    const UniqueFd out = OpenDescriptor(part, O_WRONLY | O_CREAT | O_TRUNC);
    if (out.get() < 0) return Trouble("create", part);
    hash = HashAndHand(from, [&](std::span<const uint8_t> bytes) {
      return WriteAll(out.get(), bytes.data(), bytes.size(), part.string());
    });
    if (hash.ok() && fdatasync(out.get()) != 0) hash = Trouble("sync", part);
  }
  if (hash.ok() && !expected.empty() && *hash != expected)
    hash = Status::Integrity(from.string() + ": its bytes do not match their hash " + expected);
  if (!hash.ok()) {
    fs::remove(part, error);
    return hash;
  }
  fs::rename(part, to, error);
  if (error) return Status::Failed("cannot move " + part.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SyncFolder(to.parent_path()));
  return hash;
}

}  // namespace stratalux::db
