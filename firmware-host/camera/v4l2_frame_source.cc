// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/camera/v4l2_frame_source.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <span>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <linux/videodev2.h>
#include <poll.h>
#include <sys/mman.h>

#include "firmware-host/camera/frame_stream.h"
#include "firmware-host/camera/mapped_buffer.h"
#include "firmware-host/camera/raw_format.h"
#include "firmware-host/camera/v4l2_devices.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {
namespace {

constexpr auto kReopenPause = std::chrono::milliseconds(500);  // a USB device needs some seconds to come back

Result<V4l2Node> FindCamera(const CameraWiring& wiring) {
  const std::vector<std::string> paths = wiring.device.empty() ? V4l2Paths() : std::vector<std::string>{wiring.device};
  std::vector<V4l2Node> fitting;
  std::string seen;
  for (const std::string& path : paths) {
    const UniqueFd fd = OpenV4l2(path);
    if (!fd.ok() && !wiring.device.empty())
      return Status::NotFound(path + ": " + std::strerror(errno) + "; `stratalux-rig devices` lists the cameras");
    const std::optional<V4l2Node> node = fd.ok() ? DescribeV4l2(fd.get(), path) : std::nullopt;
    if (!node) continue;
    seen += (seen.empty() ? "" : ", ") + node->ToString();
    if (Names(wiring, *node)) fitting.push_back(*node);
  }
  if (fitting.size() == 1) return fitting.front();
  if (fitting.size() > 1)
    return Status::Usage("[camera]: " + fitting[0].ToString() + " and " + fitting[1].ToString() +
                         " both match; give `device` or `bus` as well");
  return Status::NotFound("[camera]: no V4L2 camera matches device '" + wiring.device + "', driver '" + wiring.driver +
                          "', card '" + wiring.card + "', bus '" + wiring.bus +
                          "'; there are: " + (seen.empty() ? "none that this user may open (group video)" : seen));
}

struct Settings {
  double exposure_ms = 0.0;
  double gain = 1.0;
};

class Camera final : public FrameSource {
 public:
  Camera(CameraWiring wiring, Logger& logger) : wiring_(std::move(wiring)), logger_(logger) {}

  [[nodiscard]] bool follows_trigger() const override { return wiring_.pace == CameraPace::kTriggered; }
  // On failure nothing stays open.
  Status OpenDevice();
  Status Start() override;
  Status Stop() override;
  Status SetExposure(double exposure_ms, double gain) override;
  Result<std::optional<CapturedFrame>> Wait(std::chrono::nanoseconds timeout) override;

 private:
  using Clock = std::chrono::steady_clock;

  [[nodiscard]] Status Error(const std::string& what) const {
    return Status::Failed(path_ + ": " + what + ": " + std::strerror(errno));
  }
  Status SetUp();
  Status SetFormat();
  Status SetFrameRate();
  Status StreamOn();
  void Close();
  // Closes a device that broke off; `status` says how.
  void Break(const Status& status);
  // Opens it again, until `deadline`. False: not yet; an error: no use.
  Result<bool> Recover(Clock::time_point deadline);

  Status CheckControls();
  Status SetControl(uint32_t id, const std::string& name, double value);
  Status ApplySettings();
  [[nodiscard]] Settings ReadBack();
  [[nodiscard]] uint32_t ExposureId() const;
  [[nodiscard]] uint32_t GainId() const;

  // nullopt: no frame is there, or a stale one was.
  Result<std::optional<CapturedFrame>> Dequeue();
  CapturedFrame FrameOf(const v4l2_buffer& buffer);
  void SetTime(const v4l2_buffer& buffer, CapturedFrame& frame);

