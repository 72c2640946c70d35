// SPDX-License-Identifier: Apache-2.0
#include "shared/http/event_stream.h"

#include <array>

#include <gtest/gtest.h>

namespace stratalux::http {
namespace {

using State = EventStream::Taken::State;

// All that a viewer can take now, and how it went on.
struct Seen {
  std::string text;
  State state = State::kBytes;
};
Seen TakeAll(EventStream& stream, int64_t viewer) {
  Seen seen;
  std::array<char, 64> buffer{};
  while (true) {
    const auto taken = stream.Take(viewer, buffer, [] {});
    seen.state = taken.state;
    if (taken.state != State::kBytes) return seen;
    seen.text.append(buffer.data(), taken.bytes);
  }
}
bool Has(const Seen& seen, const std::string& text) { return seen.text.find(text) != std::string::npos; }

TEST(EventStream, GivesEverybodyEveryEventAndNewOnesTheLast) {
  EventStream stream;
  const int64_t early = stream.Add("", [] {});
  stream.Publish("state", "one\ntwo");
  stream.Publish("state", "three");
  const int64_t late = stream.Add("", [] {});
  EXPECT_EQ(TakeAll(stream, early).text,
            "retry: 2000\n\nid: 1\nevent: state\ndata: one\ndata: two\n\nid: 2\nevent: state\ndata: three\n\n");
  EXPECT_EQ(TakeAll(stream, late).text, "retry: 2000\n\nid: 2\nevent: state\ndata: three\n\n");
}

TEST(EventStream, ReplaysWhatCameAfterTheLastOneSeenAndTheLastAlways) {
  EventStream stream;
  for (int i = 1; i <= 5; ++i) stream.Publish("n", std::to_string(i * 11));
  const Seen back = TakeAll(stream, stream.Add("3", [] {}));
  EXPECT_FALSE(Has(back, "data: 33"));
  EXPECT_TRUE(Has(back, "data: 44"));
  EXPECT_TRUE(Has(back, "data: 55"));
  // The last one seen, which may be another run's; numbers of another run, and no numbers: as somebody new.
  for (const char* id : {"5", "99", "-1", "x", "99999999999999999999"}) {
    const Seen fresh = TakeAll(stream, stream.Add(id, [] {}));
    EXPECT_TRUE(Has(fresh, "data: 55")) << id;
    EXPECT_FALSE(Has(fresh, "data: 44")) << id;
  }
}

TEST(EventStream, WakesOnceWhoWaits) {
  EventStream stream;
  int woken = 0;
  const int64_t viewer = stream.Add("", [&woken] { ++woken; });
  EXPECT_EQ(TakeAll(stream, viewer).state, State::kWait);
  stream.Publish("a", "1");
  stream.Publish("a", "2");
  EXPECT_EQ(woken, 1);
  EXPECT_TRUE(Has(TakeAll(stream, viewer), "data: 2"));
  stream.KeepAlive();
  EXPECT_EQ(woken, 2);
  EXPECT_EQ(TakeAll(stream, viewer).text, ": keep-alive\n\n");
  stream.Remove(viewer);
  stream.Publish("a", "3");
  EXPECT_EQ(woken, 2);
}

TEST(EventStream, DropsWhoIsTooSlowAndKeepsTheOthers) {
  EventStream stream({.kept_bytes = 1000, .viewer_bytes = 500});
  const int64_t slow = stream.Add("", [] {}), quick = stream.Add("", [] {});
  for (int i = 0; i < 50; ++i) {
    stream.Publish("a", std::string(50, 'x'));
    EXPECT_EQ(TakeAll(stream, quick).state, State::kWait);
  }
  const Seen seen = TakeAll(stream, slow);
  EXPECT_EQ(seen.state, State::kEnd);
  EXPECT_EQ(stream.viewers(), 2U);
}

TEST(EventStream, KeepsTheLastEventHoweverLarge) {
  EventStream stream({.kept_bytes = 100, .viewer_bytes = 100});
  stream.Publish("a", std::string(1000, 'x'));
  EXPECT_TRUE(Has(TakeAll(stream, stream.Add("", [] {})), std::string(1000, 'x')));
}

TEST(EventStream, NoDataBeginsAnotherField) {
  EventStream stream;
  stream.Publish("na\nme", "a\rid: 9\nevent: b");
  EXPECT_EQ(TakeAll(stream, stream.Add("", [] {})).text,
            "retry: 2000\n\nid: 1\nevent: na me\ndata: a id: 9\ndata: event: b\n\n");
}

TEST(EventStream, EndsForEverybodyWhenClosed) {
  EventStream stream;
  int woken = 0;
  const int64_t viewer = stream.Add("", [&woken] { ++woken; });
  EXPECT_EQ(TakeAll(stream, viewer).state, State::kWait);
  stream.Close();
  EXPECT_EQ(woken, 1);
  EXPECT_EQ(TakeAll(stream, viewer).state, State::kEnd);
  EXPECT_EQ(TakeAll(stream, stream.Add("", [] {})).state, State::kEnd);
}

}  // namespace
}  // namespace stratalux::http
