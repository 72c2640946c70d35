// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit run` killed, interrupted and started several times at once: what it had finished is not made again,
// nothing half is listed, and the end is that of the undisturbed run, bit for bit.
#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <optional>
#include <random>
#include <thread>

#include <nlohmann/json.hpp>
#include <sys/stat.h>

#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using std::chrono::milliseconds;

constexpr int kKillsOfAChain = 4;

// Artifacts that have their name: folder -> inode and record.
std::map<std::string, std::pair<ino_t, std::string>> FinishedIn(const fs::path& session) {
  std::map<std::string, std::pair<ino_t, std::string>> finished;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(session / "artifacts", error)) {
    struct stat info {};
    if (entry.path().filename().string().starts_with(".") || stat(entry.path().c_str(), &info) != 0) continue;
    finished[entry.path().filename().string()] = {info.st_ino, ReadText(entry.path() / "artifact.json")};
  }
  return finished;
}

// How many artifacts a run says that it has made.
int ArtifactsMade(const std::string& log) {
  int made = 0;
  for (size_t at = log.find(" of processor), peak "); at != std::string::npos;
       at = log.find(" of processor), peak ", at + 1))
    ++made;
  return made;
}

int Artifacts(const State& state) {
  return static_cast<int>(std::count_if(state.begin(), state.end(),
                                        [](const auto& file) { return file.first.ends_with("artifact.json"); }));
}

class RunKill : public SmallFit {
 protected:
  // All artifacts, and no fit: as if a run had been killed before it.
  [[nodiscard]] fs::path WithoutFit(const std::string& name) const {
    fs::path store = Fitted(name);
    fs::remove_all(Session(store) / "fits");
    EXPECT_EQ(Db(store, "reindex").code, 6) << "it says that the fit is gone";
    return store;
  }
  [[nodiscard]] fs::path CopyOf(const fs::path& store, const std::string& name) const {
    fs::create_directories(folder_ / name);
    EXPECT_EQ(Shell("cp -a " + store.string() + " " + (folder_ / name).string()).code, 0);
    return folder_ / name / "store";
  }
  // A run that `environment` kills, or the clock; false where it had ended before.
  bool KillOnce(const fs::path& store, const std::vector<std::string>& environment, std::optional<milliseconds> after,
                const std::string& where) const {
    const auto before = FinishedIn(Session(store));
    Running run(RunArguments(store), store.parent_path() / "log", environment);
    if (after && !run.WaitFor(*after)) run.Send(SIGKILL);
    const Outcome outcome = run.Wait();
    EXPECT_TRUE(outcome.signal == SIGKILL || outcome.code == 0) << where << ": " << outcome.out;
    ExpectKept(store, before, where);
    if (outcome.signal == SIGKILL) ExpectNothingHalf(store, where);
    return outcome.signal == SIGKILL;
  }
  static void ExpectKept(const fs::path& store, const std::map<std::string, std::pair<ino_t, std::string>>& before,
                         const std::string& where) {
    const auto after = FinishedIn(Session(store));
    for (const auto& [name, what] : before)
      EXPECT_TRUE(after.contains(name) && after.at(name) == what) << where << ": " << name << " was made again";
  }
  // The run that ends what is there.
  void Finish(const fs::path& store, const std::string& where) const {
    const auto before = FinishedIn(Session(store));
    Running run(RunArguments(store), store.parent_path() / "log", DiesAt(store, kNever));
    const Outcome outcome = run.Wait();
    EXPECT_EQ(outcome.code, 0) << where << ": " << outcome.out;
    EXPECT_EQ(ArtifactsMade(outcome.out), Artifacts(undisturbed_) - static_cast<int>(before.size())) << where;
    ExpectKept(store, before, where);
    ExpectAsUndisturbed(store, where);
  }
  // `count` pieces of work, on two threads where there is much of it.
  static void ForEach(int count, const std::function<void(int)>& work) {
    std::atomic<int> next = 0;
    const auto take = [&] {
      for (int i = next++; i < count; i = next++) work(i);
    };
    std::vector<std::thread> others;
    for (unsigned t = 1; t < std::min(2U, std::thread::hardware_concurrency()) && Kills() >= 100; ++t)
      others.emplace_back(take);
    take();
    for (std::thread& other : others) other.join();
  }
};

