// SPDX-License-Identifier: Apache-2.0
// Stands in the guest for everything outside the computer: projector modules, the scene and the fingers on the cables.
//
// It sees the rig's output lines through the kernel's trace of GPIO values (no pulse is ever missed, however the
// emulator stalls), answers on the SYNC lines of gpio-sim, and paints what the camera would see into the output of
// vivid, which vivid loops to its capture side (v4l2-ctl -c loop_video=1). The program under test knows none of this.
//   rig-vm-responder CONFIG SCREEN [FAULT@N]...
// CONFIG: the rig.toml of the capture; its lines are made, on a gpio-sim chip of their own. SCREEN: vivid's output.
// FAULT, at the N-th TRIGGER pulse that a lit projector gets, from 0 (swap: memory place N). Pulses in the dark, on the
// way to a section of the memory, do not count: an edge too few or too many there is made good, and no frame is met.
//   lost-edge doubled-edge no-step          of that pulse alone
//   stuck-sync emergency-stop door unplug   from then on
//   swap                                    places N and N + 1 of projector 0's memory hold each other's pattern
//   control:NAME=VALUE                      a control of vivid's capture node, as the kernel names it
// Prints "ready" once it answers; goes on until SIGTERM. SIGHUP: SCREEN was unplugged and is back.
#include <algorithm>
#include <array>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/projector/memory_layout.h"
#include "tests/firmware-host/camera/vivid.h"
#include "tests/firmware-host/gpio/gpio_sim.h"
#include "tests/rig-vm/loop_scene.h"

namespace stratalux::rig {
namespace {

constexpr auto kSyncDelay = std::chrono::milliseconds(1);  // from TRIGGER to SYNC, as a module has
constexpr auto kSyncPulse = std::chrono::milliseconds(1);

[[noreturn]] void Die(const std::string& what) {
  std::cerr << "responder: " << what << (errno != 0 ? std::string(": ") + std::strerror(errno) : "") << "\n";
  std::exit(1);
}

// What the rig's lines are wired to: a simulated chip that has them all, by name.
class Lines {
 public:
  explicit Lines(const GpioWiring& wiring) {
    for (const ProjectorLines& p : wiring.projectors) {
      Add(p.enable), Add(p.trigger), Add(p.sync), Add(p.reset);
    }
    Add(wiring.camera_trigger), Add(wiring.strobe), Add(wiring.emergency_stop), Add(wiring.door), Add(wiring.start);
    sim_ = GpioSim::Create(kLabel, names_);
    if (!sim_) Die("no gpio-sim");
    // The trace names lines by the kernel's global number: "gpiochip0: GPIOs 512-527, parent: ..., rig-lines, ...".
    std::ifstream chips("/sys/kernel/debug/gpio");
    for (std::string line; std::getline(chips, line);) {
      const size_t range = line.find("GPIOs ");
      if (range != std::string::npos && line.find(kLabel) != std::string::npos)
        first_ = std::stoi(line.substr(range + 6));
    }
    if (first_ < 0) Die("/sys/kernel/debug/gpio does not list the chip");
  }
  // Its global number; -1: not wired.
  template <typename Wiring>
  [[nodiscard]] int Number(const std::optional<Wiring>& wiring) const {
    return wiring ? first_ + Offset(wiring->at.name) : -1;
  }
  // Drives an input of the rig.
  void Pull(const std::optional<InputWiring>& wiring, bool active) const {
    if (!wiring) Die("a fault of a line that is not wired");
    sim_->Pull(Offset(wiring->at.name), active == (wiring->active == ActiveLevel::kHigh));
  }
  void Unplug() const { sim_->Unplug(); }

