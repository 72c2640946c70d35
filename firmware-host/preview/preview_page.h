// SPDX-License-Identifier: Apache-2.0
// The page of `stratalux-rig preview`: the live picture, its figures, what to light and how long to expose.
#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "firmware-host/preview/frame_figures.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/frame_record.h"
#include "shared/image/image.h"

namespace stratalux::rig {

// What whoever looks has chosen.
struct PreviewChoice {
  int projector = -1;  // that shows white; -1: lights off
  double exposure_ms = 0.0;
};

struct PreviewPageOptions {
  int port = 0;             // on 127.0.0.1; 0: any free one
  std::string page_folder;  // empty: that of the program (share/stratalux/preview/page)
  // What may be chosen.
  int projectors = 0;
  double shortest_ms = 0.0, longest_ms = 0.0;  // equal: the camera has one exposure
  PreviewChoice first;
};

// Thread-safe. Serves from Start() until it goes; pictures lie in memory alone.
class PreviewPage {
 public:
  // kNotFound: the page's files; kBusy: the port is taken. `logger` outlives the page.
  static Result<std::unique_ptr<PreviewPage>> Start(const PreviewPageOptions& options, Logger& logger);
  ~PreviewPage();

  [[nodiscard]] PreviewChoice choice() const;
  // Lights off are chosen, and why.
  void PutOut(const std::string& why);
  // Somebody has pressed Reset since this was asked last.
  [[nodiscard]] bool TakeReset();
  // Until something is chosen or pressed, or the time is over.
  void Wait(std::chrono::nanoseconds time);

  void Show(const FrameRecord& record, ImageView<const uint16_t> frame, const FrameFigures& figures);
  // In place of a picture: why there is none. `stopped`: until somebody presses Reset.
  enum class Trouble { kPasses, kStopped };
  void Say(const std::string& why, Trouble trouble);

  [[nodiscard]] std::string url() const;
  [[nodiscard]] int port() const;

 private:
  struct Impl;
  explicit PreviewPage(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace stratalux::rig
