// SPDX-License-Identifier: Apache-2.0
// A real display behind the kernel's mode setting; in the virtual machine it is vkms (tests/rig-vm/jobs/display.sh).
//   STRATALUX_TEST_DISPLAY  connector to show test pictures on, such as Virtual-1; unset: these tests are skipped
//   STRATALUX_TEST_CRC      debugfs folder of its CRTC (.../crtc-0/crc): what leaves the connector is compared, too
#include "firmware-host/projector/kms_display.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/ioctl.h>

#include "firmware-host/projector/display_line_bank.h"
#include "firmware-host/projector/display_picture.h"
#include "firmware-host/projector/kms_cards.h"

namespace stratalux::rig {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

constexpr int kWidth = 640;
constexpr int kHeight = 480;

class KmsDisplay : public ::testing::Test {
 protected:
  void SetUp() override {
    const char* connector = std::getenv("STRATALUX_TEST_DISPLAY");
    if (connector == nullptr) GTEST_SKIP() << "STRATALUX_TEST_DISPLAY names no connector";
    wiring_.connector = connector;
    wiring_.width = kWidth;
    wiring_.height = kHeight;
  }
  std::unique_ptr<Display> Open() {
    auto displays = OpenKmsDisplays({wiring_});
    EXPECT_TRUE(displays.ok()) << displays.status().message();
    if (!displays.ok()) return nullptr;
    (*displays)[0]->light().Set(true);
    return std::move((*displays)[0]);
  }
  // Shows the next pattern and returns when it went on.
  static MonotonicNs Show(Display& display) {
    EXPECT_TRUE(display.Flip().ok());
    const auto flipped = display.WaitFlip(milliseconds(500));
    EXPECT_TRUE(flipped.ok() && flipped->has_value());
    return flipped.ok() && *flipped ? **flipped : MonotonicNs{};
  }
  DisplayWiring wiring_;
};

TEST_F(KmsDisplay, FlipsTwoHundredTimesAtVerticalBlanks) {
  const auto display = Open();
  ASSERT_NE(display, nullptr);
  ASSERT_EQ(display->width(), kWidth);
  ASSERT_EQ(display->height(), kHeight);
  ASSERT_TRUE(display->Load({{.kind = PatternKind::kWhite}, {}}).ok());
  constexpr double kPeriod_ms = 1e3 / 60.0;
  const MonotonicNs first = Show(*display);
  MonotonicNs last = first;
  for (int k = 1; k < 200; ++k) {
    const MonotonicNs now = Show(*display);
    const double gap_ms = static_cast<double>((now - last).count()) * 1e-6;
    // Whole frames apart: the stamps are vertical blanks. A stalled machine may skip some, never flip between them.
    const double frames = gap_ms / kPeriod_ms;
    EXPECT_GE(std::round(frames), 1.0);
    // The emulated clock and the display's differ by up to a thousandth.
    EXPECT_NEAR(frames, std::round(frames), 0.1 + 0.001 * frames) << "flip " << k;
    EXPECT_LE(now, MonotonicNow());
    last = now;
  }
  EXPECT_GE(static_cast<double>((last - first).count()) * 1e-6, 199 * kPeriod_ms * 0.98) << "faster than the display";
  RecordProperty("skipped_vblanks", static_cast<int>(display->skipped_vblanks()));
  std::printf("200 flips in %.2f s, %lld vertical blanks skipped\n", static_cast<double>((last - first).count()) * 1e-9,
              static_cast<long long>(display->skipped_vblanks()));
}

TEST_F(KmsDisplay, SyncEdgesOfTheLineBankAreItsFlips) {
  const auto display = Open();
  ASSERT_NE(display, nullptr);
  ASSERT_TRUE(display->Load({{.kind = PatternKind::kWhite}, {}}).ok());
  DisplayLineBank bank(nullptr, {{.display = display.get(), .latency = milliseconds(20)}});
  for (int k = 0; k < 5; ++k) {
    const auto trigger = bank.TriggerProjector(0);
    ASSERT_TRUE(trigger.ok());
    const auto edge = bank.WaitSync(milliseconds(500));
    ASSERT_TRUE(edge.ok() && edge->has_value());
    EXPECT_EQ((*edge)->sequence, k);
    EXPECT_GE((*edge)->time - (*trigger).time, milliseconds(20));
    EXPECT_LE((*edge)->time, MonotonicNow());
  }
}

TEST_F(KmsDisplay, RefusesWhatItCannotShow) {
  const auto display = Open();
  ASSERT_NE(display, nullptr);
  EXPECT_THAT(display->Flip().message(), HasSubstr("before any pattern"));
  EXPECT_FALSE(display->Load({{.kind = PatternKind::kComb, .period = 0}}).ok());
  ASSERT_TRUE(display->Load({{}}).ok());
  ASSERT_TRUE(display->Flip().ok());
  EXPECT_THAT(display->Flip().message(), HasSubstr("has not happened"));
}

TEST_F(KmsDisplay, NamesWhatIsMissing) {
  wiring_.connector = "HDMI-A-9";
  EXPECT_THAT(OpenKmsDisplays({wiring_}).status().message(), HasSubstr("no connector HDMI-A-9"));
  SetUp();
  wiring_.width = 641;
  const auto no_mode = OpenKmsDisplays({wiring_});
  EXPECT_EQ(no_mode.status().code(), StatusCode::kUsage);
  EXPECT_THAT(no_mode.status().message(), HasSubstr("640x480"));
  SetUp();
  wiring_.device = "/dev/dri/card9";
  EXPECT_EQ(OpenKmsDisplays({wiring_}).status().code(), StatusCode::kNotFound);
}

TEST_F(KmsDisplay, IsForOneProgramAtATime) {
  const auto display = Open();
  ASSERT_NE(display, nullptr);
  EXPECT_EQ(OpenKmsDisplays({wiring_}).status().code(), StatusCode::kBusy);
}

TEST_F(KmsDisplay, IsNotKeptFromACaptureByWhoListsTheCards) {
  std::vector<KmsGuest> guests;
  for (const std::string& path : KmsPaths()) guests.push_back(OpenAsGuest(path));
  ASSERT_FALSE(guests.empty());
  for (const KmsGuest& guest : guests) EXPECT_TRUE(guest.fd.ok() && !guest.mastered);
  KmsCard card;
  ASSERT_EQ(DescribeKmsCard(KmsPaths().front(), card), 0);
  EXPECT_FALSE(card.mastered) << card.master;
  const auto display = Open();
  ASSERT_NE(display, nullptr) << "whoever lists still holds the screen";
}

TEST_F(KmsDisplay, IsListedWithWhoHoldsIt) {
  const auto display = Open();
  ASSERT_NE(display, nullptr);
  for (const std::string& path : KmsPaths()) {
    KmsCard card;
    ASSERT_EQ(DescribeKmsCard(path, card), 0);
    const auto named = [&](const KmsConnector& one) { return one.name == wiring_.connector; };
    const auto connector = std::find_if(card.connectors.begin(), card.connectors.end(), named);
    if (connector == card.connectors.end()) continue;
    EXPECT_TRUE(card.mastered);
    EXPECT_TRUE(connector->connected);
    EXPECT_EQ(CanShow(wiring_, {&card, 1}).code(), StatusCode::kBusy);
    // The list took nothing: the display still shows.
    ASSERT_TRUE(display->Load({{.kind = PatternKind::kWhite}}).ok());
    Show(*display);
    return;
  }
  FAIL() << "no card has " << wiring_.connector;
}

// As at a console switch or under a desktop that takes over: the mastership of our own descriptor goes.
void LoseTheScreen() {
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code error;
    const std::string target = std::filesystem::read_symlink(entry.path(), error).string();
    if (!error && target.starts_with("/dev/dri/card")) ioctl(std::stoi(entry.path().filename()), _IO('d', 0x1f));
  }
}

