// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/read_only_index.h"

#include <sqlite3.h>

#include "db/base/sqlite.h"
#include "db/catalogue/session_index.h"

namespace stratalux::db {
namespace {

using Clock = std::chrono::steady_clock;

// The progress handler looks at the clock between two steps of SQLite's machine, never within one: these keep a step
// short. The longest text of a store, a calibration record or the metrics of a fit, has some hundred kilobytes.
constexpr int kLongestValue_bytes = 16 << 20;
constexpr int kLongestStatement_bytes = 1 << 20;
// Sorting and materialised subqueries, too, as temporary tables stay in memory. Of the whole process.
constexpr int64_t kMostMemory_bytes = int64_t{512} << 20;

// What the callbacks of one connection see and leave behind.
struct Guard {
  Clock::time_point deadline = Clock::time_point::max();
  bool out_of_time = false;
  std::string refused;  // what the authorizer last said no to
};

// The action's name, as an operator would call it.
const char* ActionName(int action) {
  switch (action) {
    case SQLITE_INSERT:
      return "INSERT";
    case SQLITE_UPDATE:
      return "UPDATE";
    case SQLITE_DELETE:
      return "DELETE";
    case SQLITE_PRAGMA:
      return "PRAGMA";
    case SQLITE_ATTACH:
      return "ATTACH or VACUUM";  // VACUUM asks as ATTACH of an empty name
    case SQLITE_DETACH:
      return "DETACH";
    case SQLITE_TRANSACTION:
    case SQLITE_SAVEPOINT:
      return "a transaction";
    case SQLITE_REINDEX:
      return "REINDEX";
    case SQLITE_ANALYZE:
      return "ANALYZE";
    case SQLITE_ALTER_TABLE:
      return "ALTER";
    case SQLITE_FUNCTION:
      return "function";
    default:
      return "changing the schema";
  }
}

int Authorize(void* user, int action, const char* first, const char* second, const char*, const char*) {
  const bool function = action == SQLITE_FUNCTION;
  const std::string name = function && second != nullptr ? second : "";
  // Reading rows, and functions that touch nothing outside the statement.
  if (action == SQLITE_SELECT || action == SQLITE_READ || action == SQLITE_RECURSIVE ||
      (function && name != "load_extension" && name != "fts3_tokenizer"))
    return SQLITE_OK;
  auto& guard = *static_cast<Guard*>(user);
  guard.refused = ActionName(action);
  if (function) guard.refused += " " + name;
  if (!function && first != nullptr && *first != '\0') guard.refused += std::string(" ") + first;
  return SQLITE_DENY;
}

int Progress(void* user) {
  auto& guard = *static_cast<Guard*>(user);
  guard.out_of_time = Clock::now() > guard.deadline;
  return guard.out_of_time ? 1 : 0;
}

struct Finalizer {
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using StatementHandle = std::unique_ptr<sqlite3_stmt, Finalizer>;

struct Binder {
  sqlite3_stmt* statement;
  int index;
  int operator()(std::monostate) const { return sqlite3_bind_null(statement, index); }
  int operator()(int64_t value) const { return sqlite3_bind_int64(statement, index, value); }
  int operator()(double value) const { return sqlite3_bind_double(statement, index, value); }
  int operator()(const std::string& text) const {
    return sqlite3_bind_text64(statement, index, text.data(), text.size(), SQLITE_TRANSIENT, SQLITE_UTF8);
  }
  int operator()(const Blob& bytes) const {
    return sqlite3_bind_blob64(statement, index, bytes.data(), bytes.size(), SQLITE_TRANSIENT);
  }
};

Cell CellOf(sqlite3_stmt* statement, int column) {
  const auto bytes = [&] { return static_cast<size_t>(sqlite3_column_bytes(statement, column)); };
  switch (sqlite3_column_type(statement, column)) {
    case SQLITE_INTEGER:
      return static_cast<int64_t>(sqlite3_column_int64(statement, column));
    case SQLITE_FLOAT:
      return sqlite3_column_double(statement, column);
    case SQLITE_TEXT: {
      const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(statement, column));
      return std::string(text, bytes());
    }
    case SQLITE_BLOB: {
      const auto* data = static_cast<const uint8_t*>(sqlite3_column_blob(statement, column));
      return data == nullptr ? Blob() : Blob(data, data + bytes());
    }
    default:
      return std::monostate();
  }
}

int64_t BytesOf(const Cell& cell) {
  if (const auto* text = std::get_if<std::string>(&cell)) return static_cast<int64_t>(text->size());
  if (const auto* blob = std::get_if<Blob>(&cell)) return static_cast<int64_t>(blob->size());
  return 8;
}

}  // namespace

struct ReadOnlyIndex::Impl {
  Connection connection;
  Guard guard;

