// SPDX-License-Identifier: Apache-2.0
// Reads a file that SQLite may have open in this process. Closing any descriptor of a file drops every POSIX lock that
// the process holds on it, SQLite's own included (sqlite.org/howtocorrupt.html, 2.2): another program would take a
// database for unused while a capture is written to it. So the descriptor stays open for as long as the file has a
// name, one for each file. Internal to db/.
#pragma once

#include <filesystem>

namespace stratalux::db {

// By its name: a database, or the -shm that WAL mode locks.
[[nodiscard]] bool MayBeOfSqlite(const std::filesystem::path& file);

// For pread; never to be closed. Negative, with errno, where the file cannot be opened. Thread-safe.
[[nodiscard]] int HeldDescriptor(const std::filesystem::path& file);

}  // namespace stratalux::db
