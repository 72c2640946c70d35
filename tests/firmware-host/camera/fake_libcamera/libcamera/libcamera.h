// SPDX-License-Identifier: Apache-2.0
// What the adapter uses of libcamera, without a camera: the names and rules of 0.0.3, over `fake`. Where libcamera ends
// the process (a second manager, a camera stopped after it was unplugged), so does this one.
#pragma once

#include <algorithm>
#include <any>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

namespace libcamera {

class Camera;

// The world: what a test does to it, and sees of it.
struct Fake {
  std::mutex mutex;
  std::vector<std::string> plugged;  // ids of the cameras
  std::vector<std::weak_ptr<Camera>> open;
  std::atomic<int> managers = 0;
  std::atomic<bool> hang_in_start = false, refuse_acquire = false, refuse_configure = false, refuse_buffers = false;
  std::atomic<bool> cancel_frames = false;
};
inline Fake fake;

[[noreturn]] inline void Fatal(const char* why) {
  std::fprintf(stderr, "fake libcamera: %s\n", why);
  std::abort();
}

template <typename... Args>
class Signal {
 public:
  template <typename T, typename R>
  void connect(T* object, R (T::*method)(Args...)) {
    const std::lock_guard lock(mutex_);
    slots_[object] = [object, method](Args... args) { (object->*method)(args...); };
  }
  template <typename T>
  void disconnect(T* object) {
    const std::lock_guard lock(mutex_);
    slots_.erase(object);
  }
  void emit(Args... args) {
    const std::lock_guard lock(mutex_);
    for (auto& [object, slot] : slots_) slot(args...);
  }

 private:
  std::mutex mutex_;
  std::map<void*, std::function<void(Args...)>> slots_;
};

class ControlId {
 public:
  explicit ControlId(unsigned id) : id_(id) {}
  [[nodiscard]] unsigned id() const { return id_; }

 private:
  unsigned id_;
};
template <typename T>
struct Control : ControlId {
  using ControlId::ControlId;
};
using ControlInfoMap = std::map<unsigned, int>;
namespace controls {
inline const Control<bool> AeEnable{1};
inline const Control<int32_t> ExposureTime{2};
inline const Control<float> AnalogueGain{3};
inline const Control<int64_t> SensorTimestamp{4};
inline const ControlInfoMap controls;
}  // namespace controls
namespace properties {
inline const Control<std::string> Model{5};
}  // namespace properties
class ControlList {
 public:
  ControlList() = default;
  explicit ControlList(const ControlInfoMap& /*known*/) {}
  template <typename T, typename V>
  void set(const Control<T>& control, const V& value) {
    values_[control.id()] = static_cast<T>(value);
  }
  template <typename T>
  [[nodiscard]] std::optional<T> get(const Control<T>& control) const {
    const auto found = values_.find(control.id());
    return found == values_.end() ? std::nullopt : std::optional(std::any_cast<T>(found->second));
  }
  void merge(const ControlList& other) {
    for (const auto& [id, value] : other.values_) values_.emplace(id, value);
  }

 private:
  std::map<unsigned, std::any> values_;
};

struct PixelFormat {
  std::string name;
  [[nodiscard]] std::string toString() const { return name; }
  friend bool operator==(const PixelFormat&, const PixelFormat&) = default;
};
struct Size {
  unsigned width = 0, height = 0;
};
class Stream {};
struct StreamFormats {
  [[nodiscard]] std::vector<Size> sizes(const PixelFormat& /*format*/) const { return {{32, 24}, {64, 48}}; }
  [[nodiscard]] std::vector<PixelFormat> pixelformats() const { return {{"SRGGB12"}}; }
};
enum class StreamRole { Raw, Viewfinder };
struct StreamConfiguration {
  PixelFormat pixelFormat;
  Size size;
  unsigned bufferCount = 0, stride = 0;
  Stream* stream_ = nullptr;
  [[nodiscard]] StreamFormats formats() const { return {}; }
  [[nodiscard]] std::string toString() const { return "64x48-SRGGB12"; }
  [[nodiscard]] Stream* stream() const { return stream_; }
};
class CameraConfiguration {
 public:
  enum Status { Valid, Adjusted, Invalid };
  [[nodiscard]] bool empty() const { return false; }
  StreamConfiguration& at(unsigned /*index*/) { return stream_; }
  Status validate() {
    stream_.size = {64, 48};
    stream_.stride = 128;
    return Adjusted;
  }

