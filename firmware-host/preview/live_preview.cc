// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/preview/live_preview.h"

#include <algorithm>
#include <string>

namespace stratalux::rig {
namespace {

using Clock = std::chrono::steady_clock;

constexpr auto kBetween = std::chrono::milliseconds(200);
// Between two frames: the light goes when this loop hangs, and not when the machine is busy.
constexpr auto kHold = std::chrono::seconds(2);

class LivePreview {
 public:
  LivePreview(CaptureStation& station, std::chrono::nanoseconds longest, PreviewPage& page, StopToken& stop,
              Logger& logger)
      : station_(station),
        longest_(longest),
        page_(page),
        stop_(stop),
        logger_(logger),
        saturation_dn_(station.RuleOfCamera().saturation_dn) {}

  Status Run() {
    while (!stop_.operator_asked()) {
      const auto begun = Clock::now();
      if (page_.TakeReset()) Reset();
      Look();
      page_.Wait(kBetween - std::min<Clock::duration>(kBetween, Clock::now() - begun));
    }
    return station_.light().AllOff();
  }

 private:
  void Look() {
    const Result<Shot> shot = Take(page_.choice());
    if (shot.ok()) return page_.Show(shot->record, shot->pixels.view(), FiguresOf(shot->pixels.view(), saturation_dn_));
    Darken();
    if (stop_.operator_asked()) return;
    page_.Say(shot.status().message(),
              stop_.stopped() ? PreviewPage::Trouble::kStopped : PreviewPage::Trouble::kPasses);
  }

  Result<Shot> Take(PreviewChoice choice) {
    LightGuard& light = station_.light();
    SLX_RETURN_IF_ERROR(light.Check());
    if (lit_ >= 0 && light.Now() - lit_since_ >= longest_) {
      page_.PutOut("the light was on for the longest time allowed ([capture] max_on_time_s)");
      choice.projector = -1;
    }
    if (lit_ == choice.projector) {
      if (lit_ >= 0) SLX_RETURN_IF_ERROR(light.Renew());
      return station_.Snap(choice.exposure_ms);
    }
    Darken();
    if (choice.projector < 0) return station_.Snap(choice.exposure_ms);
    lit_since_ = light.Now();
    Result<Shot> shot =
        station_.ShowPattern(choice.projector, {.kind = PatternKind::kWhite}, choice.exposure_ms, kHold);
    if (shot.ok()) lit_ = choice.projector;
    return shot;
  }

  void Darken() {
    const bool was_lit = lit_ >= 0;
    lit_ = -1;
    const Status off = station_.light().AllOff();
    if (was_lit && !off.ok()) logger_.Warning("preview: " + off.message());
  }

  // As an operator's reset of the kiosk.
  void Reset() {
    Status over;
    if (station_.CameraWent()) over = station_.ReopenCamera();
    if (over.ok() && stop_.stopped() && !stop_.operator_asked()) over = station_.light().Reset();
    if (!over.ok()) logger_.Warning("preview: " + over.message());
  }

  CaptureStation& station_;
  const std::chrono::nanoseconds longest_;
  PreviewPage& page_;
  StopToken& stop_;
  Logger& logger_;
  const double saturation_dn_;
  int lit_ = -1;
  MonotonicNs lit_since_;
};

}  // namespace

PreviewPageOptions PreviewOptionsOf(const CaptureStation& station, const RigConfig& config) {
  PreviewPageOptions options;
  options.projectors = static_cast<int>(station.rig().devices().projectors.size());
  const ExposureRule rule = station.RuleOfCamera();
  options.shortest_ms = rule.shortest_ms;
  options.longest_ms = rule.longest_ms;
  if (!station.rig().simulation && config.camera.exposure_control == ExposureControl::kNone)
    options.shortest_ms = options.longest_ms = config.camera.fixed_exposure_ms;
  options.first.exposure_ms = std::clamp(config.plan.exposure_ms, options.shortest_ms, options.longest_ms);
  return options;
}

Status RunPreview(CaptureStation& station, const RigConfig& config, PreviewPage& page, StopToken& stop,
                  Logger& logger) {
  // The guard's own end of a stretch is a fault; ours comes before it.
  return LivePreview(station, FromMilliseconds(900.0 * config.max_on_time_s), page, stop, logger).Run();
}

}  // namespace stratalux::rig
