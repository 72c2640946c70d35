// SPDX-License-Identifier: Apache-2.0
#include "tests/integration/tiny_session.h"

#include <algorithm>
#include <cstdlib>
#include <sstream>

#include <gmock/gmock.h>
#include <unistd.h>

#include "tests/integration/smallest_plan.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// Made by the first case, removed when the program ends.
struct Original {
  fs::path folder = fs::temp_directory_path() / ("stratalux_tiny_" + std::to_string(getpid()));
  ~Original() {
    std::error_code ignored;
    fs::remove_all(folder, ignored);
  }
};
const Original& TheOriginal() {
  static const Original original;
  return original;
}

// With stderr apart.
Outcome ShellIn(const fs::path& folder, const std::string& command) {
  const fs::path err = folder / "stderr";
  Outcome outcome = Shell("{ " + command + "; } 2>" + err.string());
  outcome.err = ReadText(err);
  fs::remove(err);
  return outcome;
}

// stderr without progress ("capture:  10 % (0.1 s)"), remarks and CLI11's pointer to --help.
std::vector<std::string> Complaints(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) {
    const bool progress = line.find(" % (") != std::string::npos;
    if (!progress && !line.empty() && !line.starts_with("info: ") && !line.starts_with("Run with --help"))
      lines.push_back(line);
  }
  return lines;
}

}  // namespace

const std::string kTinyConfig = "[camera]\nwidth = 96\nheight = 72\n" + kSmallestPlan;

std::map<std::string, std::string> Contents(const fs::path& folder) {
  std::map<std::string, std::string> contents;
  if (!fs::exists(folder)) return contents;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    const std::string name = fs::relative(entry.path(), folder).string();
    if (!entry.is_regular_file() || name.ends_with("-wal") || name.ends_with("-shm") ||
        name.find(".partial/") != std::string::npos)
      continue;
    contents[name] = ReadText(entry.path());
  }
  return contents;
}

void TinyStore::SetUpTestSuite() {
  const fs::path folder = TheOriginal().folder;
  if (fs::exists(folder)) return;
  fs::create_directories(folder);
  WriteText(folder / "rig.toml", kTinyConfig);
  const std::string capture = std::string(STRATALUX_BIN_DIR) + "/stratalux-rig capture --simulate --seed 3 --config " +
                              (folder / "rig.toml").string() + " --store " + (folder / "store").string();
  ASSERT_EQ(ShellIn(folder, "exec " + capture).code, 0);
  ASSERT_EQ(ShellIn(folder, "exec " + capture + " --kind calibration").code, 0);
}

void TinyStore::SetUp() {
  folder_ = TheOriginal().folder / ::testing::UnitTest::GetInstance()->current_test_info()->name();
  store_ = folder_ / "store";
  fs::create_directories(folder_);
  fs::copy(TheOriginal().folder / "store", store_, fs::copy_options::recursive);
}

void TinyStore::TearDown() { fs::remove_all(folder_); }

Outcome TinyStore::Run(const std::string& program_and_arguments, const std::string& before) const {
  return ShellIn(folder_, before + " export STRATALUX_STORE=" + store_.string() + "; exec " + STRATALUX_BIN_DIR + "/" +
                              program_and_arguments);
}

void TinyStore::ExpectRefused(const std::string& program_and_arguments, int code,
                              const std::vector<std::string>& parts) const {
  SCOPED_TRACE(program_and_arguments);
  const auto before = Contents(store_);
  const Outcome outcome = Run(program_and_arguments);
  EXPECT_EQ(outcome.signal, 0) << outcome.err;
  EXPECT_EQ(outcome.code, code) << outcome.err;
  EXPECT_EQ(outcome.out, "");
  const auto complaints = Complaints(outcome.err);
  EXPECT_EQ(complaints.size(), 1U) << outcome.err;
  for (const std::string& part : parts) EXPECT_THAT(complaints.empty() ? "" : complaints[0], HasSubstr(part));
  EXPECT_TRUE(Contents(store_) == before) << "the store was changed";
  if (std::getenv("STRATALUX_SHOW_MESSAGES") != nullptr)
    std::printf("%d  %s\n    %s", outcome.code, program_and_arguments.c_str(), outcome.err.c_str());
}

void TinyStore::ExpectUnharmed() const {
  const Outcome list = Run("stratalux-db ls"), verify = Run("stratalux-db verify");
  EXPECT_EQ(list.code, 0) << list.err;
  for (const char* session : {"s000001-", "s000002-"}) EXPECT_THAT(list.out, HasSubstr(session));
  EXPECT_EQ(verify.code, 0) << verify.out << verify.err;
}

fs::path TinyStore::Session(const std::string& prefix) const {
  for (const auto& entry : fs::directory_iterator(store_ / "sessions"))
    if (entry.path().filename().string().starts_with(prefix)) return entry.path();
  ADD_FAILURE() << "no session " << prefix;
  return {};
}

std::string TinyStore::File(const std::string& name, const std::string& text) const {
  WriteText(folder_ / name, text);
  return (folder_ / name).string();
}

}  // namespace stratalux
