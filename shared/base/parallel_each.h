// SPDX-License-Identifier: Apache-2.0
// Tasks one by one on all cores: ParallelFor where each index is work enough for a thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "shared/base/parallel.h"
#include "shared/base/result.h"

namespace stratalux {

// work(i) for each i below `count`, on all threads.
template <typename Work>
void ParallelEach(std::size_t count, const Work& work) {
  ParallelFor(static_cast<int64_t>(count), 1, [&](int64_t begin, int64_t end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) work(i);
  });
}

// The same where work(i) is a Status. All are done, whatever becomes of the others; the first failure by number.
template <typename Work>
Status ParallelTry(std::size_t count, const Work& work) {
  std::vector<Status> done(count);
  ParallelEach(count, [&](std::size_t i) { done[i] = work(i); });
  for (const Status& status : done)
    if (!status.ok()) return status;
  return Status::Ok();
}

}  // namespace stratalux
