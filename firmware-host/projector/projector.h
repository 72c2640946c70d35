// SPDX-License-Identifier: Apache-2.0
// Projector: a memory of patterns, stepped by TRIGGER pulses of the line bank.
#pragma once

#include <vector>

#include "shared/base/result.h"
#include "shared/pattern/pattern.h"

namespace stratalux::rig {

class Projector {
 public:
  virtual ~Projector() = default;
  [[nodiscard]] virtual int width() const = 0;
  [[nodiscard]] virtual int height() const = 0;
  // Makes the next TRIGGER show sequence[0], and those after it what follows. A memory that is filled beforehand goes
  // to where that stands, showing whatever lies on the way: only in the dark.
  virtual Status Load(const std::vector<Pattern>& sequence) = 0;
  // What was shown last may not be what was asked for: the next Load trusts no count of steps where it can rewind. For
  // projectors that cannot be out of step, nothing.
  virtual void Doubt() {}
  // Goes, in the dark, to where it waits between captures: the memory's first pattern, where the next program finds it,
  // too. Where that can rewind, no doubt is left then.
  virtual Status Rest() { return Status::Ok(); }
};

}  // namespace stratalux::rig
