// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/memory_layout.h"

#include <algorithm>
#include <optional>
#include <utility>

namespace stratalux::rig {
namespace {

constexpr int kSections = 7;

std::string Prefix(const std::string& where) { return where.empty() ? "" : where + ": "; }

std::optional<SessionKind> KindOf(MemorySection section) {
  switch (section) {
    case MemorySection::kVisitor:
      return SessionKind::kVisitor;
    case MemorySection::kCalibration:
      return SessionKind::kCalibration;
    case MemorySection::kDark:
      return SessionKind::kDark;
    case MemorySection::kFlat:
      return SessionKind::kFlat;
    case MemorySection::kResponse:
      return SessionKind::kResponse;
    case MemorySection::kPreview:
    case MemorySection::kWhiteCard:
      break;
  }
  return std::nullopt;
}

// What the section needs of each projector.
Result<std::vector<std::vector<Pattern>>> NeededBy(MemorySection section, const PlanOptions& options) {
  std::vector<std::vector<Pattern>> needed;
  const std::optional<SessionKind> kind = KindOf(section);
  if (!kind) {
    const std::vector<Pattern> pair = {{.kind = PatternKind::kWhite}, {.kind = PatternKind::kBlack}};
    needed.assign(static_cast<size_t>(options.projectors), pair);
    return needed;
  }
  PlanOptions of_kind = options;
  of_kind.kind = *kind;
  SLX_ASSIGN_OR_RETURN(const CapturePlan plan, BuildPlan(of_kind));
  for (int p = 0; p < options.projectors; ++p) needed.push_back(SequenceOf(plan, p));
  return needed;
}

// Each memory with the section behind what it held before, unless that has it already.
void Append(MemorySection section, const std::vector<std::vector<Pattern>>& needed,
            std::vector<ProjectorMemory>& memories) {
  for (size_t p = 0; p < memories.size(); ++p) {
    std::vector<Pattern>& held = memories[p].patterns;
    const std::vector<Pattern>& own = needed[p];
    const auto found = std::search(held.begin(), held.end(), own.begin(), own.end());
    memories[p].sections.push_back({section, static_cast<int>(found - held.begin()), static_cast<int>(own.size())});
    if (found == held.end()) held.insert(held.end(), own.begin(), own.end());
  }
}

size_t LongestOf(const std::vector<ProjectorMemory>& memories) {
  size_t longest = 0;
  for (const ProjectorMemory& memory : memories) longest = std::max(longest, memory.patterns.size());
  return longest;
}

}  // namespace

const std::vector<std::string>& MemorySectionNames() {
  static const std::vector<std::string> kNames = {"visitor", "preview", "white_card", "calibration",
                                                  "dark",    "flat",    "response"};
  return kNames;
}

const char* ToString(MemorySection section) { return MemorySectionNames()[static_cast<size_t>(section)].c_str(); }

Result<MemorySection> ParseMemorySection(const std::string& text) {
  const std::vector<std::string>& names = MemorySectionNames();
  const auto found = std::find(names.begin(), names.end(), text);
  if (found != names.end()) return static_cast<MemorySection>(found - names.begin());
  std::string allowed;
  for (const std::string& name : names) allowed += (allowed.empty() ? "" : ", ") + name;
  return Status::Usage("section '" + text + "' is unknown; allowed: " + allowed);
}

MemorySection SectionOf(SessionKind kind) {
  switch (kind) {
    case SessionKind::kVisitor:
      return MemorySection::kVisitor;
    case SessionKind::kCalibration:
      return MemorySection::kCalibration;
    case SessionKind::kDark:
      return MemorySection::kDark;
    case SessionKind::kFlat:
      return MemorySection::kFlat;
    case SessionKind::kResponse:
      break;
  }
  return MemorySection::kResponse;
}

std::vector<Pattern> SequenceOf(const CapturePlan& plan, int projector) {
  std::vector<Pattern> sequence;
  for (const int owner : {-1, projector})
    for (const PlanStep& step : plan.steps)
      if (step.projector == owner) sequence.push_back(step.pattern);
  return sequence;
}

bool MemoryLayout::Holds(MemorySection section) const {
  return std::none_of(left_out.begin(), left_out.end(), [&](const LeftOut& out) { return out.section == section; });
}

std::vector<std::vector<Pattern>> MemoryLayout::Patterns() const {
  std::vector<std::vector<Pattern>> patterns;
  for (const ProjectorMemory& memory : projectors) patterns.push_back(memory.patterns);
  return patterns;
}

Status MemoryLayout::CheckHeld(const CapturePlan& plan, int projector) const {
  const MemorySection section = SectionOf(plan.options.kind);
  const std::string name = ToString(section);
  for (const LeftOut& out : left_out)
    if (out.section == section)
      return Status::Usage(Prefix(where) + "the pattern memories hold no section '" + name + "': " + out.why +
                           "; then fill the memories again (`stratalux-rig plan render`)");
  if (projector >= static_cast<int>(projectors.size()))
    return Status::Usage("no pattern memory of projector " + std::to_string(projector) + ": they are laid out for " +
                         std::to_string(projectors.size()));
  const std::vector<Pattern> sequence = SequenceOf(plan, projector);
  const std::vector<Pattern>& held = projectors[static_cast<size_t>(projector)].patterns;
  if (std::search(held.begin(), held.end(), sequence.begin(), sequence.end()) != held.end() || sequence.empty())
    return Status::Ok();
  return Status::Usage(
      Prefix(where) + "the plan of this " + name + " differs from [plan], which the memory of " + "projector " +
      std::to_string(projector) +
      " holds; capture it with the options of [plan], or change them there and fill the memories again "
      "(`stratalux-rig plan render`)");
}

Result<MemoryLayout> LayOutMemories(const PlanOptions& plan, const MemoryOptions& options) {
  MemoryLayout layout;
  layout.projectors.resize(static_cast<size_t>(plan.projectors));
  layout.capacity = options.capacity;
  layout.where = options.where;
  const bool all = options.sections.empty();
  const auto limit = std::to_string(options.capacity);
  std::string held;
  for (int s = 0; s < kSections; ++s) {
    const auto section = static_cast<MemorySection>(s);
    const std::string name = ToString(section);
    if (!all && std::find(options.sections.begin(), options.sections.end(), section) == options.sections.end()) {
      layout.left_out.push_back({section, "[memory] sections does not name it; add it there"});
      continue;
    }
    const Result<std::vector<std::vector<Pattern>>> needed = NeededBy(section, plan);
    if (!needed.ok()) {
      if (!all) return needed.status().WithContext(Prefix(options.where) + "[memory] sections: " + name);
      layout.left_out.push_back({section, "it cannot be planned: " + needed.status().message()});
      continue;
    }
    std::vector<ProjectorMemory> larger = layout.projectors;
    Append(section, *needed, larger);
    const size_t longest = LongestOf(larger);
    if (options.capacity > 0 && longest > static_cast<size_t>(options.capacity)) {
      const std::string too_small = "memory.capacity = " + limit + " patterns, but " + std::to_string(longest) +
                                    " are needed" + (held.empty() ? "" : " with " + held);
      if (!all)
        return Status::Usage(Prefix(options.where) + "[memory] sections: no room for '" + name + "': " + too_small +
                             "; raise it if the modules hold more, or leave sections out of memory.sections");
      layout.left_out.push_back(
          {section, too_small + "; raise it if the modules hold more, or name in memory.sections what it should hold"});
      continue;
    }
    layout.projectors = std::move(larger);
    held += (held.empty() ? "" : ", ") + name;
  }
  if (held.empty())
    return Status::Usage(Prefix(options.where) + "memory.capacity = " + limit +
                         " patterns: no section fits; raise it to what the projectors' modules hold");
  return layout;
}

}  // namespace stratalux::rig
