// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/store_disk.h"

#include <cstdlib>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class StoreDiskTest : public ScratchFolderTest {
 public:
  [[nodiscard]] auto Entries() const { return std::distance(fs::directory_iterator(folder_), {}); }
};

TEST_F(StoreDiskTest, IsMeasuredWithoutATraceAndBesideWhatIsLeftOver) {
  std::ofstream(folder_ / "selftest.tmp") << "of a selftest that was killed";
  for (int i = 0; i < 2; ++i) {
    const Result<double> speed = MeasureDisk(folder_, 4096);
    ASSERT_TRUE(speed.ok()) << speed.status().message();
    EXPECT_GT(*speed, 0.0);
  }
  EXPECT_EQ(Entries(), 1);
  EXPECT_THAT(MeasureDisk(folder_ / "nowhere", 4096).status().message(), HasSubstr((folder_ / "nowhere").string()));
}

TEST_F(StoreDiskTest, IsThatOfTheNearestFolderThatIsThere) {
  EXPECT_EQ(ExistingFolder(folder_ / "a" / "b"), folder_);
  EXPECT_EQ(ExistingFolder(folder_), folder_);
}

TEST_F(StoreDiskTest, HasRoomOrSaysBothNumbers) {
  EXPECT_TRUE(CheckFreeSpace(folder_ / "store", 1).ok());
  const Status full = CheckFreeSpace(folder_ / "store", int64_t{1} << 60);
  EXPECT_EQ(full.code(), StatusCode::kFailed);
  EXPECT_THAT(full.message(), HasSubstr((folder_ / "store").string() + " has "));
  EXPECT_THAT(full.message(), HasSubstr("GB free, the session may take 1152921504.61 GB: make room"));
}

TEST(SessionBytes, AreThoseOfPackedFrames) {
  const int64_t beside = SessionBytes(0, 696, 520);
  EXPECT_EQ(SessionBytes(500, 696, 520) - beside, 500LL * 1044 * 520);
  EXPECT_EQ(SessionBytes(1, 3, 2) - beside, 10) << "an odd last pixel takes two bytes";
}

}  // namespace
}  // namespace stratalux::rig
