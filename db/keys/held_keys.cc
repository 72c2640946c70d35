// SPDX-License-Identifier: Apache-2.0
#include "db/keys/held_keys.h"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <map>
#include <mutex>

#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {
namespace {

// Magic and number; then each key's id and bytes.
struct KeysHeader {
  char magic[8];
  uint64_t count;
};
constexpr char kKeysMagic[8] = {'S', 'L', 'X', 'K', 'E', 'Y', 'S', '1'};
constexpr size_t kIdBytes = sizeof(KeyId);
using KeyRecord = LockedBytes<kIdBytes + sizeof(SecretKey::bytes)>;

// As many bytes as there are, up to `size`.
Result<size_t> FillFrom(int fd, void* bytes, size_t size) {
  size_t filled = 0;
  while (filled < size) {
    const ssize_t count = read(fd, static_cast<char*>(bytes) + filled, size - filled);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return Status::Failed(std::string("cannot read the keys: ") + std::strerror(errno));
    if (count == 0) break;
    filled += static_cast<size_t>(count);
  }
  return filled;
}

struct HeldKeys {
  std::mutex mutex;
  std::map<KeyId, std::shared_ptr<const SecretKey>> keys;
  Status read;  // of the environment's
};

void Take(HeldKeys& held, const std::vector<SessionKey>& keys) {
  for (const SessionKey& key : keys) held.keys[key.id] = key.key;
}

void TakeFromEnvironment(HeldKeys& held) {
  const char* text = std::getenv(kHeldKeysVariable);
  if (text == nullptr) return;
  char* end = nullptr;
  const long number = std::strtol(text, &end, 10);
  if (end == text || *end != '\0' || number < 0 || number > 1'000'000) {
    held.read = Status::Usage(std::string("$") + kHeldKeysVariable + ": '" + text + "' is not a file descriptor");
    return;
  }
  const UniqueFd fd(static_cast<int>(number));
  unsetenv(kHeldKeysVariable);
  auto keys = ReadKeys(fd.get());
  held.read = keys.status().WithContext(std::string("$") + kHeldKeysVariable);
  if (keys.ok()) Take(held, *keys);
}

// What a process was handed is the process's.
HeldKeys& OfThisProcess() {
  static auto* const held = [] {
    auto* made = new HeldKeys;
    TakeFromEnvironment(*made);
    return made;
  }();
  return *held;
}

}  // namespace

Status CheckKeyPipe(int fd) {
  struct stat info {};
  if (fstat(fd, &info) != 0)
    return Status::Usage("descriptor " + std::to_string(fd) + ", which should deliver keys, is not open");
  if (S_ISFIFO(info.st_mode) || S_ISSOCK(info.st_mode)) return Status::Ok();
  return Status::Usage(
      "keys are passed only through a pipe, never to or from a file: `stratalux-fit batch keys ... | "
      "stratalux-fit batch shard ... --keys`");
}

Status WriteKeys(int fd, const std::vector<SessionKey>& keys) {
  SLX_RETURN_IF_ERROR(CheckKeyPipe(fd));
  KeysHeader header{};
  std::memcpy(header.magic, kKeysMagic, sizeof kKeysMagic);
  header.count = keys.size();
  SLX_RETURN_IF_ERROR(WriteAll(fd, &header, sizeof header, "the pipe of the keys"));
  KeyRecord record;
  for (const SessionKey& key : keys) {
    std::copy(key.id.begin(), key.id.end(), record.bytes.begin());
    std::copy(key.key->bytes.begin(), key.key->bytes.end(), record.bytes.begin() + kIdBytes);
    SLX_RETURN_IF_ERROR(WriteAll(fd, record.bytes.data(), record.bytes.size(), "the pipe of the keys"));
  }
  return Status::Ok();
}

Result<std::vector<SessionKey>> ReadKeys(int fd) {
  SLX_RETURN_IF_ERROR(CheckKeyPipe(fd));
  KeysHeader header{};
  SLX_ASSIGN_OR_RETURN(const size_t begun, FillFrom(fd, &header, sizeof header));
  if (begun < sizeof header || std::memcmp(header.magic, kKeysMagic, sizeof kKeysMagic) != 0)
    return Status::Integrity("the pipe did not deliver keys of `stratalux-fit batch keys`");
  std::vector<SessionKey> keys;
  KeyRecord record;
  for (uint64_t i = 0; i < header.count; ++i) {
    SLX_ASSIGN_OR_RETURN(const size_t size, FillFrom(fd, record.bytes.data(), record.bytes.size()));
    if (size < record.bytes.size())
      return Status::Integrity("the pipe closed after " + std::to_string(i) + " of " + std::to_string(header.count) +
                               " keys");
    SessionKey key;
    auto secret = std::make_shared<SecretKey>();
    std::copy_n(record.bytes.begin(), kIdBytes, key.id.begin());
    std::copy_n(record.bytes.begin() + kIdBytes, secret->bytes.size(), secret->bytes.begin());
    key.key = std::move(secret);
    keys.push_back(std::move(key));
  }
  SLX_ASSIGN_OR_RETURN(const size_t more, FillFrom(fd, record.bytes.data(), 1));
  if (more > 0) return Status::Integrity("the pipe delivered more than the keys that were announced");
  return keys;
}

void HoldKeys(const std::vector<SessionKey>& keys) {
  HeldKeys& held = OfThisProcess();
  const std::lock_guard lock(held.mutex);
  Take(held, keys);
}

Result<SessionKey> FindHeldKey(const KeyId& id) {
  HeldKeys& held = OfThisProcess();
  const std::lock_guard lock(held.mutex);
  if (const auto found = held.keys.find(id); found != held.keys.end()) return SessionKey{id, found->second};
  SLX_RETURN_IF_ERROR(held.read);
  return Status::NotFound("this program was not given key " + ToHex(id));
}

}  // namespace stratalux::db
