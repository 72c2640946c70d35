// SPDX-License-Identifier: Apache-2.0
// What the live picture costs at full size: processor time of a picture for the kiosk's visitor and for who focuses,
// and its share of one core at five pictures a second. Run: build/bench/bin/preview_bench
#include <algorithm>
#include <cstdio>
#include <ctime>
#include <functional>
#include <vector>

#include "firmware-host/preview/frame_figures.h"
#include "firmware-host/preview/preview_picture.h"
#include "shared/base/random.h"

namespace stratalux::rig {
namespace {

constexpr int kWidth = 1392, kHeight = 1042, kPictures = 100;
constexpr double kPicturesPerSecond = 5.0, kBlackDn = 64.0, kLightDn = 900.0;

// CPU time of this thread: what a busy machine does to the wall clock says nothing of the picture.
double ThreadMs() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return 1e3 * static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_nsec);
}

// A slope with noise: a JPEG of something, not of nothing.
Image<uint16_t> NoisyFrame() {
  Random random(1, 0);
  Image<uint16_t> frame(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      frame(x, y) = static_cast<uint16_t>(kBlackDn + kLightDn * x / kWidth + 30.0 * random.Uniform());
  return frame;
}

void Measure(const char* what, const std::function<bool()>& once) {
  std::vector<double> ms;
  for (int i = 0; i < kPictures; ++i) {
    const double begin = ThreadMs();
    if (!once()) std::printf("%s: failed\n", what);
    ms.push_back(ThreadMs() - begin);
  }
  std::sort(ms.begin(), ms.end());
  const double median = ms[ms.size() / 2];
  std::printf("%-40s %6.2f ms a picture (median of %d, 99 %% %.2f ms): %5.2f %% of a core at %.0f a second\n", what,
              median, kPictures, ms[ms.size() * 99 / 100], 0.1 * median * kPicturesPerSecond, kPicturesPerSecond);
}

void Run() {
  const FrameRecord record;
  const Image<uint16_t> frame = NoisyFrame();
  Measure("kiosk: 640 px", [&] { return PreviewPicture(record, frame.view()).ok(); });
  Measure("preview: 1392 px", [&] { return PreviewPicture(record, frame.view(), kWidth).ok(); });
  Measure("preview: figures", [&] { return FiguresOf(frame.view(), 4095).focus > 0.0; });
}

}  // namespace
}  // namespace stratalux::rig

int main() { stratalux::rig::Run(); }
