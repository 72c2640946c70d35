// SPDX-License-Identifier: Apache-2.0
// A V4L2 camera without a kernel: in a test program that links scripted_v4l2.cc, regular files answer V4L2's requests.
// A file that was removed is a device that was unplugged.
#pragma once

#include <atomic>
#include <filesystem>

namespace stratalux::rig {

struct ScriptedV4l2 {
  static constexpr int kWidth = 64, kHeight = 48;
  std::atomic<unsigned long> refused = 0;  // this request fails with EIO, `refusals` times; 0: none
  std::atomic<int> refusals = 0;

  static void Plug(const std::filesystem::path& node);
};

[[nodiscard]] ScriptedV4l2& TheV4l2();

}  // namespace stratalux::rig
