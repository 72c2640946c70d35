// SPDX-License-Identifier: Apache-2.0
// Written against libcamera 0.0.3 (Debian 12); of later versions only what they kept is used.
#include "firmware-host/camera/libcamera_frame_source.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <libcamera/libcamera.h>
#include <sys/mman.h>

#include "firmware-host/camera/frame_stream.h"
#include "firmware-host/camera/mapped_buffer.h"
#include "firmware-host/camera/patient_call.h"
#include "firmware-host/camera/raw_format.h"
#include "firmware-host/camera/raw_unpack.h"

namespace stratalux::rig {
namespace {

constexpr auto kPatience = std::chrono::seconds(5);  // for a call into libcamera that waits for the device
constexpr auto kSilence = std::chrono::seconds(5);   // of waiting in vain until a camera counts as failed

// A source of this process is open; for ever once a call into libcamera hung.
std::atomic<bool> camera_in_use = false;

// libcamera ends the process at a second manager. There is one while a session has it: a session that was left behind
// keeps it, so that what is plugged in later is found by the same.
class Manager {
 public:
  using Pointer = std::shared_ptr<libcamera::CameraManager>;

  static Result<Pointer> Get() {
    const std::lock_guard lock(mutex);
    if (Pointer running = current.lock()) return running;
    Pointer started(new libcamera::CameraManager, [](libcamera::CameraManager* manager) {
      manager->stop();
      delete manager;
    });
    if (const int error = started->start(); error != 0)
      return Status::Failed(std::string("libcamera does not start: ") + std::strerror(-error));
    current = started;
    return started;
  }
  // Stops it, if nobody else has it; whoever asks next gets a new one, not before this one is gone.
  static void Release(Pointer& manager) {
    const std::lock_guard lock(mutex);
    manager.reset();
  }
  static bool Lists(const std::string& id) {
    // Who holds it for long hangs inside libcamera.
    const std::unique_lock lock(mutex, std::chrono::milliseconds(100));
    if (!lock.owns_lock()) return true;
    const Pointer running = current.lock();
    if (!running) return true;
    const auto cameras = running->cameras();
    return std::any_of(cameras.begin(), cameras.end(), [&](const auto& c) { return id.empty() || c->id() == id; });
  }

 private:
  static inline std::timed_mutex mutex;
  static inline std::weak_ptr<libcamera::CameraManager> current;
};

// All that libcamera holds and calls; a call that hangs shares it, so that it outlives a source that went.
class Session {
 public:
  Session() = default;
  ~Session() { TearDown(); }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  Status Open(const CameraWiring& wiring);
  Status Start(const libcamera::ControlList& controls);
  Status Stop();
  void TearDown();

  // The next request that completed; nullptr at the deadline.
  libcamera::Request* Take(std::chrono::nanoseconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [this] { return !completed_.empty() || gone_; });
    if (completed_.empty()) return nullptr;
    libcamera::Request* request = completed_.front();
    completed_.pop_front();
    return request;
  }
  [[nodiscard]] bool gone() const {
    const std::lock_guard lock(mutex_);
    return gone_;
  }
  [[nodiscard]] const MappedBuffer& MappingOf(const libcamera::FrameBuffer* buffer) const {
    return mappings_.at(buffer);
  }
  [[nodiscard]] libcamera::FrameBuffer* BufferOf(libcamera::Request* request) const {
    return request->findBuffer(stream_);
  }
  [[nodiscard]] Status Queue(libcamera::Request* request) const {
    return camera_->queueRequest(request) == 0 ? Status::Ok() : Status::Failed(name_ + ": a request was refused");
  }
  [[nodiscard]] bool Has(const libcamera::ControlId& control) const {
    return camera_->controls().find(control.id()) != camera_->controls().end();
  }

  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] const StreamFormat& format() const { return format_; }
  [[nodiscard]] size_t stride() const { return stride_; }

