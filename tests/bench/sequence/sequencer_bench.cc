// SPDX-License-Identifier: Apache-2.0
// The sequencer at full size: a whole capture of 1392x1042 12-bit frames into a store, from devices that hand out
// pictures made beforehand, at once or at a camera's pace. Prints frames a second, cores, memory, and what the
// sequencer itself takes of each frame; then what the idle wait for START costs. Run: build/bench/bin/sequencer_bench
// STORE-FOLDER
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <map>
#include <string>
#include <thread>

#include <sys/resource.h>

#include "db/catalogue/consent.h"
#include "db/catalogue/session_store.h"
#include "firmware-host/recording/session_archive.h"
#include "firmware-host/sequence/sequencer.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

using Clock = std::chrono::steady_clock;
constexpr int kWidth = 1392, kHeight = 1042, kColumns = 1024, kRows = 768;
constexpr double kBlackDn = 64.0, kWhiteDn = 900.0;

double Seconds(Clock::duration d) { return std::chrono::duration<double>(d).count(); }

// CPU time of this thread: what a busy machine does to the wall clock says nothing of the sequencer.
double ThreadMs() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}

// Lines, camera and one projector. A flat target and noise of 6 DN; each frame's noise is another place of one large
// field, so that no row repeats and a frame costs one addition a pixel. Keeps the CPU time spent in itself.
class Rig final : public LineBank, public FrameSource, public Projector, public LightSwitch {
 public:
  explicit Rig(double period_ms)
      : period_(static_cast<int64_t>(period_ms * 1e6)), light_(LightGuard::Start({{this}}, nullptr, stop_).value()) {
    Random random(1);
    for (int16_t& n : noise_) n = static_cast<int16_t>(std::lround(6.0 * random.Normal()));
  }
  // Everything that devices do; the rest of a frame's time is the sequencer's.
  double device_ms = 0.0;

  [[nodiscard]] LightGuard& light() { return *light_; }
  [[nodiscard]] const StopToken& stop() const { return stop_; }
  int Set(bool on) noexcept override {
    on_.store(on);
    return 0;
  }
  int Read(bool& on) noexcept override {
    on = on_.load();
    return 0;
  }
  [[nodiscard]] const char* name() const noexcept override { return "ENABLE"; }
  Result<TriggerReceipt> TriggerProjector(int) override {
    ++shown_;
    edge_ = SyncEdge{0, edges_++, MonotonicNow()};
    return TriggerReceipt{triggers_++, edge_->time};
  }
  Result<TriggerReceipt> TriggerCamera() override {
    pending_ = MonotonicNow();
    return TriggerReceipt{triggers_++, *pending_};
  }
  Result<std::optional<SyncEdge>> WaitSync(std::chrono::nanoseconds) override {
    return std::exchange(edge_, std::nullopt);
  }
  [[nodiscard]] std::optional<MonotonicNs> LastStrobe() override { return std::nullopt; }

  Status Start() override { return Status::Ok(); }
  Status Stop() override { return Status::Ok(); }
  Status SetExposure(double exposure_ms, double) override {
    exposure_ms_ = exposure_ms;
    return Status::Ok();
  }
  Result<std::optional<CapturedFrame>> Wait(std::chrono::nanoseconds) override {
    if (!pending_) return std::optional<CapturedFrame>();
    const double start = ThreadMs();
    CapturedFrame frame;
    frame.pixels = Develop(memory_[shown_]);
    frame.cfa = Cfa::kMono;
    frame.sequence = frames_++;
    frame.time = *std::exchange(pending_, std::nullopt);
    frame.clock = ClockSource::kMonotonic;
    frame.exposure_ms = exposure_ms_;
    // A camera's own pace: exposure and read-out.
    std::this_thread::sleep_until(last_ + period_);
    last_ = std::max(last_ + period_, Clock::now() - period_);
    device_ms += ThreadMs() - start;
    return std::optional(std::move(frame));
  }

  [[nodiscard]] int width() const override { return kColumns; }
  [[nodiscard]] int height() const override { return kRows; }
  Status Load(const std::vector<Pattern>& sequence) override {
    const double start = ThreadMs();
    memory_ = sequence;
    shown_ = -1;
    for (const Pattern& pattern : memory_) Picture(pattern);  // made before the clock of any frame runs
    device_ms += ThreadMs() - start;
    return Status::Ok();
  }

