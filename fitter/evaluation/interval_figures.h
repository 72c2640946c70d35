// SPDX-License-Identifier: Apache-2.0
// 95 % intervals of predicted light: what the hold-outs of a session say of a prediction's error, and whether the
// intervals that follow from some hold-outs hold for another (docs/math/evaluation.md, "Intervals").
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "fitter/evaluation/prediction_error.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// Of the judged fit with that projector held out, all light rendered: of each light and colour a few thousand pixels at
// most, evenly over those that were judged.
struct HeldOutErrors {
  int projector = 0;
  std::vector<std::string> lights;
  int colours = 0;
  std::vector<std::vector<ErrorSample>> samples;  // [light * colours + colour]
};

// Of `judged` pixels, every how many-th is a sample.
[[nodiscard]] int64_t ErrorSampleStride(int64_t judged);

// errors.npy in `folder`: a row a sample (docs/file-formats.md).
Status SaveErrors(const std::filesystem::path& folder, const HeldOutErrors& errors);
// `errors` has its lights and colours already. kIntegrity: rows that name no light or colour of them.
Status LoadErrors(const std::filesystem::path& folder, HeldOutErrors& errors);

struct IntervalFigures {
  std::vector<int> learnt_from;          // projectors that were held out
  std::vector<PredictionError> colours;  // by all of them; empty: too little to tell
  // A light of one of them, by what the others say. None where one alone was held out.
  struct Covered {
    int projector = 0;
    std::string light;
    double share = 0.0;       // of its pixels and colours within their interval, widened by the capture's noise
    double half_width = 0.0;  // RMS of the intervals' over RMS of the prediction
    int64_t samples = 0;
  };
  std::vector<Covered> covered;
};

// Of `intervals` in metrics.json; raised when its parts mean something else.
inline constexpr int kIntervalsSchema = 2;

// What a fit's metrics.json says; without colours where it says nothing of this schema (another program's, or too
// little was judged). kNotFound, kIntegrity.
[[nodiscard]] Result<IntervalFigures> ReadIntervals(const std::filesystem::path& metrics_json);

[[nodiscard]] IntervalFigures FindIntervals(const std::vector<HeldOutErrors>& heldout);

}  // namespace stratalux::fit
