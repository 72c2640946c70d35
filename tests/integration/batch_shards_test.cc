// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit batch shard` and `merge` as their user runs them: a night on machines that see the sealed sessions and
// nothing else of the store, whatever is lost, killed or run twice.
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <optional>
#include <sstream>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/base/file_lock.h"
#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using std::chrono::milliseconds;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr const char* kUnderPseudonym =
    "--visitor v-5f3a91c2 --consent-scope fit --consent-text 1 --consent-language en";

class BatchShards : public SmallFit {
 protected:
  // A store of one visitor and those of `captures`, its plan, and what another machine sees of it: no index, no keys.
  fs::path Planned(const std::vector<std::string>& captures) {
    fs::path store = Captured("store");
    for (const std::string& options : captures) EXPECT_EQ(Capture(store, options).code, 0);
    Place(folder_);
    fs::create_directories(scratch_);
    Look(store);
    const Outcome plan = Fit(store, "batch plan " + std::string(kSmallFitOptions) + " --out " + results_.string());
    EXPECT_EQ(plan.code, 0) << plan.out;
    ReadPlan();
    return store;
  }
  // Three visitors, the one in the middle under a pseudonym, planned and fitted in two shards, nothing merged: made by
  // the first case that asks, copied for each.
  fs::path FittedByShards() {
    const fs::path original = Originals() / "shards";
    if (!fs::exists(original)) {
      const fs::path store = Planned({kUnderPseudonym, ""});
      for (const char* shard : {"1/2", "2/2"}) {
        const Outcome outcome = RunShard(shard);
        EXPECT_EQ(outcome.code, 0) << outcome.out;
      }
      EXPECT_THAT(std::vector<fs::path>(fs::directory_iterator(scratch_), {}), IsEmpty());
      EXPECT_EQ(std::distance(fs::directory_iterator(seen_), {}), 2) << "a shard wrote beside the sessions";
      fs::remove_all(seen_);
      fs::rename(folder_, original);
    }
    EXPECT_EQ(Shell("cp -a " + original.string() + "/. " + folder_.string() + " 2>&1").out, "");
    Place(folder_);
    fs::path store = folder_ / "store" / "store";
    Look(store);
    ReadPlan();
    return store;
  }
  void Place(const fs::path& folder) {
    results_ = folder / "results";
    scratch_ = folder / "scratch";
    seen_ = folder / "seen";
  }
  void Look(const fs::path& store) const {
    fs::create_directories(seen_);
    for (const char* part : {"sessions", "ledger"}) fs::create_directory_symlink(store / part, seen_ / part);
  }
  void ReadPlan() {
    sessions_.clear();
    const Json json = Json::parse(ReadText(results_ / "plan.json"));
    for (const Json& visit : json.at("visits")) sessions_.push_back(visit.at("session"));
  }
  [[nodiscard]] std::vector<std::string> ShardWords(const std::string& shard) const {
    return {"stratalux-fit",   "batch",     "shard",           shard,       "--store", seen_.string(), "--results",
            results_.string(), "--scratch", scratch_.string(), "--workers", "1"};
  }
  [[nodiscard]] Outcome RunShard(const std::string& shard) const {
    return Running(ShardWords(shard), folder_ / "shard.log").Wait();
  }
  [[nodiscard]] Json Merge(const fs::path& store, int code) const {
    const Outcome outcome =
        Execute("stratalux-fit batch merge " + results_.string() + " --json --store " + store.string(), Show::kStdout);
    EXPECT_EQ(outcome.code, code) << outcome.out;
    return Json::parse(outcome.out, nullptr, false);
  }
  // The layers of its only fit; empty: it has none.
  static std::string Layers(const fs::path& session) {
    std::string bytes;
    std::error_code error;
    for (const auto& fit : fs::directory_iterator(session / "fits", error))
      for (const char* file : {"layers_weight.exr", "layers_depth_mm.exr", "quality.exr"})
        bytes += ReadText(fit.path() / file);
    return bytes;
  }
  [[nodiscard]] fs::path ManifestOf(const std::string& name) const { return results_ / (name + ".json"); }
  static int Attempts(const std::string& log) {
    int attempts = 0;
    for (size_t at = log.find(" fitted in "); at != std::string::npos; at = log.find(" fitted in ", at + 1)) ++attempts;
    return attempts;
  }

