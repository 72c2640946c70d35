// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/camera/v4l2_devices.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>

#include "firmware-host/camera/raw_format.h"

namespace stratalux::rig {
namespace {

// A driver that never says that its list ends would hold us for ever.
constexpr uint32_t kLongestList = 256;

std::string Text(const uint8_t* text, size_t size) {
  return {reinterpret_cast<const char*>(text), strnlen(reinterpret_cast<const char*>(text), size)};
}

double Milliseconds(const v4l2_fract& period) {
  return period.denominator > 0 ? 1e3 * period.numerator / period.denominator : 0.0;
}

void ListIntervals(int fd, uint32_t fourcc, V4l2FrameSize& size) {
  v4l2_frmivalenum interval{};
  interval.pixel_format = fourcc;
  interval.width = static_cast<uint32_t>(size.max_width);
  interval.height = static_cast<uint32_t>(size.max_height);
  for (; interval.index < kLongestList && CallV4l2(fd, VIDIOC_ENUM_FRAMEINTERVALS, &interval) == 0; ++interval.index) {
    if (interval.type == V4L2_FRMIVAL_TYPE_DISCRETE) {
      size.intervals_ms.push_back(Milliseconds(interval.discrete));
      continue;
    }
    size.intervals_ms = {Milliseconds(interval.stepwise.min), Milliseconds(interval.stepwise.max)};
    size.intervals_are_a_range = true;
    return;
  }
}

std::vector<V4l2FrameSize> ListSizes(int fd, uint32_t fourcc) {
  std::vector<V4l2FrameSize> sizes;
  v4l2_frmsizeenum listed{};
  listed.pixel_format = fourcc;
  for (; listed.index < kLongestList && CallV4l2(fd, VIDIOC_ENUM_FRAMESIZES, &listed) == 0; ++listed.index) {
    V4l2FrameSize& size = sizes.emplace_back();
    const bool single = listed.type == V4L2_FRMSIZE_TYPE_DISCRETE;
    const v4l2_frmsize_stepwise& range = listed.stepwise;
    size.min_width = static_cast<int>(single ? listed.discrete.width : range.min_width);
    size.min_height = static_cast<int>(single ? listed.discrete.height : range.min_height);
    size.max_width = static_cast<int>(single ? listed.discrete.width : range.max_width);
    size.max_height = static_cast<int>(single ? listed.discrete.height : range.max_height);
    if (!single) {
      size.step_width = std::max(1, static_cast<int>(range.step_width));
      size.step_height = std::max(1, static_cast<int>(range.step_height));
    }
    ListIntervals(fd, fourcc, size);
    if (!single) break;
  }
  return sizes;
}

std::vector<V4l2Control> ListControls(int fd) {
  struct Known {
    uint32_t id;
    const char *key, *value;
  };
  static constexpr std::array<Known, 4> kKnown = {
      {{V4L2_CID_EXPOSURE_ABSOLUTE, "exposure_control", "exposure_absolute"},
       {V4L2_CID_EXPOSURE, "exposure_control", "exposure"},
       {V4L2_CID_GAIN, "gain_control", "gain"},
       {V4L2_CID_ANALOGUE_GAIN, "gain_control", "analogue_gain"}}};
  std::vector<V4l2Control> controls;
  for (const Known& known : kKnown) {
    v4l2_queryctrl query{};
    query.id = known.id;
    if (CallV4l2(fd, VIDIOC_QUERYCTRL, &query) != 0 || (query.flags & V4L2_CTRL_FLAG_DISABLED) != 0) continue;
    v4l2_control current{known.id, query.default_value};
    CallV4l2(fd, VIDIOC_G_CTRL, &current);
    controls.push_back({known.key, known.value, Text(query.name, sizeof query.name), query.minimum, query.maximum,
                        query.step, query.default_value, current.value});
  }
  return controls;
}

Status HasControl(const V4l2Camera& camera, const std::string& key, const std::string& value) {
  for (const V4l2Control& control : camera.controls)
    if (control.key == key && control.value == value) return Status::Ok();
  return Status::Usage(camera.node.path + " has no control for [camera] " + key + " = \"" + value +
                       "\"; name one that it has, or \"none\"");
}

std::string SizesOf(const V4l2PixelFormat& format) {
  std::string text;
  for (const V4l2FrameSize& size : format.sizes) {
    text += (text.empty() ? "" : ", ") + std::to_string(size.max_width) + "x" + std::to_string(size.max_height);
    if (size.min_width != size.max_width || size.min_height != size.max_height) text += " and less";
  }
  return text;
}

}  // namespace

int CallV4l2(int fd, unsigned long request, void* argument) {
  int result = 0;
  do {
    result = ioctl(fd, request, argument);
  } while (result != 0 && errno == EINTR);
  return result;
}

bool V4l2FrameSize::Holds(int width, int height) const {
  return width >= min_width && width <= max_width && height >= min_height && height <= max_height &&
         (width - min_width) % step_width == 0 && (height - min_height) % step_height == 0;
}

std::vector<std::string> V4l2Paths(const std::string& folder) {
  std::vector<std::string> paths;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(folder, ignored))
    if (entry.path().filename().string().starts_with("video")) paths.push_back(entry.path().string());
  std::sort(paths.begin(), paths.end());
  return paths;
}

