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
  int64_t bytes = int64_t{256} << 20;  // of text and blobs in the answer
};

// Name without its colon -> value. A parameter of the statement that is not given is NULL.
using QueryParameters = std::map<std::string, Cell>;

// Functions that SQL run here may call besides SQLite's own:
//   planned_steps(plan_json)     steps of the capture plan; NULL where the text is no plan
//   missing_steps(step)          aggregate: what lies between 0 and the largest step and is not among them, "1-2, 4"
//   reason_class(text)           the text with every number as N, so that equal failures meet in one group
//   retention_days(retention)    days a session of that class is kept; NULL: for ever
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
