// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig kiosk` as an operator runs it: commands in, lines of JSON out.
#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"

namespace stratalux {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class KioskCommand : public ScratchFolderTest {
 protected:
  KioskCommand() {
    std::ofstream(folder_ / "rig.toml") << "[plan]\nprojector_width = 128\nprojector_height = 96\ncomb_period = 32\n"
                                           "spot_pitch = 32\nspot_radius = 2\n[camera]\nwidth = 88\nheight = 66\n"
                                           "[kiosk]\nmargin = 0.0\ncountdown_s = 1\n";
  }
  // A line of shell in the scratch folder; $rig and $db are the programs.
  [[nodiscard]] Outcome Line(const std::string& text) const {
    return Shell("cd " + folder_.string() + "; export STATE_DIRECTORY=/nonexistent; unset STRATALUX_STORE; rig='" +
                 STRATALUX_BIN_DIR + "/stratalux-rig'; db='" + STRATALUX_BIN_DIR + "/stratalux-db'; " + text);
  }
  const std::string kiosk_ = "$rig kiosk --config rig.toml --simulate=plane --no-scattering --store store";
};

TEST_F(KioskCommand, ServesAVisitAndForgetKnowsItsTicket) {
  const Outcome visit = Line(
      "(printf 'start\\nnot-sensitive\\nagree fit,research de\\n'; until grep -q ticket out; do sleep 0.1; done; "
      "echo stop) | " +
      kiosk_ + " > out 2> err; echo code $?; cat out err");
  EXPECT_THAT(visit.out, HasSubstr("code 0"));
  EXPECT_THAT(visit.out, HasSubstr("{\"screen\":\"thanks\",\"word\":\"none\"}"));
  EXPECT_THAT(visit.out, HasSubstr("\"captures\":1,\"tickets\":1,\"discarded\":0"));
  const Outcome kept = Line("$db ls --store store --json; $db consent show --store store");
  EXPECT_THAT(kept.out, HasSubstr("\"status\": \"complete\""));
  EXPECT_THAT(kept.out, HasSubstr("fit,research"));
  const Outcome forgotten =
      Line("code=$(sed -n 's/.*\"ticket\":\"\\(.*\\)\".*/\\1/p' out); $db forget --ticket $code --yes --store store");
  EXPECT_EQ(forgotten.code, 0) << forgotten.out;
  EXPECT_THAT(forgotten.out, HasSubstr("its key, the visitor and its consents"));
  EXPECT_THAT(Line("$db ls --store store").out, Not(HasSubstr("complete")));
}

TEST_F(KioskCommand, WhoRefusesLeavesNoStore) {
  const Outcome refused = Line("printf 'start\\nnot-sensitive\\nrefuse\\nnonsense\\nstop\\n' | " + kiosk_ + " 2>&1");
  EXPECT_EQ(refused.code, 0) << refused.out;
  EXPECT_THAT(refused.out, HasSubstr("\"left_nothing\":{\"refused\":1}"));
  EXPECT_THAT(refused.out, HasSubstr("'nonsense' is not a command"));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store"));
}

TEST_F(KioskCommand, EndsInOrderAtSigterm) {
  const Outcome ended = Line(kiosk_ +
                             " < /dev/null > out 2>&1 & until grep -q idle out; do sleep 0.1; done; kill -TERM $!; "
                             "wait $!; echo code $?; cat out");
  EXPECT_THAT(ended.out, HasSubstr("code 0"));
  EXPECT_THAT(ended.out, HasSubstr("{\"screen\":\"closed\",\"word\":\"shutdown\",\"closed_for\":[\"shutdown\"]}"));
  EXPECT_THAT(ended.out, HasSubstr("\"visits\":0"));
}

TEST_F(KioskCommand, RefusesWhatIsNoKiosk) {
  std::ofstream(folder_ / "dark.toml") << "[plan]\nkind = \"dark\"\n";
  EXPECT_EQ(Line("$rig kiosk --config dark.toml --simulate --store store 2>&1").code, 2);
  EXPECT_EQ(Line("$rig kiosk --config rig.toml --simulate 2>&1").code, 2) << "no store";
  EXPECT_EQ(Line("$rig kiosk --store store --seed 3 2>&1").code, 2) << "no simulation";
  std::ofstream(folder_ / "typo.toml") << "[kiosk]\nattemts = 2\n";
  const Outcome typo = Line("$rig kiosk --config typo.toml --simulate --store store 2>&1");
  EXPECT_EQ(typo.code, 2);
  EXPECT_THAT(typo.out, HasSubstr("typo.toml:2: unknown key 'kiosk.attemts'"));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store"));
}

}  // namespace
}  // namespace stratalux
