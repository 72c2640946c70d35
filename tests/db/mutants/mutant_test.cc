// SPDX-License-Identifier: Apache-2.0
// Whatever happens to a store's bytes: no command aborts or hangs, no acknowledged frame is lost, nothing false is
// taken in silence.
//
// STRATALUX_MUTANTS: how many (500; a night run takes 20000 and more). STRATALUX_SEED: which; without it, one fixed and
// one of the day. STRATALUX_MUTANT: this one of the seed alone, and its store is kept.
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "shared/base/parallel.h"
#include "tests/db/mutants/judge.h"
#include "tests/db/mutants/mutators.h"
#include "tests/db/mutants/sample_stores.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kManyMutants = 5'000;   // then each file of each sample is changed
constexpr unsigned kSecondsAMutant = 60;  // one takes a fraction of a second

int64_t Number(const char* name, int64_t otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr ? std::strtoll(text, nullptr, 10) : otherwise;
}

// Ids and keys are random: sessions/*/frames-*.seg, ledger/*.jsonl, sessions/*/artifacts/shape-*/mesh.ply.
std::string KindOf(const std::string& file) {
  if (file.starts_with("ledger/") && file.ends_with(".jsonl")) return "ledger/*.jsonl";
  const size_t slash = file.starts_with("sessions/") ? file.find('/', 9) : std::string::npos;
  const std::string kind = slash == std::string::npos ? file : "sessions/*" + file.substr(slash);
  if (const size_t key = kind.find("/artifacts/"); key != std::string::npos)
    return kind.substr(0, kind.find('-', key)) + "-*" + kind.substr(kind.find('/', key + 11));
  const size_t number = kind.find("frames-");
  return number == std::string::npos ? kind : kind.substr(0, number) + "frames-*.seg";
}

struct Tally {
  std::map<std::string, int64_t> verdicts;
  std::map<std::pair<std::string, std::string>, int64_t> files;  // sample, kind of file -> mutants
  int64_t wrong = 0;
};

