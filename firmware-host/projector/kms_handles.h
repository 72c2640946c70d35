// SPDX-License-Identifier: Apache-2.0
// What libdrm hands out, freed as it wants it. For the kms_*.cc alone: third-party types in no other header.
#pragma once

#include <memory>

#include <xf86drm.h>
#include <xf86drmMode.h>

namespace stratalux::rig::kms {

template <auto kFree>
struct Freed {
  template <typename T>
  void operator()(T* pointer) const {
    kFree(pointer);
  }
};
using Version = std::unique_ptr<drmVersion, Freed<drmFreeVersion>>;
using Resources = std::unique_ptr<drmModeRes, Freed<drmModeFreeResources>>;
using Connector = std::unique_ptr<drmModeConnector, Freed<drmModeFreeConnector>>;
using Encoder = std::unique_ptr<drmModeEncoder, Freed<drmModeFreeEncoder>>;

}  // namespace stratalux::rig::kms
