// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/sequence/rig_check.h"

#include <algorithm>
#include <cstdio>
#include <thread>

#include "firmware-host/sequence/probe_lattice.h"
#include "shared/base/median.h"
#include "shared/units/time.h"

namespace stratalux::rig {
namespace {

using std::chrono::nanoseconds;

std::string Text(const char* format, double a, double b = 0.0, double c = 0.0) {
  char text[160];
  std::snprintf(text, sizeof text, format, a, b, c);
  return text;
}

class RigCheck {
 public:
  RigCheck(const RigDevices& devices, const RigCheckOptions& options) : devices_(devices), options_(options) {
    if (!options_.wait) options_.wait = [&stop = devices.light.stop()](nanoseconds time) { stop.Sleep(time); };
  }

  Status Run() {
    report_.card.resize(devices_.projectors.size());
    report_.sync_ms.resize(devices_.projectors.size());
    SLX_RETURN_IF_ERROR(CheckInterlock());
    if (Failed()) return Status::Ok();
    SLX_RETURN_IF_ERROR(Step("camera", [this] { return CheckCamera(); }));
    for (int p = 0; p < Projectors(); ++p) {
      const std::string name = "projector " + std::to_string(p);
      SLX_RETURN_IF_ERROR(Step(name + ": TRIGGER to SYNC", [&] { return CheckLoop(p); }));
      SLX_RETURN_IF_ERROR(Step(name + ": light", [&] { return CheckLight(p); }));
    }
    SLX_RETURN_IF_ERROR(Step("frames", [this] { return CheckFrames(); }));
    const bool healthy = std::none_of(report_.items.begin(), report_.items.end(),
                                      [](const CheckItem& item) { return item.state == CheckState::kFailed; });
    if (healthy) report_.delays = delays_;
    return Status::Ok();
  }
  RigCheckReport Take() { return std::move(report_); }

 private:
  [[nodiscard]] int Projectors() const { return static_cast<int>(devices_.projectors.size()); }
  [[nodiscard]] bool Failed() const { return report_.items.back().state == CheckState::kFailed; }
  void Pass(std::string name, std::string found) {
    report_.items.push_back({std::move(name), CheckState::kPassed, std::move(found), ""});
  }
  void Fail(std::string name, std::string found, std::string remedy) {
    report_.items.push_back({std::move(name), CheckState::kFailed, std::move(found), std::move(remedy)});
  }

  // Runs a check that appends its own item; what a device refuses becomes the item.
  Status Step(const std::string& name, const std::function<Status()>& check) {
    SLX_RETURN_IF_ERROR(devices_.light.Check());
    const Status status = check();
    SLX_RETURN_IF_ERROR(devices_.light.Check());
    if (!status.ok()) Fail(name, status.message(), "check the device's cable and power, and its name in rig.toml");
    return devices_.light.AllOff();
  }

  Status CheckInterlock() {
    const Status light = devices_.light.Check();
    switch (devices_.light.stop().reason()) {
      case StopReason::kNone:
        Pass("interlock", "closed");
        return light;
      case StopReason::kEmergencyStop:
      case StopReason::kDoorOpen:
      case StopReason::kLinesGone:
        Fail("interlock", light.message(), "release the emergency stop, close the door; then press reset");
        return Status::Ok();
      default:
        return light;
    }
  }

  // For as long as the frames of it may take.
  Status Light(int projector) {
    const auto exposure = FromMilliseconds(options_.exposure_ms);
    return devices_.light.On(projector,
                             {2 * (3 * (options_.deadline + 2 * exposure) + options_.settle), options_.max_on_time});
  }

  Status DrainEdges() {
    while (true) {
      SLX_ASSIGN_OR_RETURN(const std::optional<SyncEdge> edge, devices_.lines.WaitSync({}));
      if (!edge) return Status::Ok();
    }
  }
  Status DrainFrames() {
    while (true) {
      SLX_ASSIGN_OR_RETURN(const std::optional<CapturedFrame> frame, devices_.camera.Wait({}));
      if (!frame) return Status::Ok();
    }
  }

