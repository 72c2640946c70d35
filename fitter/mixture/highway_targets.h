// SPDX-License-Identifier: Apache-2.0
// Which instruction sets the fitter's kernels are compiled for: AVX-512, AVX2 and a baseline on x86-64, NEON on ARM.
// Included by kernel sources only, once an instruction set (no include guard: Highway includes the source again for
// each). Vectors of unknown length (SVE) cannot be array elements, and sixteen lanes fill NEON as well.
#undef HWY_DISABLED_TARGETS
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_SSSE3)
#include <hwy/foreach_target.h>  // must come before highway.h
#include <hwy/highway.h>