  fs::path results_, scratch_, seen_;
  std::vector<std::string> sessions_;  // of the plan
};

TEST_F(BatchShards, NeedSealedSessionsAloneAndTheMergeEntersEachFitOnce) {
  const fs::path store = FittedByShards();
  ASSERT_EQ(sessions_.size(), 3U);
  for (const std::string& session : sessions_)
    EXPECT_EQ(Layers(store / "sessions" / session), "") << "a shard wrote there";

  const Json merged = Merge(store, 0);
  EXPECT_EQ(merged.at("entered"), 3);
  const std::string expected = Layers(Session(Fitted("alone")));
  for (const std::string& session : sessions_) EXPECT_EQ(Layers(store / "sessions" / session), expected) << session;
  const Outcome verify = Db(store, "verify --deep");
  EXPECT_EQ(verify.code, 0) << verify.out;
  EXPECT_EQ(verify.out.find("note"), std::string::npos) << verify.out;
  EXPECT_THAT(Leftovers(store, true), IsEmpty());
  // Files of a fit are further names of its artifacts, as after a run here.
  for (const auto& fit : fs::directory_iterator(Session(store) / "fits"))
    EXPECT_GT(fs::hard_link_count(fit.path() / "layers_weight.exr"), 1U);
  // The next run has nothing to do, the artifacts are its own.
  EXPECT_THAT(Fit(store, "batch run " + std::string(kSmallFitOptions)).out, HasSubstr("0 visitors to fit"));
  EXPECT_EQ(Fit(store, "run latest --layers 1 --pool 2 --prior 1000 --iterations 1 --json").out.find("error"),
            std::string::npos);

  // Shards and merge once more: nothing.
  const Outcome again = RunShard("1/2");
  EXPECT_EQ(again.code, 0) << again.out;
  EXPECT_EQ(Attempts(again.out), 0) << again.out;
  const fs::path night = store / "nights" / merged.at("night").get<std::string>() / (sessions_[0] + ".jsonl");
  const std::string said = ReadText(night);
  EXPECT_THAT(said, HasSubstr("\"event\":\"done\""));
  const Json twice = Merge(store, 0);
  EXPECT_EQ(twice.at("entered"), 0);
  EXPECT_EQ(twice.at("present"), 3);
  EXPECT_EQ(twice.at("night"), merged.at("night"));
  EXPECT_EQ(ReadText(night), said);
  const Outcome report = Execute(
      "stratalux-fit batch report " + merged.at("night").get<std::string>() + " --text --store " + store.string(),
      Show::kStdout);
  EXPECT_THAT(report.out, HasSubstr("3 of 3 visitors fitted"));
}