  // In slices, so that nobody waits for a stop.
  template <typename Wait>
  auto InSlices(nanoseconds limit, const Wait& wait) -> decltype(wait(limit)) {
    while (true) {
      SLX_RETURN_IF_ERROR(devices_.light.Check());
      const nanoseconds slice = std::min<nanoseconds>(limit, kLongestUnasked);
      auto got = wait(slice);
      limit -= slice;
      if (!got.ok() || *got || limit.count() <= 0) return got;
    }
  }
  Result<std::optional<CapturedFrame>> WaitFrame(nanoseconds limit) {
    return InSlices(limit, [this](nanoseconds slice) { return devices_.camera.Wait(slice); });
  }
  Result<std::optional<SyncEdge>> WaitEdge() {
    return InSlices(options_.deadline, [this](nanoseconds slice) { return devices_.lines.WaitSync(slice); });
  }

  // No count of steps is trusted before the lines are known to be right.
  static Status LoadAnew(Projector& projector, const std::vector<Pattern>& sequence) {
    projector.Doubt();
    return projector.Load(sequence);
  }

  // One frame of what is shown now; nullopt: none came.
  Result<std::optional<CapturedFrame>> Snap() {
    options_.wait(options_.settle);
    const auto limit = options_.deadline + nanoseconds(static_cast<int64_t>(2e6 * options_.exposure_ms));
    if (devices_.camera.follows_trigger()) {
      SLX_RETURN_IF_ERROR(DrainFrames());
      SLX_RETURN_IF_ERROR(devices_.lines.TriggerCamera().status());
      return WaitFrame(limit);
    }
    // The exposures under way may have begun before; the second frame from now on has not.
    SLX_RETURN_IF_ERROR(WaitFrame(limit).status());
    SLX_RETURN_IF_ERROR(WaitFrame(limit).status());
    return WaitFrame(limit);
  }

  Status CheckCamera() {
    SLX_RETURN_IF_ERROR(devices_.camera.SetExposure(options_.exposure_ms, options_.gain));
    SLX_ASSIGN_OR_RETURN(const std::optional<CapturedFrame> frame, Snap());
    if (!frame) {
      Fail("camera", "no frame within " + Text("%.0f ms", ToMilliseconds(options_.deadline)),
           "check the camera's TRIGGER line and polarity, and that it is set to external trigger");
      return Status::Ok();
    }
    report_.format = frame->format;
    report_.cfa = frame->cfa;
    const std::string size = std::to_string(frame->pixels.width()) + "x" + std::to_string(frame->pixels.height());
    if (frame->clock == ClockSource::kUnknown)
      Fail("camera", size + ", times of an unknown clock", "use a driver that stamps frames with CLOCK_MONOTONIC");
    else if (std::abs(frame->exposure_ms - options_.exposure_ms) > 0.02 * options_.exposure_ms)
      Fail("camera", size + Text(", reports %.3f ms for %.3f ms", frame->exposure_ms, options_.exposure_ms),
           "choose an exposure that the camera offers, switch its automatic exposure off");
    else
      Pass("camera", size + Text(", exposure %.3f ms as set", frame->exposure_ms));
    return Status::Ok();
  }

  // Every pulse gives one edge, of this projector.
  Status CheckLoop(int projector) {
    const std::string name = "projector " + std::to_string(projector) + ": TRIGGER to SYNC";
    const int of_sequence = static_cast<int>(options_.markers.size());
    const int pulses = (std::max(1, options_.pulses) + of_sequence - 1) / of_sequence * of_sequence;
    std::vector<double> latency;
    int missing = 0, extra = 0, foreign = -1;
    for (int k = 0; k < pulses; ++k) {
      if (k % of_sequence == 0) {
        SLX_RETURN_IF_ERROR(LoadAnew(*devices_.projectors[projector], options_.markers));
        SLX_RETURN_IF_ERROR(DrainEdges());
      }
      SLX_ASSIGN_OR_RETURN(const TriggerReceipt pulse, devices_.lines.TriggerProjector(projector));
      SLX_ASSIGN_OR_RETURN(std::optional<SyncEdge> edge, WaitEdge());
      if (!edge) ++missing;
      if (edge && edge->projector != projector) foreign = edge->projector;
      if (edge && edge->projector == projector) latency.push_back(ToMilliseconds(edge->time - pulse.time));
      options_.wait(options_.settle);
      SLX_ASSIGN_OR_RETURN(edge, devices_.lines.WaitSync({}));
      if (edge) ++extra;
      SLX_RETURN_IF_ERROR(DrainEdges());
    }
    report_.sync_latency_ms.insert(report_.sync_latency_ms.end(), latency.begin(), latency.end());
    delays_.sync.push_back(FiguresOf(latency));
    if (!latency.empty()) report_.sync_ms[static_cast<size_t>(projector)] = Median(latency);
    const std::string count = std::to_string(pulses);
    if (foreign >= 0)
      Fail(name, "the edge comes on SYNC of projector " + std::to_string(foreign),
           "swap the cables of projectors " + std::to_string(projector) + " and " + std::to_string(foreign));
    else if (missing > 0)
      Fail(name, std::to_string(missing) + " of " + count + " pulses without an edge",
           "check both cables, the pulse width and the polarity of SYNC");
    else if (extra > 0)
      Fail(name, std::to_string(extra) + " of " + count + " pulses with more than one edge",
           "the line rings or its polarity is wrong: check ground, termination and polarity");
    else
      Pass(name, count + " pulses, " +
                     Text("%.3f / %.3f / %.3f ms", *std::min_element(latency.begin(), latency.end()), Median(latency),
                          *std::max_element(latency.begin(), latency.end())));
    return Status::Ok();
  }