 private:
  // Without noise; a pattern along an axis is kept as one row or column.
  struct Drawn {
    std::vector<uint16_t> column, row;
    Image<uint16_t> whole;
  };
  const Drawn& Picture(const Pattern& pattern) {
    const auto [found, fresh] = drawn_.try_emplace(pattern.ToString());
    if (!fresh) return found->second;
    auto level = [](double intensity) { return static_cast<uint16_t>(std::lround(kBlackDn + kWhiteDn * intensity)); };
    auto at = [](int camera, int camera_size, int size) { return camera * size / camera_size; };
    if (!pattern.IsOneDimensional()) {
      found->second.whole = Image<uint16_t>(kWidth, kHeight);
      for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x)
          found->second.whole(x, y) = level(pattern.Intensity(at(x, kWidth, kColumns), at(y, kHeight, kRows)));
    } else if (pattern.axis == PatternAxis::kColumns) {
      for (int x = 0; x < kWidth; ++x)
        found->second.column.push_back(level(pattern.Intensity(at(x, kWidth, kColumns), 0)));
    } else {
      for (int y = 0; y < kHeight; ++y) found->second.row.push_back(level(pattern.Intensity(0, at(y, kHeight, kRows))));
    }
    return found->second;
  }
  Image<uint16_t> Develop(const Pattern& pattern) {
    const Drawn& drawn = Picture(pattern);
    Image<uint16_t> frame(kWidth, kHeight);
    Random random(2, static_cast<uint64_t>(frames_));
    for (int y = 0; y < kHeight; ++y) {
      const int16_t* noise = noise_.data() + random.Bits() % (noise_.size() - kWidth);
      const std::vector<uint16_t> level =
          drawn.row.empty() ? std::vector<uint16_t>() : std::vector<uint16_t>(kWidth, drawn.row[y]);
      const uint16_t* mean = !drawn.whole.empty() ? drawn.whole.row(y)
                             : !level.empty()     ? level.data()
                                                  : drawn.column.data();
      uint16_t* out = frame.row(y);
      for (int x = 0; x < kWidth; ++x) out[x] = static_cast<uint16_t>(mean[x] + noise[x]);
    }
    return frame;
  }

  const std::chrono::nanoseconds period_;
  StopToken stop_;
  std::atomic<bool> on_ = false;
  std::unique_ptr<LightGuard> light_;
  Clock::time_point last_{};
  std::vector<int16_t> noise_ = std::vector<int16_t>(1 << 20);
  std::map<std::string, Drawn> drawn_;
  std::vector<Pattern> memory_;
  int64_t shown_ = -1, edges_ = 0, triggers_ = 0, frames_ = 0;
  std::optional<SyncEdge> edge_;
  std::optional<MonotonicNs> pending_;
  double exposure_ms_ = 0.0;
};

double CpuSeconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         1e-6 * static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}
double PeakMiB() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

// The CPU time from step to step, less what devices and sink took.
class TimedSink : public FrameSink {
 public:
  TimedSink(FrameSink& inner, Rig& rig) : inner_(inner), rig_(rig) {}
  Status Put(FrameRecord record, Image<uint16_t> pixels) override {
    const double start = ThreadMs();
    const Status status = inner_.Put(std::move(record), std::move(pixels));
    sink_ms_ += ThreadMs() - start;
    return status;
  }
  // Called once a planned step.
  void OnStep() {
    const double now = ThreadMs(), elsewhere = rig_.device_ms + sink_ms_;
    if (steps_++ > 0) overhead_ms.push_back(now - last_ms_ - (elsewhere - last_elsewhere_ms_));
    last_ms_ = now;
    last_elsewhere_ms_ = elsewhere;
  }
  std::vector<double> overhead_ms;

 private:
  FrameSink& inner_;
  Rig& rig_;
  int64_t steps_ = 0;
  double sink_ms_ = 0.0, last_ms_ = 0.0, last_elsewhere_ms_ = 0.0;
};

struct Discard : FrameSink {
  Status Put(FrameRecord, Image<uint16_t>) override { return Status::Ok(); }
};

CapturePlan ThousandFrames() {
  PlanOptions options;
  options.projectors = 1;
  options.exposure_ms = 1.0;
  options.row_sweep = true;
  options.comb_width = 2;
  options.comb_step = 1;
  options.comb_period = 512;
  return *BuildPlan(options);
}

