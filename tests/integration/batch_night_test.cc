// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit batch` as its user runs it: a night whose workers and whose own process are killed fits everybody, bit
// for bit as an undisturbed run does.
#include <csignal>
#include <ctime>
#include <fstream>
#include <set>
#include <sstream>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using std::chrono::milliseconds;
using ::testing::HasSubstr;

class BatchNight : public SmallFit {
 protected:
  static std::vector<std::string> Batch(const fs::path& store, const std::string& verb) {
    std::vector<std::string> words = {"stratalux-fit", "batch", verb, "--store", store.string(), "--workers", "2"};
    std::istringstream options(kSmallFitOptions);
    for (std::string word; options >> word;) words.push_back(word);
    return words;
  }
  [[nodiscard]] Outcome RunBatch(const fs::path& store, const std::string& options = "") const {
    return Fit(store, "batch run --workers 2 " + std::string(kSmallFitOptions) + " " + options);
  }
  static std::vector<fs::path> Sessions(const fs::path& store) {
    std::vector<fs::path> folders;
    for (const auto& entry : fs::directory_iterator(store / "sessions")) folders.push_back(entry.path());
    std::sort(folders.begin(), folders.end());
    return folders;
  }
  // Layers of the only fit.
  static std::string Layers(const fs::path& session) {
    std::string bytes;
    int fits = 0;
    for (const auto& fit : fs::directory_iterator(session / "fits")) {
      ++fits;
      for (const char* file : {"layers_weight.exr", "layers_depth_mm.exr", "quality.exr"})
        bytes += ReadText(fit.path() / file);
    }
    EXPECT_EQ(fits, 1) << session;
    return bytes;
  }
  static int Compared(const fs::path& session) {
    int compared = 0;
    for (const auto& artifact : fs::directory_iterator(session / "artifacts"))
      compared += artifact.path().filename().string().starts_with("compare-") ? 1 : 0;
    return compared;
  }
  static pid_t AWorkerOf(pid_t batch) {
    std::ifstream file("/proc/" + std::to_string(batch) + "/task/" + std::to_string(batch) + "/children");
    pid_t worker = 0;
    file >> worker;
    return worker;
  }
};

TEST_F(BatchNight, WhateverIsKilledEverybodyIsFittedAsByAnUndisturbedRun) {
  const fs::path store = Captured("night"), log = store.string() + ".log";
  // Two for the workers, and one who waits.
  for (int i = 0; i < 2; ++i) ASSERT_EQ(Capture(store).code, 0);
  ASSERT_EQ(Sessions(store).size(), 3U);
  // A worker dies, then the night itself.
  {
    Running night(Batch(store, "run"), log);
    pid_t worker = 0;
    while ((worker = AWorkerOf(night.pid())) == 0 && !night.WaitFor(milliseconds(1))) continue;
    ASSERT_GT(worker, 0) << ReadText(log);
    // A job has less to do than the undisturbed run: nobody may be done before the night dies.
    std::this_thread::sleep_for(duration_ / 4);
    kill(worker, SIGKILL);
    std::this_thread::sleep_for(duration_ / 4);
    night.Send(SIGKILL);
    night.Wait();
  }
  const Outcome outcome = RunBatch(store);
  EXPECT_EQ(outcome.code, 0) << outcome.out;
  const fs::path alone = Sessions(Fitted("alone")).front();
  const std::string expected = Layers(alone);
  for (const fs::path& session : Sessions(store)) EXPECT_EQ(Layers(session), expected) << session;
  // Nobody waits at night: no report is made before the evaluation, as somebody's own run makes one.
  EXPECT_EQ(Compared(alone), 2);
  for (const fs::path& session : Sessions(store)) {
    EXPECT_EQ(Compared(session), 1) << session;
    for (const auto& fit : fs::directory_iterator(session / "fits"))
      EXPECT_EQ(Json::parse(ReadText(fit.path() / "metrics.json"))["evaluation"], "held_out") << fit.path();
  }
  EXPECT_EQ(Db(store, "verify --deep").code, 0);
  EXPECT_THAT(Leftovers(store, false), ::testing::IsEmpty());
  const Outcome report = Execute("stratalux-fit batch report --store " + store.string(), Show::kStdout);
  for (const fs::path& session : Sessions(store))
    EXPECT_THAT(ReadText(report.out.substr(0, report.out.find('\n'))), HasSubstr(session.filename().string()));
  // Once more there is nobody.
  EXPECT_THAT(RunBatch(store).out, HasSubstr("0 visitors to fit"));
  const Outcome status = Execute("stratalux-fit batch status --json --store " + store.string(), Show::kStdout);
  EXPECT_EQ(Json::parse(status.out).at("queue").at("done"), 3);
  // What a visitor costs is measured there, and can be taken elsewhere.
  const Outcome scale = Execute("stratalux-fit batch scale --days 2 --json --store " + store.string(), Show::kStdout);
  ASSERT_EQ(scale.code, 0);
  const Json figures = Json::parse(scale.out)["figures"];
  EXPECT_EQ(figures["fit_cpu_s"].size(), Sessions(store).size());
  for (const Json& session :
       Json::parse(Execute("stratalux-db ls --json --store " + store.string(), Show::kStdout).out)) {
    EXPECT_GT(figures["frames_bytes"].get<double>(), 0.5 * session["bytes"].get<double>());
    EXPECT_LT(figures["frames_bytes"].get<double>(), 2.0 * session["bytes"].get<double>());
  }
  WriteText(folder_ / "figures.json", figures.dump());
  EXPECT_EQ(Execute("stratalux-fit batch scale --days 2 --json --figures " + (folder_ / "figures.json").string(),
                    Show::kStdout)
                .out,
            scale.out);
}