// Moments are drawn over the whole road, every other one by the clock, the others between two file calls. Each kill of
// a chain begins where the one before has ended.
TEST_F(RunKill, EndsAsTheUndisturbedRunAndMakesNothingTwice) {
  const int wanted = Kills() - Kills() / 4;
  std::atomic<int> kills = 0, chains = 0;
  // A chain whose run is done before its next moment ends early: others take its place.
  ForEach(2 * wanted, [&](int chain) {
    if (kills >= wanted) return;
    ++chains;
    std::mt19937_64 random(Seed() * 1'000'003 + static_cast<uint64_t>(chain));
    std::uniform_real_distribution<double> anywhere(0.0, 1.0);
    std::vector<double> moments(kKillsOfAChain);
    for (double& moment : moments) moment = anywhere(random);
    std::sort(moments.begin(), moments.end());
    const fs::path store = Captured("chain" + std::to_string(chain));
    double last = 0.0;
    std::string where = "seed " + std::to_string(Seed()) + ", chain " + std::to_string(chain) + ", killed at";
    for (const double moment : moments) {
      const bool by_call = random() % 2 == 0;
      where += (by_call ? " call " : " time ") + std::to_string(moment - last);
      const double share = moment - last;
      if (!KillOnce(
              store, DiesAt(store, by_call ? static_cast<int64_t>(share * static_cast<double>(calls_)) : kNever),
              by_call ? std::nullopt : std::optional(milliseconds(static_cast<int>(share * double(duration_.count())))),
              where))
        break;
      last = moment;
      ++kills;
    }
    Finish(store, where);
    fs::remove_all(store.parent_path());
  });
  std::printf("%d kills in %d runs (%lld ms and %lld file calls undisturbed)\n", kills.load(), chains.load(),
              static_cast<long long>(duration_.count()), static_cast<long long>(calls_));
  EXPECT_GE(kills, wanted);
}

// The first report is put in its place and entered, then the evaluated one in its place: killed between any two calls
// of that.
TEST_F(RunKill, WhileAFitTakesThePlaceOfAnEarlierOne) {
  const fs::path base = WithoutFit("base"), counted = CopyOf(base, "counted"), count = folder_ / "count";
  auto environment = DiesAt(counted, kNever);
  environment.push_back("STORE_FAULT_COUNT=" + count.string());
  Running whole(RunArguments(counted), folder_ / "log", environment);
  ASSERT_EQ(whole.Wait().code, 0);
  const int64_t calls = std::atoll(ReadText(count).c_str());
  const int kills = std::max(6, Kills() / 4);
  std::atomic<int> struck = 0;
  ForEach(kills, [&](int i) {
    std::mt19937_64 random(Seed() * 7'000'003 + static_cast<uint64_t>(i));
    const int64_t first = calls * i / kills, last = calls * (i + 1) / kills;  // one of each stretch
    const int64_t call = first + static_cast<int64_t>(random() % static_cast<uint64_t>(last - first));
    const std::string name = "late" + std::to_string(i), where = "killed at call " + std::to_string(call);
    const fs::path store = CopyOf(base, name);
    if (KillOnce(store, DiesAt(store, call), std::nullopt, where)) ++struck;
    Finish(store, where);
    fs::remove_all(folder_ / name);
  });
  std::printf("%d of %d kills struck in %lld calls\n", struck.load(), kills, static_cast<long long>(calls));
  EXPECT_GT(struck, kills / 2);
}

// Together, or one after the other: each artifact is made by one of them.
TEST_F(RunKill, SeveralRunsAtOnceShareTheirWork) {
  std::mt19937_64 random(Seed() * 11'000'003);
  const int trials = std::max(2, Kills() / 50);
  for (int trial = 0; trial < trials; ++trial) {
    const fs::path store = Captured("shared" + std::to_string(trial));
    std::string where = "trial " + std::to_string(trial) + ", started after";
    std::vector<Running> runs;
    for (int i = 0; i < 2 + trial % 2; ++i) {
      const int wait = trial < 2 || i == 0 ? 0 : static_cast<int>(random() % 900);
      where += " " + std::to_string(wait);
      std::this_thread::sleep_for(milliseconds(wait));
      runs.emplace_back(RunArguments(store), folder_ / ("log" + std::to_string(i)), DiesAt(store, kNever));
    }
    int made = 0;
    for (Running& run : runs) {
      const Outcome outcome = run.Wait();
      EXPECT_EQ(outcome.code, 0) << where << ": " << outcome.out;
      made += ArtifactsMade(outcome.out);
    }
    EXPECT_EQ(made, Artifacts(undisturbed_)) << where;
    ExpectAsUndisturbed(store, where);
  }
}