TEST_F(BatchShards, WhatIsKilledLostOrHalfWrittenChangesNothingAndIsNamed) {
  const fs::path store = Planned({""});
  Running shard(ShardWords("1/1"), folder_ / "killed.log");
  // Dies when the first visitor is in its manifest.
  const auto said = [&] { return ReadText(ManifestOf("shard-0001-of-0001")).find("\"done\"") != std::string::npos; };
  while (!said() && !shard.WaitFor(milliseconds(5))) continue;
  std::this_thread::sleep_for(duration_ / 2);
  shard.Send(SIGKILL);
  EXPECT_EQ(shard.Wait().signal, SIGKILL);
  Json merged = Merge(store, 3);
  EXPECT_EQ(merged.at("entered"), 1);
  EXPECT_EQ(merged.at("missing"), Json{sessions_[1]});
  // Half a manifest: what it said is not known, what was merged stays, and the next run writes it anew.
  const std::string manifest = ReadText(ManifestOf("shard-0001-of-0001"));
  WriteText(ManifestOf("shard-0001-of-0001"), manifest.substr(0, manifest.size() / 2));
  merged = Merge(store, 3);
  EXPECT_EQ(merged.at("present"), 1);
  EXPECT_THAT(merged.at("problems").dump(), HasSubstr("does not match its own hash"));
  WriteText(ManifestOf("shard-0001-of-0001"), manifest);
  // Stopped, it says that there is more to do; run again, it goes on.
  Running stopped(ShardWords("1/1"), folder_ / "stopped.log");
  while (ReadText(folder_ / "stopped.log").find("visitors to fit") == std::string::npos &&
         !stopped.WaitFor(milliseconds(5)))
    continue;
  stopped.Send(SIGTERM);
  const Outcome told = stopped.Wait();
  EXPECT_EQ(told.code, 75) << told.out;
  const Outcome rest = RunShard("1/1");
  EXPECT_EQ(rest.code, 0) << rest.out;
  EXPECT_EQ(Attempts(rest.out), 1) << "only who was left\n" << rest.out;
  // The killed one's scratch went with the next.
  EXPECT_THAT(std::vector<fs::path>(fs::directory_iterator(scratch_), {}), IsEmpty());
  // Swapped bytes in what was made: that visitor is not entered, and fitted again by the shard.
  for (const auto& entry : fs::recursive_directory_iterator(results_ / "sessions" / sessions_[1] / "artifacts"))
    if (entry.path().filename() == "layers_weight.exr") {
      fs::permissions(entry.path(), fs::perms::owner_write, fs::perm_options::add);
      std::fstream file(entry.path(), std::ios::in | std::ios::out | std::ios::binary);
      file.seekp(200);
      file.write("damaged", 7);
    }
  merged = Merge(store, 3);
  EXPECT_EQ(merged.at("entered"), 0);
  EXPECT_EQ(merged.at("missing"), Json{sessions_[1]});
  EXPECT_THAT(merged.at("problems").dump(), HasSubstr("layers_weight.exr"));
  EXPECT_EQ(Layers(store / "sessions" / sessions_[1]), "");
  fs::remove_all(results_ / "sessions" / sessions_[1]);
  EXPECT_EQ(RunShard("1/1").code, 0);
  EXPECT_EQ(Merge(store, 0).at("entered"), 1);
  const std::string expected = Layers(Session(Fitted("alone")));
  for (const std::string& session : sessions_) EXPECT_EQ(Layers(store / "sessions" / session), expected) << session;
  EXPECT_EQ(Db(store, "verify --deep").code, 0);
}

TEST_F(BatchShards, WhoIsForgottenOrWithdrewMeanwhileIsNotEntered) {
  const fs::path store = FittedByShards();
  ASSERT_EQ(sessions_.size(), 3U);  // newest first
  ASSERT_EQ(Db(store, "consent withdraw --visitor v-5f3a91c2").code, 0);
  ASSERT_EQ(Db(store, "forget " + sessions_[0] + " --yes").code, 0);
  const Json merged = Merge(store, 0);
  EXPECT_EQ(merged.at("entered"), 1);
  EXPECT_EQ(merged.at("dropped"), 2);
  for (const int gone : {0, 1}) {
    EXPECT_EQ(Layers(store / "sessions" / sessions_[gone]), "");
    EXPECT_FALSE(fs::exists(results_ / "sessions" / sessions_[gone])) << "what was made of them";
  }
  EXPECT_EQ(Db(store, "verify --deep").code, 0);
  // Nor does a shard that runs later fit them, though they were planned.
  const Outcome again = RunShard("1/2");
  EXPECT_EQ(again.code, 0) << again.out;
  EXPECT_EQ(RunShard("2/2").code, 0);
  for (const int gone : {0, 1}) EXPECT_FALSE(fs::exists(results_ / "sessions" / sessions_[gone]));
  // Said once.
  EXPECT_EQ(Merge(store, 0).at("dropped"), 2);
  std::string told;
  for (const auto& entry : fs::directory_iterator(store / "nights" / merged.at("night").get<std::string>()))
    if (entry.path().extension() == ".jsonl") told += ReadText(entry.path());
  size_t drops = 0;
  for (size_t at = told.find("\"dropped\""); at != std::string::npos; at = told.find("\"dropped\"", at + 1)) ++drops;
  EXPECT_EQ(drops, 2U) << told;
  EXPECT_EQ(told.find(sessions_[0]), std::string::npos) << "a forgotten session's id";
}

