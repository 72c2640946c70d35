// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware-host/camera/scripted_v4l2.h"

#include <cerrno>
#include <cstdarg>
#include <cstring>
#include <deque>
#include <fstream>
#include <mutex>

#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

constexpr uint32_t kFrameBytes = 2 * ScriptedV4l2::kWidth * ScriptedV4l2::kHeight;
constexpr uint32_t kBufferBytes = 8192;  // whole pages
constexpr uint32_t kMaxBuffers = 32;

std::mutex mutex;
std::deque<uint32_t> queued;
uint32_t sequence = 0;
bool format_set = false, streaming = false;

int Fail(int error) {
  errno = error;
  return -1;
}

int SetFormat(v4l2_pix_format& format) {
  format.width = ScriptedV4l2::kWidth;
  format.height = ScriptedV4l2::kHeight;
  format.bytesperline = 2 * ScriptedV4l2::kWidth;
  format_set = true;
  return 0;
}

int Dequeue(v4l2_buffer& buffer) {
  if (!streaming || queued.empty()) return Fail(EAGAIN);
  buffer.index = queued.front();
  queued.pop_front();
  buffer.sequence = sequence++;
  buffer.bytesused = kFrameBytes;
  buffer.flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
  const int64_t now = MonotonicNow().ns;
  buffer.timestamp.tv_sec = now / 1'000'000'000;
  buffer.timestamp.tv_usec = now / 1000 % 1'000'000;
  return 0;
}

int Answer(unsigned long request, void* argument) {
  const std::lock_guard lock(mutex);
  switch (request) {
    case VIDIOC_QUERYCAP: {
      auto& capability = *static_cast<v4l2_capability*>(argument);
      std::strcpy(reinterpret_cast<char*>(capability.driver), "scripted");
      capability.capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
      return 0;
    }
    case VIDIOC_ENUM_FMT: {
      auto& format = *static_cast<v4l2_fmtdesc*>(argument);
      if (format.index > 0) return Fail(EINVAL);
      format.pixelformat = V4L2_PIX_FMT_Y12;
      // A node that was opened anew keeps nothing.
      format_set = streaming = false;
      return 0;
    }
    case VIDIOC_ENUM_FRAMESIZES: {
      auto& size = *static_cast<v4l2_frmsizeenum*>(argument);
      if (size.index > 0) return Fail(EINVAL);
      size.type = V4L2_FRMSIZE_TYPE_DISCRETE;
      size.discrete = {ScriptedV4l2::kWidth, ScriptedV4l2::kHeight};
      return 0;
    }
    case VIDIOC_ENUM_FRAMEINTERVALS: {
      // Never says that its list ends.
      auto& interval = *static_cast<v4l2_frmivalenum*>(argument);
      interval.type = V4L2_FRMIVAL_TYPE_DISCRETE;
      interval.discrete = {1, 25};
      return 0;
    }
    case VIDIOC_S_FMT:
      return SetFormat(static_cast<v4l2_format*>(argument)->fmt.pix);
    case VIDIOC_QUERYCTRL: {
      auto& query = *static_cast<v4l2_queryctrl*>(argument);
      query.minimum = 1;
      query.maximum = 10000;
      return 0;
    }
    case VIDIOC_REQBUFS: {
      auto& buffers = *static_cast<v4l2_requestbuffers*>(argument);
      if (!format_set) return Fail(EINVAL);
      buffers.count = std::min(buffers.count, kMaxBuffers);
      queued.clear();
      return 0;
    }
    case VIDIOC_QUERYBUF: {
      auto& buffer = *static_cast<v4l2_buffer*>(argument);
      buffer.length = kBufferBytes;
      buffer.m.offset = buffer.index * kBufferBytes;
      return 0;
    }
    case VIDIOC_QBUF:
      queued.push_back(static_cast<v4l2_buffer*>(argument)->index);
      return 0;
    case VIDIOC_DQBUF:
      return Dequeue(*static_cast<v4l2_buffer*>(argument));
    case VIDIOC_STREAMON:
      streaming = true;
      return 0;
    case VIDIOC_STREAMOFF:
      streaming = false;
      return 0;
    default:
      return 0;  // controls and the frame rate: as asked
  }
}

}  // namespace

ScriptedV4l2& TheV4l2() {
  static ScriptedV4l2 scripted;
  return scripted;
}

void ScriptedV4l2::Plug(const std::filesystem::path& node) {
  std::ofstream(node) << "";
  std::filesystem::resize_file(node, kMaxBuffers * kBufferBytes);
}

}  // namespace stratalux::rig

// Stands before libc's.
extern "C" int ioctl(int fd, unsigned long request, ...) noexcept {
  using stratalux::rig::TheV4l2;
  va_list arguments;
  va_start(arguments, request);
  void* argument = va_arg(arguments, void*);
  va_end(arguments);
  struct stat node {};
  if (_IOC_TYPE(request) != 'V' || fstat(fd, &node) != 0 || !S_ISREG(node.st_mode))
    return static_cast<int>(syscall(SYS_ioctl, fd, request, argument));
  if (node.st_nlink == 0) return stratalux::rig::Fail(ENODEV);
  if (request == TheV4l2().refused.load() && TheV4l2().refusals.fetch_sub(1) > 0) return stratalux::rig::Fail(EIO);
  return stratalux::rig::Answer(request, argument);
}
