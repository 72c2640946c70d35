// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/store_watch.h"

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>

#include <gmock/gmock.h>

#include "tests/firmware-host/session/small_station.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class StoreWatchTest : public ScratchFolderTest {
 protected:
  StoreWatchTest() : station_(SmallStation(folder_)) {
    rules_.space_bytes = 1;
    rules_.calibration_days = 30;
  }
  // What was logged since the last call.
  std::string Said() {
    logger_.Flush();
    std::string said(4096, ' ');
    std::fseek(file_.get(), read_, SEEK_SET);
    said.resize(std::fread(said.data(), 1, said.size(), file_.get()));
    read_ += static_cast<long>(said.size());
    return said;
  }

  StationOptions station_;
  VisitRules rules_;
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_{std::tmpfile(), std::fclose};
  long read_ = 0;
  Logger logger_{LogLevel::kWarning, file_.get()};
};

TEST_F(StoreWatchTest, AStoreWhoseDiskWentHasNoRoomAndIsNamed) {
  const std::filesystem::path store = station_.config.store.folder;
  StoreWatch watch(station_, rules_, logger_);
  EXPECT_GT(watch.Space().bytes, 0) << "one that is yet to be made has its disk's";
  std::filesystem::create_directory(store);
  EXPECT_GT(watch.Space().bytes, 0);
  EXPECT_THAT(Said(), IsEmpty());
  std::filesystem::rename(store, folder_ / "elsewhere");
  EXPECT_EQ(watch.Space().bytes, 0) << "not what the disk around it has";
  EXPECT_THAT(Said(), AllOf(HasSubstr(store.string()), HasSubstr("is gone")));
  EXPECT_EQ(watch.Space().bytes, 0);
  EXPECT_THAT(Said(), IsEmpty()) << "once";
  std::filesystem::rename(folder_ / "elsewhere", store);
  EXPECT_GT(watch.Space().bytes, 0);
}

// The folder is where the disk was mounted: it is there still, and has the room of the disk beneath.
TEST_F(StoreWatchTest, AMountPointWithoutItsDiskIsNoStore) {
  const std::filesystem::path store = station_.config.store.folder;
  std::filesystem::create_directory(store);
  std::ofstream(store / "index.sqlite") << "rows";
  StoreWatch watch(station_, rules_, logger_);
  EXPECT_GT(watch.Space().bytes, 0);
  std::filesystem::rename(store, folder_ / "elsewhere");
  std::filesystem::create_directory(store);
  EXPECT_EQ(watch.Space().bytes, 0);
  EXPECT_THAT(Said(), AllOf(HasSubstr(store.string()), HasSubstr("is gone")));
}

TEST_F(StoreWatchTest, ADiskThatCannotBeAskedIsNotEndless) {
  station_.config.store.folder = folder_ / std::string(300, 'x');  // as a mount that is dead: an error, no answer
  StoreWatch watch(station_, rules_, logger_);
  EXPECT_EQ(watch.Space().bytes, 0);
  EXPECT_THAT(Said(), HasSubstr("cannot find out how much space is free: File name too long"));
}

TEST_F(StoreWatchTest, WhyACalibrationIsNotGoodIsSaidOnceAtEachChange) {
  StoreWatch watch(station_, rules_, logger_);
  const Result<db::CalibrationVersion> none = Status::NotFound("no calibration of it: capture board poses");
  EXPECT_EQ(watch.Judge(none, {0}), (event::Calibration{false, 0}));
  EXPECT_THAT(Said(), HasSubstr("closed: no calibration of it: capture board poses"));
  EXPECT_EQ(watch.Judge(none, {0}), (event::Calibration{false, 0}));
  EXPECT_THAT(Said(), IsEmpty());
  constexpr int64_t kDay = 86'400'000'000'000;
  db::CalibrationVersion version;
  version.id = "c0ffee";
  EXPECT_EQ(watch.Judge(version, {30 * kDay}), (event::Calibration{true, 30}));
  EXPECT_THAT(Said(), IsEmpty());
  EXPECT_EQ(watch.Judge(version, {31 * kDay}), (event::Calibration{true, 31}));
  EXPECT_THAT(Said(), HasSubstr("calibration c0ffee is 31 days old, kiosk.calibration_days = 30; capture board poses"));
  EXPECT_EQ(watch.Judge(version, {31 * kDay + 1}), (event::Calibration{true, 31}));
  EXPECT_THAT(Said(), IsEmpty());
}

TEST_F(StoreWatchTest, AnIndexThatIsBeingWrittenChangesNothing) {
  StoreWatch watch(station_, rules_, logger_);
  EXPECT_FALSE(watch.Judge(Status::Busy("another program is writing"), {0}).there) << "nobody has said yet";
  EXPECT_TRUE(watch.Judge(db::CalibrationVersion(), {0}).there);
  EXPECT_TRUE(watch.Judge(Status::Busy("another program is writing"), {0}).there);
  EXPECT_THAT(Said(), IsEmpty());
}

TEST_F(StoreWatchTest, ARigWithoutTheCalibrationItIsToHaveIsClosed) {
  station_.config.calibration = "latest";
  StoreWatch watch(station_, rules_, logger_);
  EXPECT_FALSE(watch.Calibration().there);
  EXPECT_THAT(Said(), HasSubstr("closed: "));
  station_.config.calibration = "exact";
  EXPECT_TRUE(watch.Calibration().there);
}

}  // namespace
}  // namespace stratalux::rig