TEST_F(BatchShards, AMergeThatIsKilledAnywhereIsFinishedByTheNext) {
  Planned({});
  ASSERT_EQ(RunShard("1/1").code, 0);
  const fs::path made = folder_ / "made";
  ASSERT_EQ(Shell("cp -a " + results_.string() + " " + made.string()).code, 0);
  // What it writes in the store, and how often it calls for a file there.
  const fs::path count = folder_ / "count";
  const auto merge = [&](const fs::path& store, int64_t call, const std::vector<std::string>& more) {
    EXPECT_EQ(Shell("rm -rf " + results_.string() + " && cp -a " + made.string() + " " + results_.string()).code, 0);
    std::vector<std::string> environment = DiesAt(store, call);
    environment.insert(environment.end(), more.begin(), more.end());
    return Running({"stratalux-fit", "batch", "merge", results_.string(), "--store", store.string()},
                   folder_ / "merge.log", environment)
        .Wait();
  };
  const fs::path whole = Captured("whole");
  // The captured session of all cases has one id.
  ASSERT_EQ(Session(whole).filename().string(), sessions_.at(0));
  ASSERT_EQ(merge(whole, kNever, {"STORE_FAULT_COUNT=" + count.string()}).code, 0);
  const int64_t calls = std::atoll(ReadText(count).c_str());
  ASSERT_GT(calls, 100);
  const State expected = StateOf(whole);
  const int kills = Kills() / 2;
  for (int k = 0; k < kills; ++k) {
    const int64_t call = calls * (2 * k + 1) / (2 * kills);
    const std::string where = "killed at call " + std::to_string(call) + " of " + std::to_string(calls);
    const fs::path store = Captured("killed" + std::to_string(k));
    EXPECT_EQ(merge(store, call, {}).signal, SIGKILL) << where;
    ExpectNothingHalf(store, where);
    const Json merged = Merge(store, 0);
    EXPECT_EQ(merged.at("entered").get<int>() + merged.at("present").get<int>(), 1) << where;
    EXPECT_TRUE(StateOf(store) == expected) << where;
    EXPECT_THAT(Leftovers(store, true), IsEmpty()) << where;
    EXPECT_EQ(Db(store, "verify --deep").code, 0) << where;
    fs::remove_all(store.parent_path());
  }
}

// All shards are done: `submit` stays to merge, and asks no engine.
TEST_F(BatchShards, AMergeByHandDoesNotEndTheNightsSubmit) {
  const fs::path store = FittedByShards();
  WriteText(results_ / "slurm.json", R"({"schema": 1, "shards": 2, "jobs": ["1"]})");
  auto by_hand = std::make_optional(db::FileLock::TryTake(results_ / ".merge.lock", "busy"));
  ASSERT_TRUE(by_hand->ok());
  const fs::path log = folder_ / "submit.log";
  Running submit({"stratalux-fit", "batch", "submit", "--engine", "slurm", "--again", "--store", store.string(),
                  "--results", results_.string(), "--until", InHours(1), "--every", "0.2"},
                 log);
  while (ReadText(log).find("is running") == std::string::npos && !submit.WaitFor(milliseconds(20))) continue;
  EXPECT_FALSE(submit.WaitFor(milliseconds(1000))) << ReadText(log);
  by_hand.reset();
  const Outcome outcome = submit.Wait();
  EXPECT_EQ(outcome.code, 0) << outcome.out;
  EXPECT_THAT(outcome.out, HasSubstr("3 fits entered"));
  for (const std::string& session : sessions_) EXPECT_NE(Layers(store / "sessions" / session), "") << session;
}

