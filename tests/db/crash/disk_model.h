// SPDX-License-Identifier: Apache-2.0
// What a disk may hold after a power cut: the model of docs/decisions/0008-what-we-assume-of-a-disk.md, run over a log.
#pragma once

#include <cstdint>
#include <random>

#include "tests/db/crash/disk_recorder.h"

namespace stratalux::db::crash {

// What happens to that which no sync covers.
enum class PowerCut {
  kKeepsAll,         // the process was killed, the machine runs on
  kDropsAll,         // bytes and names
  kDropsNames,       // bytes are there, the files are not
  kDropsBytes,       // the files are there, empty
  kTearsLastWrite,   // all is there, but of the last write a part, and noise behind it
  kKeepsSomeBlocks,  // of each 4 KiB block any of its versions, of each file any of its sizes, any subset of the names
};
[[nodiscard]] const char* ToString(PowerCut cut);

// The state of a disk while a log is replayed.
class Disk {
 public:
  explicit Disk(const DiskLog& log);
  void Apply(const DiskCall& call);
  // Where each file and folder is to be found now, as running processes see it.
  [[nodiscard]] std::map<std::string, Inode> Paths() const;
  // What one finds after the power came back. `random` serves the last two.
  [[nodiscard]] DiskImage After(PowerCut cut, std::mt19937_64& random) const;

 private:
  struct Change {  // of a file's bytes
    int64_t offset = 0;
    std::vector<uint8_t> bytes;
    bool truncates = false;
    bool lost = false;  // a sync failed on it: it may be in memory, it will never be on the disk
  };
  struct File {
    bool folder = false;
    std::vector<uint8_t> durable;
    std::vector<uint8_t> cached;  // in memory, as every process sees it
    std::vector<Change> pending;
    std::map<std::string, Inode> entries;  // durable
  };
  using Entries = std::map<Inode, std::map<std::string, Inode>>;
  static void Write(std::vector<uint8_t>& bytes, const Change& change);
  void Sync(Inode inode);
  static void ApplyName(Entries& entries, const DiskCall& call);
  [[nodiscard]] Entries Names(PowerCut cut, std::mt19937_64& random) const;
  [[nodiscard]] std::vector<uint8_t> Bytes(Inode inode, PowerCut cut, std::mt19937_64& random) const;
  [[nodiscard]] static std::vector<uint8_t> SomeBlocks(const File& file, std::mt19937_64& random);
  static void ListPaths(const Entries& entries, Inode folder, const std::string& prefix,
                        std::map<std::string, Inode>& paths);
  void Collect(const Entries& entries, Inode folder, const std::string& prefix, PowerCut cut, std::mt19937_64& random,
               DiskImage& image) const;

  std::map<Inode, File> files_;
  std::vector<DiskCall> names_;  // changes of names that no sync covers
  Inode last_written_ = -1;
};

// The first `calls` of `log`, and then `next`, which was recorded on what they left: a process was killed, another one
// went on in the same memory.
[[nodiscard]] DiskLog Continue(const DiskLog& log, size_t calls, DiskLog next);

}  // namespace stratalux::db::crash
