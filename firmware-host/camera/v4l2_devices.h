// SPDX-License-Identifier: Apache-2.0
// The V4L2 cameras of this machine and what they can do: what a frame source chooses from, and `stratalux-rig devices`
// prints. Nothing here changes a device or takes it from who uses it. All functions are reentrant.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "firmware-host/camera/camera_wiring.h"
#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

// Who it is, as VIDIOC_QUERYCAP says.
struct V4l2Node {
  std::string path, driver, card, bus;

  [[nodiscard]] std::string ToString() const { return path + " (" + driver + ", " + card + ", " + bus + ")"; }
};

// From `min` to `max`; both alike for a single size. Pixels of the mosaic.
struct V4l2FrameSize {
  int min_width = 0, min_height = 0;
  int max_width = 0, max_height = 0;
  int step_width = 1, step_height = 1;
  std::vector<double> intervals_ms;    // between frames that run freely, as the driver lists them
  bool intervals_are_a_range = false;  // from the first to the second

  [[nodiscard]] bool Holds(int width, int height) const;
};

struct V4l2PixelFormat {
  uint32_t fourcc = 0;
  std::string name;         // FourCC as text, for [camera] format
  std::string description;  // the driver's
  std::vector<V4l2FrameSize> sizes;
};

// In the driver's units.
struct V4l2Control {
  std::string key, value;  // the words of rig.toml that choose it: exposure_control = "exposure_absolute"
  std::string name;        // the driver's
  int minimum = 0, maximum = 0, step = 1, preset = 0, current = 0;
};

struct V4l2Camera {
  V4l2Node node;
  std::vector<V4l2PixelFormat> formats;  // those that are not raw without their sizes
  std::vector<V4l2Control> controls;     // of exposure and gain, of those that rig.toml can name
};

// ioctl(2), again after signals.
int CallV4l2(int fd, unsigned long request, void* argument);

// The device nodes by their names, sorted.
[[nodiscard]] std::vector<std::string> V4l2Paths(const std::string& folder = "/dev");
// Not ok: errno says why.
[[nodiscard]] UniqueFd OpenV4l2(const std::string& path);
// nullopt: no device that streams frames.
[[nodiscard]] std::optional<V4l2Node> DescribeV4l2(int fd, const std::string& path);
// What the driver lists, without sizes.
[[nodiscard]] std::vector<V4l2PixelFormat> V4l2Formats(int fd);
[[nodiscard]] V4l2Camera InquireV4l2(int fd, V4l2Node node);

// Whether [camera] means this one. `device` may be a link to it.
[[nodiscard]] bool Names(const CameraWiring& wiring, const V4l2Node& node);
// The FourCC that [camera] format means, the one of most bits where it names none. kUsage: not offered; the message
// lists the raw ones.
[[nodiscard]] Result<uint32_t> ChooseV4l2Format(const std::string& path, std::span<const V4l2PixelFormat> formats,
                                                const std::string& wanted);
// kUsage: this camera cannot be what [camera] asks for, by what it lists of formats, sizes and controls; no frame was
// taken.
[[nodiscard]] Status CanBe(const CameraWiring& wiring, const V4l2Camera& camera);

}  // namespace stratalux::rig