 private:
  static constexpr const char* kLabel = "rig-lines";
  template <typename Wiring>
  void Add(const std::optional<Wiring>& wiring) {
    if (wiring) names_.push_back(wiring->at.name);
  }
  [[nodiscard]] int Offset(const std::string& name) const {
    return static_cast<int>(std::find(names_.begin(), names_.end(), name) - names_.begin());
  }
  std::vector<std::string> names_;
  std::unique_ptr<GpioSim> sim_;
  int first_ = -1;
};

// Each change of an output line, in order. The kernel tells every write, also of the value a line has.
class PulseTrace {
 public:
  struct Change {
    int line = 0;
    bool high = false;
  };
  PulseTrace() {
    std::ofstream("/sys/kernel/tracing/trace_clock") << "mono" << std::flush;  // one order for all processors
    std::ofstream("/sys/kernel/tracing/events/gpio/gpio_value/enable") << "1" << std::flush;
    pipe_ = std::fopen("/sys/kernel/tracing/trace_pipe", "re");
    if (pipe_ == nullptr) Die("cannot open the kernel's trace");
  }
  ~PulseTrace() { std::fclose(pipe_); }
  PulseTrace(const PulseTrace&) = delete;
  PulseTrace& operator=(const PulseTrace&) = delete;

  // nullopt: a signal came.
  std::optional<Change> Next() {
    std::array<char, 512> text{};
    std::clearerr(pipe_);
    while (std::fgets(text.data(), text.size(), pipe_) != nullptr) {
      const char* event = std::strstr(text.data(), "gpio_value: ");
      Change change;
      int high = 0;
      if (event == nullptr || std::sscanf(event, "gpio_value: %d set %d", &change.line, &high) != 2) continue;
      change.high = high != 0;
      if (std::exchange(high_[change.line], change.high) == change.high) continue;
      return change;
    }
    return std::nullopt;
  }

 private:
  std::FILE* pipe_;
  std::map<int, bool> high_;  // by line
};

// vivid's output: one buffer, queued for ever. Vivid copies it to every captured frame, so what is painted is seen.
class Screen {
 public:
  explicit Screen(const char* path) {
    fd_ = open(path, O_RDWR | O_CLOEXEC);
    if (fd_ < 0) Die(path);
    v4l2_format format{};
    format.type = V4L2_BUF_TYPE_VIDEO_OUTPUT;
    format.fmt.pix.width = kLoopWidth;
    format.fmt.pix.height = kLoopHeight;
    format.fmt.pix.pixelformat = V4L2_PIX_FMT_Y12;
    format.fmt.pix.field = V4L2_FIELD_NONE;
    Call(VIDIOC_S_FMT, &format);
    if (format.fmt.pix.width != kLoopWidth || format.fmt.pix.height != kLoopHeight ||
        format.fmt.pix.bytesperline != 2 * kLoopWidth)
      Die("vivid's output does not take the picture's size");
    v4l2_requestbuffers request{};
    request.count = 2;  // the least vivid gives
    request.type = format.type;
    request.memory = V4L2_MEMORY_MMAP;
    Call(VIDIOC_REQBUFS, &request);
    v4l2_buffer buffer{};
    buffer.type = format.type;
    buffer.memory = V4L2_MEMORY_MMAP;
    Call(VIDIOC_QUERYBUF, &buffer);
    memory_ = mmap(nullptr, buffer.length, PROT_READ | PROT_WRITE, MAP_SHARED, fd_, buffer.m.offset);
    if (memory_ == MAP_FAILED) Die("mapping vivid's output");
    bytes_ = buffer.length;
    pixels_ = {static_cast<uint16_t*>(memory_), kLoopWidth, kLoopHeight};
    buffer.bytesused = buffer.length;
    buffer.field = V4L2_FIELD_NONE;
    Call(VIDIOC_QBUF, &buffer);
    int type = static_cast<int>(format.type);
    Call(VIDIOC_STREAMON, &type);
  }
  ~Screen() {
    munmap(memory_, bytes_);
    close(fd_);
  }
  Screen(const Screen&) = delete;
  Screen& operator=(const Screen&) = delete;
  [[nodiscard]] ImageView<uint16_t> pixels() const { return pixels_; }