// No manifest changes when it can be read again, and yet there is something to merge.
TEST_F(BatchShards, WhatCannotBeReadForAWhileIsMergedByTheNightsSubmit) {
  const fs::path store = FittedByShards(), log = folder_ / "submit.log";
  WriteText(results_ / "slurm.json", R"({"schema": 1, "shards": 2, "jobs": ["1"]})");
  const fs::path record = fs::directory_iterator(results_ / "sessions" / sessions_[0] / "fits")->path() / "fit.json";
  const std::string text = ReadText(record);
  fs::remove(record);
  fs::create_directory(record);
  Running submit({"stratalux-fit", "batch", "submit", "--engine", "slurm", "--again", "--store", store.string(),
                  "--results", results_.string(), "--until", InHours(1), "--every", "0.2"},
                 log);
  const std::string problem = "cannot read " + record.string();
  while (ReadText(log).find(problem) == std::string::npos && !submit.WaitFor(milliseconds(20))) continue;
  EXPECT_FALSE(submit.WaitFor(milliseconds(1000))) << ReadText(log);
  fs::remove(record);
  WriteText(record, text);
  const bool by_itself = submit.WaitFor(milliseconds(60'000));
  EXPECT_TRUE(by_itself) << "merged only as it was told to stop";
  if (!by_itself) submit.Send(SIGTERM);
  const Outcome outcome = submit.Wait();
  EXPECT_EQ(outcome.code, 0) << outcome.out;
  EXPECT_EQ(outcome.out.find(problem), outcome.out.rfind(problem)) << "said more than once\n" << outcome.out;
  for (const std::string& session : sessions_) EXPECT_NE(Layers(store / "sessions" / session), "") << session;
}

// Begun too late, as behind a pull of a whole night: it would stay until the next day's --until.
TEST_F(BatchShards, OutsideOfItsSpanNobodyIsSubmitted) {
  const fs::path store = Fitted("span"), called = folder_ / "called", results = folder_ / "r";
  ASSERT_EQ(Capture(store).code, 0);  // how long a visitor takes is known, and somebody is not fitted yet
  fs::create_directories(folder_ / "bin");
  WriteText(folder_ / "bin" / "sbatch", "#!/bin/sh\ntouch " + called.string() + "\n");
  fs::permissions(folder_ / "bin" / "sbatch", fs::perms::owner_all);
  const Outcome outcome =
      Running({"stratalux-fit", "batch", "submit", "--engine", "slurm", "--store", store.string(), "--results",
               results.string(), "--from", InHours(2), "--until", InHours(4)},
              folder_ / "submit.log", {"PATH=" + (folder_ / "bin").string() + ":" + std::getenv("PATH")})
          .Wait();
  EXPECT_EQ(outcome.code, 3) << outcome.out;
  EXPECT_THAT(outcome.out, HasSubstr("nobody is fitted: it is not between"));
  EXPECT_FALSE(fs::exists(results));
  EXPECT_FALSE(fs::exists(called));
}

TEST_F(BatchShards, BadWordsAreNamed) {
  const fs::path store = Captured("words");
  const std::string batch = "stratalux-fit batch ", in = " --store " + store.string();
  EXPECT_THAT(Execute(batch + "shard 3/2 --results " + folder_.string() + in).out, HasSubstr("I/N with 1 <= I <= N"));
  EXPECT_THAT(Execute(batch + "shard 1/2 --results " + folder_.string() + in).out, HasSubstr("batch plan --out"));
  EXPECT_EQ(Execute(batch + "merge " + folder_.string() + in).code, 4);
  ASSERT_EQ(Execute(batch + "plan --out " + (folder_ / "r").string() + in).code, 0);
  EXPECT_EQ(Execute(batch + "plan --out " + (folder_ / "r").string() + in).code, 2);
  EXPECT_THAT(Execute(batch + "shard 1/1 --scratch /nowhere --results " + (folder_ / "r").string() + in).out,
              HasSubstr("--scratch /nowhere"));
}

}  // namespace
}  // namespace stratalux
