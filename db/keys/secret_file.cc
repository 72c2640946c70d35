// SPDX-License-Identifier: Apache-2.0
#include "db/keys/secret_file.h"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sodium.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMostBytes = 256;  // of such a file
constexpr size_t kDigits = 2 * sizeof(SecretKey::bytes);

// Opens `file`, which has no other bytes then and no other writer until the descriptor is closed: two that make the
// same key at once must not write into one file.
Result<UniqueFd> OpenAlone(const fs::path& file) {
  while (true) {
    UniqueFd fd(open(file.c_str(), O_WRONLY | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0600));
    if (!fd.ok()) return Status::Failed("cannot write " + file.string() + ": " + std::strerror(errno));
    if (flock(fd.get(), LOCK_EX) != 0 && errno != EINTR)
      return Status::Failed("cannot lock " + file.string() + ": " + std::strerror(errno));
    struct stat opened {
    }, named{};
    if (fstat(fd.get(), &opened) != 0 || lstat(file.c_str(), &named) != 0 || opened.st_ino != named.st_ino)
      continue;  // whoever held it has removed it
    if (fchmod(fd.get(), 0600) != 0 || ftruncate(fd.get(), 0) != 0)
      return Status::Failed("cannot make " + file.string() + " private");
    return fd;
  }
}

bool MayBeReadByOthers(const struct stat& info, SecretFileGuard guard) {
  return (info.st_mode & (guard == SecretFileGuard::kFolder ? 007 : 077)) != 0;
}

}  // namespace

std::string Unspaced(std::string text) {
  while (!text.empty() && (text.back() == '\n' || text.back() == '\r' || text.back() == ' ')) text.pop_back();
  return text;
}

Result<std::shared_ptr<const SecretKey>> ReadSecretFile(const fs::path& file, const SecretFileKind& kind,
                                                        SecretFileGuard guard) {
  const UniqueFd fd(open(file.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK));
  if (!fd.ok() && errno == ENOENT) return Status::NotFound(file.string() + " is not there: " + kind.made_by);
  if (!fd.ok()) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
  struct stat info {};
  if (fstat(fd.get(), &info) != 0 || !S_ISREG(info.st_mode) || MayBeReadByOthers(info, guard))
    return Status::Failed(file.string() +
                          " can be read by others: `chmod 600` it, and consider whether it is still a secret");
  LockedBytes<kMostBytes> held;  // zeros behind what is read
  char* text = reinterpret_cast<char*>(held.bytes.data());
  const ssize_t size = read(fd.get(), text, kMostBytes - 1);
  if (size < 0) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
  const std::string start = std::string(kind.first_line) + "\n";
  auto key = std::make_shared<SecretKey>();
  size_t bytes = 0;
  const char *digits = text + start.size(), *behind = nullptr;
  const bool whole =
      std::strncmp(text, start.c_str(), start.size()) == 0 && std::strlen(digits) >= kDigits &&
      sodium_hex2bin(key->bytes.data(), key->bytes.size(), digits, kDigits, nullptr, &bytes, &behind) == 0 &&
      bytes == key->bytes.size() && behind == digits + kDigits && behind[std::strspn(behind, " \r\n")] == '\0';
  if (!whole)
    return Status::Integrity(file.string() + " is not a " + kind.name + ", or damaged; restore it from your own copy");
  return std::shared_ptr<const SecretKey>(std::move(key));
}

Status PlaceSecretFile(const fs::path& file, const SecretFileKind& kind, const SecretKey& key) {
  LockedBytes<kMostBytes> held;
  char* text = reinterpret_cast<char*>(held.bytes.data());
  const std::string start = std::string(kind.first_line) + "\n";
  std::memcpy(text, start.data(), start.size());
  sodium_bin2hex(text + start.size(), kDigits + 1, key.bytes.data(), key.bytes.size());
  text[start.size() + kDigits] = '\n';
  const fs::path beside = file.string() + ".new";
  SLX_ASSIGN_OR_RETURN(const UniqueFd fd, OpenAlone(beside));
  Status placed = WriteAll(fd.get(), text, std::strlen(text), beside.string());
  if (placed.ok() && fsync(fd.get()) != 0)
    placed = Status::Failed("cannot sync " + beside.string() + ": " + std::strerror(errno));
  if (placed.ok() && link(beside.c_str(), file.c_str()) != 0)
    placed = errno == EEXIST ? Status::Usage(file.string() + " already exists; " + kind.never_replaced)
                             : Status::Failed("cannot create " + file.string() + ": " + std::strerror(errno));
  unlink(beside.c_str());
  return placed.ok() ? SyncFolder(file.parent_path()) : placed;
}

}  // namespace stratalux::db