class Told final : public CaptureObserver {
 public:
  explicit Told(TimedSink& sink) : sink_(sink) {}
  void OnStepDone(const PlanStep& /*step*/) override { sink_.OnStep(); }

 private:
  TimedSink& sink_;
};

Result<CaptureReport> Run(Rig& rig, FrameSink& sink, const CapturePlan& plan, CaptureObserver* observer) {
  static Logger logger(LogLevel::kError);
  SequencerOptions options;
  options.shooter.settle = std::chrono::nanoseconds(0);
  options.max_on_time = std::chrono::nanoseconds(0);
  return Sequencer({rig.light(), rig, rig, {&rig}}, options, logger, observer).Run(plan, sink);
}

void PrintReport(const char* what, const Result<CaptureReport>& report, int frames, double seconds, double cpu) {
  if (!report.ok()) {
    std::printf("%s: %s\n", what, report.status().message().c_str());
    return;
  }
  std::printf("%s: %s, %d frames, %d shot again, %.1f frames/s, %.2f cores, peak %.0f MiB\n", what,
              ToString(report->status), frames, report->retried, frames / seconds, cpu / seconds, PeakMiB());
  for (const std::string& reason : report->Reasons()) std::printf("  %s\n", reason.c_str());
}

int Main(const std::filesystem::path& folder) {
  const CapturePlan plan = ThousandFrames();
  const int frames = static_cast<int>(plan.steps.size());
  {  // What the sequencer itself takes: devices and sink answer at once.
    Rig rig(0.0);
    Discard discard;
    TimedSink sink(discard, rig);
    Told told(sink);
    const auto report = Run(rig, sink, plan, &told);
    std::vector<double>& ms = sink.overhead_ms;
    std::sort(ms.begin(), ms.end());
    if (!ms.empty())
      std::printf("sequencer: %.3f ms of CPU a frame at the median, %.3f at the 99th percentile, %.3f at most (%s)\n",
                  ms[ms.size() / 2], ms[ms.size() * 99 / 100], ms.back(),
                  report.ok() ? ToString(report->status) : report.status().message().c_str());
  }
  for (const double period_ms : {1000.0 / 60.0, 0.0}) {
    Rig rig(period_ms);
    Status status = db::SessionStore::Create(folder);
    auto store = db::SessionStore::Open(folder, db::AccessMode::kReadWrite);
    if (!status.ok() || !store.ok()) {
      std::fprintf(stderr, "%s\n", (status.ok() ? store.status() : status).message().c_str());
      return 1;
    }
    SessionInfo info;
    info.kind = plan.options.kind;
    info.simulated = true;
    info.visitor = std::string(db::kSimulatedVisitor);
    info.plan_json = PlanOptionsToJson(plan.options);
    auto writer = store->BeginSession(info);
    if (!writer.ok()) {
      std::fprintf(stderr, "%s\n", writer.status().message().c_str());
      return 1;
    }
    SessionArchive archive(std::move(*writer));
    const double cpu = CpuSeconds();
    const auto start = Clock::now();
    Result<CaptureReport> report = Status::Ok();
    {
      Recorder recorder(archive, 32, rig.stop());
      report = Run(rig, recorder, plan, nullptr);
      status = recorder.Close();
    }
    if (status.ok()) status = archive.writer().Finish(report.ok() ? report->status : SessionStatus::kFailed);
    PrintReport(period_ms > 0.0 ? "into the store, camera at 60 frames/s" : "into the store, camera as fast as asked",
                report, frames, Seconds(Clock::now() - start), CpuSeconds() - cpu);
    if (!status.ok()) std::printf("  store: %s\n", status.message().c_str());
  }
  // The kiosk's wait between visitors.
  Rig rig(0.0);
  const double cpu = CpuSeconds();
  const auto start = Clock::now();
  while (Seconds(Clock::now() - start) < 3.0) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    if (!rig.light().Check().ok()) return 1;
  }
  std::printf("idle: %.2f %% of a core\n", 100.0 * (CpuSeconds() - cpu) / Seconds(Clock::now() - start));
  return 0;
}

}  // namespace
}  // namespace stratalux::rig

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: sequencer_bench STORE-FOLDER\n");
    return 2;
  }
  return stratalux::rig::Main(argv[1]);
}