 private:
  Status Acquire(const std::string& id);
  Status Configure(const CameraWiring& wiring);
  Status MakeRequests();
  // On a thread of libcamera's.
  void OnCompleted(libcamera::Request* request) {
    const std::lock_guard lock(mutex_);
    completed_.push_back(request);
    changed_.notify_all();
  }
  void OnGone() {
    const std::lock_guard lock(mutex_);
    gone_ = true;
    changed_.notify_all();
  }

  Manager::Pointer manager_;
  std::shared_ptr<libcamera::Camera> camera_;
  std::string name_;
  std::unique_ptr<libcamera::CameraConfiguration> configuration_;
  libcamera::Stream* stream_ = nullptr;
  StreamFormat format_;
  size_t stride_ = 0;
  std::unique_ptr<libcamera::FrameBufferAllocator> allocator_;
  std::map<const libcamera::FrameBuffer*, MappedBuffer> mappings_;  // of their first planes
  std::vector<std::unique_ptr<libcamera::Request>> requests_;
  bool running_ = false;

  mutable std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  std::deque<libcamera::Request*> completed_;
  bool gone_ = false;
};

Status Session::Open(const CameraWiring& wiring) {
  SLX_ASSIGN_OR_RETURN(manager_, Manager::Get());
  SLX_RETURN_IF_ERROR(Acquire(wiring.device));
  SLX_RETURN_IF_ERROR(Configure(wiring));
  return MakeRequests();
}

Status Session::Acquire(const std::string& id) {
  std::string seen;
  for (const std::shared_ptr<libcamera::Camera>& camera : manager_->cameras()) {
    seen += (seen.empty() ? "'" : ", '") + camera->id() + "'";
    if (id.empty() && camera_ != nullptr)
      return Status::Usage("[camera]: libcamera has several cameras; name one as `device`: " + seen);
    if (id.empty() || camera->id() == id) camera_ = camera;
  }
  if (!camera_)
    return Status::NotFound("[camera]: libcamera has no camera '" + id +
                            "'; there are: " + (seen.empty() ? "none" : seen));
  name_ = camera_->id();
  if (camera_->acquire() != 0) {
    camera_.reset();
    return Status::Busy(name_ + ": another program uses this camera, or this program gave it up; restart that program");
  }
  camera_->requestCompleted.connect(this, &Session::OnCompleted);
  camera_->disconnected.connect(this, &Session::OnGone);
  return Status::Ok();
}

Status Session::Configure(const CameraWiring& wiring) {
  configuration_ = camera_->generateConfiguration({libcamera::StreamRole::Raw});
  if (!configuration_ || configuration_->empty()) return Status::Usage(name_ + ": this camera has no raw stream");
  libcamera::StreamConfiguration& stream = configuration_->at(0);
  std::string offered;
  std::optional<libcamera::PixelFormat> best;
  int best_bits = 0;
  for (const libcamera::PixelFormat& format : stream.formats().pixelformats()) {
    const std::string name = format.toString();
    const std::optional<StreamFormat> known = StreamFormatOf(name);
    if (!known) continue;
    offered += (offered.empty() ? "" : ", ") + name;
    if (wiring.format.empty() ? known->green_of_bgr || known->raw.bits <= best_bits : name != wiring.format) continue;
    best = format;
    best_bits = known->raw.bits;
  }
  if (!best)
    return Status::Usage(name_ + ": [camera] format '" + wiring.format + "' is not offered; formats of this camera: " +
                         (offered.empty() ? "none that is raw" : offered));
  stream.pixelFormat = *best;
  stream.size = {static_cast<unsigned>(wiring.width), static_cast<unsigned>(wiring.height)};
  stream.bufferCount = static_cast<unsigned>(wiring.buffers);
  const libcamera::CameraConfiguration::Status valid = configuration_->validate();
  const bool as_asked = stream.pixelFormat == *best && static_cast<int>(stream.size.width) == wiring.width &&
                        static_cast<int>(stream.size.height) == wiring.height;
  if (valid == libcamera::CameraConfiguration::Invalid || !as_asked)
    return Status::Usage(name_ + ": [camera] asks for " + std::to_string(wiring.width) + "x" +
                         std::to_string(wiring.height) + " " + best->toString() + ", the camera offers " +
                         stream.toString() + "; set width, height and format to what it has");
  if (camera_->configure(configuration_.get()) != 0) return Status::Failed(name_ + ": the format was refused");
  stream_ = stream.stream();
  format_ = *StreamFormatOf(best->toString());
  stride_ = stream.stride;
  return Status::Ok();
}

