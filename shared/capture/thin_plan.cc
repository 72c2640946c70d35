// SPDX-License-Identifier: Apache-2.0
#include "shared/capture/thin_plan.h"

#include <algorithm>
#include <functional>

namespace stratalux {
namespace {

// Of a cycle's combs, one in so many is left at least, and so many of them: EM takes no fewer samples than three.
constexpr int kMostApart = 16, kFewestCombs = 4;

// Steps that are kept or left out together, of all projectors.
struct Group {
  std::string name;
  std::vector<int> steps;
};

using Test = std::function<bool(const PlanStep&)>;

class Thinner {
 public:
  explicit Thinner(const CapturePlan& plan) : plan_(plan) {
    const PlanOptions& o = plan.options;
    combs_ = o.comb_period / o.comb_step;
    for (int every = kMostApart; every >= 1; every /= 2)
      if (combs_ % every == 0 && combs_ / every >= kFewestCombs) levels_.push_back(every);
    AddGroups();
  }

  [[nodiscard]] ThinPlan Take(int frames) {
    ThinPlan thin;
    thin.asked = frames;
    thin.whole = static_cast<int>(plan_.steps.size());
    size_t taken = 0;
    int used = 0;
    while (taken < groups_.size() && used + Count(taken) <= frames) used += Count(taken++);
    for (size_t g = 0; g < taken; ++g) Keep(groups_[g], thin);
    Fill(frames, thin);
    Describe(taken, thin);
    return thin;
  }

  // Frames of the groups up to the codes of columns.
  [[nodiscard]] int ForSurface() const {
    int frames = 0;
    for (size_t g = 0; g <= columns_; ++g) frames += Count(g);
    return frames;
  }
  [[nodiscard]] int Fewest() const { return Count(0); }

 private:
  [[nodiscard]] int Count(size_t group) const { return static_cast<int>(groups_[group].steps.size()); }

  [[nodiscard]] bool IsComb(const PlanStep& s, PatternAxis axis) const {
    return s.phase == CapturePhase::kSweep && s.bracket == 0 && s.pattern.axis == axis;
  }

  // Combs of one cycle in `every`, but for those of one in `but` (0: none).
  [[nodiscard]] Test Combs(int every, int but) const {
    return [=, this](const PlanStep& s) {
      if (!IsComb(s, PatternAxis::kColumns)) return false;
      const int k = s.pattern.shift / plan_.options.comb_step;
      return k % every == 0 && (but == 0 || k % but != 0);
    };
  }

  static Test Nominal(CapturePhase phase, PatternKind kind, PatternAxis axis, bool inverse = false) {
    return [=](const PlanStep& s) {
      return s.phase == phase && s.bracket == 0 && s.pattern.kind == kind && s.pattern.axis == axis &&
             s.pattern.inverse == inverse;
    };
  }

  void Add(const std::string& name, const Test& test) {
    Group group{name, {}};
    for (const PlanStep& step : plan_.steps)
      if (step.projector >= 0 && test(step)) group.steps.push_back(step.index);
    groups_.push_back(std::move(group));
  }

  void AddCombs(size_t level) {
    if (level < levels_.size()) Add("", Combs(levels_[level], level == 0 ? 0 : levels_[level - 1]));
  }

  void AddGroups() {
    using enum CapturePhase;
    using enum PatternKind;
    using enum PatternAxis;
    const auto least = Combs(levels_.empty() ? 1 : levels_.front(), 0);
    Add("", [&](const PlanStep& s) { return (s.phase == kReference && s.bracket == 0) || least(s); });
    AddCombs(1);
    Add("sinusoids along columns", Nominal(kSeparation, kSinusoid, kColumns));
    columns_ = groups_.size();
    Add("codes of columns", Nominal(kCorrespondence, kGray, kColumns));
    AddCombs(2);
    AddCombs(3);
    row_sinusoids_ = groups_.size();
    Add("sinusoids along rows", Nominal(kSeparation, kSinusoid, kRows));
    Add("inverse codes of columns", Nominal(kCorrespondence, kGray, kColumns, true));
    for (size_t level = 4; level < levels_.size(); ++level) AddCombs(level);
    Add("codes of rows", Nominal(kCorrespondence, kGray, kRows));
    Add("inverse codes of rows", Nominal(kCorrespondence, kGray, kRows, true));
    Add("combs over rows", [&](const PlanStep& s) { return IsComb(s, kRows); });
    Add("further exposures",
        [](const PlanStep& s) { return s.bracket > 0 && (s.phase == kReference || s.phase == kSweep); });
  }

  void Keep(const Group& group, ThinPlan& thin) const {
    thin.kept.insert(thin.kept.end(), group.steps.begin(), group.steps.end());
  }

  // One more frame of every projector at a time. Black first: its noise is in all samples of a sweep alike.
  void Fill(int frames, ThinPlan& thin) const {
    std::vector<std::vector<const PlanStep*>> blacks(plan_.options.projectors), whites = blacks;
    for (const PlanStep& s : plan_.steps) {
      if (s.projector < 0) continue;
      if (s.phase == CapturePhase::kGuard) blacks[static_cast<size_t>(s.projector)].push_back(&s);
      if (s.phase == CapturePhase::kMotion) whites[static_cast<size_t>(s.projector)].push_back(&s);
    }
    for (size_t k = 0; k < std::max(blacks[0].size(), whites[0].size()); ++k)
      for (const auto* of : {&blacks, &whites}) {
        if (k >= of->front().size()) continue;
        if (static_cast<int>(thin.kept.size() + of->size()) > frames) return;
        for (const auto& steps : *of) thin.kept.push_back(steps[k]->index);
      }
  }

