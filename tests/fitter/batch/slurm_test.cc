// SPDX-License-Identifier: Apache-2.0
// What sbatch is given. What a real Slurm does with it: tests/cluster/slurm.sh.
#include "fitter/batch/slurm.h"

#include <gmock/gmock.h>

#include "fitter/batch/shard_manifest.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

ShardPlan PlanOfMany(int visits, double seconds) {
  ShardPlan plan;
  plan.id = "0123456789abcdef0123456789abcdef";
  for (int i = 0; i < visits; ++i)
    plan.visits.push_back({"s" + std::to_string(i), "f", 1, VisitCost{seconds, int64_t{1} << 30}});
  return plan;
}

TEST(ShardCount, IsByMeasuredMinutesAndTheCoresOfATask) {
  SlurmOptions options;
  options.chunk_minutes = 60;
  options.cpus = 2;
  EXPECT_EQ(*ShardCount(PlanOfMany(15000, 70), options), 146);  // 15000 * 70 s / 2 / 3600 s
  options.cpus = 1;
  EXPECT_EQ(*ShardCount(PlanOfMany(15000, 70), options), 292);
  options.chunk_minutes = 0.001;
  EXPECT_EQ(*ShardCount(PlanOfMany(7, 70), options), 7) << "no task without a visitor";
  EXPECT_EQ(*ShardCount(PlanOfMany(0, 70), options), 1);
  ShardPlan unmeasured = PlanOfMany(1, 70);
  unmeasured.visits[0].cost = std::nullopt;
  EXPECT_THAT(ShardCount(unmeasured, options).status().message(), HasSubstr("--most 1"));
}

TEST(ArraysOf, NoIndexExceedsWhatSlurmTakes) {
  std::vector<int> all;
  for (int i = 1; i <= 2500; ++i)
    if (i % 10 != 0) all.push_back(i);
  std::vector<int> together;
  for (const auto& array : ArraysOf(all, 1000)) {
    EXPECT_LT(array.back() - array.front(), 1000);
    together.insert(together.end(), array.begin(), array.end());
  }
  EXPECT_EQ(together, all);
  EXPECT_EQ(ArraysOf(all, 1000).size(), 3U);
  EXPECT_TRUE(ArraysOf({}, 1000).empty());
}

class SbatchScriptTest : public ScratchFolderTest {
 protected:
  // The script's last part, run by bash with a program that ends so; `scontrol` notes what it is asked.
  Outcome RunTask(const std::string& program, const std::string& environment) {
    SlurmOptions options;
    options.store = "/the store";
    options.results = "/shared/o'brien";
    options.program = folder_ / "program";
    WriteText(folder_ / "program", "#!/bin/sh\necho \"$@\" > " + (folder_ / "asked").string() + "\n" + program + "\n");
    WriteText(folder_ / "scontrol", "#!/bin/sh\necho \"$@\" > " + (folder_ / "scontrolled").string() + "\n");
    WriteText(folder_ / "script", SbatchScript(PlanOfMany(9, 70), options, {4, 5, 7}, 9));
    std::filesystem::remove(folder_ / "scontrolled");
    return Shell("cd " + folder_.string() + " && chmod +x program scontrol && PATH=" + folder_.string() +
                 ":$PATH SLURM_ARRAY_JOB_ID=12 " + environment + " bash script 2>&1");
  }
  std::string Requeued() const { return ReadText(folder_ / "scontrolled"); }
};

TEST_F(SbatchScriptTest, EachTaskIsItsShardInWordsThatAShellUnderstands) {
  EXPECT_EQ(RunTask("exit 0", "SLURM_ARRAY_TASK_ID=3").code, 0);
  EXPECT_THAT(ReadText(folder_ / "asked"),
              HasSubstr("batch shard 7/9 --plan 0123456789abcdef0123456789abcdef --store /the store --results "
                        "/shared/o'brien --workers 1"));
  const std::string script = ReadText(folder_ / "script");
  EXPECT_THAT(script, HasSubstr("#SBATCH --array=0-1,3\n"));
  EXPECT_THAT(script, HasSubstr("#SBATCH --mem=1280M\n"));
  EXPECT_THAT(script, HasSubstr("#SBATCH --cpus-per-task=2\n"));
  EXPECT_EQ(Requeued(), "");
}

