// SPDX-License-Identifier: Apache-2.0
// ParallelFor: a loop over independent items on all cores. Results never depend on the number of threads, since each
// item writes only its own output.
#pragma once

#include <cstdint>
#include <functional>

namespace stratalux {

// Calls body(begin, end) for disjoint ranges that cover [0, count), in chunks of `grain`, on `threads` threads
// (0: STRATALUX_THREADS, else the machine's cores). Blocks until all are done. An exception of `body` is rethrown here.
void ParallelFor(int64_t count, int64_t grain, const std::function<void(int64_t begin, int64_t end)>& body,
                 int threads = 0);

[[nodiscard]] int DefaultThreadCount();

}  // namespace stratalux
