// SPDX-License-Identifier: Apache-2.0
// What disk_calls.cc asks before and tells after each file call.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <sys/types.h>

namespace stratalux::db::crash {

// 0, or the errno with which the call must fail without being made.
int RefusalOf(const char* path);
int RefusalOf(int fd);
// Of `size` bytes, those that still fit: a disk that fills up takes half of them first, then none.
size_t SpaceFor(int fd, size_t size);
int SyncRefusalOf(int fd);
// Calls that a full disk does not refuse (removals, syncs), but before which a process may die as well.
void MayDie(const char* path);
void MayDie(int fd);
bool SyncIsSkipped();
[[nodiscard]] bool IsRecorded(int fd);

void NoteOpen(int fd, const char* path, int flags);
void NoteClose(int fd);
// `offset` -1: where the descriptor stood before it wrote `size` bytes.
void NoteWrite(int fd, const void* data, size_t size, int64_t offset);
void NoteTruncate(int fd, int64_t size);
void NoteTruncate(const char* path, int64_t size);
void NoteSync(int fd);
void NoteRename(const char* from, const char* to);
void NoteHardLink(const char* from, const char* to);
void NoteUnlink(const char* path);
void NoteMakeFolder(const char* path);
// "/absolute/path" of a name relative to a folder's descriptor.
[[nodiscard]] std::string PathAt(int folder_fd, const char* path);

}  // namespace stratalux::db::crash
