// SPDX-License-Identifier: Apache-2.0
// A value that is dear to make and wanted by several stages in a row: the last one is kept in memory.
#pragma once

#include <optional>
#include <string>
#include <utility>

#include "shared/base/result.h"

namespace stratalux::fit {

// Thread-bound.
template <typename T>
class Kept {
 public:
  // What `make`, a function to a Result<T>, made of `key`: valid until another key is asked for, or Drop(). A failure
  // is not kept. At no time are there two values.
  template <typename Make>
  Result<const T*> Of(const std::string& key, const Make& make) {
    if (value_ && key == key_) return &*value_;
    Drop();
    SLX_ASSIGN_OR_RETURN(auto made, make());
    value_.emplace(std::move(made));
    key_ = key;
    return &*value_;
  }
  // Keeps what was made of `key` elsewhere.
  void Put(const std::string& key, T value) {
    Drop();
    value_.emplace(std::move(value));
    key_ = key;
  }
  // The value that is kept, or nullptr; who changes it, changes it for all who have it.
  T* Get() { return value_ ? &*value_ : nullptr; }
  void Drop() { value_.reset(); }
  [[nodiscard]] bool Empty() const { return !value_; }

 private:
  std::string key_;
  std::optional<T> value_;
};

}  // namespace stratalux::fit