TEST_F(SbatchScriptTest, IsQueuedAgainThreeTimesWhereItWasStoppedOrKilledAndNotWhereItFailed) {
  EXPECT_EQ(RunTask("exit 75", "SLURM_ARRAY_TASK_ID=0").code, 75);
  EXPECT_EQ(Requeued(), "requeue 12_0\n");
  EXPECT_EQ(RunTask("exit 75", "SLURM_ARRAY_TASK_ID=0 SLURM_RESTART_COUNT=2").code, 75);
  EXPECT_EQ(Requeued(), "requeue 12_0\n");
  EXPECT_EQ(RunTask("exit 75", "SLURM_ARRAY_TASK_ID=0 SLURM_RESTART_COUNT=3").code, 75);
  EXPECT_EQ(Requeued(), "");
  EXPECT_EQ(RunTask("kill -KILL $$", "SLURM_ARRAY_TASK_ID=0").code, 137);
  EXPECT_EQ(Requeued(), "requeue 12_0\n");
  for (const int code : {0, 1, 2, 3, 6}) {
    EXPECT_EQ(RunTask("exit " + std::to_string(code), "SLURM_ARRAY_TASK_ID=0").code, code);
    EXPECT_EQ(Requeued(), "") << code;
  }
}

// Slurm signals the script before the time is over: the shard gives its visitors back, and says so by 75.
TEST_F(SbatchScriptTest, AStopReachesTheShardAndItsWordIsAwaited) {
  const Outcome outcome = RunTask(
      "trap 'sleep 0.2; exit 75' TERM; kill -TERM $PPID; i=0; while [ $i -lt 100 ]; do sleep 0.05; i=$((i+1)); done; "
      "exit 1",
      "SLURM_ARRAY_TASK_ID=0");
  EXPECT_EQ(outcome.code, 75) << outcome.out;
  EXPECT_EQ(Requeued(), "requeue 12_0\n");
}

class ShardsToDoTest : public ScratchFolderTest {};

TEST_F(ShardsToDoTest, AreThoseInWhichSomebodyHasNotEnded) {
  const ShardPlan plan = PlanOfMany(6, 70);
  EXPECT_EQ(ShardsToDo(plan, folder_, 3), (std::vector<int>{1, 2, 3}));
  ShardManifest manifest{plan.id, {2, 3}, {}};
  const std::vector<size_t> own = VisitsOf(plan, {2, 3});
  ASSERT_EQ(own.size(), 2U);
  manifest.Say({{.kind = NightEventKind::kDone, .session = plan.visits[own[0]].session}, {}});
  ASSERT_TRUE(WriteManifest(folder_, manifest).ok());
  EXPECT_EQ(ShardsToDo(plan, folder_, 3), (std::vector<int>{1, 2, 3}));
  manifest.Say({{.kind = NightEventKind::kFailed, .session = plan.visits[own[1]].session}, {}});
  ASSERT_TRUE(WriteManifest(folder_, manifest).ok());
  EXPECT_EQ(ShardsToDo(plan, folder_, 3), (std::vector<int>{1, 3}));
  // Half a manifest says nothing.
  const auto file = ManifestFile(folder_, {2, 3});
  WriteText(file, ReadText(file).substr(0, 100));
  EXPECT_EQ(ShardsToDo(plan, folder_, 3), (std::vector<int>{1, 2, 3}));
  EXPECT_EQ(ShardsToDo(plan, folder_, 9).size(), 6U) << "shards without visitors have nothing to do";
}

TEST(SlurmOptionsTest, DirectivesAreOptionsOfSbatch) {
  SlurmOptions options;
  options.directives = {"--partition=night"};
  EXPECT_TRUE(options.Validate().ok());
  for (const char* directive : {"partition", "--a=b\nrm -rf /"}) {
    options.directives = {directive};
    EXPECT_EQ(options.Validate().code(), StatusCode::kUsage) << directive;
  }
}

}  // namespace
}  // namespace stratalux::fit
