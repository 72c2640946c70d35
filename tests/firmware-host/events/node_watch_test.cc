// SPDX-License-Identifier: Apache-2.0
// Files stand for device nodes.
#include "firmware-host/events/node_watch.h"

#include <filesystem>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class NodeWatchTest : public ScratchFolderTest {
 protected:
  NodeWatchTest() { Plug(); }
  void Plug() const { std::ofstream(folder_ / "video0") << "x"; }
  void Unplug() const { std::filesystem::remove(folder_ / "video0"); }
  void Watch() {
    WatchedDevice camera;
    camera.prefix = "video";
    camera.is_there = [this] {
      ++asked_;
      return std::filesystem::exists(folder_ / "video0");
    };
    auto watch = NodeWatch::Start(folder_.string(), camera, events_);
    ASSERT_TRUE(watch.ok()) << watch.status().message();
    watch_ = std::move(watch).value();
  }
  // The next events; none within `patience_ms`.
  std::vector<std::string> Next(int patience_ms = 20000) {
    pollfd waiting{events_.fd(), POLLIN, 0};
    poll(&waiting, 1, patience_ms);
    std::vector<std::string> words;
    for (const RigEvent& event : events_.Take()) words.emplace_back(event.ToString());
    return words;
  }
  StopToken stop_;
  RigEvents events_{stop_};
  std::atomic<int> asked_ = 0;
  std::unique_ptr<NodeWatch> watch_;
};

TEST_F(NodeWatchTest, TellsThatTheCameraWentAndThatItCameBack) {
  Watch();
  for (int time = 0; time < 3; ++time) {
    Unplug();
    EXPECT_THAT(Next(), ElementsAre("camera unplugged"));
    EXPECT_EQ(stop_.reason(), StopReason::kCameraGone);
    stop_.Reset();
    Plug();
    EXPECT_THAT(Next(), ElementsAre("camera plugged in"));
  }
}

TEST_F(NodeWatchTest, OneThatIsAwayFromTheBeginningIsTold) {
  Unplug();
  Watch();
  EXPECT_THAT(Next(), ElementsAre("camera unplugged"));
}

TEST_F(NodeWatchTest, OtherNodesAreNotWorthALook) {
  Watch();
  while (asked_.load() == 0) std::this_thread::yield();
  const int before = asked_.load();
  for (int i = 0; i < 50; ++i) std::ofstream(folder_ / ("tty" + std::to_string(i))) << "x";
  EXPECT_THAT(Next(300), IsEmpty());
  EXPECT_EQ(asked_.load(), before);
  std::ofstream(folder_ / "video1") << "x";
  EXPECT_THAT(Next(300), IsEmpty()) << "another camera";
  EXPECT_GT(asked_.load(), before);
}

// More changes than the kernel keeps.
TEST_F(NodeWatchTest, AnOverflowOfTheKernelsQueueLosesNoCamera) {
  Watch();
  for (int i = 0; i < 20000; ++i) {
    std::filesystem::rename(folder_ / "video0", folder_ / "video9");
    std::filesystem::rename(folder_ / "video9", folder_ / "video0");
  }
  Unplug();
  std::vector<std::string> last;
  for (auto next = Next(); !next.empty(); next = Next(2500)) last = next;
  EXPECT_EQ(last.empty() ? "" : last.back(), "camera unplugged");
}

TEST_F(NodeWatchTest, GoesOnByAskingWhenTheFolderWasReplaced) {
  const auto nodes = folder_ / "nodes";
  std::filesystem::create_directory(nodes);
  std::ofstream(nodes / "video0") << "x";
  WatchedDevice camera;
  camera.prefix = "video";
  camera.is_there = [&] { return std::filesystem::exists(nodes / "video0"); };
  auto watch = NodeWatch::Start(nodes.string(), camera, events_);
  ASSERT_TRUE(watch.ok());
  std::filesystem::remove_all(nodes);
  EXPECT_THAT(Next(), ElementsAre("camera unplugged"));
  std::filesystem::create_directory(nodes);
  std::ofstream(nodes / "video0") << "x";
  EXPECT_THAT(Next(), ElementsAre("camera plugged in"));
  std::filesystem::remove(nodes / "video0");
  EXPECT_THAT(Next(), ElementsAre("camera unplugged"));
}

TEST_F(NodeWatchTest, AFolderThatCannotBeWatchedIsNamed) {
  const auto watch = NodeWatch::Start((folder_ / "none").string(), {}, events_);
  EXPECT_THAT(watch.status().message(), HasSubstr((folder_ / "none").string()));
}

}  // namespace
}  // namespace stratalux::rig