  // Whether comparisons with held-out light read it (fitter/evaluation/heldout_takes.h).
  [[nodiscard]] static bool IsEvaluated(const PlanStep& s) {
    return s.bracket == 0 &&
           (s.phase == CapturePhase::kSpot || s.phase == CapturePhase::kRepeat || s.phase == CapturePhase::kMotion ||
            (s.phase == CapturePhase::kSweep && s.pattern.axis == PatternAxis::kColumns && s.pattern.shift == 0));
  }

  void Describe(size_t taken, ThinPlan& thin) const {
    std::sort(thin.kept.begin(), thin.kept.end());
    std::vector<bool> is_kept(plan_.steps.size(), false);
    for (const int step : thin.kept) is_kept[static_cast<size_t>(step)] = true;
    int combs = 0;
    for (const PlanStep& s : plan_.steps) {
      const bool kept = is_kept[static_cast<size_t>(s.index)];
      if (s.projector == 0 && IsComb(s, PatternAxis::kColumns)) combs += kept ? 1 : 0;
      if (IsEvaluated(s) && !kept) ++thin.evaluation_only;
      thin.row_sweep = thin.row_sweep || (kept && IsComb(s, PatternAxis::kRows));
    }
    thin.comb_every = combs > 0 ? combs_ / combs : 1;
    thin.columns = taken > columns_;
    thin.sinusoids.clear();
    if (taken >= columns_) thin.sinusoids.push_back(PatternAxis::kColumns);
    if (taken > row_sinusoids_) thin.sinusoids.push_back(PatternAxis::kRows);
    if (combs < combs_)
      thin.left_out.push_back("combs: " + std::to_string(combs_ - combs) + " of " + std::to_string(combs_));
    for (size_t g = taken; g < groups_.size(); ++g) {
      const Group& group = groups_[g];
      if (group.name.empty() || group.steps.empty()) continue;
      thin.left_out.push_back(group.name + ": " +
                              std::to_string(group.steps.size() / static_cast<size_t>(plan_.options.projectors)));
    }
    if (plan_.options.preroll_markers > 0)
      thin.left_out.push_back("pre-roll: " + std::to_string(plan_.options.preroll_markers) + " in all");
    for (const auto& [name, phase] :
         {std::pair{"guards", CapturePhase::kGuard}, {"motion whites", CapturePhase::kMotion}})
      DescribeMissing(name, phase, is_kept, thin);
  }

  void DescribeMissing(const std::string& name, CapturePhase phase, const std::vector<bool>& is_kept,
                       ThinPlan& thin) const {
    int all = 0, missing = 0;
    for (const PlanStep& s : plan_.steps) {
      if (s.phase != phase || s.projector != 0) continue;
      ++all;
      missing += is_kept[static_cast<size_t>(s.index)] ? 0 : 1;
    }
    if (missing > 0) thin.left_out.push_back(name + ": " + std::to_string(missing) + " of " + std::to_string(all));
  }

  const CapturePlan& plan_;
  int combs_ = 0;
  std::vector<int> levels_;  // one comb in so many, falling
  std::vector<Group> groups_;
  size_t columns_ = 0, row_sinusoids_ = 0;  // numbers of the codes of columns, of the sinusoids along rows
};

ThinPlan Whole(const CapturePlan& plan, int frames) {
  ThinPlan whole;
  whole.asked = frames;
  whole.whole = static_cast<int>(plan.steps.size());
  for (const PlanStep& step : plan.steps) whole.kept.push_back(step.index);
  whole.row_sweep = plan.options.row_sweep;
  return whole;
}

}  // namespace

Result<ThinPlan> ThinTo(const CapturePlan& plan, int frames) {
  if (plan.options.kind != SessionKind::kVisitor)
    return Status::Usage("frames = " + std::to_string(frames) +
                         ": only a visitor's plan can be thinned, not one of kind '" + ToString(plan.options.kind) +
                         "'");
  if (frames >= static_cast<int>(plan.steps.size())) return Whole(plan, frames);
  Thinner thinner(plan);
  if (frames < thinner.Fewest())
    return Status::Usage("frames = " + std::to_string(frames) + ": white, black and a few combs of each of " +
                         std::to_string(plan.options.projectors) + " projectors need at least " +
                         std::to_string(thinner.Fewest()) + " frames");
  return thinner.Take(frames);
}

std::string Describe(const ThinPlan& thin) {
  std::string text = std::to_string(thin.kept.size()) + " of " + std::to_string(thin.whole) + " frames";
  if (thin.evaluation_only > 0)
    text += ", and " + std::to_string(thin.evaluation_only) + " that only comparisons with held-out light use";
  for (const std::string& what : thin.left_out)
    text += (&what == &thin.left_out.front() ? "; left out for each projector: " : ", ") + what;
  return text;
}

int LeastForSurface(const CapturePlan& plan) { return Thinner(plan).ForSurface(); }

}  // namespace stratalux
