// SPDX-License-Identifier: Apache-2.0
#include "db/base/sqlite.h"

#include <cerrno>
#include <cstdio>
#include <cstring>

#include <fcntl.h>
#include <sqlite3.h>
#include <unistd.h>

namespace stratalux::db {
namespace {

thread_local StatementWork work_of_this_thread;

}  // namespace

void Connection::Closer::operator()(sqlite3* handle) const { sqlite3_close(handle); }
void Statement::Finalizer::operator()(sqlite3_stmt* handle) const {
  work_of_this_thread.scanned_rows += sqlite3_stmt_status(handle, SQLITE_STMTSTATUS_FULLSCAN_STEP, 0);
  work_of_this_thread.steps += sqlite3_stmt_status(handle, SQLITE_STMTSTATUS_VM_STEP, 0);
  sqlite3_finalize(handle);
}

StatementWork WorkOfThisThread() { return work_of_this_thread; }

Status Connection::Error(const std::string& what) const {
  const int code = handle_ ? sqlite3_errcode(handle_.get()) & 0xff : SQLITE_CANTOPEN;
  std::string message = file_ + ": " + what + ": " + (handle_ ? sqlite3_errmsg(handle_.get()) : "cannot be opened");
  // SQLite tries to read what it could not create: then the system's last word is that there is no such file.
  const int reason = handle_ ? sqlite3_system_errno(handle_.get()) : 0;
  if ((code == SQLITE_CANTOPEN || code == SQLITE_IOERR) && reason != 0 && reason != ENOENT)
    message += std::string(" (") + std::strerror(reason) + ")";
  if (code == SQLITE_BUSY || code == SQLITE_LOCKED)
    return Status::Busy(message + "; another program is writing to it, try again");
  if (code == SQLITE_CORRUPT || code == SQLITE_NOTADB)
    return Status::Integrity(message + "; restore it from a copy (the frames in sessions/ are not touched)");
  // A row that the schema refuses is the fault of what it was made from.
  if (code == SQLITE_CONSTRAINT) return Status::Integrity(message);
  // It was opened before another file took its name (reindex); what is written to it would be lost.
  if (handle_ && sqlite3_extended_errcode(handle_.get()) == SQLITE_READONLY_DBMOVED)
    return Status::Busy(message + "; it was replaced by a new one meanwhile, try again");
  if (code == SQLITE_READONLY)
    return Status::Failed(message + "; its disk is mounted read-only, or its permissions forbid writing");
  if (code == SQLITE_CANTOPEN)
    return Status::Failed(message +
                          "; it or its -wal can be neither opened nor created: check the permissions and the"
                          " free space");
  if (code == SQLITE_FULL || code == SQLITE_IOERR)
    return Status::Failed(message + "; check the free space and the health of its disk");
  return Status::Failed(message);
}

Result<Connection> Connection::Open(const std::filesystem::path& file, Mode mode) {
  Connection connection;
  connection.file_ = file.string();
  sqlite3* handle = nullptr;
  // SQLite would tell the reason of its last attempt, to open for reading, instead of that of the first.
  if (mode == Mode::kCreate) {
    const int fd = open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0640);
    if (fd < 0) return Status::Failed("cannot create " + connection.file_ + ": " + std::strerror(errno));
    close(fd);
  }
  // What a writer left that was killed without a log (entering or leaving WAL mode), only a writer rolls back.
  if (std::error_code error; mode == Mode::kReadOnly && std::filesystem::exists(file.string() + "-journal", error))
    if (const auto writer = Open(file, Mode::kReadWrite); writer.ok())
      sqlite3_exec(writer->handle_.get(), "PRAGMA schema_version", nullptr, nullptr, nullptr);
  const int flags = mode == Mode::kReadOnly    ? SQLITE_OPEN_READONLY
                    : mode == Mode::kReadWrite ? SQLITE_OPEN_READWRITE
                                               : SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE;
  const int code = sqlite3_open_v2(file.c_str(), &handle, flags, nullptr);
  connection.handle_.reset(handle);
  if (code != SQLITE_OK) return connection.Error("open");
  sqlite3_busy_timeout(handle, 5000);
  // A WAL database needs its -shm, which cannot be made here.
  const bool unwritable = access(file.parent_path().empty() ? "." : file.parent_path().c_str(), W_OK) != 0;
  if (unwritable && sqlite3_exec(handle, "PRAGMA schema_version", nullptr, nullptr, nullptr) == SQLITE_CANTOPEN)
    return OpenUnwritable(file);
  return connection;
}

// Nobody can write the file, so that no locks are needed. What the -wal holds is read, where there is one, with its
// index in memory (exclusive mode).
Result<Connection> Connection::OpenUnwritable(const std::filesystem::path& file) {
  Connection connection;
  connection.file_ = file.string();
  std::error_code error;
  const auto log_bytes = std::filesystem::file_size(file.string() + "-wal", error);
  const bool log = !error && log_bytes > 0;
  std::string name = "file:";
  for (const char c : std::filesystem::absolute(file).string()) {
    char escaped[4] = {c, 0};
    if (c == '%' || c == '?' || c == '#') std::snprintf(escaped, sizeof escaped, "%%%02X", static_cast<unsigned>(c));
    name += escaped;
  }
  name += log ? "?vfs=unix-none" : "?immutable=1";
  sqlite3* handle = nullptr;
  const int code = sqlite3_open_v2(name.c_str(), &handle, SQLITE_OPEN_READONLY | SQLITE_OPEN_URI, nullptr);
  connection.handle_.reset(handle);
  if (code != SQLITE_OK) return connection.Error("open");
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA locking_mode = EXCLUSIVE"));
  return connection;
}