TEST_F(BatchNight, AStopGivesBackAndTheNextNightGoesOn) {
  const fs::path store = Captured("stopped"), log = store.string() + ".log";
  ASSERT_EQ(Capture(store).code, 0);
  Running night(Batch(store, "run"), log);
  while (AWorkerOf(night.pid()) == 0 && !night.WaitFor(milliseconds(1))) continue;
  night.Send(SIGTERM);
  const Outcome stopped = night.Wait();
  EXPECT_EQ(stopped.code, 0) << stopped.out;
  EXPECT_THAT(stopped.out, HasSubstr("goes back to the queue"));
  EXPECT_THAT(stopped.out, HasSubstr("wait for the next night"));
  EXPECT_THAT(Leftovers(store, false), ::testing::IsEmpty());
  EXPECT_EQ(RunBatch(store).code, 0);
  for (const fs::path& session : Sessions(store)) EXPECT_FALSE(Layers(session).empty());
}

TEST_F(BatchNight, WhoCannotBeFittedIsNamedAndTheRestGoesOn) {
  const fs::path store = Captured("named");
  // Encrypted, and its key is lost.
  ASSERT_EQ(Capture(store, "--encrypt").code, 0);
  fs::remove(store / "keys.sqlite");
  // A visitor whose frames are damaged.
  ASSERT_EQ(Capture(store).code, 0);
  const auto sessions = Sessions(store);
  ASSERT_EQ(sessions.size(), 3U);
  for (const auto& entry : fs::directory_iterator(sessions[2]))
    if (entry.path().filename().string().starts_with("frames-")) {
      fs::permissions(entry.path(), fs::perms::owner_write, fs::perm_options::add);
      std::fstream file(entry.path(), std::ios::in | std::ios::out | std::ios::binary);
      file.seekp(static_cast<std::streamoff>(fs::file_size(entry.path()) / 2));
      file.write("damaged by a test", 17);
    }
  const Outcome outcome = RunBatch(store);
  EXPECT_EQ(outcome.code, 3) << "somebody could not be fitted\n" << outcome.out;
  EXPECT_FALSE(Layers(sessions[0]).empty());
  const Outcome status = Execute("stratalux-fit batch status --json --store " + store.string(), Show::kStdout);
  const Json json = Json::parse(status.out);
  ASSERT_EQ(json.at("left_out").size(), 1U) << status.out;
  EXPECT_EQ(json.at("left_out")[0].at("session"), sessions[1].filename().string());
  EXPECT_EQ(json.at("left_out")[0].at("why"), "key");
  std::set<std::string> states;
  for (const Json& visit : json.at("visits"))
    states.insert(visit.at("session").get<std::string>() + " " + visit.at("state").get<std::string>());
  EXPECT_EQ(states, (std::set<std::string>{sessions[0].filename().string() + " done",
                                           sessions[2].filename().string() + " failed"}));
  const Outcome text = Execute("stratalux-fit batch report --text --store " + store.string(), Show::kStdout);
  EXPECT_THAT(text.out, HasSubstr("1 of 2 visitors fitted, 1 failed"));
  EXPECT_THAT(text.out, HasSubstr(sessions[2].filename().string() + "  failed"));
  EXPECT_THAT(text.out, HasSubstr(sessions[1].filename().string() + "  key"));
}

