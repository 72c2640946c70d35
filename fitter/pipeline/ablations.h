// SPDX-License-Identifier: Apache-2.0
// What must predict a held-out light worse than the fit itself: training data spoilt on purpose, in place (a full-size
// set of SRDs fills memory once, not twice) and mended again.
#pragma once

#include <vector>

#include "fitter/pipeline/srd_stage.h"

namespace stratalux::fit {

// Gives the training lights' directions to each other while it lives.
class PermutedProjectors {
 public:
  PermutedProjectors(SrdSet& srds, int heldout);
  ~PermutedProjectors();
  PermutedProjectors(const PermutedProjectors&) = delete;
  PermutedProjectors& operator=(const PermutedProjectors&) = delete;

 private:
  void Turn(int by);
  SrdSet& srds_;
  std::vector<int> training_;
};

// Puts the frames of each comb cycle in a random order while it lives.
class ShuffledCombFrames {
 public:
  ShuffledCombFrames(SrdSet& srds, uint64_t seed);
  ~ShuffledCombFrames();
  ShuffledCombFrames(const ShuffledCombFrames&) = delete;
  ShuffledCombFrames& operator=(const ShuffledCombFrames&) = delete;

 private:
  SrdSet& srds_;
  std::vector<std::vector<int>> orders_;  // by batch, those of columns first: sample k came from orders_[b][k]
};

}  // namespace stratalux::fit