 private:
  void Call(unsigned long request, void* argument) const {
    if (ioctl(fd_, request, argument) != 0) Die("vivid's output");
  }
  int fd_ = -1;
  void* memory_ = nullptr;
  size_t bytes_ = 0;
  ImageView<uint16_t> pixels_;
};

// A projector module with its memory and its light.
struct Module {
  std::vector<Pattern> memory;
  int next = 0;    // the place a TRIGGER shows
  int shown = -1;  // -1: nothing yet
  bool lit = false;
  bool stuck = false;  // its SYNC
};

// What the camera sees: the light of every lit projector, and noise that never repeats.
class Scene {
 public:
  Scene(const char* screen, int projector_width, int projector_height)
      : path_(screen),
        width_(projector_width),
        height_(projector_height),
        screen_(std::in_place, screen),
        light_dn_(kPixels) {
    std::mt19937 random(1);
    std::normal_distribution<double> normal(0.0, kLoopNoise_dn);
    for (int16_t& n : noise_dn_) n = static_cast<int16_t>(std::clamp(std::lround(normal(random)), -40L, 40L));
  }
  void Show(const std::vector<Module>& modules) {
    std::vector<float> light(kPixels, kLoopBlack_dn);
    for (size_t p = 0; p < modules.size(); ++p) {
      if (!modules[p].lit || modules[p].shown < 0) continue;
      const std::vector<float>& added = LightOf(static_cast<int>(p), modules[p].memory[modules[p].shown]);
      std::transform(light.begin(), light.end(), added.begin(), light.begin(), std::plus<>());
    }
    {
      const std::lock_guard lock(mutex_);
      std::transform(light.begin(), light.end(), light_dn_.begin(),
                     [](float v) { return static_cast<int16_t>(std::lround(v)); });
    }
    Repaint();
  }
  void ReopenScreen() {
    {
      const std::lock_guard lock(mutex_);
      screen_.emplace(path_);
    }
    Repaint();
  }
  void Repaint() {
    const std::lock_guard lock(mutex_);
    for (int y = 0; y < kLoopHeight; ++y) {
      const int16_t* noise = &noise_dn_[random_() % (noise_dn_.size() - kLoopWidth)];
      const int16_t* light = &light_dn_[static_cast<size_t>(y) * kLoopWidth];
      uint16_t* row = screen_->pixels().row(y);
      for (int x = 0; x < kLoopWidth; ++x) row[x] = static_cast<uint16_t>(light[x] + noise[x]);
    }
  }

 private:
  static constexpr size_t kPixels = static_cast<size_t>(kLoopWidth) * kLoopHeight;
  // Kept once computed: a memory is stepped through again and again.
  const std::vector<float>& LightOf(int projector, const Pattern& pattern) {
    std::vector<float>& light = lights_[{projector, pattern.ToString()}];
    if (light.empty()) light = LoopLight(pattern, projector, width_, height_);
    return light;
  }

  const char* path_;
  int width_, height_;
  std::map<std::pair<int, std::string>, std::vector<float>> lights_;
  std::mutex mutex_;  // guards what follows
  std::optional<Screen> screen_;
  std::vector<int16_t> light_dn_;  // without noise
  std::array<int16_t, 16384> noise_dn_{};
  std::mt19937 random_{2};
};

struct Fault {
  std::string kind;
  int64_t at = 0;
};

Fault ParseFault(const std::string& text) {
  const size_t at = text.rfind('@');
  if (at == std::string::npos) Die("fault without @N: " + text);
  Fault fault{text.substr(0, at), std::stoll(text.substr(at + 1))};
  if (fault.at < 0) Die("fault before the first pulse: " + text);
  return fault;
}

volatile std::sig_atomic_t replugged = 0;  // SIGHUP came

class Responder {
 public:
  Responder(const RigConfig& config, const MemoryLayout& layout, Scene& scene, std::vector<Fault> faults)
      : wiring_(config.gpio), lines_(wiring_), vivid_(Vivid::Find()), scene_(scene), faults_(std::move(faults)) {
    if (!vivid_) Die("no vivid");
    for (const ProjectorMemory& filled : layout.projectors) modules_.push_back({.memory = filled.patterns});
    for (const Fault& fault : faults_)
      if (fault.kind == "swap") std::swap(modules_[0].memory.at(fault.at), modules_[0].memory.at(fault.at + 1));
  }
  // Goes on until a signal comes.
  void Run() {
    std::cout << "ready" << std::endl;
    while (true) {
      const auto change = trace_.Next();
      if (change) Answer(*change);
      if (replugged == 0 && !change) return;
      if (replugged != 0) scene_.ReopenScreen();
      replugged = 0;
    }
  }

