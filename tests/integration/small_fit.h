// SPDX-License-Identifier: Apache-2.0
// The smallest session that goes the whole road, from frames to an evaluated report, for tests that disturb
// `stratalux-fit run`: captured and fitted once, each case works on copies. STRATALUX_SHARED_CAPTURES names a folder in
// which programs leave it for each other (tests/integration/CMakeLists.txt); without it each makes its own.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <sys/types.h>

#include "tests/support/run_program.h"

namespace stratalux {

inline constexpr const char* kSmallFitOptions = "--pool 2 --prior 1000 --iterations 1 --layers 1";

// A program of this build that runs beside the test, in the environment of the test and `environment`.
class Running {
 public:
  // stdout and stderr go to `log`.
  Running(const std::vector<std::string>& program_and_arguments, const std::filesystem::path& log,
          const std::vector<std::string>& environment = {});
  void Send(int signal) const;
  // False where it still runs then.
  bool WaitFor(std::chrono::milliseconds patience);
  [[nodiscard]] pid_t pid() const { return pid_; }
  // What all its threads have taken of the processors so far: of a test's machine that is busy, the same.
  [[nodiscard]] std::chrono::nanoseconds ProcessorTime() const;
  // code and signal; `out` is what it printed on both.
  Outcome Wait();

 private:
  pid_t pid_ = -1;
  std::filesystem::path log_;
  bool ended_ = false;
  int status_ = 0;
  std::chrono::nanoseconds processor_time_{};  // once it has ended
};

// A path below a session's folder -> what is there, without the times that differ from run to run:
//   artifact.json          seconds, cpu_seconds, peak_rss_bytes, finished_wall_ns, and with them its own hash
//   metrics.json           of `stages`: seconds, cpu_seconds, peak_rss_bytes
//   report/index.html      the table "Where the time goes", but for the names of the stages
//   fit.json               created_wall_ns, its own hash, size and hash of the two above
using State = std::map<std::string, std::string>;

class SmallFit : public ::testing::Test {
 protected:
  static void SetUpTestSuite();
  void SetUp() override;
  void TearDown() override;

  // The folder of what all cases copy, and a copy of one of its stores, ORIGINAL/store, in `folder`.
  static std::filesystem::path Originals();
  static std::filesystem::path CopyOfOriginal(const std::string& original, const std::filesystem::path& folder);
  // Captures the session of all cases: the same frames, bit for bit, in any store.
  static Outcome Capture(const std::filesystem::path& store, const std::string& options = "");
  // A copy of the store: as captured, or as the undisturbed run left it. Hard links stay links.
  [[nodiscard]] std::filesystem::path Captured(const std::string& name) const;
  [[nodiscard]] std::filesystem::path Fitted(const std::string& name) const;
  // `out` is what they printed on both streams.
  static Outcome Fit(const std::filesystem::path& store, const std::string& verb_and_options);
  static Outcome Db(const std::filesystem::path& store, const std::string& arguments);
  // `stratalux-fit run` as the undisturbed one.
  static std::vector<std::string> RunArguments(const std::filesystem::path& store);
  static std::filesystem::path Session(const std::filesystem::path& store);
  // Of fits/ and artifacts/.
  static State StateOf(const std::filesystem::path& store);
  // No run has left anything half made, and all is what the undisturbed run left.
  static void ExpectAsUndisturbed(const std::filesystem::path& store, const std::string& where);
  // What is listed is whole, whatever a killed run left.
  static void ExpectNothingHalf(const std::filesystem::path& store, const std::string& where);
  // Names of what is half made, or a lock.
  static std::vector<std::string> Leftovers(const std::filesystem::path& store, bool locks);

  std::filesystem::path folder_;  // of the case
  static inline State undisturbed_;
  static inline std::chrono::milliseconds duration_{};  // of the undisturbed run
  static inline int64_t calls_ = 0;                     // of its file calls, as the fault layer counts them

 private:
  // Captured and fitted in `folder`.
  static void Make(const std::filesystem::path& folder);
  // The first of several programs makes it, the others wait and copy.
  static void MakeOrCopy(const std::filesystem::path& shared, const std::filesystem::path& folder);
  static Outcome CaptureAs(const std::filesystem::path& folder, const std::filesystem::path& store,
                           const std::string& options);
};

inline constexpr int64_t kNever = 1'000'000'000;  // a file call that no run comes to

// STRATALUX_RUN_KILLS, or 10: how often a run is killed in all, a quarter of it while a fit is put in its place. From
// 100 on other things are tried more often, too.
[[nodiscard]] int Kills();
// STRATALUX_SEED, or 1.
[[nodiscard]] uint64_t Seed();
// A time of day, such as "07:00", that many hours from now.
[[nodiscard]] std::string InHours(int hours);
// The fault layer over a store: SIGKILL before the file call of that number. Syncs are not waited for.
[[nodiscard]] std::vector<std::string> DiesAt(const std::filesystem::path& store, int64_t call);

}  // namespace stratalux
