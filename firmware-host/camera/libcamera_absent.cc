// SPDX-License-Identifier: Apache-2.0
// Stands in for libcamera_frame_source.cc where libcamera was not found.
#include "firmware-host/camera/libcamera_frame_source.h"

namespace stratalux::rig {

Result<std::vector<LibcameraDevice>> LibcameraFrameSource::List() {
  return Status::Usage("this program was built without libcamera; install libcamera-dev and build again");
}

Result<std::unique_ptr<FrameSource>> LibcameraFrameSource::Open(const CameraWiring&, Logger&) {
  return Status::Usage(
      "[camera] backend = \"libcamera\": this program was built without libcamera; install libcamera-dev and build "
      "again");
}

bool LibcameraFrameSource::IsBuilt() { return false; }

bool LibcameraFrameSource::IsThere(const CameraWiring&) { return false; }

}  // namespace stratalux::rig