 private:
  void Answer(const PulseTrace::Change& change) {
    for (size_t p = 0; p < modules_.size(); ++p) {
      Module& module = modules_[p];
      const ProjectorLines& lines = wiring_.projectors[p];
      if (change.line == lines_.Number(lines.enable) && change.high != module.lit) {
        module.lit = change.high;
        scene_.Show(modules_);
      } else if (change.high && change.line == lines_.Number(lines.reset)) {
        module.next = 0;
      } else if (change.high && change.line == lines_.Number(lines.trigger)) {
        Step(module, lines);
      }
    }
  }
  void Step(Module& module, const ProjectorLines& lines) {
    const int64_t pulse = module.lit ? lit_pulses_++ : kInTheDark;
    if (!Has("no-step", pulse)) {
      module.shown = module.next;
      module.next = (module.next + 1) % static_cast<int>(module.memory.size());
      scene_.Show(modules_);
    }
    for (const Fault& fault : faults_)
      if (fault.at == pulse) Inject(fault.kind);
    if (unplugged_ || module.stuck || Has("lost-edge", pulse)) return;
    std::this_thread::sleep_for(kSyncDelay);
    for (int edges = Has("doubled-edge", pulse) ? 2 : 1; edges > 0; --edges) {
      lines_.Pull(lines.sync, true);
      module.stuck = Has("stuck-sync", pulse);
      if (module.stuck) return;
      std::this_thread::sleep_for(kSyncPulse);
      lines_.Pull(lines.sync, false);
    }
  }
  // What goes beyond one pulse of one module.
  void Inject(const std::string& kind) {
    if (kind == "emergency-stop") lines_.Pull(wiring_.emergency_stop, true);
    if (kind == "door") lines_.Pull(wiring_.door, true);
    if (kind == "unplug") {
      lines_.Unplug();
      unplugged_ = true;
    }
    if (kind.starts_with("control:")) {
      const size_t value = kind.find('=');
      const std::string name = kind.substr(8, value - 8);
      if (value == std::string::npos || !vivid_->Set(name, std::stoi(kind.substr(value + 1))))
        Die("vivid's control " + name);
    }
  }
  [[nodiscard]] bool Has(const char* kind, int64_t pulse) const {
    return std::any_of(faults_.begin(), faults_.end(),
                       [&](const Fault& fault) { return fault.kind == kind && fault.at == pulse; });
  }

  static constexpr int64_t kInTheDark = -1;  // a pulse that no fault is bound to
  PulseTrace trace_;
  const GpioWiring& wiring_;
  Lines lines_;
  std::unique_ptr<Vivid> vivid_;
  Scene& scene_;
  std::vector<Fault> faults_;
  std::vector<Module> modules_;
  int64_t lit_pulses_ = 0;
  bool unplugged_ = false;
};

// A signal only interrupts what waits; Run then ends, and with it the chip, or looks at its screen anew.
void HearSignals() {
  struct sigaction action {};
  action.sa_handler = [](int signal) { replugged = signal == SIGHUP ? 1 : 0; };
  for (const int signal : {SIGTERM, SIGHUP}) sigaction(signal, &action, nullptr);
}

int Main(int argc, char** argv) {
  if (argc < 3) Die("usage: rig-vm-responder CONFIG SCREEN [FAULT@N]...");
  const auto config = LoadRigConfig(argv[1]);
  if (!config.ok()) Die(config.status().message());
  const auto layout = LayOutMemories((*config).plan, (*config).memory);
  if (!layout.ok()) Die(layout.status().message());
  std::vector<Fault> faults;
  for (int i = 3; i < argc; ++i) faults.push_back(ParseFault(argv[i]));
  HearSignals();
  Scene scene(argv[2], (*config).plan.projector_width, (*config).plan.projector_height);
  scene.Show({});
  const std::jthread noise([&scene](const std::stop_token& stop) {
    sigset_t signals;
    sigfillset(&signals);
    pthread_sigmask(SIG_BLOCK, &signals, nullptr);
    while (!stop.stop_requested()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(8));
      scene.Repaint();
    }
  });
  Responder(*config, *layout, scene, std::move(faults)).Run();
  return 0;
}

}  // namespace
}  // namespace stratalux::rig

int main(int argc, char** argv) { return stratalux::rig::Main(argc, argv); }