  [[nodiscard]] Status ErrorOf(int code, const QueryLimits& limits) const;
  Result<StatementHandle> Prepare(const std::string& sql, const QueryLimits& limits);
  Result<ResultTable> Collect(sqlite3_stmt* statement, const QueryLimits& limits) const;
};

Status ReadOnlyIndex::Impl::ErrorOf(int code, const QueryLimits& limits) const {
  if (guard.out_of_time)
    return Status::Failed("stopped after " + std::to_string(limits.time.count()) +
                          " ms without finishing; ask for less (a WHERE, a --since) or give it more time");
  switch (code & 0xff) {
    case SQLITE_AUTH:
      return Status::Usage("this only reads: " + (guard.refused.empty() ? "that statement" : guard.refused) +
                           " is refused");
    case SQLITE_READONLY:
      return Status::Usage("this only reads: the statement writes");
    case SQLITE_TOOBIG:
      return Status::Usage("a value or the statement is too long for a query; allowed: values of " +
                           std::to_string(kLongestValue_bytes) + " bytes, statements of " +
                           std::to_string(kLongestStatement_bytes));
    case SQLITE_NOMEM:
      return Status::Failed("stopped: it needs more than " + std::to_string(kMostMemory_bytes >> 20) +
                            " MiB of memory; ask for less (a WHERE, a LIMIT, fewer columns)");
    case SQLITE_ERROR:
    case SQLITE_MISMATCH:
    case SQLITE_RANGE:
      return Status::Usage(std::string("SQL: ") + sqlite3_errmsg(connection.handle()));
    default:
      return connection.Error("query");
  }
}

Result<StatementHandle> ReadOnlyIndex::Impl::Prepare(const std::string& sql, const QueryLimits& limits) {
  sqlite3_stmt* raw = nullptr;
  const char* tail = nullptr;
  if (sql.find('\0') != std::string::npos) return Status::Usage("SQL: a statement must not contain a zero byte");
  int code = sqlite3_prepare_v2(connection.handle(), sql.c_str(), -1, &raw, &tail);
  StatementHandle statement(raw);
  if (code != SQLITE_OK) return ErrorOf(code, limits);
  if (!statement) return Status::Usage("SQL: no statement given");
  // What follows may be blanks and comments alone.
  code = sqlite3_prepare_v2(connection.handle(), tail, -1, &raw, nullptr);
  const StatementHandle second(raw);
  if (code != SQLITE_OK || second) return Status::Usage("SQL: one statement at a time");
  if (sqlite3_stmt_readonly(statement.get()) == 0) return Status::Usage("this only reads: the statement writes");
  return statement;
}

Result<ResultTable> ReadOnlyIndex::Impl::Collect(sqlite3_stmt* statement, const QueryLimits& limits) const {
  ResultTable table;
  const int columns = sqlite3_column_count(statement);
  for (int c = 0; c < columns; ++c) {
    const char* name = sqlite3_column_name(statement, c);
    table.columns.push_back({name == nullptr ? "?" : name});
  }
  int64_t bytes = 0;
  while (true) {
    const int code = sqlite3_step(statement);
    if (code == SQLITE_DONE) return table;
    if (code != SQLITE_ROW) return ErrorOf(code, limits);
    if (static_cast<int64_t>(table.rows.size()) >= limits.rows || bytes >= limits.bytes) {
      table.truncated = true;
      return table;
    }
    std::vector<Cell>& row = table.rows.emplace_back();
    row.reserve(static_cast<size_t>(columns));
    for (int c = 0; c < columns; ++c) bytes += BytesOf(row.emplace_back(CellOf(statement, c)));
  }
}

Result<ReadOnlyIndex> ReadOnlyIndex::Open(const std::filesystem::path& folder) {
  // Says what is wrong with a store, and migrates an old one.
  SLX_RETURN_IF_ERROR(SessionIndex::Open(folder, AccessMode::kReadOnly).status());
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(folder / "index.sqlite", Connection::Mode::kReadOnly));
  // SQLite declares a table-valued function at its first use, and asks the authorizer as if it wrote the schema.
  for (const char* function : {"json_each", "json_tree"})
    SLX_RETURN_IF_ERROR(connection.QueryInteger("SELECT count(*) FROM " + std::string(function) + "('[]')").status());
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA query_only = ON; PRAGMA temp_store = MEMORY"));
  sqlite3_hard_heap_limit64(kMostMemory_bytes);
  std::unique_ptr<Impl> impl(new Impl{std::move(connection), {}});
  sqlite3* handle = impl->connection.handle();
  sqlite3_limit(handle, SQLITE_LIMIT_ATTACHED, 0);
  sqlite3_limit(handle, SQLITE_LIMIT_LENGTH, kLongestValue_bytes);
  sqlite3_limit(handle, SQLITE_LIMIT_SQL_LENGTH, kLongestStatement_bytes);
  sqlite3_limit(handle, SQLITE_LIMIT_EXPR_DEPTH, 200);
  sqlite3_limit(handle, SQLITE_LIMIT_COMPOUND_SELECT, 100);
  sqlite3_limit(handle, SQLITE_LIMIT_COLUMN, 500);
  sqlite3_limit(handle, SQLITE_LIMIT_LIKE_PATTERN_LENGTH, 1000);
  sqlite3_db_config(handle, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
  sqlite3_db_config(handle, SQLITE_DBCONFIG_ENABLE_LOAD_EXTENSION, 0, nullptr);
  sqlite3_set_authorizer(handle, Authorize, &impl->guard);
  sqlite3_progress_handler(handle, 1000, Progress, &impl->guard);
  return ReadOnlyIndex(std::move(impl));
}

ReadOnlyIndex::ReadOnlyIndex(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ReadOnlyIndex::ReadOnlyIndex(ReadOnlyIndex&&) noexcept = default;
ReadOnlyIndex& ReadOnlyIndex::operator=(ReadOnlyIndex&&) noexcept = default;
ReadOnlyIndex::~ReadOnlyIndex() = default;

Result<ResultTable> ReadOnlyIndex::Run(const std::string& sql, const QueryParameters& parameters,
                                       const QueryLimits& limits) {
  impl_->guard = {Clock::now() + limits.time, false, {}};
  SLX_ASSIGN_OR_RETURN(const StatementHandle statement, impl_->Prepare(sql, limits));
  for (int i = 1; i <= sqlite3_bind_parameter_count(statement.get()); ++i) {
    const char* name = sqlite3_bind_parameter_name(statement.get(), i);
    const auto given = name == nullptr ? parameters.end() : parameters.find(name + 1);
    if (given == parameters.end()) continue;
    if (const int code = std::visit(Binder{statement.get(), i}, given->second); code != SQLITE_OK)
      return impl_->ErrorOf(code, limits);
  }
  return impl_->Collect(statement.get(), limits);
}

}  // namespace stratalux::db
