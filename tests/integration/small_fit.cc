// SPDX-License-Identifier: Apache-2.0
#include "tests/integration/small_fit.h"

#include <algorithm>
#include <cstdlib>
#include <ctime>
#include <sstream>
#include <thread>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/file.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "shared/base/unique_fd.h"
#include "tests/integration/smallest_plan.h"
#include "tests/support/text_file.h"

extern char** environ;

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using std::chrono::milliseconds;
using std::chrono::steady_clock;

// A mono camera sees a quad with each of its pixels: a surface as fine as that of a mosaic twice as wide.
constexpr const char* kScene = "name = \"face\"\n[subject]\nshape = \"head\"\n[camera]\ncfa = \"mono\"\n";
const std::string kConfig = "[camera]\nwidth = 64\nheight = 48\n" + kSmallestPlan;

constexpr const char* kCountFile = "count";           // file calls of the undisturbed run
constexpr const char* kDurationFile = "duration_ms";  // of the undisturbed run; written last

// Made by the first case, removed when the program ends.
struct Original {
  fs::path folder = fs::temp_directory_path() / ("stratalux_small_fit_" + std::to_string(getpid()));
  ~Original() {
    std::error_code ignored;
    fs::remove_all(folder, ignored);
  }
};
const Original& TheOriginal() {
  static const Original original;
  return original;
}

std::string Program(const std::string& name) { return std::string(STRATALUX_BIN_DIR) + "/" + name; }

void ForgetTimes(Json& metrics) {
  for (Json& stage : metrics["stages"]) stage = stage["name"];
}

// Rows of the table keep the stage's name.
std::string WithoutTimes(std::string html) {
  const size_t table = html.find("Where the time goes"), body = html.find("<tbody>", table);
  if (table == std::string::npos || body == std::string::npos) return html;
  const size_t end = html.find("</tbody>", body);
  std::string rows;
  for (size_t row = html.find("<tr><td>", body); row < end; row = html.find("<tr><td>", row + 1))
    rows += html.substr(row, html.find("</td>", row) - row) + "\n";
  return html.replace(body, end - body, rows);
}

std::string Comparable(const std::string& name, const std::string& text) {
  const std::string file = fs::path(name).filename().string();
  if (file == "index.html") return WithoutTimes(text);
  if (file != "artifact.json" && file != "metrics.json" && file != "fit.json") return text;
  Json json = Json::parse(text);
  if (file == "metrics.json") ForgetTimes(json);
  for (const char* time : {"seconds", "cpu_seconds", "peak_rss_bytes", "finished_wall_ns", "created_wall_ns", "hash"})
    json.erase(time);
  if (file == "fit.json") {
    Json metrics = Json::parse(json["metrics_json"].get<std::string>());
    ForgetTimes(metrics);
    json["metrics_json"] = metrics;
    for (Json& entry : json["files"])
      if (entry["name"] == "metrics.json" || entry["name"] == "report/index.html") entry = entry["name"];
  }
  return json.dump();
}

}  // namespace

int Kills() {
  const char* text = std::getenv("STRATALUX_RUN_KILLS");
  return text == nullptr ? 10 : std::max(10, std::atoi(text));
}

uint64_t Seed() {
  const char* text = std::getenv("STRATALUX_SEED");
  return text == nullptr ? 1 : std::strtoull(text, nullptr, 10);
}

std::string InHours(int hours) {
  const std::time_t then = std::time(nullptr) + int64_t{3600} * hours;
  std::tm local{};
  localtime_r(&then, &local);
  char text[8];
  std::strftime(text, sizeof text, "%H:%M", &local);
  return text;
}

std::vector<std::string> DiesAt(const fs::path& store, int64_t call) {
  return {std::string("LD_PRELOAD=") + STRATALUX_FAULT_LAYER, "ASAN_OPTIONS=verify_asan_link_order=0",
          "STORE_FAULT=death " + std::to_string(call) + " once " + store.string()};
}

