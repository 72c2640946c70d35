// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig preview` as an operator runs it.
#include <filesystem>

#include <gmock/gmock.h>

#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"

namespace stratalux {
namespace {

using ::testing::HasSubstr;

class PreviewCommand : public ScratchFolderTest {
 protected:
  [[nodiscard]] Outcome Line(const std::string& text) const {
    return Shell("cd " + folder_.string() + "; export STATE_DIRECTORY=/nonexistent; unset STRATALUX_STORE; rig='" +
                 STRATALUX_BIN_DIR + "/stratalux-rig'; " + text);
  }
};

TEST_F(PreviewCommand, SaysWhereItIsAndCtrlCEndsIt) {
  // A job of a shell without job control ignores SIGINT; env gives it back.
  const Outcome ended = Line(
      "env --default-signal=INT $rig preview --simulate=plane --no-scattering --size 348x260 > out 2> err & "
      "until grep -q page out; do kill -0 $! || break; sleep 0.1; done; sleep 1; kill -INT $!; wait $!; echo code $?; "
      "cat out err");
  EXPECT_THAT(ended.out, HasSubstr("code 0"));
  EXPECT_THAT(ended.out, HasSubstr("{\"page\":\"http://127.0.0.1:"));
  for (const auto& entry : std::filesystem::directory_iterator(folder_))
    EXPECT_THAT(entry.path().filename().string(), ::testing::AnyOf("out", "err")) << "it stores nothing";
}

TEST_F(PreviewCommand, RefusesWhatItCannotShow) {
  const Outcome none = Line(
      "printf '[camera]\\nwidth = 348\\nheight = 260\\n' > none.toml; "
      "$rig preview --config none.toml 2>&1");
  EXPECT_EQ(none.code, 2);
  EXPECT_THAT(none.out, HasSubstr("[[projector]]"));
  EXPECT_EQ(Line("$rig preview --simulate --port 65536 2>&1").code, 2);
  EXPECT_EQ(Line("$rig preview --seed 3 2>&1").code, 2) << "no simulation";
  EXPECT_EQ(Line("$rig preview --simulate --exposure auto 2>&1").code, 2);
  EXPECT_THAT(Line("$rig preview --help").out, HasSubstr("stratalux-rig preview --config rig.toml"));
}

}  // namespace
}  // namespace stratalux
