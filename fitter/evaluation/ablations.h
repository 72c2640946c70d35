// SPDX-License-Identifier: Apache-2.0
// Data spoilt on purpose: a fit of it must predict the held-out light worse (model section 9).
#pragma once

#include <cstdint>

#include "fitter/stages/srd.h"

namespace stratalux::fit {

// The training lights' directions given to each other: light k gets those of the next one, around.
[[nodiscard]] SrdSet WithPermutedProjectors(SrdSet srds, int heldout);
// The samples of every comb cycle in another, random order; one a sweep.
[[nodiscard]] SrdSet WithShuffledCombFrames(SrdSet srds, uint64_t seed);

}  // namespace stratalux::fit
