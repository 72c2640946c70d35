// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

namespace stratalux::bench {

// Runs `rounds` of independent multiply-adds on the chosen instruction set's vectors; returns how many floats were
// multiplied and added. The machine's peak: no memory, no dependence that stalls.
int64_t MultiplyAdds(int64_t rounds);

}  // namespace stratalux::bench
