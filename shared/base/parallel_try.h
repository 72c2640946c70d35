// SPDX-License-Identifier: Apache-2.0
// ParallelTry: tasks that may fail, on all cores.
#pragma once

#include <cstddef>
#include <vector>

#include "shared/base/parallel.h"
#include "shared/base/result.h"

namespace stratalux {

// work(i), a Status, for each i below `count`. All are done, whatever becomes of the others; the first failure by
// number.
template <typename Work>
Status ParallelTry(std::size_t count, const Work& work) {
  std::vector<Status> done(count);
  ParallelFor(static_cast<int64_t>(count), 1, [&](int64_t begin, int64_t end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) done[i] = work(i);
  });
  for (const Status& status : done)
    if (!status.ok()) return status;
  return Status::Ok();
}

}  // namespace stratalux