Status Session::MakeRequests() {
  allocator_ = std::make_unique<libcamera::FrameBufferAllocator>(camera_);
  if (allocator_->allocate(stream_) < 0) return Status::Failed(name_ + ": no buffers");
  for (const std::unique_ptr<libcamera::FrameBuffer>& buffer : allocator_->buffers(stream_)) {
    const libcamera::FrameBuffer::Plane& plane = buffer->planes()[0];
    const size_t size = plane.offset + plane.length;
    const auto [mapping, added] = mappings_.try_emplace(
        buffer.get(), mmap(nullptr, size, PROT_READ, MAP_SHARED, plane.fd.get(), 0), size, plane.offset);
    if (!mapping->second.ok()) return Status::Failed(name_ + ": a buffer cannot be mapped: " + std::strerror(errno));
    std::unique_ptr<libcamera::Request> request = camera_->createRequest();
    if (!request || request->addBuffer(stream_, buffer.get()) != 0) return Status::Failed(name_ + ": no requests");
    requests_.push_back(std::move(request));
  }
  return Status::Ok();
}

Status Session::Start(const libcamera::ControlList& controls) {
  if (camera_->start(&controls) != 0) return Status::Failed(name_ + ": streaming does not start");
  running_ = true;
  for (const std::unique_ptr<libcamera::Request>& request : requests_) {
    request->reuse(libcamera::Request::ReuseBuffers);
    request->controls().merge(controls);
    SLX_RETURN_IF_ERROR(Queue(request.get()));
  }
  return Status::Ok();
}

Status Session::Stop() {
  if (!running_) return Status::Ok();
  running_ = false;
  const int error = camera_->stop();  // completes what is queued as cancelled
  const std::lock_guard lock(mutex_);
  completed_.clear();
  return error == 0 ? Status::Ok() : Status::Failed(name_ + ": streaming does not stop");
}

void Session::TearDown() {
  if (!manager_) return;
  if (camera_) {
    static_cast<void>(Stop());
    camera_->requestCompleted.disconnect(this);
    camera_->disconnected.disconnect(this);
    requests_.clear();
    mappings_.clear();
    allocator_.reset();
    camera_->release();
    camera_.reset();
  }
  Manager::Release(manager_);
}

class Camera final : public FrameSource {
 public:
  Camera(CameraWiring wiring, Logger& logger) : wiring_(std::move(wiring)), logger_(logger) {}
  ~Camera() override {
    if (!session_) return;
    if (started_ && Lost()) {
      static_cast<void>(GiveUp(""));
      return;
    }
    static_cast<void>(Within("closing", [](Session& s) {
      s.TearDown();
      return Status::Ok();
    }));
    // Else it was left behind, and said for how long.
    if (session_) camera_in_use = false;
  }
  Camera(const Camera&) = delete;
  Camera& operator=(const Camera&) = delete;

