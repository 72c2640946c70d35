// SPDX-License-Identifier: Apache-2.0
#include "db/care/index_swap.h"

#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "db/base/sqlite.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

fs::path FreeName(const fs::path& store) {
  std::error_code error;
  for (int n = 1;; ++n) {
    const fs::path name = store / (kKeptIndex + std::to_string(n) + ".sqlite");
    if (!fs::exists(name, error)) return name;
  }
}

Status Move(const fs::path& from, const fs::path& to) {
  std::error_code error;
  fs::rename(from, to, error);
  return error ? Status::Failed("cannot move " + from.string() + " to " + to.string() + ": " + error.message())
               : Status::Ok();
}

}  // namespace

Result<std::shared_ptr<void>> ReleaseIndex(const fs::path& store) {
  const fs::path file = store / "index.sqlite";
  std::error_code error;
  std::shared_ptr<void> held;
  if (!fs::exists(file, error)) return held;
  auto connection = Connection::Open(file, Connection::Mode::kReadWrite);
  if (!connection.ok()) return held;
  // Leaving WAL mode needs the file for oneself: SQLite itself says whether somebody reads.
  const Status left = connection->Execute("PRAGMA journal_mode = DELETE");
  if (left.code() == StatusCode::kBusy)
    return Status::Busy(file.string() + " is open in another program; close it and try again");
  if (!left.ok()) return held;
  const Status locked = connection->Execute("BEGIN IMMEDIATE");
  if (locked.code() == StatusCode::kBusy) {  // somebody came in between
    (void)ResumeIndex(store).ok();           // not while that program is there
    return locked;
  }
  if (locked.ok()) held = std::make_shared<Connection>(std::move(connection).value());
  return held;
}

Status ResumeIndex(const fs::path& store) {
  std::error_code error;
  if (!fs::exists(store / "index.sqlite", error)) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(store / "index.sqlite", Connection::Mode::kReadWrite));
  return connection.Execute("PRAGMA journal_mode = WAL");
}

Result<fs::path> SwapIndex(const fs::path& store, const fs::path& fresh) {
  const fs::path file = store / "index.sqlite";
  SLX_RETURN_IF_ERROR(SyncFile(fresh));
  std::error_code error;
  fs::path kept;
  if (fs::exists(file, error)) {
    kept = FreeName(store);
    // A second name first, so that at every moment there is an index under the name that programs open.
    fs::create_hard_link(file, kept, error);
    if (error) fs::copy_file(file, kept, error);
    if (error) return Status::Failed("cannot keep " + file.string() + " as " + kept.string() + ": " + error.message());
  }
  // The log of a damaged index must not be taken for one of the new.
  for (const char* suffix : {"-wal", "-shm", "-journal"}) {
    const fs::path log = file.string() + suffix;
    if (!fs::exists(log, error)) continue;
    SLX_RETURN_IF_ERROR(Move(log, (kept.empty() ? FreeName(store) : kept).string() + suffix));
  }
  SLX_RETURN_IF_ERROR(Move(fresh, file));
  SLX_RETURN_IF_ERROR(SyncFolder(store));
  return kept;
}

}  // namespace stratalux::db
