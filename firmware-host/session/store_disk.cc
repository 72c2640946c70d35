// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/store_disk.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <fcntl.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {
namespace {

constexpr int64_t kBesideFrames = int64_t{64} << 20;

std::string Gigabytes(uint64_t bytes) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f GB", 1e-9 * static_cast<double>(bytes));
  return text;
}

}  // namespace

std::filesystem::path ExistingFolder(const std::filesystem::path& store) {
  std::filesystem::path folder = std::filesystem::absolute(store);
  std::error_code ignored;
  while (!std::filesystem::is_directory(folder, ignored) && folder.has_relative_path()) folder = folder.parent_path();
  return folder;
}

int64_t SessionBytes(int64_t frames, int width, int height) {
  const int64_t row = (int64_t{width} * 3 + 1) / 2;
  return frames * row * height + kBesideFrames;
}

Status CheckFreeSpace(const std::filesystem::path& store, int64_t bytes) {
  const std::filesystem::path folder = ExistingFolder(store);
  std::error_code error;
  const auto space = std::filesystem::space(folder, error);
  if (error)
    return Status::Failed("cannot find out how much space is free in " + folder.string() + ": " + error.message());
  if (space.capacity == 0 || space.available >= static_cast<uint64_t>(bytes)) return Status::Ok();
  return Status::Failed("the store " + store.string() + " has " + Gigabytes(space.available) +
                        " free, the session may take " + Gigabytes(static_cast<uint64_t>(bytes)) +
                        ": make room on its disk (`stratalux-db purge` forgets what is due), or name another --store");
}

Result<double> MeasureDisk(const std::filesystem::path& folder, size_t frame_bytes) {
  using Clock = std::chrono::steady_clock;
  constexpr int kGroups = 4, kFramesInGroup = 16;
  std::string file = (folder / "selftest-XXXXXX").string();
  const UniqueFd fd(mkostemp(file.data(), O_CLOEXEC));
  if (!fd.ok()) return Status::Failed("cannot create " + file + ": " + std::strerror(errno));
  unlink(file.c_str());
  // Bytes that no file system stores as a hole or compresses away.
  std::vector<uint8_t> bytes(frame_bytes);
  uint32_t state = 1;
  for (uint8_t& b : bytes) b = static_cast<uint8_t>((state = state * 1664525U + 1013904223U) >> 24);
  const auto start = Clock::now();
  for (int g = 0; g < kGroups; ++g) {
    for (int k = 0; k < kFramesInGroup; ++k)
      SLX_RETURN_IF_ERROR(db::WriteAll(fd.get(), bytes.data(), bytes.size(), file));
    if (fdatasync(fd.get()) != 0) return Status::Failed("cannot sync " + file + ": " + std::strerror(errno));
  }
  const double seconds = std::chrono::duration<double>(Clock::now() - start).count();
  return static_cast<double>(frame_bytes) * kGroups * kFramesInGroup / std::max(1e-9, seconds);
}

}  // namespace stratalux::rig
