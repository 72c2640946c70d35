// SPDX-License-Identifier: Apache-2.0
// The pages for operators do not lie: every stratalux-db and sqlite3 command in their fences runs as it is written.
//
// What a page cannot know is replaced, and this is the convention for whoever writes one:
//   s000017, s000012                       the newest session of the test's store, and the oldest
//   v-5f3a91c2, p-0417                     visitors of that store
//   store                                  the store, beside the folder the commands run in (STRATALUX_STORE too)
//   /media/...                             a folder of the test
//   kiosk@rig-1:/var/lib/stratalux/store         another store, on this machine
//   archive, copy-of-the-store, workstation   stores without sessions: what was pulled, what is all signed, what
//   imports 192.168.7.2, --port 8080               an address of this machine, a port that is free a command that
//   serves                  is stopped with SIGTERM once it has printed its link a command with "# exit N" behind it
//   ends with that code; 0 otherwise
// Commands run in the order of the page, in a folder of their own.
#include <fstream>
#include <regex>
#include <sstream>

#include <gmock/gmock.h>

#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;

struct Command {
  std::string page, text;
  int line = 0, exit_code = 0;
};

// Lines of fenced blocks that begin with the program, or with what a program of theirs needs, with or without "$ "; a
// comment behind goes.
std::vector<Command> CommandsOf(const std::string& page) {
  std::ifstream file(std::string(STRATALUX_SOURCE_DIR) + "/docs/" + page);
  EXPECT_TRUE(file.good()) << page;
  std::vector<Command> commands;
  bool fenced = false;
  int number = 0;
  const std::regex exit_code(R"(# exit (\d+))");
  for (std::string line; std::getline(file, line);) {
    ++number;
    if (line.starts_with("```")) fenced = !fenced;
    if (line.starts_with("$ ")) line = line.substr(2);
    const bool runs = line.starts_with("stratalux-db ") || line.starts_with("sqlite3 ") || line.starts_with("(umask ");
    if (!fenced || !runs) continue;
    Command command{page, line, number, 0};
    std::smatch code;
    if (std::regex_search(line, code, exit_code)) command.exit_code = std::stoi(code[1]);
    command.text = line.substr(0, line.find(" #"));
    commands.push_back(command);
  }
  return commands;
}

class Guide : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    place_ = folder_ / "place";
    std::filesystem::create_directories(place_ / "media");
    for (const char* name : {"store", "rig"}) {
      ASSERT_TRUE(SessionStore::Create(place_ / name).ok());
      for (const char* visitor : {"p-0417", "v-5f3a91c2"}) Store(place_ / name, visitor);
    }
    for (const char* name : {"archive", "copy-of-the-store", "workstation"})
      ASSERT_TRUE(SessionStore::Create(place_ / name).ok());
  }
  void Store(const std::filesystem::path& folder, const std::string& visitor) {
    ASSERT_EQ(Execute("stratalux-db consent give --store " + folder.string() + " --visitor " + visitor +
                      " --text-version 3 --language de --scope fit,research")
                  .code,
              0);
    SessionStore store = *SessionStore::Open(folder, AccessMode::kReadWrite);
    SessionInfo info = SimulatedVisit();
    info.rig = "kiosk";
    info.visitor = visitor;
    info.started_wall = WallNow();
    auto writer = store.BeginSession(info, {});
    ASSERT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 6; ++i) ASSERT_TRUE(AppendTo(*writer, i).ok());
    ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    if (folder.filename() != "store") return;
    newest_ = writer->info().id;
    if (oldest_.empty()) oldest_ = newest_;
  }
  [[nodiscard]] Outcome Run(std::string text) const {
    const auto replace = [&text](const std::string& what, const std::string& with) {
      for (size_t at = 0; (at = text.find(what, at)) != std::string::npos; at += with.size())
        text.replace(at, what.size(), with);
    };
    replace("s000017", newest_);
    replace("s000012", oldest_);
    replace("192.168.7.2", "0.0.0.0");
    replace("--port 8080", "--port 0");
    replace("kiosk@rig-1:/var/lib/stratalux/store", (place_ / "rig").string());
    replace("/media/", (place_ / "media").string() + "/");
    if (text.starts_with("stratalux-db serve "))
      text = "rm -f served; " + text +  // an earlier one's would say that this one is ready
             " > served 2>&1 & pid=$!; for i in $(seq 600); do grep -q http:// served && break;"
             " kill -0 $pid || break; sleep 0.1; done; kill $pid; wait $pid; code=$?; cat served; exit $code";
    return Shell("exec 2>&1; cd " + place_.string() + " && export STRATALUX_STORE=store PATH=" + STRATALUX_BIN_DIR +
                 ":$PATH; " + text);
  }

  std::filesystem::path place_;
  std::string newest_, oldest_;
};