// All stages are there, the fit is not: they meet where it is put in its place.
TEST_F(RunKill, SeveralRunsAtOnceEnterOneFit) {
  const int trials = std::max(3, Kills() / 15);
  for (int trial = 0; trial < trials; ++trial) {
    const fs::path store = WithoutFit("entered" + std::to_string(trial));
    std::vector<Running> runs;
    for (int i = 0; i < 3; ++i)
      runs.emplace_back(RunArguments(store), folder_ / ("log" + std::to_string(i)), DiesAt(store, kNever));
    const std::string where = "trial " + std::to_string(trial);
    for (Running& run : runs) {
      const Outcome outcome = run.Wait();
      EXPECT_EQ(outcome.code, 0) << where << ": " << outcome.out;
      EXPECT_EQ(ArtifactsMade(outcome.out), 0) << where;
    }
    ExpectAsUndisturbed(store, where);
    fs::remove_all(store.parent_path());
  }
}

// Ctrl-C and its kin end the program as they always do, at once, and leave nothing half made.
TEST_F(RunKill, InterruptionsLeaveNothingHalfMade) {
  const int chains = std::max(1, Kills() / 40);
  std::atomic<int> signals = 0;
  ForEach(chains, [&](int chain) {
    std::mt19937_64 random(Seed() * 13'000'003 + static_cast<uint64_t>(chain));
    const fs::path store = Captured("chain" + std::to_string(chain));
    std::string where = "chain " + std::to_string(chain) + ":";
    for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGINT}) {
      Running run(RunArguments(store), store.parent_path() / "log");
      const int wait = 10 + static_cast<int>(random() % static_cast<uint64_t>(duration_.count() / 3));
      where += " " + std::to_string(wait);
      if (run.WaitFor(milliseconds(wait))) break;
      const auto before = run.ProcessorTime();
      run.Send(signal);
      const Outcome outcome = run.Wait();
      EXPECT_LT(run.ProcessorTime() - before, std::chrono::seconds(2)) << where;
      if (outcome.code == 0) break;
      EXPECT_EQ(outcome.signal, signal) << where << ": " << outcome.out;
      EXPECT_EQ(Leftovers(store, false), std::vector<std::string>()) << where;
      ExpectNothingHalf(store, where);
      ++signals;
    }
    Finish(store, where);
    fs::remove_all(store.parent_path());
  });
  std::printf("%d interruptions\n", signals.load());
}

// The same between two file calls, where an artifact gets its name.
TEST_F(RunKill, InterruptionsAtAnyFileCallLeaveNothingHalfMade) {
  const int count = std::max(6, Kills() / 5);
  const fs::path store = Captured("store");
  std::mt19937_64 random(Seed() * 17'000'003);
  int struck = 0;
  for (int i = 0; i < count; ++i) {
    const auto call = static_cast<int64_t>(random() % 400);
    const std::string where = "interruption " + std::to_string(i) + " at call " + std::to_string(call);
    auto environment = DiesAt(store, call);
    for (std::string& variable : environment)
      if (variable.starts_with("STORE_FAULT=death")) variable.replace(12, 5, "interruption");
    Running run(RunArguments(store), folder_ / "log", environment);
    const Outcome outcome = run.Wait();
    EXPECT_TRUE(outcome.signal == SIGINT || outcome.code == 0) << where << ": " << outcome.code << outcome.out;
    EXPECT_EQ(Leftovers(store, false), std::vector<std::string>()) << where;
    ExpectNothingHalf(store, where);
    if (outcome.code == 0) break;
    ++struck;
  }
  Finish(store, "after interruptions");
  std::printf("%d interruptions at file calls\n", struck);
}

}  // namespace
}  // namespace stratalux
