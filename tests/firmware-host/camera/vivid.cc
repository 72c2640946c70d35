// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/camera/vivid.h"

#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>

namespace stratalux::rig {

std::unique_ptr<Vivid> Vivid::Find() {
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", ignored)) {
    if (!entry.path().filename().string().starts_with("video")) continue;
    UniqueFd fd(open(entry.path().c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
    v4l2_capability capability{};
    if (!fd.ok() || ioctl(fd.get(), VIDIOC_QUERYCAP, &capability) != 0) continue;
    if (std::strcmp(reinterpret_cast<const char*>(capability.driver), "vivid") != 0) continue;
    auto vivid = std::make_unique<Vivid>();
    vivid->fd_ = std::move(fd);
    return vivid;
  }
  return nullptr;
}

bool Vivid::Set(const std::string& control, int value) {
  v4l2_queryctrl query{};
  query.id = V4L2_CTRL_FLAG_NEXT_CTRL;
  for (; ioctl(fd_.get(), VIDIOC_QUERYCTRL, &query) == 0; query.id |= V4L2_CTRL_FLAG_NEXT_CTRL) {
    if (control != reinterpret_cast<const char*>(query.name)) continue;
    v4l2_control set{query.id, value};
    return ioctl(fd_.get(), VIDIOC_S_CTRL, &set) == 0;
  }
  return false;
}

}  // namespace stratalux::rig
