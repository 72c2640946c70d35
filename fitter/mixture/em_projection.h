// SPDX-License-Identifier: Apache-2.0
// Between the fine grid and the samples: the line response B of model section 7 and its transpose, for sixteen profiles
// at once. Chosen for the machine's instruction set at run time, like em_kernel.h.
#pragma once

#include "fitter/mixture/em_light.h"

namespace stratalux::fit {

// Of the light whose layers were added to work's `mass` last: model = B mass + surface + background. `surface`,
// `background`: [lane].
void Project(EmLight& light, EmWork& work, const float* surface, const float* background);

// ratio = data / (model + shift), 0 in lanes without the light, with its sums. divergence[lane] += the light's share of
// the generalised Kullback-Leibler divergence, sum of counts (m - d + d log(d / m)).
void Compare(EmLight& light, EmWork& work, float* divergence);

// q = B^T ratio; cells that no sample sees get the model's own expectation (exact EM for a truncated observation).
void ProjectBack(const EmLight& light, EmWork& work);

}  // namespace stratalux::fit