  Status Open() {
    session_ = std::make_shared<Session>();
    return Within("opening", [wiring = wiring_](Session& s) { return s.Open(wiring); });
  }
  [[nodiscard]] bool follows_trigger() const override { return wiring_.pace == CameraPace::kTriggered; }
  Status Start() override {
    if (started_) return Status::Ok();
    SLX_RETURN_IF_ERROR(Within("starting", [controls = Controls()](Session& s) { return s.Start(controls); }));
    started_ = true;
    failures_ = 0;
    waited_ = {};
    return Status::Ok();
  }
  Status Stop() override {
    if (!started_) return Status::Ok();
    started_ = false;
    stream_.Reopened();
    if (Lost()) return GiveUp(session_->name() + ": the camera was unplugged");
    return Within("stopping", [](Session& s) { return s.Stop(); });
  }
  Status SetExposure(double exposure_ms, double gain) override;
  Result<std::optional<CapturedFrame>> Wait(std::chrono::nanoseconds timeout) override;

 private:
  // Runs a call that may block on a thread of its own, for kPatience.
  Status Within(const std::string& what, std::function<Status(Session&)> call);
  // It was unplugged: by its own word, or because libcamera lists it no longer.
  [[nodiscard]] bool Lost() const { return session_ && (session_->gone() || !Manager::Lists(session_->name())); }
  enum class Failure { kDevice, kHung };
  // Leaves the session behind, threads and all; `why` is what every later call says.
  Status GiveUp(const std::string& why, Failure failure = Failure::kDevice);
  [[nodiscard]] libcamera::ControlList Controls() const;
  CapturedFrame FrameOf(libcamera::Request& request, const libcamera::FrameBuffer& buffer);
  void SetTime(libcamera::Request& request, const libcamera::FrameBuffer& buffer, CapturedFrame& frame);
  Image<uint16_t> PixelsOf(const libcamera::FrameBuffer& buffer, CapturedFrame& frame);

  CameraWiring wiring_;
  Logger& logger_;
  std::shared_ptr<Session> session_;  // null: given up
  std::string why_;
  bool started_ = false;
  double exposure_ms_ = 0.0, gain_ = 1.0;  // as asked for; 0: not yet
  FrameStream stream_;
  int failures_ = 0;                    // requests that brought no picture, in a row
  std::chrono::nanoseconds waited_{0};  // in vain, since the last frame
};

Status Camera::Within(const std::string& what, std::function<Status(Session&)> call) {
  if (!session_) return Status::Failed(why_);
  const std::optional<Status> done =
      CallPatiently<Status>(kPatience, [session = session_, call = std::move(call)] { return call(*session); });
  if (done) return *done;
  return GiveUp("camera: " + what + " hangs inside libcamera", Failure::kHung);
}

Status Camera::GiveUp(const std::string& why, Failure failure) {
  // Never destroyed: libcamera 0.0.3 aborts where it has to stop a camera that is gone. (`camera_in_use` keeps others
  // from here.)
  static std::vector<std::shared_ptr<Session>>& left_behind = *new std::vector<std::shared_ptr<Session>>;
  left_behind.push_back(std::exchange(session_, nullptr));
  why_ = why + "; check the camera and its cable: " +
         (failure == Failure::kDevice ? "once unplugged and plugged in again it is reopened; otherwise " : "") +
         "reload its driver if needed, and restart the program";
  if (failure == Failure::kDevice) camera_in_use = false;
  return Status::Failed(why_);
}

libcamera::ControlList Camera::Controls() const {
  libcamera::ControlList controls(libcamera::controls::controls);
  if (!session_ || exposure_ms_ == 0.0) return controls;
  if (session_->Has(libcamera::controls::AeEnable)) controls.set(libcamera::controls::AeEnable, false);
  if (session_->Has(libcamera::controls::ExposureTime))
    controls.set(libcamera::controls::ExposureTime, static_cast<int32_t>(std::lround(1e3 * exposure_ms_)));
  if (session_->Has(libcamera::controls::AnalogueGain))
    controls.set(libcamera::controls::AnalogueGain, static_cast<float>(gain_));
  return controls;
}