  // A frame after projector `stepped` went on by one, all memories standing before black, white.
  Result<Image<uint16_t>> FrameAfterStep(int stepped) {
    SLX_RETURN_IF_ERROR(devices_.lines.TriggerProjector(stepped).status());
    SLX_RETURN_IF_ERROR(WaitEdge().status());
    SLX_RETURN_IF_ERROR(DrainEdges());
    SLX_ASSIGN_OR_RETURN(std::optional<CapturedFrame> frame, Snap());
    if (!frame) return Status::Failed("no frame within " + Text("%.0f ms", ToMilliseconds(options_.deadline)));
    if (report_.samples.size() < 4) report_.samples.push_back(frame->pixels);
    return std::move(frame->pixels);
  }

  Status CheckLight(int projector) {
    const std::string name = "projector " + std::to_string(projector) + ": light";
    const Pattern black, white = {.kind = PatternKind::kWhite};
    for (Projector* p : devices_.projectors) SLX_RETURN_IF_ERROR(LoadAnew(*p, {black, white}));
    SLX_RETURN_IF_ERROR(Light(projector));
    SLX_ASSIGN_OR_RETURN(const Image<uint16_t> black_frame, FrameAfterStep(projector));
    SLX_ASSIGN_OR_RETURN(const Image<uint16_t> white_frame, FrameAfterStep(projector));
    report_.card[static_cast<size_t>(projector)] = CardFiguresOf(black_frame, white_frame, report_.cfa);
    const double dark = MeanDn(black_frame), lit = MeanDn(white_frame);
    SLX_RETURN_IF_ERROR(devices_.light.Off(projector));
    SLX_ASSIGN_OR_RETURN(std::optional<CapturedFrame> frame, Snap());
    const double off = frame ? MeanDn(frame->pixels) : dark;
    const std::string found = Text("black %.1f DN, white %.1f DN, switched off %.1f DN", dark, lit, off);
    if (lit - dark <= -options_.min_contrast_dn) {
      Fail(name, found, "patterns come out inverted: check the projector's display mode");
    } else if (lit - dark < options_.min_contrast_dn) {
      return ExplainDarkness(projector, name, found);
    } else if (off - dark >= 0.5 * (lit - dark)) {
      Fail(name, found, "ENABLE does not switch the light off: check its cable and polarity");
    } else {
      Pass(name, found);
    }
    return Status::Ok();
  }

  // Does the light of `projector` answer to another one's TRIGGER?
  Status ExplainDarkness(int projector, const std::string& name, const std::string& found) {
    const Pattern black, white = {.kind = PatternKind::kWhite};
    for (int other = 0; other < Projectors(); ++other) {
      if (other == projector) continue;
      SLX_RETURN_IF_ERROR(devices_.light.Off(projector));
      for (Projector* p : devices_.projectors) SLX_RETURN_IF_ERROR(LoadAnew(*p, {black, white}));
      SLX_RETURN_IF_ERROR(Light(projector));
      SLX_ASSIGN_OR_RETURN(const Image<uint16_t> black_frame, FrameAfterStep(other));
      SLX_ASSIGN_OR_RETURN(const Image<uint16_t> white_frame, FrameAfterStep(other));
      if (MeanDn(white_frame) - MeanDn(black_frame) < options_.min_contrast_dn) continue;
      const std::string both = std::to_string(projector) + " and " + std::to_string(other);
      Fail(name, found + "; its ENABLE lights what TRIGGER of projector " + std::to_string(other) + " steps",
           "swap the ENABLE or the TRIGGER cables of projectors " + both);
      return Status::Ok();
    }
    Fail(name, found, "no light: check the lamp, ENABLE and its polarity, the lens cap, and that a target is in place");
    return Status::Ok();
  }

