// SPDX-License-Identifier: Apache-2.0
// Finding: one thing that was seen of a capture, as data. Stored with the session; words are made of it at the edge.
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux {

// `value` against `limit`: see each. Steps and projectors are those of the finding.
enum class FindingKind {
  kStopped,            // who or what took the light away; in `detail`
  kDevice,             // a device or the disk failed; in `detail`
  kPreroll,            // the pre-roll's code did not decode; in `detail`
  kSilentRig,          // shots in a row without a usable frame | how many end a capture
  kNoProof,            // the step has no proven frame
  kWrongPattern,       // the step's last frame does not show its pattern
  kProofReused,        // the step's trigger or frame number proves another step, too
  kTriggersUnmatched,  // camera triggers | frames and named losses
  kMoved,    // rms difference of the step's probes from what they were, over white; without a step, of all projectors'
             // whites together, or of the one whose share of them differs most | largest of a subject that holds still
  kLamp,     // light of the step, of a comb cycle or of the pre-roll, as a share of the reference's | largest
             // deviation from 1
  kBlink,    // the same of one frame whose neighbours are as they should be
  kMixedUp,  // sum of a comb cycle where one line passes, over the mean of all lines | largest deviation from 1
  kSaturated,  // share of the lit subject that saturates | largest
  kDim,        // signal-to-noise ratio of the darkest tenth of the lit subject | smallest
  kWatch,      // what the session is captured for (a board, a matt target) objects; in `detail`
};
inline constexpr int kFindingKindCount = 15;

// Words of the store: "stopped", "device", ..., of the enumerators' names.
[[nodiscard]] const char* ToString(FindingKind kind);
// kNewerSchema for a word that this program does not know: another version's.
[[nodiscard]] Result<FindingKind> ParseFindingKind(const std::string& word);

struct Finding {
  FindingKind kind = FindingKind::kDevice;
  int projector = -1;  // -1: of all, or of none
  int step = -1;       // of the plan; -1: of none
  double value = 0.0;  // finite; see FindingKind
  double limit = 0.0;
  std::string detail = {};  // a device's own words; empty where the numbers say all

  friend bool operator==(const Finding&, const Finding&) = default;
};

// What a capture found: findings in the order they came up, and shots that did not count, by the fault's name
// ("lost frame" -> 2).
struct CaptureFindings {
  std::vector<Finding> findings;
  std::map<std::string, int64_t> faults;

  friend bool operator==(const CaptureFindings&, const CaptureFindings&) = default;
};

// One line a finding, for people; findings of one kind that differ in their steps alone share one
// ("no proven frame for steps 3, 17 and 2 more").
[[nodiscard]] std::vector<std::string> ToText(const std::vector<Finding>& findings);

// Steps of which no frame counts, whatever was said of it when it was stored: what came later told that it proves
// nothing (a code it was judged by was given up, a projector turned out to have been out of step).
[[nodiscard]] std::set<int> WithdrawnSteps(const std::vector<Finding>& findings);

// [{"kind", "projector", "step", "value", "limit", "detail"}]; projector, step, detail are left out where there is
// none. Reading: kIntegrity for another shape or a number that is not finite, kNewerSchema for an unknown kind.
[[nodiscard]] std::string FindingsToJson(const std::vector<Finding>& findings);
[[nodiscard]] Result<std::vector<Finding>> FindingsFromJson(const std::string& text);
// {"lost frame": 2}. kIntegrity for another shape or a negative count.
[[nodiscard]] std::string FaultsToJson(const std::map<std::string, int64_t>& faults);
[[nodiscard]] Result<std::map<std::string, int64_t>> FaultsFromJson(const std::string& text);

}  // namespace stratalux
