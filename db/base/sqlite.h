// SPDX-License-Identifier: Apache-2.0
// SQLite wrapped once: connection, statement, transaction. Internal to db/; no sqlite3 type leaves it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "shared/base/result.h"

struct sqlite3;
struct sqlite3_stmt;

namespace stratalux::db {

class Statement;

class Connection {
 public:
  enum class Mode { kReadOnly, kReadWrite, kCreate };
  // On a disk that cannot be written the connection only reads, whatever the mode.
  static Result<Connection> Open(const std::filesystem::path& file, Mode mode);

  // Runs one or more statements without results.
  Status Execute(const std::string& sql);
  Result<Statement> Prepare(const std::string& sql);
  // First column of the first row.
  Result<int64_t> QueryInteger(const std::string& sql);
  // Another database as schema `name`; its file's name may hold any character.
  Status Attach(const std::filesystem::path& file, const std::string& name);
  // The whole database, as one transaction sees it, as the new file `to`.
  Status CopyInto(const std::filesystem::path& to);
  // All of `source` in place of this database, which is empty, as one transaction.
  Status FillFrom(const Connection& source);
  [[nodiscard]] int64_t LastInsertId() const;
  // Status of a failed call, naming the file.
  [[nodiscard]] Status Error(const std::string& what) const;
  // For what db/*.cc does with SQLite itself (authorizer, functions, limits).
  [[nodiscard]] sqlite3* handle() const { return handle_.get(); }

 private:
  friend class Transaction;
  struct Closer {
    void operator()(sqlite3* handle) const;
  };
  static Result<Connection> OpenUnwritable(const std::filesystem::path& file);
  std::unique_ptr<sqlite3, Closer> handle_;
  std::string file_;
};

// What finished statements of this thread have done so far, for tests of what a question costs: rows that scans without
// an index visited, and steps of SQLite's machine.
struct StatementWork {
  int64_t scanned_rows = 0, steps = 0;
};
[[nodiscard]] StatementWork WorkOfThisThread();

class Statement {
 public:
  Statement& Bind(int index, int64_t value);
  Statement& Bind(int index, double value);
  Statement& Bind(int index, const std::string& value);
  Statement& Bind(int index, std::span<const uint8_t> bytes);
  // True while there is a row.
  Result<bool> Step();
  void Reset();
  // Runs to the end and resets, for statements without rows.
  Status Run();
  [[nodiscard]] int64_t Integer(int column) const;
  [[nodiscard]] double Real(int column) const;
  [[nodiscard]] std::string Text(int column) const;
  [[nodiscard]] std::vector<uint8_t> Blob(int column) const;

 private:
  friend class Connection;
  struct Finalizer {
    void operator()(sqlite3_stmt* handle) const;
  };
  Statement(Connection* connection, sqlite3_stmt* handle) : connection_(connection), handle_(handle) {}
  Connection* connection_;
  std::unique_ptr<sqlite3_stmt, Finalizer> handle_;
};

// Rolls back unless committed. Within another one it is a part of that: nothing is on the disk before the outer
// commits.
class Transaction {
 public:
  static Result<Transaction> Begin(Connection& connection);
  ~Transaction();
  Transaction(Transaction&& other) noexcept
      : connection_(std::exchange(other.connection_, nullptr)), kind_(other.kind_) {}
  Transaction& operator=(Transaction&&) = delete;
  Status Commit();

 private:
  enum class Kind { kOuter, kNested };
  Transaction(Connection* connection, Kind kind) : connection_(connection), kind_(kind) {}
  Connection* connection_;
  Kind kind_;
};

}  // namespace stratalux::db