Status Camera::SetExposure(double exposure_ms, double gain) {
  if (!session_) return Status::Failed(why_);
  if (!session_->Has(libcamera::controls::ExposureTime) && std::abs(exposure_ms - wiring_.fixed_exposure_ms) > 1e-6)
    return Status::Usage(
        session_->name() + ": an exposure of " + std::to_string(exposure_ms) +
        " ms was requested, but this camera's exposure cannot be set, and [camera] fixed_exposure_ms is " +
        std::to_string(wiring_.fixed_exposure_ms));
  if (!session_->Has(libcamera::controls::AnalogueGain) && gain != 1.0)
    return Status::Usage(session_->name() + ": gain " + std::to_string(gain) +
                         " was requested, but this camera has none");
  exposure_ms_ = exposure_ms;
  gain_ = gain;
  return Status::Ok();
}

Result<std::optional<CapturedFrame>> Camera::Wait(std::chrono::nanoseconds timeout) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  while (true) {
    if (!session_) return Status::Failed(why_);
    if (!started_) return Status::Failed(session_->name() + ": asked for a frame before Start");
    const auto left = std::max<std::chrono::nanoseconds>(deadline - std::chrono::steady_clock::now(), {});
    libcamera::Request* request = session_->Take(left);
    if (request == nullptr) {
      waited_ += left;
      if (session_->gone()) return GiveUp(session_->name() + ": the camera was unplugged");
      if (waited_ > kSilence) return GiveUp(session_->name() + ": no frame in 5 s of waiting");
      return std::optional<CapturedFrame>();
    }
    waited_ = {};
    const libcamera::FrameBuffer& buffer = *session_->BufferOf(request);
    std::optional<CapturedFrame> frame;
    if (buffer.metadata().status == libcamera::FrameMetadata::FrameCancelled) {
      if (++failures_ > wiring_.buffers)
        return GiveUp(session_->name() + ": " + std::to_string(failures_) + " requests in a row failed");
    } else {
      failures_ = 0;
      frame = FrameOf(*request, buffer);
    }
    request->reuse(libcamera::Request::ReuseBuffers);
    request->controls().merge(Controls());
    SLX_RETURN_IF_ERROR(session_->Queue(request));
    if (frame) return frame;
  }
}

CapturedFrame Camera::FrameOf(libcamera::Request& request, const libcamera::FrameBuffer& buffer) {
  CapturedFrame frame;
  frame.format = session_->format().raw.pixel_format();
  frame.cfa = session_->format().raw.cfa;
  frame.sequence = stream_.Number(buffer.metadata().sequence);
  frame.corrupt = buffer.metadata().status != libcamera::FrameMetadata::FrameSuccess;
  const libcamera::ControlList &reported = request.metadata(), &asked = request.controls();
  auto value = [&](const auto& control, double fixed) {
    if (const auto v = reported.get(control)) return static_cast<double>(*v);
    if (const auto v = asked.get(control)) return static_cast<double>(*v);
    return fixed;
  };
  frame.exposure_ms = 1e-3 * value(libcamera::controls::ExposureTime, 1e3 * wiring_.fixed_exposure_ms);
  frame.gain = value(libcamera::controls::AnalogueGain, 1.0);
  SetTime(request, buffer, frame);
  frame.pixels = PixelsOf(buffer, frame);
  return frame;
}

void Camera::SetTime(libcamera::Request& request, const libcamera::FrameBuffer& buffer, CapturedFrame& frame) {
  MonotonicNs stamp{static_cast<int64_t>(buffer.metadata().timestamp)};
  const auto sensor = request.metadata().get(libcamera::controls::SensorTimestamp);
  if (sensor) {
    stamp = MonotonicNs{*sensor} + -TimeSuspended();
    frame.time = stamp;
  } else {
    const double before_stamp_ms = wiring_.readout_ms + frame.exposure_ms;
    frame.time = stamp + FromMilliseconds(-before_stamp_ms);
  }
  frame.clock = stamp.ns > 0 ? ClockSource::kMonotonic : ClockSource::kUnknown;
  if (frame.clock == ClockSource::kMonotonic && !stream_.StampFits(stamp, MonotonicNow())) {
    frame.corrupt = true;
    logger_.Warning(session_->name() + ": frame " + std::to_string(frame.sequence) + " is stamped " +
                    std::to_string(1e-9 * static_cast<double>(stamp.ns)) + " s, outside the stream");
  }
}

