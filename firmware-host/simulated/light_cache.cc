// SPDX-License-Identifier: Apache-2.0
// An entry's file: magic and version, key, number of values, XXH3-128 of all of it and the values; values. It is
// written beside its place and renamed, so no reader sees half of it. It need not survive a power cut: the checksum
// tells.
#include "firmware-host/simulated/light_cache.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <system_error>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include "shared/base/unique_fd.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;

constexpr std::array<char, 8> kMagic = {'S', 'L', 'X', 'L', 'I', 'T', 'E', '1'};
constexpr const char* kSuffix = ".light";
constexpr const char* kUnfinished = ".part";
constexpr std::chrono::hours kAbandoned{1};  // what a process that died left behind

struct Header {
  std::array<char, 8> magic = kMagic;
  std::array<uint64_t, 2> key{};
  uint64_t count = 0;
  std::array<uint64_t, 2> checksum{};
};
static_assert(std::has_unique_object_representations_v<Header>);

std::array<uint64_t, 2> ChecksumOf(const Header& header, std::span<const float> values) {
  CacheKey sum;
  sum.Add(header.key[0]);
  sum.Add(header.key[1]);
  sum.AddAll(values);
  return sum.Digest();
}

bool ReadAll(int fd, void* data, size_t size) {
  auto* at = static_cast<char*>(data);
  while (size > 0) {
    const ssize_t got = ::read(fd, at, size);
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) return false;
    at += got;
    size -= static_cast<size_t>(got);
  }
  return true;
}

bool WriteAll(int fd, const void* data, size_t size) {
  const auto* at = static_cast<const char*>(data);
  while (size > 0) {
    const ssize_t put = ::write(fd, at, size);
    if (put < 0 && errno == EINTR) continue;
    if (put < 0) return false;
    at += put;
    size -= static_cast<size_t>(put);
  }
  return true;
}

}  // namespace

struct CacheKey::State {
  XXH3_state_t* hash = XXH3_createState();
  State() { XXH3_128bits_reset(hash); }
  ~State() { XXH3_freeState(hash); }
  State(const State&) = delete;
  State& operator=(const State&) = delete;
};

CacheKey::CacheKey() : state_(std::make_unique<State>()) {}
CacheKey::~CacheKey() = default;
CacheKey::CacheKey(CacheKey&&) noexcept = default;
CacheKey& CacheKey::operator=(CacheKey&&) noexcept = default;

void CacheKey::AddBytes(std::span<const std::byte> bytes) {
  if (!bytes.empty()) XXH3_128bits_update(state_->hash, bytes.data(), bytes.size());
}

std::array<uint64_t, 2> CacheKey::Digest() const {
  const XXH128_hash_t digest = XXH3_128bits_digest(state_->hash);
  return {digest.high64, digest.low64};
}

LightCache::LightCache(fs::path folder, uint64_t limit_bytes, Logger& logger)
    : folder_(std::move(folder)), limit_bytes_(limit_bytes), logger_(logger) {}

fs::path LightCache::FolderOfUser() {
  if (const char* own = std::getenv("STRATALUX_CACHE")) return own;
  const char* base = std::getenv("XDG_CACHE_HOME");
  if (base != nullptr && fs::path(base).is_absolute()) return fs::path(base) / "stratalux";
  const char* home = std::getenv("HOME");
  if (home == nullptr || !fs::path(home).is_absolute()) return {};
  return fs::path(home) / ".cache" / "stratalux";
}

fs::path LightCache::FileOf(const Digest& key) const {
  char name[40];
  std::snprintf(name, sizeof name, "%016llx%016llx", static_cast<unsigned long long>(key[0]),
                static_cast<unsigned long long>(key[1]));
  return folder_ / (std::string(name) + kSuffix);
}

std::optional<std::vector<float>> LightCache::Load(const Digest& key, size_t count) {
  const fs::path file = FileOf(key);
  const UniqueFd fd(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
  if (fd.get() < 0) return std::nullopt;
  struct stat about {};
  Header header;
  std::vector<float> values;
  const bool fits = ::fstat(fd.get(), &about) == 0 && S_ISREG(about.st_mode) &&
                    static_cast<uint64_t>(about.st_size) == sizeof header + count * sizeof(float);
  if (fits) values.resize(count);
  if (!fits || !ReadAll(fd.get(), &header, sizeof header) || header.magic != kMagic || header.key != key ||
      header.count != count || !ReadAll(fd.get(), values.data(), count * sizeof(float)) ||
      header.checksum != ChecksumOf(header, values)) {
    logger_.Warning("simulated rig: " + file.string() + " is damaged; it is computed again");
    std::error_code ignored;
    fs::remove(file, ignored);
    return std::nullopt;
  }
  ::futimens(fd.get(), nullptr);  // used now: the last to go
  return values;
}

void LightCache::Keep(const Digest& key, std::span<const float> values) {
  static std::atomic<int> number = 0;
  std::error_code error;
  fs::create_directories(folder_, error);
  if (error) return WarnOnce("cannot make " + folder_.string() + ": " + error.message());
  const fs::path file = FileOf(key);
  const fs::path part = file.string() + "." + std::to_string(::getpid()) + "." + std::to_string(number++) + kUnfinished;
  Header header;
  header.key = key;
  header.count = values.size();
  header.checksum = ChecksumOf(header, values);
  {
    const UniqueFd fd(::open(part.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600));
    const bool written = fd.get() >= 0 && WriteAll(fd.get(), &header, sizeof header) &&
                         WriteAll(fd.get(), values.data(), values.size_bytes());
    if (!written) {
      const std::string why = std::strerror(errno);
      fs::remove(part, error);
      return WarnOnce("cannot write " + part.string() + ": " + why);
    }
  }
  fs::rename(part, file, error);
  if (error) {
    const std::string why = error.message();
    fs::remove(part, error);
    return WarnOnce("cannot rename " + part.string() + ": " + why);
  }
  MakeRoom();
}

void LightCache::MakeRoom() {
  const std::lock_guard lock(mutex_);
  struct Entry {
    fs::file_time_type used;
    uint64_t bytes;
    fs::path file;
  };
  std::vector<Entry> entries;
  uint64_t total = 0;
  std::error_code error;
  // Other processes keep and delete, too: whatever is gone meanwhile is passed over.
  for (fs::directory_iterator it(folder_, error), end; !error && it != end; it.increment(error)) {
    std::error_code gone;
    const fs::path& file = it->path();
    const auto used = it->last_write_time(gone);
    const uint64_t bytes = gone ? 0 : it->file_size(gone);
    if (gone) continue;
    if (file.extension() == kUnfinished && used < fs::file_time_type::clock::now() - kAbandoned) fs::remove(file, gone);
    if (file.extension() != kSuffix) continue;
    entries.push_back({used, bytes, file});
    total += bytes;
  }
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.used < b.used; });
  for (const Entry& oldest : entries) {
    if (total <= limit_bytes_) break;
    std::error_code gone;
    fs::remove(oldest.file, gone);
    total -= oldest.bytes;
  }
}

void LightCache::WarnOnce(const std::string& message) {
  const std::lock_guard lock(mutex_);
  if (!warned_)
    logger_.Warning("simulated rig: computed light is not kept for the next run: " + message +
                    " (STRATALUX_CACHE= keeps none)");
  warned_ = true;
}

}  // namespace stratalux::rig
