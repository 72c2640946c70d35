// SPDX-License-Identifier: Apache-2.0
// What is said of a head whose motion is not known, and kept of it.
#include <gmock/gmock.h>

#include "fitter/stages/motion.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class MotionStage : public ScratchFolderTest {};

TEST_F(MotionStage, SaysWhetherWhitesWereLackingOrTooDark) {
  FaceMotion none, dark, unasked;
  none.later_whites = 0;
  dark.later_whites = 12;
  EXPECT_THAT(Describe(none), HasSubstr("takes two white frames"));
  EXPECT_THAT(Describe(dark), HasSubstr("12 white frames"));
  EXPECT_THAT(Describe(dark), HasSubstr("quads"));
  EXPECT_THAT(Describe(dark), Not(HasSubstr("takes two white frames")));
  EXPECT_THAT(Describe(unasked), HasSubstr("not looked for"));
}

TEST_F(MotionStage, AnOlderFileDoesNotSayWhichAndIsRead) {
  FaceMotion motion;
  motion.projectors.push_back({1.0, 2.0, 3.0});
  motion.later_whites = 3;
  ASSERT_TRUE(SaveMotion(folder_, motion).ok());
  auto loaded = LoadMotion(folder_);
  ASSERT_TRUE(loaded.ok()) << loaded.status().message();
  EXPECT_EQ(loaded->later_whites, 3);
  std::string text = ReadText(folder_ / "motion.json");
  text.replace(text.find("later_whites"), 12, "what_follows");
  WriteText(folder_ / "motion.json", text);
  loaded = LoadMotion(folder_);
  ASSERT_TRUE(loaded.ok()) << loaded.status().message();
  EXPECT_FALSE(loaded->later_whites);
  EXPECT_THAT(Describe(*loaded), HasSubstr("no two white frames of one projector show enough"));
}

}  // namespace
}  // namespace stratalux::fit