// As a unit that is begun again when its span is over: nothing is done, and the exit code says how the night went.
TEST_F(BatchNight, OutsideOfItsSpanItSaysHowTheNightWent) {
  const fs::path store = Captured("span");
  const auto outside = [&] {
    return Execute("stratalux-fit batch run --from " + InHours(2) + " --until " + InHours(4) + " --store " +
                   store.string());
  };
  const auto night = [&](const std::string& name, int hours_ago, const std::string& end) {
    const std::string at = std::to_string((std::time(nullptr) - int64_t{3600} * hours_ago) * 1'000'000'000);
    fs::create_directories(store / "nights" / name);
    WriteText(store / "nights" / name / "night.jsonl", R"({"event":"began","visitors":1,"at_ns":)" + at + "}\n" +
                                                           R"({"event":"ended","visitors":0,"at_ns":)" + at + end +
                                                           "}\n");
  };
  const Outcome never = outside();
  EXPECT_EQ(never.code, 3);
  EXPECT_THAT(never.out, HasSubstr("nobody is fitted: it is not between"));
  EXPECT_THAT(never.out, HasSubstr("no night has begun since"));
  EXPECT_FALSE(fs::exists(store / "nights"));
  night("1", 23, "");
  EXPECT_EQ(outside().code, 3) << "of the day before";
  night("2", 2, "");
  const Outcome clean = outside();
  EXPECT_EQ(clean.code, 0) << clean.out;
  night("3", 1, R"(,"reason":"No space left on device","by_error":true)");
  const Outcome failed = outside();
  EXPECT_EQ(failed.code, 3);
  EXPECT_THAT(failed.out, HasSubstr("No space left on device"));
  for (const fs::path& session : Sessions(store)) EXPECT_FALSE(fs::exists(session / "fits"));
}

TEST_F(BatchNight, BadWordsAreNamed) {
  const fs::path store = Captured("words");
  const std::string batch = "stratalux-fit batch ", in = " --store " + store.string();
  EXPECT_THAT(Execute(batch + "run --until 25:00" + in).out, HasSubstr("--until 25:00: expected a time of day"));
  EXPECT_EQ(Execute(batch + "run --until 7" + in).code, 2);
  EXPECT_EQ(Execute(batch + "run --from 20:00" + in).code, 2);
  EXPECT_EQ(Execute(batch + "run --workers 2 --layers 99" + in).code, 2);
  EXPECT_EQ(Execute(batch + "status" + in).code, 4);
  EXPECT_THAT(Execute(batch + "report" + in).out, HasSubstr("has had no night"));
  EXPECT_THAT(Execute(batch + "retry" + in).out, HasSubstr("--all"));
  EXPECT_EQ(Execute(batch + "retry 99" + in).code, 4);
  EXPECT_EQ(Execute(batch + "run --store /nowhere").code, 4);
  EXPECT_EQ(Execute(batch).code, 2);
  EXPECT_FALSE(fs::exists(store / "nights"));
}

}  // namespace
}  // namespace stratalux
