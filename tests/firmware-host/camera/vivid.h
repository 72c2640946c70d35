// SPDX-License-Identifier: Apache-2.0
// The kernel's virtual camera, loaded as
//   modprobe vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0x0
// and its faults. After `Disconnect` it is gone until its last user closes it.
#pragma once

#include <memory>
#include <string>

#include "shared/base/unique_fd.h"

namespace stratalux::rig {

class Vivid {
 public:
  // Null where this machine has none.
  static std::unique_ptr<Vivid> Find();

  // A control by its name as `v4l2-ctl -L` of the kernel spells it ("Percentage of Dropped Buffers"); false: refused.
  bool Set(const std::string& control, int value);

 private:
  UniqueFd fd_;
};

}  // namespace stratalux::rig
