// SPDX-License-Identifier: Apache-2.0
// A view of the index that cannot write: a connection of its own, opened read-only, whose authorizer lets nothing but
// SELECT pass. Takes SQL from operators as it comes. No sqlite3 type appears here.
#pragma once

#include <chrono>
#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "db/catalogue/result_table.h"
#include "shared/base/result.h"

namespace stratalux::db {

struct QueryLimits {
  std::chrono::milliseconds time{10'000};  // an endless recursion ends here
  int64_t rows = 100'000;
  int64_t bytes = int64_t{32} << 20;  // of text and blobs in the answer
};

// Name without its colon -> value. A parameter of the statement that is not given is NULL.
using QueryParameters = std::map<std::string, Cell>;

// Values are at most 16 MiB long, statements 1 MiB, and SQLite takes at most 512 MiB of memory. A single call of a
// function on values that long may nevertheless outlast the time limit (instr, replace and their like take the product
// of two lengths): who runs what others wrote ends its process then, as `stratalux-db sql` does (db/apps/watchdog.h).
class ReadOnlyIndex {
 public:
  // Migrates an older store first. kNotFound, kNewerSchema, kIntegrity, kBusy as SessionStore::Open.
  static Result<ReadOnlyIndex> Open(const std::filesystem::path& folder);
  ~ReadOnlyIndex();
  ReadOnlyIndex(ReadOnlyIndex&&) noexcept;
  ReadOnlyIndex& operator=(ReadOnlyIndex&&) noexcept;

  // One statement. kUsage: it is wrong, writes, or is more than one; kFailed: it ran into the time limit.
  // Reaching the limit of rows or bytes is no error: `truncated` says so.
  Result<ResultTable> Run(const std::string& sql, const QueryParameters& parameters = {},
                          const QueryLimits& limits = {});

 private:
  struct Impl;
  explicit ReadOnlyIndex(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace stratalux::db
