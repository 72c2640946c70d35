// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/calibration/light_watch.h"

#include <algorithm>
#include <cmath>
#include <random>

#include <gmock/gmock.h>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// A target whose light falls to the sides, with shot noise.
Image<uint16_t> Picture(double level_dn, double signal_dn, uint32_t seed = 1) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0.0, 1.0);
  Image<uint16_t> image(320, 240);
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x) {
      const double r2 = (std::pow(x - 160.0, 2) + std::pow(y - 120.0, 2)) / (160.0 * 160.0 + 120.0 * 120.0);
      const double signal = signal_dn * (1.0 - 0.15 * r2);
      const double value = level_dn + signal + (3.0 + 0.5 * std::sqrt(signal)) * noise(random);
      image(x, y) = static_cast<uint16_t>(std::clamp(value, 0.0, 4095.0));
    }
  return image;
}

std::vector<CaptureFault> Faults(SessionKind kind, double level_dn, double signal_dn) {
  LightWatchOptions options;
  options.kind = kind;
  options.projectors = 1;
  LightWatch watch(options);
  FrameRecord record;
  record.projector = 0;
  record.pattern.kind = PatternKind::kBlack;
  watch.OnFrame(record, Picture(level_dn, kind == SessionKind::kDark ? signal_dn : 0.0));
  record.pattern.kind = PatternKind::kWhite;
  if (kind != SessionKind::kDark) watch.OnFrame(record, Picture(level_dn, signal_dn));
  return watch.Faults();
}

TEST(LightWatch, AcceptsADarkWhateverItsBlackLevel) {
  EXPECT_THAT(Faults(SessionKind::kDark, 64.0, 0.0), IsEmpty());
  EXPECT_THAT(Faults(SessionKind::kDark, 300.0, 0.0), IsEmpty());
}

TEST(LightWatch, SeesLightInADark) {
  const auto faults = Faults(SessionKind::kDark, 64.0, 400.0);
  ASSERT_THAT(faults, SizeIs(1));
  EXPECT_THAT(faults[0].what, HasSubstr("not dark"));
  EXPECT_THAT(Faults(SessionKind::kDark, 64.0, 2000.0), SizeIs(1));
}

TEST(LightWatch, AcceptsAWellLitFlat) { EXPECT_THAT(Faults(SessionKind::kFlat, 64.0, 2800.0), IsEmpty()); }

TEST(LightWatch, SaysWhichExposureASaturatedFlatWants) {
  const auto faults = Faults(SessionKind::kFlat, 64.0, 4200.0);
  ASSERT_THAT(faults, SizeIs(1));
  EXPECT_THAT(faults[0].what, HasSubstr("saturated"));
  EXPECT_THAT(faults[0].remedy, HasSubstr("--exposure 9.6"));
}

TEST(LightWatch, SaysWhichExposureADimFlatWants) {
  const auto faults = Faults(SessionKind::kResponse, 64.0, 400.0);
  ASSERT_THAT(faults, SizeIs(1));
  EXPECT_THAT(faults[0].what, HasSubstr("reaches only"));
  // 16 ms x 0.75 x 4031 / (400 and a little noise): about 115 ms.
  EXPECT_THAT(faults[0].remedy, HasSubstr("--exposure 11"));
}

TEST(LightWatch, SaysThatNothingIsLit) {
  const auto faults = Faults(SessionKind::kFlat, 64.0, 0.0);
  ASSERT_THAT(faults, SizeIs(1));
  EXPECT_THAT(faults[0].what, HasSubstr("lights nothing"));
}

}  // namespace
}  // namespace stratalux::rig
