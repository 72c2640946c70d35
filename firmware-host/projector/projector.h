// SPDX-License-Identifier: Apache-2.0
// Projector: pattern memory loaded once, then stepped by TRIGGER pulses of the line bank.
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
  // Loads the sequence that TRIGGER pulses step through and rewinds: the next pulse shows sequence[0].
  virtual Status Load(const std::vector<Pattern>& sequence) = 0;
};

}  // namespace stratalux::rig