  CameraWiring wiring_;
  Logger& logger_;
  std::string path_;
  UniqueFd fd_;
  RawFormat format_;
  size_t stride_ = 0;
  std::vector<MappedBuffer> mappings_;
  bool started_ = false;
  MonotonicNs started_at_;
  FrameStream stream_;
  int failed_tries_ = 0;  // since the last frame
  Clock::time_point next_try_;
  int reopened_ = 0;
  std::optional<Settings> wanted_;
  Settings before_, current_;  // as read back; frames begun before `changed_at_` have the former
  MonotonicNs changed_at_;
};

uint32_t Camera::ExposureId() const {
  return wiring_.exposure_control == ExposureControl::kExposure ? V4L2_CID_EXPOSURE : V4L2_CID_EXPOSURE_ABSOLUTE;
}

uint32_t Camera::GainId() const {
  return wiring_.gain_control == GainControl::kGain ? V4L2_CID_GAIN : V4L2_CID_ANALOGUE_GAIN;
}

Status Camera::OpenDevice() {
  SLX_ASSIGN_OR_RETURN(const V4l2Node node, FindCamera(wiring_));
  path_ = node.path;
  fd_ = OpenV4l2(path_);
  if (!fd_.ok()) return Error("cannot be opened");
  Status ready = SetUp();
  if (!ready.ok()) Close();
  return ready;
}

Status Camera::SetUp() {
  SLX_RETURN_IF_ERROR(SetFormat());
  SLX_RETURN_IF_ERROR(SetFrameRate());
  SLX_RETURN_IF_ERROR(CheckControls());
  current_ = before_ = ReadBack();
  return ApplySettings();
}

Status Camera::SetFormat() {
  SLX_ASSIGN_OR_RETURN(const uint32_t fourcc, ChooseV4l2Format(path_, V4l2Formats(fd_.get()), wiring_.format));
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  format.fmt.pix.width = static_cast<uint32_t>(wiring_.width);
  format.fmt.pix.height = static_cast<uint32_t>(wiring_.height);
  format.fmt.pix.pixelformat = fourcc;
  format.fmt.pix.field = V4L2_FIELD_NONE;
  if (CallV4l2(fd_.get(), VIDIOC_S_FMT, &format) != 0) return Error("format " + FourccText(fourcc) + " refused");
  const v4l2_pix_format& got = format.fmt.pix;
  if (got.pixelformat != fourcc || static_cast<int>(got.width) != wiring_.width ||
      static_cast<int>(got.height) != wiring_.height)
    return Status::Usage(path_ + ": [camera] asks for " + std::to_string(wiring_.width) + "x" +
                         std::to_string(wiring_.height) + " " + FourccText(fourcc) + ", the camera offers " +
                         std::to_string(got.width) + "x" + std::to_string(got.height) + " " +
                         FourccText(got.pixelformat) + "; set width, height and format to what it has");
  format_ = *RawFormatOf(FourccText(fourcc));
  stride_ = std::max<size_t>(got.bytesperline, RowBytes(format_, wiring_.width));
  return Status::Ok();
}

Status Camera::SetFrameRate() {
  if (wiring_.frame_rate_hz <= 0.0) return Status::Ok();
  v4l2_streamparm parameters{};
  parameters.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  v4l2_fract& period = parameters.parm.capture.timeperframe;
  period = {1000, static_cast<uint32_t>(std::lround(1000.0 * wiring_.frame_rate_hz))};
  if (CallV4l2(fd_.get(), VIDIOC_S_PARM, &parameters) != 0) return Error("[camera] frame_rate_hz cannot be set");
  const double got_hz = period.numerator > 0 ? static_cast<double>(period.denominator) / period.numerator : 0.0;
  if (std::abs(got_hz - wiring_.frame_rate_hz) <= 0.01 * wiring_.frame_rate_hz) return Status::Ok();
  return Status::Usage(path_ + ": [camera] asks for frame_rate_hz = " + std::to_string(wiring_.frame_rate_hz) +
                       ", the nearest the camera has is " + std::to_string(got_hz));
}

// Our controls must be there, and nobody else's hand on them.
Status Camera::CheckControls() {
  for (auto [id, value] : {std::pair<uint32_t, int>{V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL},
                           std::pair<uint32_t, int>{V4L2_CID_AUTOGAIN, 0}}) {
    v4l2_control control{id, value};
    if (CallV4l2(fd_.get(), VIDIOC_S_CTRL, &control) != 0 && errno != EINVAL)
      logger_.Warning(path_ + ": automatic exposure or gain cannot be switched off: " + std::strerror(errno));
  }
  auto check = [this](bool used, uint32_t id, const char* key) {
    v4l2_queryctrl query{};
    query.id = id;
    if (!used || CallV4l2(fd_.get(), VIDIOC_QUERYCTRL, &query) == 0) return Status::Ok();
    return Status::Usage(path_ + ": the camera lacks the control that [camera] " + key +
                         " names; `stratalux-rig devices` lists what it has");
  };
  SLX_RETURN_IF_ERROR(check(wiring_.exposure_control != ExposureControl::kNone, ExposureId(), "exposure_control"));
  return check(wiring_.gain_control != GainControl::kNone, GainId(), "gain_control");
}

Status Camera::SetControl(uint32_t id, const std::string& name, double value) {
  v4l2_queryctrl query{};
  query.id = id;
  if (CallV4l2(fd_.get(), VIDIOC_QUERYCTRL, &query) != 0) return Error(name);
  const double rounded = std::round(value);
  if (rounded < query.minimum || rounded > query.maximum)
    return Status::Usage(path_ + ": " + name + " would be " + std::to_string(value) + " units, the camera allows " +
                         std::to_string(query.minimum) + " .. " + std::to_string(query.maximum));
  v4l2_control control{id, static_cast<int32_t>(rounded)};
  if (CallV4l2(fd_.get(), VIDIOC_S_CTRL, &control) != 0) return Error(name);
  return Status::Ok();
}

Settings Camera::ReadBack() {
  Settings settings{wiring_.fixed_exposure_ms, 1.0};
  v4l2_control control{ExposureId(), 0};
  if (wiring_.exposure_control != ExposureControl::kNone && CallV4l2(fd_.get(), VIDIOC_G_CTRL, &control) == 0)
    settings.exposure_ms = 1e-3 * control.value * wiring_.exposure_unit_us;
  control = {GainId(), 0};
  if (wiring_.gain_control != GainControl::kNone && CallV4l2(fd_.get(), VIDIOC_G_CTRL, &control) == 0)
    settings.gain = control.value / wiring_.gain_unit;
  return settings;
}

Status Camera::ApplySettings() {
  if (!wanted_) return Status::Ok();
  if (wiring_.exposure_control == ExposureControl::kNone) {
    if (std::abs(wanted_->exposure_ms - wiring_.fixed_exposure_ms) > 1e-6)
      return Status::Usage(path_ + ": an exposure of " + std::to_string(wanted_->exposure_ms) +
                           " ms was requested, but [camera] fixed_exposure_ms is " +
                           std::to_string(wiring_.fixed_exposure_ms));
  } else {
    SLX_RETURN_IF_ERROR(SetControl(ExposureId(), "exposure", 1e3 * wanted_->exposure_ms / wiring_.exposure_unit_us));
  }
  if (wiring_.gain_control == GainControl::kNone) {
    if (wanted_->gain != 1.0)
      return Status::Usage(path_ + ": gain " + std::to_string(wanted_->gain) +
                           " was requested, but [camera] gain_control is none");
  } else {
    SLX_RETURN_IF_ERROR(SetControl(GainId(), "gain", wanted_->gain * wiring_.gain_unit));
  }
  before_ = current_;
  current_ = ReadBack();
  changed_at_ = MonotonicNow();
  return Status::Ok();
}

Status Camera::SetExposure(double exposure_ms, double gain) {
  wanted_ = Settings{exposure_ms, gain};
  if (!fd_.ok()) return Status::Ok();  // Recover sets it
  return ApplySettings();
}

Status Camera::StreamOn() {
  v4l2_requestbuffers request{};
  request.count = static_cast<uint32_t>(wiring_.buffers);
  request.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  request.memory = V4L2_MEMORY_MMAP;
  if (CallV4l2(fd_.get(), VIDIOC_REQBUFS, &request) != 0) return Error("no buffers");
  if (request.count < 2)
    return Status::Failed(path_ + ": the driver grants " + std::to_string(request.count) + " buffers");
  if (static_cast<int>(request.count) < wiring_.buffers)
    logger_.Warning(path_ + ": the driver grants " + std::to_string(request.count) + " buffers of " +
                    std::to_string(wiring_.buffers));
  for (uint32_t i = 0; i < request.count; ++i) {
    v4l2_buffer buffer{};
    buffer.type = request.type;
    buffer.memory = request.memory;
    buffer.index = i;
    if (CallV4l2(fd_.get(), VIDIOC_QUERYBUF, &buffer) != 0) return Error("buffer " + std::to_string(i));
    void* address = mmap(nullptr, buffer.length, PROT_READ | PROT_WRITE, MAP_SHARED, fd_.get(),
                         static_cast<off_t>(buffer.m.offset));
    if (address == MAP_FAILED) return Error("buffer " + std::to_string(i) + " cannot be mapped");
    mappings_.emplace_back(address, buffer.length);
    if (CallV4l2(fd_.get(), VIDIOC_QBUF, &buffer) != 0) return Error("buffer " + std::to_string(i) + " refused");
  }
  started_at_ = MonotonicNow();
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (CallV4l2(fd_.get(), VIDIOC_STREAMON, &type) != 0) return Error("streaming does not start");
  return Status::Ok();
}

void Camera::Close() {
  if (fd_.ok()) {
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    CallV4l2(fd_.get(), VIDIOC_STREAMOFF, &type);
  }
  mappings_.clear();
  fd_ = UniqueFd();
}

void Camera::Break(const Status& status) {
  logger_.Warning("camera stopped working: " + status.message());
  Close();
  stream_.Reopened();
}

Result<bool> Camera::Recover(Clock::time_point deadline) {
  while (true) {
    if (const auto until = std::min(deadline, next_try_); Clock::now() < until) std::this_thread::sleep_until(until);
    if (Clock::now() < next_try_) return false;
    next_try_ = Clock::now() + kReopenPause;
    Status status = OpenDevice();
    if (status.ok()) status = StreamOn();
    if (status.ok()) {
      logger_.Warning(path_ + ": camera opened again (" + std::to_string(++reopened_) + ". time)");
      return true;
    }
    Close();
    if (++failed_tries_ >= wiring_.reopen_tries)
      return status.WithContext("the camera did not come back in " + std::to_string(failed_tries_) + " tries");
  }
}

Status Camera::Start() {
  if (started_) return Status::Ok();
  failed_tries_ = 0;
  if (!fd_.ok()) SLX_RETURN_IF_ERROR(OpenDevice());
  if (const Status status = StreamOn(); !status.ok()) {
    Break(status);
    // Ends by success or with the last try.
    SLX_RETURN_IF_ERROR(Recover(Clock::time_point::max()).status());
  }
  started_ = true;
  return Status::Ok();
}

Status Camera::Stop() {
  if (!started_) return Status::Ok();
  started_ = false;
  Close();
  stream_.Reopened();
  return Status::Ok();
}

void Camera::SetTime(const v4l2_buffer& buffer, CapturedFrame& frame) {
  const MonotonicNs stamp{buffer.timestamp.tv_sec * 1'000'000'000LL + buffer.timestamp.tv_usec * 1000LL};
  frame.clock = (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC
                    ? ClockSource::kMonotonic
                    : ClockSource::kUnknown;
  if (frame.clock == ClockSource::kMonotonic && !stream_.StampFits(stamp, MonotonicNow())) {
    frame.corrupt = true;
    logger_.Warning(path_ + ": frame " + std::to_string(frame.sequence) + " is stamped " +
                    std::to_string(1e-9 * static_cast<double>(stamp.ns)) +
                    " s, outside the stream: the driver's clock wrapped or jumped");
  }
  auto start_if_exposed = [&](const Settings& settings) {
    if ((buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE) return stamp;
    const double before_stamp_ms = wiring_.readout_ms + settings.exposure_ms;
    return stamp + FromMilliseconds(-before_stamp_ms);
  };
  const bool begun_before = start_if_exposed(current_) < changed_at_;
  const Settings& settings = begun_before ? before_ : current_;
  frame.time = start_if_exposed(settings);
  frame.exposure_ms = settings.exposure_ms;
  frame.gain = settings.gain;
}

CapturedFrame Camera::FrameOf(const v4l2_buffer& buffer) {
  current_ = ReadBack();
  CapturedFrame frame;
  frame.format = format_.pixel_format();
  frame.cfa = format_.cfa;
  frame.sequence = stream_.Number(buffer.sequence);
  frame.corrupt = (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0;
  SetTime(buffer, frame);
  const std::span<const uint8_t> mapped = mappings_[buffer.index].bytes();
  Result<Image<uint16_t>> pixels = UnpackRaw(mapped.first(std::min<size_t>(mapped.size(), buffer.bytesused)), format_,
                                             wiring_.width, wiring_.height, stride_);
  if (pixels.ok()) {
    frame.pixels = std::move(pixels).value();
  } else if (!frame.corrupt) {
    logger_.Warning(path_ + ": frame " + std::to_string(frame.sequence) + ": " + pixels.status().message());
    frame.corrupt = true;
  }
  return frame;
}

Result<std::optional<CapturedFrame>> Camera::Dequeue() {
  v4l2_buffer buffer{};
  buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  buffer.memory = V4L2_MEMORY_MMAP;
  if (CallV4l2(fd_.get(), VIDIOC_DQBUF, &buffer) != 0) {
    if (errno == EAGAIN) return std::optional<CapturedFrame>();
    return Error("no frame");
  }
  if (buffer.index >= mappings_.size()) return Status::Failed(path_ + ": a buffer that was never queued");
  CapturedFrame frame = FrameOf(buffer);
  failed_tries_ = 0;
  // The frame is good whatever becomes of its buffer.
  if (CallV4l2(fd_.get(), VIDIOC_QBUF, &buffer) != 0) Break(Error("buffer refused"));
  if (!frame.corrupt && frame.clock == ClockSource::kMonotonic && frame.time < started_at_)
    return std::optional<CapturedFrame>();  // exposed before the stream was ours
  return std::optional(std::move(frame));
}

Result<std::optional<CapturedFrame>> Camera::Wait(std::chrono::nanoseconds timeout) {
  if (!started_) return Status::Failed("the camera was not started");
  const Clock::time_point deadline = Clock::now() + timeout;
  while (true) {
    if (!fd_.ok()) {
      SLX_ASSIGN_OR_RETURN(const bool open, Recover(deadline));
      if (!open) return std::optional<CapturedFrame>();
    }
    const auto left = std::max<std::chrono::nanoseconds>(deadline - Clock::now(), std::chrono::nanoseconds(0));
    const timespec wait{static_cast<time_t>(left.count() / 1'000'000'000),
                        static_cast<long>(left.count() % 1'000'000'000)};
    pollfd waiting{fd_.get(), POLLIN, 0};
    const int ready = ppoll(&waiting, 1, &wait, nullptr);
    if (ready == 0) return std::optional<CapturedFrame>();
    if (ready < 0) continue;  // a signal
    if ((waiting.revents & POLLIN) == 0) {
      Break(Status::Failed(path_ + ": the driver hung up"));
      continue;
    }
    Result<std::optional<CapturedFrame>> frame = Dequeue();
    if (!frame.ok()) {
      Break(frame.status());
      continue;
    }
    if (*frame) return frame;
    if (deadline <= Clock::now()) return std::optional<CapturedFrame>();
  }
}

}  // namespace

Result<std::unique_ptr<FrameSource>> V4l2FrameSource::Open(const CameraWiring& wiring, Logger& logger) {
  auto camera = std::make_unique<Camera>(wiring, logger);
  SLX_RETURN_IF_ERROR(camera->OpenDevice());
  return std::unique_ptr<FrameSource>(std::move(camera));
}

bool V4l2FrameSource::IsThere(const CameraWiring& wiring) {
  // A node that is in use, or may not be opened just now, is there.
  const auto away = [](const std::string& node) {
    const UniqueFd fd = OpenV4l2(node);
    return !fd.ok() && (errno == ENOENT || errno == ENODEV || errno == ENXIO);
  };
  if (!wiring.device.empty() && !OpenV4l2(wiring.device).ok()) return !away(wiring.device);
  const Result<V4l2Node> found = FindCamera(wiring);
  // Several: one more than wanted.
  if (found.ok() || found.status().code() == StatusCode::kUsage) return true;
  if (!wiring.device.empty()) return false;
  const std::vector<std::string> nodes = V4l2Paths();
  return std::any_of(nodes.begin(), nodes.end(),
                     [&](const std::string& node) { return !OpenV4l2(node).ok() && !away(node); });
}

}  // namespace stratalux::rig