 private:
  StreamConfiguration stream_;
};

class SharedFD {
 public:
  explicit SharedFD(int fd)
      : fd_(new int(fd), [](const int* f) {
          close(*f);
          delete f;
        }) {}
  [[nodiscard]] int get() const { return *fd_; }

 private:
  std::shared_ptr<int> fd_;
};
struct FrameMetadata {
  enum Status { FrameSuccess, FrameError, FrameCancelled };
  struct Plane {
    unsigned bytesused = 64 * 48 * 2;
  };
  Status status = FrameSuccess;
  unsigned sequence = 0;
  uint64_t timestamp = 0;
  std::vector<Plane> planes_ = {Plane{}};
  [[nodiscard]] const std::vector<Plane>& planes() const { return planes_; }
};
class FrameBuffer {
 public:
  struct Plane {
    SharedFD fd;
    unsigned offset = 0, length = 0;
  };
  FrameBuffer() {
    const int fd = memfd_create("frame", MFD_CLOEXEC);
    if (fd < 0 || ftruncate(fd, 64 * 48 * 2) != 0) Fatal("no memory");
    planes_.push_back({SharedFD(fd), 0, 64 * 48 * 2});
  }
  [[nodiscard]] const std::vector<Plane>& planes() const { return planes_; }
  [[nodiscard]] const FrameMetadata& metadata() const { return metadata_; }

 private:
  friend class Camera;
  std::vector<Plane> planes_;
  FrameMetadata metadata_;
};

class Request {
 public:
  enum ReuseFlag { Default = 0, ReuseBuffers = 1 };
  int addBuffer(const Stream* /*stream*/, FrameBuffer* buffer) {
    buffer_ = buffer;
    return 0;
  }
  [[nodiscard]] FrameBuffer* findBuffer(const Stream* /*stream*/) const { return buffer_; }
  void reuse(ReuseFlag /*flags*/) { controls_ = ControlList(); }
  ControlList& controls() { return controls_; }
  [[nodiscard]] const ControlList& metadata() const { return metadata_; }

 private:
  FrameBuffer* buffer_ = nullptr;
  ControlList controls_, metadata_;
};

class Camera {
 public:
  explicit Camera(std::string id) : id_(std::move(id)) {}
  ~Camera() {
    if (acquired_) Fatal("a camera that is in use went");
  }
  [[nodiscard]] const std::string& id() const { return id_; }
  int acquire() {
    if (fake.refuse_acquire || acquired_) return -16;
    acquired_ = true;
    return 0;
  }
  int release() {
    if (running_) Fatal("released while it runs");
    acquired_ = false;
    return 0;
  }
  std::unique_ptr<CameraConfiguration> generateConfiguration(const std::vector<StreamRole>& /*roles*/) {
    auto configuration = std::make_unique<CameraConfiguration>();
    configuration->at(0).stream_ = &stream_;
    return configuration;
  }
  int configure(CameraConfiguration* /*configuration*/) { return fake.refuse_configure ? -22 : 0; }
  std::unique_ptr<Request> createRequest() { return std::make_unique<Request>(); }
  [[nodiscard]] const ControlInfoMap& controls() const {
    static const ControlInfoMap kControls = {{1, 0}, {2, 0}, {3, 0}};
    return kControls;
  }
  [[nodiscard]] const ControlList& properties() const {
    static const ControlList kProperties = [] {
      ControlList list;
      list.set(libcamera::properties::Model, std::string("imx477"));
      return list;
    }();
    return kProperties;
  }
  int start(const ControlList* /*controls*/) {
    while (fake.hang_in_start) usleep(1000);
    if (gone_) return -19;
    running_ = true;
    return 0;
  }
  int stop() {
    if (gone_ && running_) Fatal("stopped after it was unplugged, with requests queued");
    running_ = false;
    return 0;
  }
  // A frame at once; the queue of a camera that is gone keeps what it has.
  int queueRequest(Request* request) {
    if (!running_) return -22;
    if (gone_) return 0;
    timespec now{};
    clock_gettime(CLOCK_MONOTONIC, &now);
    FrameMetadata& metadata = request->findBuffer(&stream_)->metadata_;
    metadata.status = fake.cancel_frames ? FrameMetadata::FrameCancelled : FrameMetadata::FrameSuccess;
    metadata.sequence = sequence_++;
    metadata.timestamp = static_cast<uint64_t>(now.tv_sec) * 1'000'000'000U + static_cast<uint64_t>(now.tv_nsec);
    requestCompleted.emit(request);
    return 0;
  }
  void Unplug() {
    gone_ = true;
    disconnected.emit();
  }

