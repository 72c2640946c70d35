// SPDX-License-Identifier: Apache-2.0
// Deleter of what the kernel's graphics library gives: std::unique_ptr<drmModeRes, Freed<drmModeFreeResources>>.
// Internal to the KMS sources.
#pragma once

namespace stratalux::rig {

template <auto kFree>
struct Freed {
  template <typename T>
  void operator()(T* pointer) const {
    kFree(pointer);
  }
};

}  // namespace stratalux::rig
