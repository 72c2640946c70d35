// SPDX-License-Identifier: Apache-2.0
// The fault layer under the store: libc's file calls, as this program, SQLite and libstdc++ make them, pass through
// functions of the same names (disk_calls.cc) and on to here. Below one folder each change is written down in order, or
// is refused as a full or broken disk would refuse it. Thread-safe; the log of a night is of one thread.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace stratalux::db::crash {

// Files and folders by their number, not by name: names move, what was written stays with the file.
using Inode = int;
inline constexpr Inode kRoot = 0;

struct DiskCall {
  enum class Kind {
    kLink,        // `file` appears in `folder` as `name`: created empty, or moved there from `old_folder`/`old_name`
    kUnlink,      // `name` of `folder` disappears
    kWrite,       // `bytes` at `offset`
    kTruncate,    // to `offset` bytes
    kSync,        // fsync or fdatasync of a file or folder returned 0
    kFailedSync,  // it returned an error: what was unsynced may never reach the disk, whatever later calls say
    kMark         // `offset`: how many promises the store had made by then
  };
  Kind kind = Kind::kMark;
  Inode file = -1, folder = -1, old_folder = -1;
  std::string name, old_name;
  int64_t offset = 0;
  std::vector<uint8_t> bytes;
  bool makes_folder = false;
};

// Files by path below the root; folders end with '/'.
using DiskImage = std::map<std::string, std::vector<uint8_t>>;

struct DiskLog {
  DiskImage start;  // all of it durable
  std::map<std::string, Inode> inodes;
  std::vector<DiskCall> calls;
};

// What the disk refuses.
struct DiskFault {
  enum class Kind {
    kNone,
    kNoSpace,
    kSyncError,
    kDeath,        // SIGKILL where kNoSpace would refuse, and before removals and syncs
    kInterruption  // SIGINT there, to the process; the call goes on
  };
  enum class Extent { kOnce, kFromThenOn };
  Kind kind = Kind::kNone;
  int64_t at = 0;  // 0-based, counted over the calls that can fail so
  Extent extent = Extent::kOnce;
};

// kUnread: other programs write there, too; what lies there is written down when it is first met.
enum class StartImage { kRead, kUnread };
// Starts recording what happens below `folder`; one recording at a time. Syncs are noted but not waited for.
void StartRecording(const std::filesystem::path& folder, const DiskFault& fault = {},
                    StartImage image = StartImage::kRead);
void Mark(int64_t promises);
// No more calls fail; recording goes on.
void RepairDisk();
DiskLog StopRecording();
// Calls that could have failed as `kind` since StartRecording(); how many did.
[[nodiscard]] int64_t CallsThatCanFail(DiskFault::Kind kind);
[[nodiscard]] int64_t CallsThatFailed();
// For checks by the thousand: fsync returns at once. Never outside of tests.
void SkipSyncs();

[[nodiscard]] DiskImage ReadImage(const std::filesystem::path& folder);
// Replaces whatever lies in `folder`.
void WriteImage(const DiskImage& image, const std::filesystem::path& folder);

}  // namespace stratalux::db::crash