Running::Running(const std::vector<std::string>& words, const fs::path& log,
                 const std::vector<std::string>& environment)
    : log_(log) {
  std::vector<std::string> args = words, variables = environment;
  args[0] = Program(args[0]);
  for (char** v = environ; *v != nullptr; ++v) variables.emplace_back(*v);
  std::vector<char*> argv, envp;
  for (std::string& word : args) argv.push_back(word.data());
  for (std::string& variable : variables) envp.push_back(variable.data());
  argv.push_back(nullptr);
  envp.push_back(nullptr);
  const int out = open(log.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
  pid_ = vfork();  // cases run several from threads: between here and exec nothing but system calls
  if (pid_ == 0) {
    dup2(out, 1);
    dup2(out, 2);
    execve(argv[0], argv.data(), envp.data());
    _exit(127);
  }
  close(out);
}

void Running::Send(int signal) const { kill(pid_, signal); }

bool Running::WaitFor(milliseconds patience) {
  const auto until = steady_clock::now() + patience;
  while (!ended_) {
    struct rusage usage {};
    if (wait4(pid_, &status_, WNOHANG, &usage) == pid_) {
      ended_ = true;
      for (const timeval& part : {usage.ru_utime, usage.ru_stime})
        processor_time_ += std::chrono::seconds(part.tv_sec) + std::chrono::microseconds(part.tv_usec);
    } else if (steady_clock::now() >= until) {
      return false;
    } else {
      std::this_thread::sleep_for(milliseconds(1));
    }
  }
  return true;
}

std::chrono::nanoseconds Running::ProcessorTime() const {
  if (ended_) return processor_time_;
  clockid_t clock{};
  timespec time{};
  EXPECT_EQ(clock_getcpuclockid(pid_, &clock), 0);
  EXPECT_EQ(clock_gettime(clock, &time), 0);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

Outcome Running::Wait() {
  while (!WaitFor(std::chrono::minutes(5))) Send(SIGKILL);  // a run that hangs
  Outcome outcome;
  if (WIFEXITED(status_)) outcome.code = WEXITSTATUS(status_);
  if (WIFSIGNALED(status_)) outcome.signal = WTERMSIG(status_);
  outcome.out = ReadText(log_);
  return outcome;
}

std::vector<std::string> SmallFit::RunArguments(const fs::path& store) {
  std::vector<std::string> words = {"stratalux-fit", "run", "latest", "--store", store.string()};
  std::istringstream options(kSmallFitOptions);
  for (std::string word; options >> word;) words.push_back(word);
  return words;
}

Outcome SmallFit::Fit(const fs::path& store, const std::string& verb_and_options) {
  return Execute("stratalux-fit " + verb_and_options + " --store " + store.string(), Show::kAll);
}

Outcome SmallFit::Db(const fs::path& store, const std::string& arguments) {
  return Execute("stratalux-db " + arguments + " --store " + store.string(), Show::kAll);
}

fs::path SmallFit::Session(const fs::path& store) {
  for (const auto& entry : fs::directory_iterator(store / "sessions")) return entry.path();
  ADD_FAILURE() << "no session in " << store;
  return {};
}

State SmallFit::StateOf(const fs::path& store) {
  State state;
  const fs::path session = Session(store);
  for (const char* part : {"fits", "artifacts"}) {
    if (!fs::exists(session / part)) continue;
    for (const auto& entry : fs::recursive_directory_iterator(session / part)) {
      const std::string name = fs::relative(entry.path(), session).string();
      state[name] = entry.is_regular_file() ? Comparable(name, ReadText(entry.path())) : "";
    }
  }
  return state;
}

std::vector<std::string> SmallFit::Leftovers(const fs::path& store, bool locks) {
  std::vector<std::string> names;
  std::error_code error;
  for (const char* part : {"fits", "artifacts"})
    for (const auto& entry : fs::directory_iterator(Session(store) / part, error)) {
      const std::string name = entry.path().filename().string();
      if (name.starts_with(".making-") || name.ends_with(".partial") || (locks && name.starts_with(".")))
        names.push_back(name);
    }
  return names;
}

void SmallFit::ExpectAsUndisturbed(const fs::path& store, const std::string& where) {
  EXPECT_EQ(Leftovers(store, true), std::vector<std::string>()) << where;
  const State state = StateOf(store);
  std::vector<std::string> differing;
  for (const auto& [name, text] : undisturbed_)
    if (const auto found = state.find(name); found == state.end())
      differing.push_back(name + " is missing");
    else if (found->second != text)
      differing.push_back(name + " is another");
  for (const auto& [name, text] : state)
    if (!undisturbed_.contains(name)) differing.push_back(name + " is new");
  const size_t all = differing.size();
  differing.resize(std::min<size_t>(all, 5));
  EXPECT_THAT(differing, ::testing::IsEmpty()) << where << ": " << all << " in all";
  const Outcome verify = Db(store, "verify --deep");
  EXPECT_EQ(verify.code, 0) << where << ": " << verify.out;
  EXPECT_EQ(verify.out.find("note"), std::string::npos) << where << ": " << verify.out;
}

void SmallFit::ExpectNothingHalf(const fs::path& store, const std::string& where) {
  const Outcome verify = Db(store, "verify --deep");
  EXPECT_EQ(verify.code, 0) << where << ": " << verify.out;
  const Outcome list = Execute("stratalux-db ls --json --store " + store.string(), Show::kStdout),
                show = Execute("stratalux-db show latest --json --store " + store.string(), Show::kStdout);
  EXPECT_EQ(list.code, 0) << where;
  EXPECT_EQ(show.code, 0) << where;
  const Json row = Json::parse(list.out, nullptr, false);
  ASSERT_TRUE(row.is_array() && row.size() == 1) << where << ": " << list.out;
  if (row[0]["fits"] == 0) return;
  const fs::path fit = Session(store) / "fits" / row[0]["newest_fit"].get<std::string>();
  EXPECT_TRUE(fs::exists(fit / "fit.json")) << where << ": a fit is listed without what proves it";
  EXPECT_TRUE(fs::exists(fit / "report" / "index.html")) << where;
}

fs::path SmallFit::Originals() { return TheOriginal().folder; }

fs::path SmallFit::CopyOfOriginal(const std::string& original, const fs::path& folder) {
  fs::create_directories(folder);
  fs::path store = folder / "store";
  EXPECT_EQ(
      Shell("cp -a " + (TheOriginal().folder / original / "store").string() + " " + folder.string() + " 2>&1").out, "");
  return store;
}

Outcome SmallFit::CaptureAs(const fs::path& folder, const fs::path& store, const std::string& options) {
  return Execute("stratalux-rig capture --simulate=" + (folder / "scene.toml").string() + " --seed 3 --config " +
                 (folder / "rig.toml").string() + " --store " + store.string() + " " + options);
}

Outcome SmallFit::Capture(const fs::path& store, const std::string& options) {
  return CaptureAs(Originals(), store, options);
}

void SmallFit::Make(const fs::path& folder) {
  fs::create_directories(folder / "captured");
  WriteText(folder / "rig.toml", kConfig);
  WriteText(folder / "scene.toml", kScene);
  const Outcome capture = CaptureAs(folder, folder / "captured" / "store", "");
  ASSERT_EQ(capture.code, 0) << capture.out;
  ASSERT_EQ(Shell("cp -a " + (folder / "captured").string() + " " + (folder / "fitted").string() + " 2>&1").out, "");
  const fs::path fitted = folder / "fitted" / "store", count = folder / kCountFile;
  auto environment = DiesAt(fitted, kNever);
  environment.push_back("STORE_FAULT_COUNT=" + count.string());
  const auto begin = steady_clock::now();
  Running run(RunArguments(fitted), folder / "log", environment);
  const Outcome outcome = run.Wait();
  ASSERT_EQ(outcome.code, 0) << outcome.out;
  const auto took = std::chrono::duration_cast<milliseconds>(steady_clock::now() - begin);
  WriteText(folder / kDurationFile, std::to_string(took.count()));
}

void SmallFit::MakeOrCopy(const fs::path& shared, const fs::path& folder) {
  fs::create_directories(shared.parent_path());
  const UniqueFd lock(open((shared.string() + ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
  ASSERT_GE(lock.get(), 0) << shared;
  ASSERT_EQ(flock(lock.get(), LOCK_EX), 0) << shared;
  // Made beside and renamed: a program may be killed before it is whole, and what it ran may go on writing for a while.
  if (!fs::exists(shared)) {
    const fs::path making = shared.string() + ".making-" + std::to_string(getpid());
    Make(making);
    if (HasFatalFailure()) return;
    fs::rename(making, shared);
  }
  ASSERT_EQ(Shell("cp -a " + shared.string() + " " + folder.string() + " 2>&1").out, "");
}

void SmallFit::SetUpTestSuite() {
  const fs::path folder = TheOriginal().folder;
  if (fs::exists(folder)) return;
  if (const char* shared = std::getenv("STRATALUX_SHARED_CAPTURES"); shared != nullptr)
    MakeOrCopy(fs::path(shared) / "small_fit", folder);
  else
    Make(folder);
  if (HasFatalFailure()) return;
  duration_ = milliseconds(std::atoll(ReadText(folder / kDurationFile).c_str()));
  calls_ = std::atoll(ReadText(folder / kCountFile).c_str());
  undisturbed_ = StateOf(folder / "fitted" / "store");
}

void SmallFit::SetUp() {
  folder_ = TheOriginal().folder / ::testing::UnitTest::GetInstance()->current_test_info()->name();
  fs::create_directories(folder_);
}

void SmallFit::TearDown() { fs::remove_all(folder_); }

fs::path SmallFit::Captured(const std::string& name) const { return CopyOfOriginal("captured", folder_ / name); }
fs::path SmallFit::Fitted(const std::string& name) const { return CopyOfOriginal("fitted", folder_ / name); }

}  // namespace stratalux