TEST_F(Guide, EveryCommandOfThePagesRunsAsItIsWritten) {
  for (const char* page : {"operators-guide.md", "store-queries.md"}) {
    const auto commands = CommandsOf(page);
    ASSERT_GE(commands.size(), 3U) << page << ": the test reads nothing";
    for (const Command& command : commands) {
      const Outcome outcome = Run(command.text);
      EXPECT_EQ(outcome.code, command.exit_code)
          << "docs/" << page << ":" << command.line << ": " << command.text << "\n"
          << outcome.out;
    }
  }
}

// What follows "Examples:" in the help of every command.
std::vector<std::string> ExamplesIn(const std::string& help) {
  std::vector<std::string> examples;
  const size_t start = help.find("Examples:\n");
  if (start == std::string::npos) return examples;
  std::istringstream lines(help.substr(start));
  std::string line;
  std::getline(lines, line);
  while (std::getline(lines, line) && line.starts_with("  ")) examples.push_back(line.substr(2));
  return examples;
}

std::vector<std::string> Subcommands() {
  std::istringstream lines(Execute("stratalux-db --help").out);
  std::vector<std::string> names;
  bool listed = false;
  for (std::string line; std::getline(lines, line);) {
    if (line == "Subcommands:") listed = true;
    if (listed && line.empty()) break;
    std::istringstream words(line);
    std::string name;
    if (listed && line.starts_with("  ") && line[2] != ' ' && words >> name) names.push_back(name);
  }
  return names;
}

TEST_F(Guide, TheExamplesOfACommandAreItsOwn) {
  const auto names = Subcommands();
  ASSERT_GE(names.size(), 19U);
  for (const std::string& name : names) {
    const auto examples = ExamplesIn(Execute("stratalux-db " + name + " --help").out);
    EXPECT_THAT(examples, ::testing::Not(::testing::IsEmpty())) << name << " --help shows no example";
    for (const std::string& example : examples)
      EXPECT_THAT(example + " ", HasSubstr("stratalux-db " + name + " ")) << "in the help of " << name;
  }
}

// Examples that need nothing but a store run; the others need files that only their reader has.
TEST_F(Guide, TheExamplesOfTheHelpRun) {
  const std::regex needs_more(
      "forget|import|key |restore|pull|transcode|config|export|backup|--merge|xdg-open|serve|transfer");
  int run = 0;
  for (const std::string& name : Subcommands())
    for (const std::string& example : ExamplesIn(Execute("stratalux-db " + name + " --help").out)) {
      if (std::regex_search(example, needs_more)) continue;
      const Outcome outcome = Run(example);
      EXPECT_EQ(outcome.code, 0) << example << "\n" << outcome.out;
      ++run;
    }
  EXPECT_GE(run, 20);
}

TEST_F(Guide, AMistypedNameIsAnsweredWithTheOneThatWasMeant) {
  for (const auto& [typed, meant] : std::vector<std::pair<std::string, std::string>>{
           {"shwo latest", "'show'"}, {"verfy", "'verify'"}, {"consent giv", "'give'"}, {"exprot", "'export'"}}) {
    const Outcome outcome = Run("stratalux-db " + typed);
    EXPECT_EQ(outcome.code, 2) << typed;
    EXPECT_THAT(outcome.out, HasSubstr("did you mean " + meant)) << typed;
  }
  EXPECT_THAT(Run("stratalux-db query last-nite").out, HasSubstr("did you mean 'last-night'?"));
  EXPECT_EQ(Run("stratalux-db query last-nite").code, 4);
  EXPECT_THAT(Run("stratalux-db frobnicate").out, HasSubstr("there are: init, "));
}

}  // namespace
}  // namespace stratalux::db