Status Connection::Execute(const std::string& sql) {
  if (sqlite3_exec(handle_.get(), sql.c_str(), nullptr, nullptr, nullptr) != SQLITE_OK) return Error("execute");
  return Status::Ok();
}

Result<Statement> Connection::Prepare(const std::string& sql) {
  sqlite3_stmt* statement = nullptr;
  if (sqlite3_prepare_v2(handle_.get(), sql.c_str(), static_cast<int>(sql.size()), &statement, nullptr) != SQLITE_OK)
    return Error("prepare");
  return Statement(this, statement);
}

Result<int64_t> Connection::QueryInteger(const std::string& sql) {
  SLX_ASSIGN_OR_RETURN(auto statement, Prepare(sql));
  SLX_ASSIGN_OR_RETURN(const bool row, statement.Step());
  return row ? statement.Integer(0) : int64_t{0};
}

Status Connection::Attach(const std::filesystem::path& file, const std::string& name) {
  SLX_ASSIGN_OR_RETURN(auto attach, Prepare("ATTACH ?1 AS " + name));
  return attach.Bind(1, file.string()).Run();
}

Status Connection::CopyInto(const std::filesystem::path& to) {
  SLX_ASSIGN_OR_RETURN(auto copy, Prepare("VACUUM INTO ?1"));
  return copy.Bind(1, to.string()).Run();
}

Status Connection::FillFrom(const Connection& source) {
  sqlite3_backup* copy = sqlite3_backup_init(handle_.get(), "main", source.handle_.get(), "main");
  if (copy == nullptr) return Error("fill");
  const bool done = sqlite3_backup_step(copy, -1) == SQLITE_DONE;
  const bool finished = sqlite3_backup_finish(copy) == SQLITE_OK;
  return done && finished ? Status::Ok() : Error("fill");
}

int64_t Connection::LastInsertId() const { return sqlite3_last_insert_rowid(handle_.get()); }

Statement& Statement::Bind(int index, int64_t value) {
  sqlite3_bind_int64(handle_.get(), index, value);
  return *this;
}
Statement& Statement::Bind(int index, double value) {
  sqlite3_bind_double(handle_.get(), index, value);
  return *this;
}
Statement& Statement::Bind(int index, const std::string& value) {
  sqlite3_bind_text(handle_.get(), index, value.data(), static_cast<int>(value.size()), SQLITE_TRANSIENT);
  return *this;
}
Statement& Statement::Bind(int index, std::span<const uint8_t> bytes) {
  sqlite3_bind_blob(handle_.get(), index, bytes.data(), static_cast<int>(bytes.size()), SQLITE_TRANSIENT);
  return *this;
}

Result<bool> Statement::Step() {
  const int code = sqlite3_step(handle_.get());
  if (code == SQLITE_ROW) return true;
  if (code == SQLITE_DONE) return false;
  return connection_->Error("step");
}

void Statement::Reset() { sqlite3_reset(handle_.get()); }

Status Statement::Run() {
  const Result<bool> row = Step();
  sqlite3_reset(handle_.get());
  return row.status();
}

int64_t Statement::Integer(int column) const { return sqlite3_column_int64(handle_.get(), column); }
double Statement::Real(int column) const { return sqlite3_column_double(handle_.get(), column); }
std::string Statement::Text(int column) const {
  const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(handle_.get(), column));
  return text == nullptr ? std::string()
                         : std::string(text, static_cast<size_t>(sqlite3_column_bytes(handle_.get(), column)));
}
std::vector<uint8_t> Statement::Blob(int column) const {
  const auto* bytes = static_cast<const uint8_t*>(sqlite3_column_blob(handle_.get(), column));
  return bytes == nullptr ? std::vector<uint8_t>()
                          : std::vector<uint8_t>(bytes, bytes + sqlite3_column_bytes(handle_.get(), column));
}

Result<Transaction> Transaction::Begin(Connection& connection) {
  const bool nested = sqlite3_get_autocommit(connection.handle_.get()) == 0;
  SLX_RETURN_IF_ERROR(connection.Execute(nested ? "SAVEPOINT nested" : "BEGIN IMMEDIATE"));
  return Transaction(&connection, nested ? Kind::kNested : Kind::kOuter);
}

Transaction::~Transaction() {
  if (connection_ != nullptr)
    (void)connection_->Execute(kind_ == Kind::kNested ? "ROLLBACK TO nested; RELEASE nested" : "ROLLBACK").ok();
}

Status Transaction::Commit() {
  SLX_RETURN_IF_ERROR(connection_->Execute(kind_ == Kind::kNested ? "RELEASE nested" : "COMMIT"));
  connection_ = nullptr;
  return Status::Ok();
}

}  // namespace stratalux::db
