// SPDX-License-Identifier: Apache-2.0
// What the programs' own tables do not have today; tests/manual holds what they have.
#include "shared/manual/manual.h"

#include <cstdlib>
#include <fstream>

#include <gmock/gmock.h>

#include "shared/manual/completion.h"
#include "shared/manual/man_page.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"

namespace stratalux {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

class Manual : public ScratchFolderTest {
 protected:
  Manual() {
    app_.footer("Examples:\n  program it's --out 'a b'\n\n.Dd is no request here.");
    CLI::App* command = app_.add_subcommand("it", "Quotes ' \" ` and $(touch /tmp/x), a\\b, [brackets]: all of it");
    command->add_option("--format", format_, ".Sh NAME\n'in' the middle")->check(CLI::IsMember({"png", "tiff"}));
    command->add_option("--scene", scene_, "a scene")->expected(0, 1);
    command->add_option("--hidden", hidden_, "not for --help")->group("");
    command->add_option("FILE", files_, "files");
    command->add_subcommand("below", "a command below it");
  }
  [[nodiscard]] CommandEntry Table() const { return CommandTable(app_, "program"); }

  CLI::App app_{"A program"};
  std::string format_ = "png", scene_, hidden_;
  std::vector<std::string> files_;
};

TEST_F(Manual, TheTableIsThatOfHelp) {
  const CommandEntry table = Table();
  ASSERT_EQ(table.commands.size(), 1U);
  const CommandEntry& command = table.commands[0];
  EXPECT_EQ(command.path, "it");
  EXPECT_EQ(command.commands[0].path, "it below");
  ASSERT_EQ(command.options.size(), 4U) << "FILE, -h, --format, --scene; not --hidden";
  EXPECT_TRUE(command.options[0].positional);
  EXPECT_TRUE(command.options[0].repeated);
  EXPECT_THAT(command.options[1].names, ElementsAre("-h", "--help"));
  EXPECT_EQ(command.options[1].value, "");
  EXPECT_THAT(command.options[2].choices, ElementsAre("png", "tiff"));
  EXPECT_FALSE(command.options[2].value_optional);
  EXPECT_TRUE(command.options[3].value_optional);
}

// Text of an option may hold anything: it ends no macro and begins no request.
TEST_F(Manual, TextIsNoRequestOfRoff) {
  const std::string page = ManPage(Table(), "1.0", "November 3, 2026");
  EXPECT_THAT(page, HasSubstr("\n\\&.Sh NAME"));
  EXPECT_THAT(page, HasSubstr("a\\eb"));
  EXPECT_THAT(page, HasSubstr("\n\\&.Dd is no request here.\n"));
  EXPECT_THAT(page, Not(HasSubstr("hidden")));
}

// Nor does it end a quote of a shell: what it says is never run.
TEST_F(Manual, TextIsNoCommandOfAShell) {
  const std::string file = (folder_ / "bash").string();
  std::ofstream(file) << BashCompletion(Table());
  const Outcome offered =
      Shell("bash -c 'source " + file +
            "; COMP_WORDS=(program it --format \"\"); COMP_CWORD=3; _program; echo ${COMPREPLY[@]}'");
  EXPECT_EQ(offered.out, "png tiff\n");
  EXPECT_THAT(ZshCompletion(Table()), HasSubstr("'it:Quotes '\\'' \" ` and $(touch /tmp/x)"));
  EXPECT_THAT(FishCompletion(Table()), HasSubstr("-d 'Quotes \\' \" ` and $(touch /tmp/x), a\\\\b"));
}

TEST_F(Manual, AsksForNothingElse) {
  setenv("SOURCE_DATE_EPOCH", "1793664000", 1);
  const char* asked[] = {"program", "manual", "man"};
  const auto page = AskedManual(app_, "program", 3, asked);
  ASSERT_TRUE(page.has_value());
  EXPECT_THAT(*page, HasSubstr(".Dd November 3, 2026\n"));
  const char* other[] = {"program", "manual", "html"};
  EXPECT_FALSE(AskedManual(app_, "program", 3, other).has_value());
  EXPECT_FALSE(AskedManual(app_, "program", 2, asked).has_value());
  EXPECT_THAT(*page, StartsWith(".\\\" Made by"));
}

}  // namespace
}  // namespace stratalux
