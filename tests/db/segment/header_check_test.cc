// SPDX-License-Identifier: Apache-2.0
// Right hashes do not make a header right.
#include "db/segment/header_check.h"

#include <cmath>
#include <cstring>
#include <functional>
#include <limits>

#include <gmock/gmock.h>

#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

FrameHeader Whole() {
  FrameHeader h = MakeFrameHeader(RecordFor(3, PixelFormat::kMono12, 6, 4), 3, "gray rows bit=3/10 inverse");
  h.codec = static_cast<uint16_t>(Codec::kRaw12);
  h.payload_bytes = 36;
  return h;
}

struct Case {
  const char* name;
  std::function<void(FrameHeader&)> change;
};

TEST(CheckHeader, TakesWhatWritersWrite) {
  EXPECT_TRUE(CheckHeader(Whole()).ok()) << CheckHeader(Whole()).message();
  FrameHeader h = Whole();
  h.projector = h.pose = -1;
  h.trigger_number = h.driver_sequence = -1;
  EXPECT_TRUE(CheckHeader(h).ok()) << "imports know no trigger";
}

TEST(CheckHeader, ValuesOfTheNextVersionAreSaidToBeNewer) {
  const Case cases[] = {{"phase", [](FrameHeader& h) { h.phase = 10; }},
                        {"format", [](FrameHeader& h) { h.format = 5; }},
                        {"colour filter array", [](FrameHeader& h) { h.cfa = 5; }},
                        {"codec", [](FrameHeader& h) { h.codec = 6; }},
                        {"cipher", [](FrameHeader& h) { h.cipher = 2; }},
                        {"clock", [](FrameHeader& h) { h.frame_clock = 3; }},
                        {"level check", [](FrameHeader& h) { h.level_check = 3; }},
                        {"header", [](FrameHeader& h) { h.header_bytes = 384; }}};
  for (const Case& c : cases) {
    FrameHeader h = Whole();
    c.change(h);
    const Status status = CheckHeader(h);
    EXPECT_EQ(status.code(), StatusCode::kNewerSchema) << c.name;
    EXPECT_THAT(status.message(), HasSubstr("frame 3"));
    EXPECT_THAT(status.message(), HasSubstr(c.name));
    EXPECT_EQ(RecordOf(h).status().code(), StatusCode::kNewerSchema);
  }
}

TEST(CheckHeader, WhatNoVersionWritesIsDamage) {
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  const Case cases[] = {
      {"exposure NaN", [nan](FrameHeader& h) { h.exposure_ms = nan; }},
      {"exposure infinite", [infinity](FrameHeader& h) { h.exposure_ms = infinity; }},
      {"exposure negative", [](FrameHeader& h) { h.exposure_ms = -1.0; }},
      {"gain NaN", [nan](FrameHeader& h) { h.gain = nan; }},
      {"mean NaN", [nan](FrameHeader& h) { h.mean_dn = -nan; }},
      {"no format", [](FrameHeader& h) { h.format = 0; }},
      {"no codec", [](FrameHeader& h) { h.codec = 0; }},
      {"frame", [](FrameHeader& h) { h.frame = -1; }},
      {"frame beyond all", [](FrameHeader& h) { h.frame = std::numeric_limits<int64_t>::max(); }},
      {"step", [](FrameHeader& h) { h.step = -1; }},
      {"projector", [](FrameHeader& h) { h.projector = -2; }},
      {"bracket", [](FrameHeader& h) { h.bracket = -1; }},
      {"pose", [](FrameHeader& h) { h.pose = -2; }},
      {"retry", [](FrameHeader& h) { h.retry = -1; }},
      {"crop", [](FrameHeader& h) { h.crop_x = -1; }},
      {"width", [](FrameHeader& h) { h.width = 0; }},
      {"negative width", [](FrameHeader& h) { h.width = -6; }},
      {"huge width", [](FrameHeader& h) { h.width = std::numeric_limits<int32_t>::max(); }},
      {"channels", [](FrameHeader& h) { h.channels = 0; }},
      {"payload too short", [](FrameHeader& h) { h.payload_bytes = 35; }},
      {"payload too long", [](FrameHeader& h) { h.payload_bytes = 37; }},
      {"payload without end", [](FrameHeader& h) { h.payload_bytes = ~uint64_t{0} - 319; }},
      {"delta not shorter", [](FrameHeader& h) { h.codec = static_cast<uint16_t>(Codec::kDelta); }},
      {"another raw codec", [](FrameHeader& h) { h.codec = static_cast<uint16_t>(Codec::kRaw16); }},
      {"a map among frames", [](FrameHeader& h) { h.format = static_cast<uint16_t>(PixelFormat::kF32); }},
      {"pattern without end", [](FrameHeader& h) { std::memset(h.pattern, 'x', sizeof h.pattern); }},
      {"bytes behind the pattern", [](FrameHeader& h) { h.pattern[60] = 'x'; }},
      {"no pattern", [](FrameHeader& h) { std::memcpy(h.pattern, "hologram", 9); }},
      {"cause without end", [](FrameHeader& h) { std::memset(h.retake_cause, 'x', sizeof h.retake_cause); }},
      {"key without cipher", [](FrameHeader& h) { h.key_id[7] = 1; }}};
  for (const Case& c : cases) {
    FrameHeader h = Whole();
    c.change(h);
    EXPECT_EQ(CheckHeader(h).code(), StatusCode::kIntegrity) << c.name;
  }
}

TEST(CheckHeader, TruthMapsAreFloatsUnderAnyName) {
  FrameHeader h = Whole();
  h.format = static_cast<uint16_t>(PixelFormat::kF32);
  h.codec = static_cast<uint16_t>(Codec::kF32);
  h.payload_bytes = 6 * 4 * 4;
  std::memset(h.pattern, 0, sizeof h.pattern);
  std::memcpy(h.pattern, "depth", 6);
  EXPECT_TRUE(CheckHeader(h, RecordKind::kTruthMap).ok()) << CheckHeader(h, RecordKind::kTruthMap).message();
  EXPECT_EQ(CheckHeader(h).code(), StatusCode::kIntegrity);
  EXPECT_EQ(CheckHeader(Whole(), RecordKind::kTruthMap).code(), StatusCode::kIntegrity);
}

}  // namespace
}  // namespace stratalux::db
