// SPDX-License-Identifier: Apache-2.0
// Status and Result<T>: how every stage, I/O and device border reports failure.
#pragma once

#include <optional>
#include <string>
#include <utility>

namespace stratalux {

// The codes are also the documented exit codes of the three programs.
enum class StatusCode : int {
  kOk = 0,
  kFailed = 1,
  kUsage = 2,     // wrong flags, configuration, plan or input-file content, found before work starts
  kDegraded = 3,  // partial result
  kNotFound = 4,
  kBusy = 5,
  kIntegrity = 6,  // hash mismatch, truncation
  kNewerSchema = 7,
  kTryAgain = 75,
};

// A code and a message for people. The message names file, value and remedy; context is added in front.
class [[nodiscard]] Status {
 public:
  Status() = default;
  Status(StatusCode code, std::string message) : code_(code), message_(std::move(message)) {}

  static Status Ok() { return {}; }
  static Status Failed(std::string m) { return {StatusCode::kFailed, std::move(m)}; }
  static Status Usage(std::string m) { return {StatusCode::kUsage, std::move(m)}; }
  static Status NotFound(std::string m) { return {StatusCode::kNotFound, std::move(m)}; }
  static Status Busy(std::string m) { return {StatusCode::kBusy, std::move(m)}; }
  static Status Integrity(std::string m) { return {StatusCode::kIntegrity, std::move(m)}; }

  [[nodiscard]] bool ok() const { return code_ == StatusCode::kOk; }
  [[nodiscard]] StatusCode code() const { return code_; }
  [[nodiscard]] const std::string& message() const { return message_; }
  [[nodiscard]] int exit_code() const { return static_cast<int>(code_); }

  // "context: message"; leaves an ok status untouched.
  [[nodiscard]] Status WithContext(const std::string& context) const {
    return ok() ? *this : Status(code_, context + ": " + message_);
  }

 private:
  StatusCode code_ = StatusCode::kOk;
  std::string message_;
};

// A value or the status that says why there is none.
template <typename T>
class [[nodiscard]] Result {
 public:
  Result(T value) : value_(std::move(value)) {}  // NOLINT(google-explicit-constructor)
  // An error: without one a caller would take what was never made for made.
  Result(Status status)  // NOLINT(google-explicit-constructor)
      : status_(status.ok() ? Status::Failed("neither a value nor an error (a fault of the program)")
                            : std::move(status)) {}

  [[nodiscard]] bool ok() const { return value_.has_value(); }
  [[nodiscard]] const Status& status() const { return status_; }
  [[nodiscard]] T& value() & { return *value_; }
  [[nodiscard]] const T& value() const& { return *value_; }
  [[nodiscard]] T&& value() && { return *std::move(value_); }
  T& operator*() & { return *value_; }
  const T& operator*() const& { return *value_; }
  T&& operator*() && { return *std::move(value_); }
  T* operator->() { return &*value_; }
  const T* operator->() const { return &*value_; }

  [[nodiscard]] Result WithContext(const std::string& context) && {
    if (ok()) return std::move(*this);
    return Result(status_.WithContext(context));
  }

 private:
  std::optional<T> value_;
  Status status_;
};

}  // namespace stratalux

#define SLX_CONCAT_INNER(a, b) a##b
#define SLX_CONCAT(a, b) SLX_CONCAT_INNER(a, b)

// Returns from the enclosing function when `expr` (a Status) is not ok.
#define SLX_RETURN_IF_ERROR(expr)                                                     \
  do {                                                                                \
    if (::stratalux::Status slx_status = (expr); !slx_status.ok()) return slx_status; \
  } while (false)

// SLX_ASSIGN_OR_RETURN(auto x, F()): x = value of F(), or return its status.
#define SLX_ASSIGN_OR_RETURN(lhs, expr) SLX_ASSIGN_OR_RETURN_IMPL(SLX_CONCAT(slx_result_, __LINE__), lhs, expr)
#define SLX_ASSIGN_OR_RETURN_IMPL(tmp, lhs, expr) \
  auto tmp = (expr);                              \
  if (!tmp.ok()) return tmp.status();             \
  lhs = std::move(tmp).value()