  Status CheckFrames() {
    SLX_RETURN_IF_ERROR(DrainFrames());
    const bool triggered = devices_.camera.follows_trigger();
    const auto limit = options_.deadline + nanoseconds(static_cast<int64_t>(2e6 * options_.exposure_ms));
    std::optional<int64_t> last;
    MonotonicNs first_time, last_time;
    int arrived = 0;
    const nanoseconds exposure = FromMilliseconds(options_.exposure_ms);
    std::vector<double> delays, transfers;
    for (int k = 0; k < options_.frames; ++k) {
      ++report_.frames_asked;
      MonotonicNs from = last_time;
      if (triggered) {
        SLX_ASSIGN_OR_RETURN(const TriggerReceipt pulse, devices_.lines.TriggerCamera());
        from = pulse.time;
      }
      SLX_ASSIGN_OR_RETURN(const std::optional<CapturedFrame> frame, WaitFrame(limit));
      const MonotonicNs now = devices_.light.Now();
      if (!frame) {
        ++report_.frames_lost;
        continue;
      }
      if (last && frame->sequence <= *last) ++report_.frames_doubled;
      if (last && frame->sequence > *last + 1 && !triggered) report_.frames_lost += frame->sequence - *last - 1;
      last = std::max(last.value_or(frame->sequence), frame->sequence);
      if (triggered || arrived > 0) {
        report_.frame_latency_ms.push_back(ToMilliseconds(frame->time - from));
        delays.push_back(ToMilliseconds(now - from - (triggered ? exposure : 2 * exposure)));
        transfers.push_back(ToMilliseconds(now - frame->time - exposure));
      }
      if (arrived++ == 0) first_time = frame->time;
      last_time = frame->time;
      if (!triggered) continue;
      SLX_ASSIGN_OR_RETURN(const std::optional<CapturedFrame> unasked, devices_.camera.Wait({}));
      report_.frames_doubled += unasked.has_value();
    }
    delays_.frame = FiguresOf(delays);
    delays_.transfer_ms = Median(transfers);
    delays_.exposure_ms = options_.exposure_ms;
    if (arrived > 1) delays_.frame_period_ms = ToMilliseconds(last_time - first_time) / (arrived - 1);
    if (arrived > 1)
      report_.frames_per_s = 1e3 * (arrived - 1) / std::max(1e-6, ToMilliseconds(last_time - first_time));
    const std::string found = std::to_string(report_.frames_asked) + " asked, " + std::to_string(report_.frames_lost) +
                              " lost, " + std::to_string(report_.frames_doubled) + " doubled, " +
                              Text("%.1f frames/s", report_.frames_per_s);
    if (report_.frames_lost + report_.frames_doubled > 0 || arrived < 2)
      Fail("frames", found, "check the TRIGGER cable for ringing, the link's bandwidth and the driver's buffers");
    else
      Pass("frames", found);
    return Status::Ok();
  }

  const RigDevices& devices_;
  RigCheckOptions options_;
  RigCheckReport report_;
  RigDelays delays_;
};

}  // namespace

const char* ToString(CheckState state) {
  switch (state) {
    case CheckState::kPassed:
      return "ok";
    case CheckState::kFailed:
      return "FAILED";
    case CheckState::kSkipped:
      return "skipped";
  }
  return "unknown";
}

Result<RigCheckReport> CheckRig(const RigDevices& devices, const RigCheckOptions& options) {
  const auto& markers = options.markers;
  const auto pair = std::adjacent_find(markers.begin(), markers.end(), [](const Pattern& a, const Pattern& b) {
    return a.kind == PatternKind::kBlack && b.kind == PatternKind::kWhite;
  });
  if (pair == markers.end())
    return Status::Usage(
        "the rig's check needs a pre-roll with white after black: [plan] preroll_markers of 6 or more");
  SLX_RETURN_IF_ERROR(devices.camera.Start().WithContext("camera"));
  RigCheck check(devices, options);
  const Status ended = check.Run();
  // Lights first, whatever happened.
  const Status off = devices.light.AllOff();
  // One that cannot was named above.
  for (Projector* projector : devices.projectors) static_cast<void>(projector->Rest().ok());
  const Status stopped = devices.camera.Stop().WithContext("camera");
  SLX_RETURN_IF_ERROR(ended);
  SLX_RETURN_IF_ERROR(off);
  SLX_RETURN_IF_ERROR(stopped);
  return check.Take();
}

}  // namespace stratalux::rig
