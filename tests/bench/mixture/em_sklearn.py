#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""scikit-learn's GaussianMixture on the profiles of em_bench, in em_bench's units (docs/benchmarks.md).

  STRATALUX_BENCH_PROFILES=profiles.txt build/bench/bin/em_bench
  tests/bench/mixture/em_sklearn.py profiles.txt

Takes no weights: each sample is repeated as often as it has photons, spread over its cell.
"""
import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: a core alone

import math
import sys
import time
import warnings

import numpy as np
import sklearn
from sklearn.mixture import GaussianMixture

SWEEPS = 50


def read_profiles(path):
    """One dictionary of arrays a profile: lines as WritePeerProfiles (peer_profiles.h) writes them."""
    profiles = []
    for line in open(path):
        name, *words = line.split()
        if name == "noisy":
            profiles.append({})
        profiles[-1][name] = np.array(words, dtype=float)
    for profile in profiles:
        profile["start"] = profile["start"].reshape(-1, 3)  # weight, mean mm, sigma mm
    return profiles


def repeated_samples(photons):
    """Places in mm, one a photon."""
    first_mm, step_mm = photons[:2]
    counts = np.rint(photons[2:]).astype(int)
    in_cell = [(np.arange(n) + 0.5) / n - 0.5 for n in counts if n > 0]
    return first_mm + step_mm * (np.repeat(np.arange(len(counts)), counts) + np.concatenate(in_cell))


def fit(profile, from_own_start):
    """Rows of weight, mean, sigma after SWEEPS iterations, from k-means or from our layers."""
    weight, mean, sigma = profile["start"].T
    start = dict(weights_init=weight, means_init=mean[:, None], precisions_init=sigma[:, None] ** -2)
    mixture = GaussianMixture(len(weight), covariance_type="diag", tol=0.0, max_iter=SWEEPS, random_state=1,
                              **(start if from_own_start else {}))
    mixture.fit(repeated_samples(profile["noisy"])[:, None])
    return np.stack([mixture.weights_, mixture.means_[:, 0], np.sqrt(mixture.covariances_[:, 0])], axis=1)


def divergence(photons, layers):
    """Kullback-Leibler, the mixture integrated over each cell: DivergenceOf of peer_profiles.cc."""
    first_mm, step_mm = photons[:2]
    p = photons[2:] / photons[2:].sum()
    edges = first_mm + step_mm * (np.arange(len(p) + 1) - 0.5)
    below = [sum(w * 0.5 * math.erfc((m - x) / (s * math.sqrt(2.0))) for w, m, s in layers) for x in edges]
    q = np.maximum(np.diff(below) / (below[-1] - below[0]), 1e-12)
    lit = p > 0.0
    return float(np.sum(p[lit] * np.log(p[lit] / q[lit])))


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    profiles = read_profiles(sys.argv[1])
    warnings.simplefilter("ignore")  # that it has not converged: the sweeps are given
    for from_own_start in (False, True):
        before = time.process_time()
        fits = [fit(profile, from_own_start) for profile in profiles]
        rate = len(profiles) / (time.process_time() - before)
        noisy, truth = (np.mean([divergence(profile[of], layers) for profile, layers in zip(profiles, fits)])
                        for of in ("noisy", "truth"))
        start = "own start" if from_own_start else "k-means"
        print(f"scikit-learn {sklearn.__version__}/{start}: {rate:.2f} profiles/s, "
              f"divergence from the data {noisy:.2e}, from the truth {truth:.2e}")


if __name__ == "__main__":
    main()
