// SPDX-License-Identifier: Apache-2.0
#include "tests/db/crash/disk_model.h"

#include <algorithm>
#include <set>

namespace stratalux::db::crash {
namespace {

using Kind = DiskCall::Kind;
constexpr int64_t kBlock = 4096;

uint64_t Draw(std::mt19937_64& random, uint64_t below) { return below == 0 ? 0 : random() % below; }

}  // namespace

const char* ToString(PowerCut cut) {
  switch (cut) {
    case PowerCut::kKeepsAll:
      return "keeps all";
    case PowerCut::kDropsAll:
      return "drops all";
    case PowerCut::kDropsNames:
      return "drops names";
    case PowerCut::kDropsBytes:
      return "drops bytes";
    case PowerCut::kTearsLastWrite:
      return "tears the last write";
    case PowerCut::kKeepsSomeBlocks:
      break;
  }
  return "keeps some blocks";
}

Disk::Disk(const DiskLog& log) {
  files_[kRoot].folder = true;
  for (const auto& [path, inode] : log.inodes) {
    if (inode == kRoot) continue;
    const size_t slash = path.rfind('/');
    const Inode parent = slash == std::string::npos ? kRoot : log.inodes.at(path.substr(0, slash));
    files_[parent].entries[slash == std::string::npos ? path : path.substr(slash + 1)] = inode;
    const auto bytes = log.start.find(path);
    files_[inode].folder = bytes == log.start.end();
    if (bytes != log.start.end()) files_[inode].durable = files_[inode].cached = bytes->second;
  }
}

void Disk::Write(std::vector<uint8_t>& bytes, const Change& change) {
  const auto offset = static_cast<size_t>(change.offset);
  if (change.truncates) return bytes.resize(offset);
  bytes.resize(std::max(bytes.size(), offset + change.bytes.size()));
  std::copy(change.bytes.begin(), change.bytes.end(), bytes.begin() + change.offset);
}

void Disk::ApplyName(Entries& entries, const DiskCall& call) {
  if (!call.old_name.empty()) entries[call.old_folder].erase(call.old_name);
  if (call.kind == Kind::kUnlink) {
    entries[call.folder].erase(call.name);
  } else {
    entries[call.folder][call.name] = call.file;
  }
}

void Disk::Apply(const DiskCall& call) {
  switch (call.kind) {
    case Kind::kLink:
      if (call.old_name.empty()) files_[call.file].folder = call.makes_folder;
      names_.push_back(call);
      break;
    case Kind::kUnlink:
      names_.push_back(call);
      break;
    case Kind::kWrite:
    case Kind::kTruncate: {
      File& file = files_[call.file];
      file.pending.push_back({call.offset, call.bytes, call.kind == Kind::kTruncate, false});
      Write(file.cached, file.pending.back());
      if (call.kind == Kind::kWrite) last_written_ = call.file;
      break;
    }
    case Kind::kSync:
      Sync(call.file);
      break;
    case Kind::kFailedSync:
      for (Change& c : files_[call.file].pending) c.lost = true;
      break;
    case Kind::kMark:
      break;
  }
}

void Disk::Sync(Inode inode) {
  File& file = files_[inode];
  if (!file.folder) {
    std::vector<Change> lost;
    for (Change& c : file.pending)
      if (c.lost) {
        lost.push_back(std::move(c));
      } else {
        Write(file.durable, c);
      }
    file.pending = std::move(lost);
    return;
  }
  Entries entries;
  for (auto& [number, f] : files_)
    if (f.folder) entries[number] = std::move(f.entries);
  std::erase_if(names_, [&](const DiskCall& call) {
    const bool covered = call.folder == inode || (!call.old_name.empty() && call.old_folder == inode);
    if (covered) ApplyName(entries, call);
    return covered;
  });
  for (auto& [number, names] : entries) files_[number].entries = std::move(names);
}

Disk::Entries Disk::Names(PowerCut cut, std::mt19937_64& random) const {
  Entries entries;
  for (const auto& [number, file] : files_)
    if (file.folder) entries[number] = file.entries;
  if (cut == PowerCut::kDropsAll || cut == PowerCut::kDropsNames) return entries;
  // A name's changes come in their order; the names are independent of each other, as no journal is assumed.
  std::set<std::pair<Inode, std::string>> stale;
  for (const DiskCall& call : names_) {
    const std::pair to{call.folder, call.name}, from{call.old_folder, call.old_name};
    const bool late = stale.contains(to) || stale.contains(from);
    if (late || (cut == PowerCut::kKeepsSomeBlocks && Draw(random, 2) == 0)) {
      stale.insert(to);
      if (!call.old_name.empty()) stale.insert(from);
    } else {
      ApplyName(entries, call);
    }
  }
  return entries;
}

std::vector<uint8_t> Disk::Bytes(Inode inode, PowerCut cut, std::mt19937_64& random) const {
  const File& file = files_.at(inode);
  std::vector<uint8_t> bytes = file.durable;
  if (cut == PowerCut::kDropsAll || cut == PowerCut::kDropsBytes) return bytes;
  if (cut == PowerCut::kKeepsSomeBlocks) return SomeBlocks(file, random);
  if (cut == PowerCut::kKeepsAll || inode != last_written_) return file.cached;
  for (size_t i = 0; i < file.pending.size(); ++i) {
    Change change = file.pending[i];
    if (cut == PowerCut::kTearsLastWrite && inode == last_written_ && i + 1 == file.pending.size() &&
        !change.bytes.empty()) {
      // Half of the tears are at a sector's end, as disks write; noise: whatever the sectors held before.
      size_t kept = Draw(random, change.bytes.size());
      if (Draw(random, 2) == 0) kept = kept / 512 * 512;
      for (size_t k = kept; k < change.bytes.size(); ++k) change.bytes[k] = static_cast<uint8_t>(random());
    }
    Write(bytes, change);
  }
  return bytes;
}

std::vector<uint8_t> Disk::SomeBlocks(const File& file, std::mt19937_64& random) {
  // The versions of the file in their order; each block takes one of them, and so does the size.
  std::vector<std::vector<uint8_t>> versions = {file.durable};
  for (const Change& c : file.pending) {
    if (c.lost) continue;
    versions.push_back(versions.back());
    Write(versions.back(), c);
  }
  std::vector<uint8_t> bytes(versions[Draw(random, versions.size())].size());
  for (size_t start = 0; start < bytes.size(); start += kBlock) {
    const auto& version = versions[Draw(random, versions.size())];
    const size_t end = std::min({bytes.size(), version.size(), start + kBlock});
    if (start < end) std::copy(version.begin() + start, version.begin() + end, bytes.begin() + start);
  }
  return bytes;
}

void Disk::Collect(const Entries& entries, Inode folder, const std::string& prefix, PowerCut cut,
                   std::mt19937_64& random, DiskImage& image) const {
  const auto names = entries.find(folder);
  if (names == entries.end()) return;
  for (const auto& [name, inode] : names->second) {
    if (files_.at(inode).folder) {
      image[prefix + name + "/"] = {};
      Collect(entries, inode, prefix + name + "/", cut, random, image);
    } else {
      image[prefix + name] = Bytes(inode, cut, random);
    }
  }
}

void Disk::ListPaths(const Entries& entries, Inode folder, const std::string& prefix,
                     std::map<std::string, Inode>& paths) {
  const auto names = entries.find(folder);
  if (names == entries.end()) return;
  for (const auto& [name, inode] : names->second) {
    paths[prefix + name] = inode;
    ListPaths(entries, inode, prefix + name + "/", paths);
  }
}

std::map<std::string, Inode> Disk::Paths() const {
  std::mt19937_64 unused;
  std::map<std::string, Inode> paths = {{"", kRoot}};
  ListPaths(Names(PowerCut::kKeepsAll, unused), kRoot, "", paths);
  return paths;
}

DiskLog Continue(const DiskLog& log, size_t calls, DiskLog next) {
  DiskLog both = log;
  both.calls.resize(calls);
  Disk disk(log);
  Inode highest = 0;
  for (const auto& [path, inode] : log.inodes) highest = std::max(highest, inode);
  for (const DiskCall& call : log.calls) highest = std::max(highest, call.file);
  for (const DiskCall& call : both.calls) disk.Apply(call);
  const auto paths = disk.Paths();
  std::map<Inode, Inode> renumbered;
  for (const auto& [path, inode] : next.inodes)
    if (paths.contains(path)) renumbered[inode] = paths.at(path);
  const auto renumber = [&](Inode& inode) {
    if (inode < 0) return;
    const auto [known, fresh] = renumbered.emplace(inode, highest + 1);
    highest += fresh ? 1 : 0;
    inode = known->second;
  };
  for (DiskCall& call : next.calls) {
    for (Inode* inode : {&call.file, &call.folder, &call.old_folder}) renumber(*inode);
    both.calls.push_back(std::move(call));
  }
  return both;
}

DiskImage Disk::After(PowerCut cut, std::mt19937_64& random) const {
  DiskImage image;
  Collect(Names(cut, random), kRoot, "", cut, random, image);
  // SQLite's shared memory is a cache of the -wal: whoever opens first makes it anew. It is written through a mapping,
  // which no recorder sees.
  std::erase_if(image, [](const auto& file) { return file.first.ends_with("-shm"); });
  return image;
}

}  // namespace stratalux::db::crash