Image<uint16_t> Camera::PixelsOf(const libcamera::FrameBuffer& buffer, CapturedFrame& frame) {
  const std::span<const uint8_t> mapped = session_->MappingOf(&buffer).bytes();
  const size_t used = std::min<size_t>(mapped.size(), buffer.metadata().planes()[0].bytesused);
  if (session_->format().green_of_bgr) {
    const bool whole = used >= session_->stride() * static_cast<size_t>(wiring_.height);
    if (whole) return UnpackGreenOfBgr(mapped, wiring_.width, wiring_.height, session_->stride());
    frame.corrupt = true;
    return {wiring_.width, wiring_.height};
  }
  Result<Image<uint16_t>> pixels =
      UnpackRaw(mapped.first(used), session_->format().raw, wiring_.width, wiring_.height, session_->stride());
  if (pixels.ok()) return std::move(pixels).value();
  if (!frame.corrupt)
    logger_.Warning(session_->name() + ": frame " + std::to_string(frame.sequence) + ": " + pixels.status().message());
  frame.corrupt = true;
  return {wiring_.width, wiring_.height};
}

LibcameraDevice Describe(libcamera::Camera& camera) {
  LibcameraDevice device{camera.id(), camera.properties().get(libcamera::properties::Model).value_or(""), {}};
  auto configuration = camera.generateConfiguration({libcamera::StreamRole::Raw});
  if (!configuration || configuration->empty())
    configuration = camera.generateConfiguration({libcamera::StreamRole::Viewfinder});
  if (!configuration || configuration->empty()) return device;
  const libcamera::StreamFormats formats = configuration->at(0).formats();
  for (const libcamera::PixelFormat& format : formats.pixelformats()) {
    LibcameraFormat& listed = device.formats.emplace_back(format.toString());
    for (const libcamera::Size& size : formats.sizes(format))
      listed.sizes.emplace_back(static_cast<int>(size.width), static_cast<int>(size.height));
  }
  return device;
}

Result<std::vector<LibcameraDevice>> ListDevices() {
  SLX_ASSIGN_OR_RETURN(Manager::Pointer manager, Manager::Get());
  std::vector<LibcameraDevice> devices;
  for (const std::shared_ptr<libcamera::Camera>& camera : manager->cameras()) devices.push_back(Describe(*camera));
  Manager::Release(manager);
  return devices;
}

}  // namespace

Result<std::vector<LibcameraDevice>> LibcameraFrameSource::List() {
  if (auto listed = CallPatiently<Result<std::vector<LibcameraDevice>>>(kPatience, ListDevices))
    return std::move(*listed);
  return Status::Failed("libcamera does not answer; unplug the camera, reload its driver if needed, and try again");
}

Result<std::unique_ptr<FrameSource>> LibcameraFrameSource::Open(const CameraWiring& wiring, Logger& logger) {
  if (camera_in_use.exchange(true))
    return Status::Busy("camera: this process already has a libcamera camera, or one hung; restart the program");
  auto camera = std::make_unique<Camera>(wiring, logger);
  SLX_RETURN_IF_ERROR(camera->Open());
  return std::unique_ptr<FrameSource>(std::move(camera));
}

bool LibcameraFrameSource::IsBuilt() { return true; }
bool LibcameraFrameSource::IsThere(const CameraWiring& wiring) { return Manager::Lists(wiring.device); }

}  // namespace stratalux::rig