TEST_F(KmsDisplay, SaysThatTheScreenWasTakenAway) {
  const auto display = Open();
  ASSERT_NE(display, nullptr);
  ASSERT_TRUE(display->Load({{.kind = PatternKind::kWhite}}).ok());
  Show(*display);
  LoseTheScreen();
  EXPECT_THAT(display->Flip().message(), HasSubstr("another program took the screen"));
  const int refused = display->light().Set(false);
  EXPECT_TRUE(refused == EACCES || refused == EPERM) << refused;
}

// CRC-32 (reflected, polynomial 0xedb88320, no inversion at either end) of what vkms composes: per pixel opacity, red,
// green and blue, 16 bits each, 8-bit levels times 257.
uint32_t CrcOf(const Image<uint32_t>& pixels) {
  uint32_t crc = 0;
  const auto add = [&crc](uint8_t byte) {
    crc ^= byte;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1U) != 0 ? 0xedb88320U : 0U);
  };
  for (const uint32_t pixel : pixels.pixels()) {
    for (const int shift : {24, 16, 8, 0}) {
      const auto level = static_cast<uint8_t>(shift == 24 ? 0xff : pixel >> shift);
      add(level);
      add(level);
    }
  }
  return crc;
}

TEST_F(KmsDisplay, SendsThePatternAndNothingElse) {
  const char* folder = std::getenv("STRATALUX_TEST_CRC");
  if (folder == nullptr) GTEST_SKIP() << "STRATALUX_TEST_CRC names no folder";
  const auto display = Open();
  ASSERT_NE(display, nullptr);
  const std::vector<Pattern> sequence = {{.kind = PatternKind::kGray, .bit = 4, .bits = 10},
                                         {.kind = PatternKind::kSinusoid, .period = 32, .shift = 1, .shifts = 4},
                                         {.kind = PatternKind::kComb, .period = 64, .width = 2, .shift = 6}};
  ASSERT_TRUE(display->Load(sequence).ok());
  // CRC of the first whole frame from now on; the frame in progress may still show what was before.
  const auto crc_now = [&] {
    std::ofstream(std::string(folder) + "/control") << "auto";
    std::ifstream data(std::string(folder) + "/data");
    std::string frame, crc;
    for (int k = 0; k < 3; ++k) data >> frame >> crc;
    return static_cast<uint32_t>(std::stoul(crc, nullptr, 16));
  };
  const auto drawn = [](const Pattern& pattern) {
    Image<uint32_t> pixels(kWidth, kHeight);
    DrawPattern(pattern, 1.0, kWidth, pixels);
    return CrcOf(pixels);
  };
  for (const Pattern& pattern : {sequence[0], sequence[1], sequence[2], sequence[0]}) {
    Show(*display);
    EXPECT_EQ(crc_now(), drawn(pattern)) << pattern.ToString();
  }
  bool on = false;
  EXPECT_EQ(display->light().Read(on), 0);
  EXPECT_TRUE(on);
  ASSERT_EQ(display->light().Set(false), 0);
  EXPECT_EQ(crc_now(), drawn({})) << "not black";
  EXPECT_EQ(display->light().Read(on), 0);
  EXPECT_FALSE(on);
  Show(*display);
  EXPECT_EQ(crc_now(), drawn({})) << "a display that is off showed a pattern";
  display->light().Set(true);
  Show(*display);
  EXPECT_EQ(crc_now(), drawn(sequence[2])) << "the place in the sequence was lost";
}

}  // namespace
}  // namespace stratalux::rig