class Mutants : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (TemporaryFolder() / "stratalux-mutants-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
    samples_ = MakeSampleStores(root_ / "samples");
    for (const SampleStore& sample : samples_) expected_.push_back(ExpectedOf(sample, root_ / "expected"));
    setenv("STRATALUX_THREADS", "1", 1);  // the mutants fill the cores
  }
  void TearDown() override {
    unsetenv("STRATALUX_THREADS");
    if (Number("STRATALUX_MUTANT", -1) < 0) fs::remove_all(root_);
  }

  // In a process of its own: changes a copy and tells verdict, change and reason in `told`.
  [[noreturn]] void RunOne(uint64_t seed, int64_t number, const fs::path& folder, const fs::path& told) const {
    const int nowhere = open("/dev/null", O_WRONLY);
    dup2(nowhere, STDERR_FILENO);
    Random random(seed * 1'000'003 + static_cast<uint64_t>(number));
    const size_t which = random() % samples_.size();
    fs::copy(samples_[which].folder, folder, fs::copy_options::recursive);
    const Mutant mutant = Mutate(samples_[which], folder, random);
    const std::string file = samples_[which].name + "\n" + KindOf(mutant.file) + "\n";
    std::ofstream(told) << "abort or hang\n" << file << samples_[which].name << ": " << mutant.what << "\n";
    alarm(kSecondsAMutant);
    std::string why;
    const Verdict verdict = Judge(samples_[which], expected_[which], mutant, folder, why);
    std::ofstream(told) << ToString(verdict) << "\n"
                        << file << samples_[which].name << ": " << mutant.what
                        << (mutant.consistent ? " (consistent)" : "") << "\n  " << why << "\n";
    _exit(IsWrong(verdict) ? 1 : 0);
  }

  void Settle(uint64_t seed, int64_t number, int status, Tally& tally) {
    const fs::path told = root_ / ("told-" + std::to_string(number));
    std::ifstream in(told);
    std::string verdict, sample, kind, rest;
    std::getline(in, verdict);
    std::getline(in, sample);
    std::getline(in, kind);
    std::getline(in, rest, '\0');
    if (WIFSIGNALED(status)) verdict = "SIGNAL " + std::to_string(WTERMSIG(status));
    if (WIFSIGNALED(status) && WTERMSIG(status) == SIGALRM) verdict = "HANG";
    ++tally.verdicts[verdict];
    ++tally.files[{sample, kind}];
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
      ++tally.wrong;
      if (tally.wrong <= 40)
        ADD_FAILURE() << "STRATALUX_SEED=" << seed << " STRATALUX_MUTANT=" << number << ": " << verdict << "\n" << rest;
    } else if (Number("STRATALUX_MUTANT", -1) >= 0) {
      std::printf("%s\n%s\n", verdict.c_str(), rest.c_str());
    }
    fs::remove(told);
    const fs::path folder = root_ / std::to_string(number);
    if (Number("STRATALUX_MUTANT", -1) >= 0) return (void)std::printf("kept: %s\n", folder.c_str());
    fs::remove_all(folder);
    fs::remove_all(folder.string() + "-scratch");
  }

  Tally Run(uint64_t seed, int64_t from, int64_t to) {
    Tally tally;
    std::map<pid_t, int64_t> running;
    const auto wait_for_one = [&] {
      int status = 0;
      const pid_t child = wait(&status);
      const auto found = running.find(child);
      if (found == running.end()) return;
      Settle(seed, found->second, status, tally);
      running.erase(found);
    };
    const auto workers = static_cast<size_t>(std::max(1L, sysconf(_SC_NPROCESSORS_ONLN)));
    for (int64_t number = from; number < to; ++number) {
      std::fflush(nullptr);
      const pid_t child = fork();
      if (child == 0) RunOne(seed, number, root_ / std::to_string(number), root_ / ("told-" + std::to_string(number)));
      EXPECT_GT(child, 0);
      running[child] = number;
      if (running.size() >= workers) wait_for_one();
    }
    while (!running.empty()) wait_for_one();
    return tally;
  }

  void RunAll(uint64_t seed, int64_t count) {
    const int64_t only = Number("STRATALUX_MUTANT", -1);
    const auto start = std::chrono::steady_clock::now();
    const Tally tally = only >= 0 ? Run(seed, only, only + 1) : Run(seed, 0, count);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    std::printf("STRATALUX_SEED=%llu: %lld mutants in %.1f s:", static_cast<unsigned long long>(seed),
                static_cast<long long>(count), seconds);
    for (const auto& [verdict, number] : tally.verdicts)
      std::printf(" %lld %s;", static_cast<long long>(number), verdict.c_str());
    std::printf("\n");
    EXPECT_EQ(tally.wrong, 0);
    const auto found = tally.verdicts.find("found");
    const int64_t bitten = found == tally.verdicts.end() ? 0 : found->second;
    EXPECT_TRUE(count < 200 || only >= 0 || bitten > count / 3) << "mutants must bite";
    if (count >= kManyMutants && only < 0) LookAtFiles(tally);
  }

  // Which files of which sample were changed, and that none was left out.
  void LookAtFiles(const Tally& tally) const {
    for (const SampleStore& sample : samples_) {
      std::map<std::string, int64_t> kinds;
      for (const fs::path& file : MutableFiles(sample.folder))
        kinds[KindOf(file.lexically_relative(sample.folder))] = 0;
      std::printf("%s:", sample.name.c_str());
      for (auto& [kind, mutants] : kinds) {
        const auto found = tally.files.find({sample.name, kind});
        if (found != tally.files.end()) mutants = found->second;
        std::printf(" %s %lld;", kind.c_str(), static_cast<long long>(mutants));
        EXPECT_GT(mutants, 0) << kind << " of " << sample.name << " was never changed";
      }
      std::printf("\n");
    }
  }

  fs::path root_;
  std::vector<SampleStore> samples_;
  std::vector<Expected> expected_;
};

TEST_F(Mutants, UnchangedStoresAreSound) {
  for (size_t i = 0; i < samples_.size(); ++i) {
    std::string why;
    const fs::path folder = root_ / "unchanged";
    fs::copy(samples_[i].folder, folder, fs::copy_options::recursive);
    EXPECT_EQ(Judge(samples_[i], expected_[i], {"nothing"}, folder, why), Verdict::kHarmless)
        << samples_[i].name << " " << why;
    fs::remove_all(folder);
    fs::remove_all(folder.string() + "-scratch");
  }
}

TEST_F(Mutants, AreFoundOrHarmlessAndLoseNoFrame) {
  const int64_t count = Number("STRATALUX_MUTANTS", 500);
  if (std::getenv("STRATALUX_SEED") != nullptr)
    return RunAll(static_cast<uint64_t>(Number("STRATALUX_SEED", 0)), count);
  const auto day = std::chrono::duration_cast<std::chrono::hours>(std::chrono::system_clock::now().time_since_epoch());
  RunAll(1, count / 2);
  RunAll(static_cast<uint64_t>(day.count() / 24), count - count / 2);
}

}  // namespace
}  // namespace stratalux::db
