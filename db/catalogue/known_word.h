// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <utility>

#include "shared/base/result.h"

namespace stratalux::db {

// Of a file's word for one of several: words of the next version are not damage.
template <typename T>
[[nodiscard]] Result<T> Known(Result<T> parsed) {
  if (parsed.ok()) return parsed;
  return Status(StatusCode::kNewerSchema, parsed.status().message() + "; a newer stratalux may know it");
}

}  // namespace stratalux::db