  Signal<Request*> requestCompleted;
  Signal<> disconnected;

 private:
  const std::string id_;
  Stream stream_;
  std::atomic<bool> acquired_ = false, running_ = false, gone_ = false;
  unsigned sequence_ = 0;
};

class FrameBufferAllocator {
 public:
  explicit FrameBufferAllocator(std::shared_ptr<Camera> camera) : camera_(std::move(camera)) {}
  int allocate(Stream* /*stream*/) {
    if (fake.refuse_buffers) return -12;
    for (int i = 0; i < 4; ++i) buffers_.push_back(std::make_unique<FrameBuffer>());
    return 4;
  }
  [[nodiscard]] const std::vector<std::unique_ptr<FrameBuffer>>& buffers(Stream* /*stream*/) const { return buffers_; }

 private:
  std::shared_ptr<Camera> camera_;
  std::vector<std::unique_ptr<FrameBuffer>> buffers_;
};

class CameraManager {
 public:
  CameraManager() {
    if (++fake.managers > 1) Fatal("multiple CameraManager objects are not allowed");
  }
  ~CameraManager() { --fake.managers; }
  int start() {
    started_ = true;
    return 0;
  }
  void stop() {
    const std::lock_guard lock(fake.mutex);
    started_ = false;
    cameras_.clear();
  }
  // As the kernel has them now: it follows what is plugged in and out while it runs.
  [[nodiscard]] std::vector<std::shared_ptr<Camera>> cameras() const {
    const std::lock_guard lock(fake.mutex);
    auto plugged = [](const std::string& id) {
      return std::find(fake.plugged.begin(), fake.plugged.end(), id) != fake.plugged.end();
    };
    std::erase_if(cameras_, [&](const auto& c) { return !plugged(c->id()) || unplugged_.contains(c.get()); });
    for (const std::string& id : fake.plugged) {
      if (!started_ || std::any_of(cameras_.begin(), cameras_.end(), [&](const auto& c) { return c->id() == id; }))
        continue;
      cameras_.push_back(std::make_shared<Camera>(id));
      fake.open.push_back(cameras_.back());
    }
    return cameras_;
  }

 private:
  friend void Unplug(const std::string& id);
  bool started_ = false;
  mutable std::vector<std::shared_ptr<Camera>> cameras_;
  static inline std::map<const Camera*, int> unplugged_;
};

inline void Plug(const std::string& id) {
  const std::lock_guard lock(fake.mutex);
  fake.plugged.push_back(id);
}
inline void Unplug(const std::string& id) {
  std::vector<std::shared_ptr<Camera>> gone;
  {
    const std::lock_guard lock(fake.mutex);
    std::erase(fake.plugged, id);
    for (const auto& weak : fake.open)
      if (const auto camera = weak.lock(); camera && camera->id() == id) gone.push_back(camera);
    for (const auto& camera : gone) CameraManager::unplugged_[camera.get()] = 1;
    fake.open.clear();
  }
  for (const auto& camera : gone) camera->Unplug();
}

}  // namespace libcamera
