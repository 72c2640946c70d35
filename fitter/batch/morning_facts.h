// SPDX-License-Identifier: Apache-2.0
// What an operator wants to know of a night: who was fitted, who not and why, whose figures are unlike this store's,
// what was slow, and how long the disk lasts.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "fitter/batch/night_status.h"
#include "shared/base/result.h"

namespace stratalux::fit {

// By name; what a fit does not have is not there.
using Figures = std::map<std::string, double>;
// Of metrics.json: "error of stripes, %" (held out, without noise), "coverage, %" (judged of lit skin), "divergence",
// "drift, px" (largest shift of a projector against its calibration; none where none was judged).
[[nodiscard]] Figures FiguresOf(const std::string& metrics_json);
// Processor seconds of each stage, those of one name added.
[[nodiscard]] Figures StageSecondsOf(const std::string& metrics_json);

struct Outlier {
  std::string session, figure;
  double value = 0.0, usual = 0.0, spread = 0.0;  // median and standard deviation (1.4826 MAD) of the earlier fits
};
// Figures further than 3.5 such deviations from the median of at least 8 earlier fits (Iglewicz and Hoaglin, "How to
// Detect and Handle Outliers", 1993, section 3.3).
[[nodiscard]] std::vector<Outlier> OutliersOf(const std::string& session, const Figures& figures,
                                              const std::vector<Figures>& earlier);

struct FittedVisit {
  NightVisit visit;
  bool sealed = false;
  Figures figures = {};
  std::vector<std::string> findings = {};  // of the capture, by kind
  int64_t bytes = 0;                       // of its folder: frames, artifacts, fits
};

struct SlowStage {
  std::string stage;
  double tonight_s = 0.0, usual_s = 0.0;  // of processor, medians
};

struct MorningFacts {
  std::filesystem::path folder;  // of the night
  NightStatus night;
  int unread = 0;  // lines of the night's log
  std::vector<FittedVisit> fitted;
  std::vector<Outlier> outliers;
  std::vector<SlowStage> stages;  // slowest first; usual_s 0: no earlier fit
  size_t earlier = 0;             // fits that tonight's were held against
  int64_t free_bytes = 0;
  // Until the disk is full, were all nights like this one; nullopt: nobody was fitted.
  std::optional<double> nights_left;
};

// Whom nothing may name any more.
[[nodiscard]] Result<std::set<std::string>> ForgottenOf(const std::filesystem::path& store);

// Of nobody who is forgotten. `night`: a name of Nights(store). Earlier fits: the newest 200 of other visitors that
// were made before it.
[[nodiscard]] Result<MorningFacts> GatherMorning(const std::filesystem::path& store, const std::string& night);

}  // namespace stratalux::fit