UniqueFd OpenV4l2(const std::string& path) { return UniqueFd(open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC)); }

std::optional<V4l2Node> DescribeV4l2(int fd, const std::string& path) {
  v4l2_capability capability{};
  if (CallV4l2(fd, VIDIOC_QUERYCAP, &capability) != 0) return std::nullopt;
  const uint32_t can =
      (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? capability.device_caps : capability.capabilities;
  if ((can & V4L2_CAP_VIDEO_CAPTURE) == 0 || (can & V4L2_CAP_STREAMING) == 0) return std::nullopt;
  return V4l2Node{path, Text(capability.driver, sizeof capability.driver),
                  Text(capability.card, sizeof capability.card), Text(capability.bus_info, sizeof capability.bus_info)};
}

std::vector<V4l2PixelFormat> V4l2Formats(int fd) {
  std::vector<V4l2PixelFormat> formats;
  v4l2_fmtdesc listed{};
  listed.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  for (; listed.index < kLongestList && CallV4l2(fd, VIDIOC_ENUM_FMT, &listed) == 0; ++listed.index)
    formats.push_back(
        {listed.pixelformat, FourccText(listed.pixelformat), Text(listed.description, sizeof listed.description), {}});
  return formats;
}

V4l2Camera InquireV4l2(int fd, V4l2Node node) {
  V4l2Camera camera{std::move(node), V4l2Formats(fd), ListControls(fd)};
  for (V4l2PixelFormat& format : camera.formats)
    if (RawFormatOf(format.name)) format.sizes = ListSizes(fd, format.fourcc);
  return camera;
}

bool Names(const CameraWiring& wiring, const V4l2Node& node) {
  auto wanted = [](const std::string& given, const std::string& is) { return given.empty() || given == is; };
  std::error_code ignored;
  const bool device =
      wanted(wiring.device, node.path) || std::filesystem::equivalent(wiring.device, node.path, ignored);
  return device && wanted(wiring.driver, node.driver) && wanted(wiring.card, node.card) && wanted(wiring.bus, node.bus);
}

Result<uint32_t> ChooseV4l2Format(const std::string& path, std::span<const V4l2PixelFormat> formats,
                                  const std::string& wanted) {
  std::string offered;
  std::optional<uint32_t> best;
  int best_bits = 0;
  for (const V4l2PixelFormat& format : formats) {
    const std::optional<RawFormat> raw = RawFormatOf(format.name);
    if (!raw) continue;
    offered += (offered.empty() ? "" : ", ") + format.name;
    if (wanted.empty() ? raw->bits <= best_bits : format.name != wanted) continue;
    best = format.fourcc;
    best_bits = raw->bits;
  }
  if (best) return *best;
  return Status::Usage(path + ": [camera] format '" + wanted +
                       "' is not offered; raw formats of this camera: " + (offered.empty() ? "none" : offered));
}

Status CanBe(const CameraWiring& wiring, const V4l2Camera& camera) {
  SLX_ASSIGN_OR_RETURN(const uint32_t fourcc, ChooseV4l2Format(camera.node.path, camera.formats, wiring.format));
  const auto format = std::find_if(camera.formats.begin(), camera.formats.end(),
                                   [&](const V4l2PixelFormat& offered) { return offered.fourcc == fourcc; });
  // A driver that lists no sizes tells them only when the format is set.
  const bool has_size = format->sizes.empty() ||
                        std::any_of(format->sizes.begin(), format->sizes.end(),
                                    [&](const V4l2FrameSize& size) { return size.Holds(wiring.width, wiring.height); });
  if (!has_size)
    return Status::Usage(camera.node.path + ": [camera] asks for " + std::to_string(wiring.width) + "x" +
                         std::to_string(wiring.height) + " " + format->name + ", the camera offers " +
                         SizesOf(*format) + "; set width and height to what it has");
  if (wiring.exposure_control != ExposureControl::kNone)
    SLX_RETURN_IF_ERROR(
        HasControl(camera, "exposure_control",
                   wiring.exposure_control == ExposureControl::kExposure ? "exposure" : "exposure_absolute"));
  if (wiring.gain_control == GainControl::kNone) return Status::Ok();
  return HasControl(camera, "gain_control", wiring.gain_control == GainControl::kGain ? "gain" : "analogue_gain");
}

}  // namespace stratalux::rig
