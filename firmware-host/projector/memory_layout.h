// SPDX-License-Identifier: Apache-2.0
// What the pattern memories of one rig hold: a section for each kind of capture, so that one filling serves them all.
//
//   index 0        visitor | preview | white_card | calibration | dark | flat | response
//                  always in this order; a section whose patterns stand in a row already has its place there
//
// White and black of preview and white card stand in every visit, so that both cost nothing beside one.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/capture/plan.h"

namespace stratalux::rig {

enum class MemorySection : uint8_t {
  kVisitor,      // pre-roll and steps of a visit; white and black of its pre-scan are among them
  kPreview,      // white, black: single frames of whoever sits there
  kWhiteCard,    // white, black: the rig's own check before a white card
  kCalibration,  // each kind of session has the section of its name: pre-roll, then the projector's own steps
  kDark,
  kFlat,
  kResponse
};

[[nodiscard]] const char* ToString(MemorySection section);
// Their names, in the order of the memory.
[[nodiscard]] const std::vector<std::string>& MemorySectionNames();
[[nodiscard]] Result<MemorySection> ParseMemorySection(const std::string& text);
[[nodiscard]] MemorySection SectionOf(SessionKind kind);

struct MemoryOptions {
  std::vector<MemorySection> sections;  // what is held; empty: all that fit, in order
  int capacity = 0;                     // patterns that each memory can hold; 0: no limit
  std::string where;                    // "rig.toml:12": what messages name; empty: the built-in defaults
};

struct SectionPlace {
  MemorySection section = MemorySection::kVisitor;
  int first = 0;  // index of its first pattern
  int count = 0;

  friend bool operator==(const SectionPlace&, const SectionPlace&) = default;
};

// Of one projector.
struct ProjectorMemory {
  std::vector<Pattern> patterns;       // in the order of the TRIGGER pulses
  std::vector<SectionPlace> sections;  // in the order of the enumeration

  friend bool operator==(const ProjectorMemory&, const ProjectorMemory&) = default;
};

struct MemoryLayout {
  struct LeftOut {
    MemorySection section = MemorySection::kVisitor;
    std::string why;  // such as "[memory] sections does not name it"
  };
  std::vector<ProjectorMemory> projectors;
  std::vector<LeftOut> left_out;  // held by none of them
  int capacity = 0;               // as MemoryOptions has it
  std::string where;              // as MemoryOptions has it

  [[nodiscard]] bool Holds(MemorySection section) const;
  // All their patterns, projector by projector.
  [[nodiscard]] std::vector<std::vector<Pattern>> Patterns() const;
  // kUsage with the remedy where a capture of `plan` needs what this projector's memory does not hold.
  [[nodiscard]] Status CheckHeld(const CapturePlan& plan, int projector) const;
};

// What TRIGGER pulses show on a projector in a capture of `plan`: the pre-roll markers, then its own steps.
[[nodiscard]] std::vector<Pattern> SequenceOf(const CapturePlan& plan, int projector);

// The sections of `plan`, whatever its kind. kUsage where a section asked for cannot be planned or does not fit, or
// none fits; the message names file, key, value and remedy.
[[nodiscard]] Result<MemoryLayout> LayOutMemories(const PlanOptions& plan, const MemoryOptions& options = {});

}  // namespace stratalux::rig
