// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/recording/recorder.h"

#include <atomic>
#include <future>

#include <gtest/gtest.h>

namespace stratalux::rig {
namespace {

using std::chrono::milliseconds;

class GatedArchive : public FrameArchive {
 public:
  Status Append(const FrameRecord& record, const Image<uint16_t>&) override {
    gate.get_future().wait();
    gate = std::promise<void>();
    gate.set_value();
    if (record.step >= fail_from) return Status::Failed("write frames-0001.seg: No space left on device");
    steps.push_back(record.step);
    return Status::Ok();
  }
  Status Flush() override {
    ++flushes;
    return Status::Ok();
  }
  Status FlushIfDue() override {
    ++asked;
    return Status::Ok();
  }
  std::promise<void> gate;
  std::vector<int> steps;
  int fail_from = 1 << 30;
  std::atomic<int> flushes = 0, asked = 0;
};

const StopToken stop;  // of nobody

FrameRecord Step(int step) {
  FrameRecord record;
  record.step = step;
  return record;
}

TEST(Recorder, KeepsEveryFrameInOrder) {
  GatedArchive archive;
  archive.gate.set_value();
  Recorder recorder(archive, 3, stop);
  for (int i = 0; i < 50; ++i) ASSERT_TRUE(recorder.Put(Step(i), Image<uint16_t>(2, 2)).ok());
  ASSERT_TRUE(recorder.Close().ok());
  ASSERT_EQ(archive.steps.size(), 50U);
  for (int i = 0; i < 50; ++i) EXPECT_EQ(archive.steps[i], i);
  EXPECT_GE(archive.flushes, 1);
}

// On the writer's thread it would end the program, kiosk and all.
TEST(Recorder, AnExceptionOfTheArchiveIsAnError) {
  class Throwing final : public FrameArchive {
   public:
    Status Append(const FrameRecord&, const Image<uint16_t>&) override { throw std::bad_alloc(); }
    Status Flush() override { return Status::Ok(); }
    Status FlushIfDue() override { return Status::Ok(); }
  } archive;
  Recorder recorder(archive, 1, stop);
  Status put;
  for (int i = 0; i < 100 && put.ok(); ++i) put = recorder.Put(Step(i), Image<uint16_t>(2, 2));
  EXPECT_EQ(put.code(), StatusCode::kFailed);
  EXPECT_NE(recorder.Close().message().find("bad_alloc"), std::string::npos);
}

TEST(Recorder, BlocksTheProducerInsteadOfDropping) {
  GatedArchive archive;
  Recorder recorder(archive, 2, stop);
  std::atomic<int> put = 0;
  auto producer = std::async(std::launch::async, [&] {
    for (int i = 0; i < 10; ++i, ++put) EXPECT_TRUE(recorder.Put(Step(i), Image<uint16_t>(2, 2)).ok());
  });
  // One frame is with the stalled writer, two are queued, the fourth must wait.
  EXPECT_EQ(producer.wait_for(milliseconds(150)), std::future_status::timeout);
  EXPECT_LE(put, 3);
  archive.gate.set_value();
  producer.get();
  EXPECT_TRUE(recorder.Close().ok());
  EXPECT_EQ(archive.steps.size(), 10U);
}

TEST(Recorder, AStopReachesABlockedProducerAndLosesNoQueuedFrame) {
  GatedArchive archive;
  StopToken stopped;
  Recorder recorder(archive, 1, stopped);
  std::atomic<int> put = 0;
  auto producer = std::async(std::launch::async, [&] {
    Status status;
    for (int i = 0; status.ok(); ++i) {
      status = recorder.Put(Step(i), Image<uint16_t>(2, 2));
      put += static_cast<int>(status.ok());
    }
    return status;
  });
  EXPECT_EQ(producer.wait_for(milliseconds(100)), std::future_status::timeout) << "the disk stands still";
  stopped.Request(StopReason::kVisitorLeft);
  EXPECT_EQ(producer.get().message(), "the visitor left");
  archive.gate.set_value();
  EXPECT_TRUE(recorder.Close().ok());
  EXPECT_EQ(static_cast<int>(archive.steps.size()), put);
}

TEST(Recorder, TheArchivesErrorReachesABlockedProducer) {
  GatedArchive archive;
  archive.fail_from = 0;
  Recorder recorder(archive, 1, stop);
  auto producer = std::async(std::launch::async, [&] {
    Status status;
    while (status.ok()) status = recorder.Put(Step(0), Image<uint16_t>(2, 2));
    return status;
  });
  archive.gate.set_value();
  EXPECT_NE(producer.get().message().find("No space left"), std::string::npos);
  EXPECT_NE(recorder.Close().message().find("No space left"), std::string::npos);
  EXPECT_EQ(archive.flushes, 0);
}

TEST(Recorder, FramesAreSafeWhenNoMoreCome) {
  GatedArchive archive;
  archive.gate.set_value();
  Recorder recorder(archive, 1, stop);
  ASSERT_TRUE(recorder.Put(Step(0), Image<uint16_t>(2, 2)).ok());
  // The archive is asked again and again whether what it holds has waited long enough.
  const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (archive.asked < 3 && std::chrono::steady_clock::now() < limit) std::this_thread::sleep_for(milliseconds(5));
  EXPECT_GE(archive.asked, 3);
  EXPECT_TRUE(recorder.Close().ok());
}

TEST(Recorder, RefusesFramesAfterClose) {
  GatedArchive archive;
  archive.gate.set_value();
  Recorder recorder(archive, 1, stop);
  EXPECT_TRUE(recorder.Close().ok());
  EXPECT_FALSE(recorder.Put(Step(0), Image<uint16_t>(2, 2)).ok());
}

TEST(BoundedQueue, HoldsNoMoreThanItsCapacity) {
  BoundedQueue<int> queue(2);
  int item = 1;
  EXPECT_TRUE(queue.PushFor(milliseconds(0), item));
  item = 2;
  EXPECT_TRUE(queue.PushFor(milliseconds(0), item));
  item = 3;
  EXPECT_FALSE(queue.PushFor(milliseconds(0), item));
  EXPECT_EQ(item, 3) << "what did not go in is the caller's still";
  auto third = std::async(std::launch::async, [&] { return queue.PushFor(std::chrono::minutes(1), item); });
  EXPECT_EQ(third.wait_for(milliseconds(50)), std::future_status::timeout);
  EXPECT_EQ(queue.size(), 2U);
  EXPECT_EQ(*queue.Pop(), 1);
  EXPECT_TRUE(third.get());
  queue.Close();
  EXPECT_EQ(*queue.Pop(), 2);
  EXPECT_EQ(*queue.Pop(), 3);
  EXPECT_FALSE(queue.Pop().has_value());
}

}  // namespace
}  // namespace stratalux::rig
