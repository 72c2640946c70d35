// SPDX-License-Identifier: Apache-2.0
#define ARMA_NO_DEBUG  // no checks of indices, as its manual recommends for speed
#include <armadillo>

#include "shared/base/check.h"
#include "tests/bench/mixture/em_peers.h"

namespace stratalux::bench {
namespace {

fit::LayerSet GmmDiag(const Photons& photons, const fit::LayerSet& start, int layers, int sweeps) {
  const arma::rowvec samples(RepeatedSamples(photons));
  arma::gmm_diag mixture;
  const bool given = !start.weight.empty();
  if (given)
    mixture.set_params(arma::rowvec(start.depth_mm), arma::square(arma::rowvec(start.sigma_mm)),
                       arma::rowvec(start.weight));
  constexpr int kKmeansIterations = 10;
  constexpr double kLeastVariance = 1e-6;  // mm^2
  const arma::gmm_seed_mode& seed = given ? static_cast<const arma::gmm_seed_mode&>(arma::keep_existing)
                                          : static_cast<const arma::gmm_seed_mode&>(arma::static_spread);
  SLX_CHECK(mixture.learn(samples, layers, arma::eucl_dist, seed, given ? 0 : kKmeansIterations, sweeps, kLeastVariance,
                          false));
  const arma::rowvec sigma = arma::sqrt(mixture.dcovs);
  fit::LayerSet fitted;
  fitted.weight.assign(mixture.hefts.begin(), mixture.hefts.end());
  fitted.depth_mm.assign(mixture.means.begin(), mixture.means.end());
  fitted.sigma_mm.assign(sigma.begin(), sigma.end());
  return fitted;
}

}  // namespace

PeerEm ArmadilloEm() { return GmmDiag; }

}  // namespace stratalux::bench
