// SPDX-License-Identifier: Apache-2.0
// What became of a finished fit and its artifacts: changed files are named by whoever reads them and made again, other
// verbs leave the fit alone, and a dry run names what an option touches.
#include <functional>
#include <set>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>

#include "db/base/own_hash.h"
#include "db/catalogue/fit_record.h"
#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::IsSupersetOf;
using ::testing::Not;
using ::testing::UnorderedElementsAre;
using Json = nlohmann::json;

// Of another inode: the fit's own name of the file keeps what it had.
void Replace(const fs::path& file, const std::string& text) {
  fs::remove(file);
  WriteText(file, text);
}

// `text` as the record of the folder, its own hash right.
void Forge(const fs::path& record, const std::function<void(Json&)>& change) {
  Json json = Json::parse(ReadText(record));
  json.erase("hash");
  change(json);
  Replace(record, db::WithOwnHash(json.dump(1)));
}

struct Damage {
  const char* name;
  const char* file;  // of the artifact
  std::function<void(const fs::path&)> how;
  int code = 6;  // of what reads it
};

// Every third, as the seed has it; all of them at night.
std::vector<Damage> Sample(std::vector<Damage> all) {
  if (Kills() >= 100) return all;
  std::vector<Damage> some;
  for (size_t i = Seed() % 3; i < all.size(); i += 3) some.push_back(std::move(all[i]));
  return some;
}

std::vector<Damage> Damages() {
  const auto flip = [](std::string text) {
    text[text.size() / 2] = static_cast<char>(text[text.size() / 2] ^ 1);
    return text;
  };
  const auto record = [](const char* member, const Json& value) {
    return [=](const fs::path& file) { Forge(file, [&](Json& json) { json[member] = value; }); };
  };
  std::string deep(100'000, '[');
  deep.append(100'000, ']');
  return {
      {"a byte is another", "quality.exr", [=](const fs::path& f) { Replace(f, flip(ReadText(f))); }},
      {"cut short", "quality.exr", [](const fs::path& f) { Replace(f, ReadText(f).substr(0, 100)); }},
      {"removed", "quality.exr", [](const fs::path& f) { fs::remove(f); }},
      {"a link", "quality.exr",
       [](const fs::path& f) {
         fs::remove(f);
         fs::create_symlink("/etc/hostname", f);
       }},
      {"a folder", "quality.exr",
       [](const fs::path& f) {
         fs::remove(f);
         fs::create_directory(f);
       }},
      {"no record", "artifact.json", [](const fs::path& f) { fs::remove(f); }},
      {"an empty record", "artifact.json", [](const fs::path& f) { Replace(f, ""); }},
      {"a changed record", "artifact.json", [=](const fs::path& f) { Replace(f, flip(ReadText(f))); }},
      {"a later schema", "artifact.json", record("schema", 99), 7},
      {"a schema of 1e300", "artifact.json", record("schema", 1e300)},
      {"a version of 1e300", "artifact.json", record("version", 1e300)},
      {"sizes of 1e300", "artifact.json",
       [](const fs::path& f) { Forge(f, [](Json& json) { json["files"][0]["bytes"] = 1e300; }); }},
      {"an end at 1e300", "artifact.json", record("finished_wall_ns", 1e300)},
      {"files that are none", "artifact.json", record("files", "all")},
      {"a file from elsewhere", "artifact.json",
       [](const fs::path& f) { Forge(f, [](Json& json) { json["files"][0]["name"] = "../../manifest.json"; }); }},
      {"deep nesting", "artifact.json",
       [=](const fs::path& f) {
         Forge(f, [](Json& json) { json["options"] = "NEST"; });
         std::string text = ReadText(f);
         text = text.substr(0, text.find(",\n \"hash\"")) + "\n}";
         text.replace(text.find("\"NEST\""), 6, deep);
         Replace(f, db::WithOwnHash(text));
       }},
  };
}

class DamagedArtifacts : public SmallFit {
 protected:
  static fs::path FitOf(const fs::path& store) {
    for (const auto& entry : fs::directory_iterator(Session(store) / "fits")) return entry.path();
    ADD_FAILURE() << "no fit";
    return {};
  }
  // That the fit is made of, if there is one.
  static fs::path Artifact(const fs::path& store, const std::string& stage, const std::string& file) {
    const Json record = Json::parse(ReadText(FitOf(store) / "fit.json"));
    if (record["artifacts"].contains(stage))
      return Session(store) / "artifacts" / record["artifacts"][stage].get<std::string>();
    for (const auto& entry : fs::directory_iterator(Session(store) / "artifacts"))
      if (entry.path().filename().string().starts_with(stage + "-") && fs::exists(entry.path() / file)) return entry;
    ADD_FAILURE() << "no artifact of " << stage;
    return {};
  }
  static void ExpectNamed(const Outcome& outcome, int code, const fs::path& file, const std::string& where) {
    EXPECT_EQ(outcome.signal, 0) << where;
    EXPECT_EQ(outcome.code, code) << where << ": " << outcome.out;
    EXPECT_THAT(outcome.out, HasSubstr(file.string())) << where;
  }
  static std::string Options(const std::string& verb) { return verb + " latest " + kSmallFitOptions; }
};

TEST_F(DamagedArtifacts, AreNamedByWhoReadsThemAndMadeAgain) {
  const fs::path store = Fitted("store"), folder = Artifact(store, "fit", "quality.exr");
  for (const Damage& damage : Sample(Damages())) {
    SCOPED_TRACE(damage.name);
    damage.how(folder / damage.file);
    const fs::path file = folder / damage.file;
    ExpectNamed(Fit(store, Options("fit")), damage.code, file, "fit");
    ExpectNamed(Db(store, "verify --deep"), 6, file, "verify");
    EXPECT_THAT(Fit(store, "clean latest --damaged").out, HasSubstr("1 artifacts removed"));
    EXPECT_EQ(Fit(store, Options("fit")).code, 0);
    ExpectAsUndisturbed(store, damage.name);
  }
}

// It has a name of its own for each file.
TEST_F(DamagedArtifacts, HarmNoFinishedFit) {
  const fs::path store = Fitted("store"), folder = Artifact(store, "fit", "quality.exr"), file = folder / "quality.exr";
  Replace(file, "no map");
  EXPECT_EQ(Fit(store, Options("run")).code, 0);
  EXPECT_EQ(Fit(store, "report latest").code, 0);
  ExpectNamed(Fit(store, Options("run") + " --standard-errors"), 6, file, "run that reads it");
  EXPECT_THAT(Fit(store, "clean latest --damaged --dry-run").out, HasSubstr(folder.filename().string()));
  EXPECT_EQ(ReadText(file), "no map") << "a dry run";
}

// A run that is not yet done reads what an earlier one has made.
TEST_F(DamagedArtifacts, EndTheRunThatNeedsThem) {
  const fs::path store = Fitted("store"), folder = Artifact(store, "shape", "position.exr");
  fs::remove_all(FitOf(store));
  Replace(folder / "position.exr", ReadText(folder / "depth_sigma.exr"));
  ExpectNamed(Fit(store, Options("run")), 6, folder / "position.exr", "run");
  EXPECT_THAT(Leftovers(store, true), IsEmpty());
  EXPECT_THAT(Fit(store, "clean latest --damaged").out, HasSubstr("1 artifacts removed"));
  EXPECT_EQ(Fit(store, Options("run")).code, 0);
  ExpectAsUndisturbed(store, "after clean and run");
}

// docs/operators-guide.md: clean --damaged, the fit's folder removed, run.
TEST_F(DamagedArtifacts, AFitThatWasChangedIsNamedAndMadeAgain) {
  const fs::path store = Fitted("store"), fit = FitOf(store);
  const auto in_place = [](const fs::path& file) { WriteText(file, std::string(fs::file_size(file), 'x')); };
  const std::vector<Damage> damages = {
      {"written over, in the artifact as well", "layers_depth_mm.exr", in_place},
      {"another map", "layers_depth_mm.exr",
       [&](const fs::path& f) { Replace(f, ReadText(fit / "layers_sigma_mm.exr")); }},
      {"cut short", "report/index.html", [](const fs::path& f) { Replace(f, ReadText(f).substr(0, 999)); }},
      {"removed", "report/03.png", [](const fs::path& f) { fs::remove(f); }},
      {"other figures", "metrics.json", [](const fs::path& f) { Replace(f, "{\"evaluation\": \"full\"}"); }},
      {"nested figures", "metrics.json", [](const fs::path& f) { Replace(f, std::string(100'000, '[')); }},
      {"another record", "fit.json", [](const fs::path& f) { Replace(f, "{}"); }},
  };
  for (const Damage& damage : Sample(damages)) {
    SCOPED_TRACE(damage.name);
    const fs::path file = fit / damage.file;
    damage.how(file);
    ExpectNamed(Fit(store, Options("run")), 6, file, "run");
    ExpectNamed(Fit(store, "report latest --path-only"), 6, file, "report");
    ExpectNamed(Fit(store, "render latest --direction=0,0,-1 --out " + (folder_ / "out").string()), 6, file, "render");
    ExpectNamed(Fit(store, "export latest --out " + (folder_ / "out").string()), 6, file, "export");
    EXPECT_FALSE(fs::exists(folder_ / "out"));
    ExpectNamed(Db(store, "verify --deep"), 6, file, "verify");
    EXPECT_EQ(Fit(store, "clean latest --damaged").code, 0);
    fs::remove_all(fit);
    EXPECT_EQ(Fit(store, Options("run")).code, 0);
    ExpectAsUndisturbed(store, damage.name);
  }
}

// Stages that a fit is judged by change, too: figures of another program are no figures of this one.
TEST_F(DamagedArtifacts, FiguresOfAnotherProgramAreMadeAnew) {
  const fs::path store = Fitted("store"), fit = FitOf(store), metrics = fit / "metrics.json";
  const auto key = [&] { return Json::parse(ReadText(metrics))["evaluation_key"].get<std::string>(); };
  const std::string todays = key();
  Json others = Json::parse(ReadText(metrics));
  others["evaluation_key"] = std::string(todays.size(), '0');
  Replace(metrics, others.dump());
  const auto row = db::ReadFitRecord(fit, Session(store).filename().string());
  ASSERT_TRUE(row.ok()) << row.status().message();
  Replace(fit / db::kFitRecordFile, *db::FitRecordOf(fit, *row));
  const Outcome again = Fit(store, Options("run"));
  EXPECT_EQ(again.code, 0);
  EXPECT_THAT(again.out, Not(HasSubstr("complete already")));
  EXPECT_EQ(key(), todays);
  EXPECT_THAT(Fit(store, Options("run")).out, HasSubstr("complete already"));
  EXPECT_EQ(Db(store, "verify --deep").code, 0);
}

TEST_F(DamagedArtifacts, OtherVerbsLeaveAFinishedFitAlone) {
  const fs::path store = Fitted("store"), fit = FitOf(store);
  const auto all = [&] {
    std::map<std::string, std::pair<ino_t, std::string>> files;
    for (const auto& entry : fs::recursive_directory_iterator(Session(store))) {
      struct stat info {};
      if (entry.is_regular_file() && stat(entry.path().c_str(), &info) == 0)
        files[entry.path().string()] = {info.st_ino, ReadText(entry.path())};
    }
    return files;
  };
  const auto before = all();
  for (const char* verb : {"reconstruct", "separate", "normals", "skin", "srd", "fit", "run"}) {
    const Outcome outcome = Execute("stratalux-fit " + Options(verb) + " --store " + store.string(), Show::kStdout);
    EXPECT_EQ(outcome.code, 0) << verb;
    EXPECT_TRUE(fs::exists(outcome.out.substr(0, outcome.out.find('\n')))) << verb << outcome.out;
    EXPECT_TRUE(all() == before) << verb;
  }
  const Outcome report = Execute("stratalux-fit report latest --path-only --store " + store.string(), Show::kStdout);
  EXPECT_EQ(report.code, 0);
  EXPECT_EQ(report.out, (fit / "report" / "index.html").string() + "\n");
  EXPECT_TRUE(fs::exists(fit / "report" / "index.html"));
  EXPECT_EQ(Fit(store, "clean latest").code, 0);
  EXPECT_EQ(Fit(store, "report latest --path-only").code, 0);
  EXPECT_EQ(Db(store, "verify --deep").code, 0) << "a fit needs no artifact";
}

// As the night's unit does: whoever is being fitted is left, the others are cleaned.
TEST_F(DamagedArtifacts, CleanAllLeavesWhoIsBeingFittedAndTakesTheOthers) {
  const fs::path store = Fitted("store"), done = Session(store);
  const auto artifacts = [](const fs::path& session) {
    std::error_code error;
    return std::distance(fs::directory_iterator(session / "artifacts", error), fs::directory_iterator());
  };
  const auto before = artifacts(done);
  EXPECT_THAT(Fit(store, "clean --all --keep-days 1").out, HasSubstr("0 artifacts removed"));
  EXPECT_EQ(artifacts(done), before) << "younger than a day";
  ASSERT_EQ(Capture(store).code, 0);
  fs::path busy;
  for (const auto& entry : fs::directory_iterator(store / "sessions"))
    if (entry.path() != done) busy = entry.path();
  Running run(RunArguments(store), folder_ / "log");
  while (artifacts(busy) == 0 && !run.WaitFor(std::chrono::milliseconds(5))) {
  }
  run.Send(SIGSTOP);
  const Outcome clean = Execute("stratalux-fit clean --all --json --store " + store.string(), Show::kStdout);
  EXPECT_EQ(clean.code, 5);
  const auto json = nlohmann::json::parse(clean.out, nullptr, false);
  ASSERT_TRUE(json.is_object()) << clean.out;
  EXPECT_EQ(json["sessions"], nlohmann::json::array({done.filename().string()}));
  ASSERT_EQ(json["failed"].size(), 1U);
  EXPECT_EQ(json["failed"][0]["session"], busy.filename().string());
  EXPECT_EQ(static_cast<int64_t>(json["removed"].size()), before - artifacts(done));
  EXPECT_GT(json["removed"].size(), 0U);
  run.Send(SIGCONT);
  EXPECT_EQ(run.Wait().code, 0) << "nothing was taken from it";
  EXPECT_EQ(Fit(store, "clean --all").code, 0);
  EXPECT_EQ(Fit(store, "clean latest --all").code, 2) << "one or all";
  EXPECT_EQ(Db(store, "verify --deep").code, 0);
}

TEST_F(DamagedArtifacts, ADryRunNamesWhatAnOptionTouches) {
  const fs::path store = Fitted("store");
  const auto runs = [&](const std::string& options) {
    const Outcome outcome =
        Execute("stratalux-fit " + Options("run") + " --dry-run --json " + options + " --store " + store.string(),
                Show::kStdout);
    EXPECT_EQ(outcome.code, 0) << options;
    std::vector<std::string> stages;
    const Json plan = Json::parse(outcome.out);
    for (const Json& stage : plan["stages"])
      if (stage["runs"]) {
        EXPECT_NE(stage["why"], "") << stage;
        stages.push_back(stage["label"]);
      }
    return stages;
  };
  const State before = StateOf(store);
  EXPECT_THAT(runs(""), IsEmpty());
  const std::vector<std::string> errors = runs("--standard-errors");
  EXPECT_THAT(errors,
              UnorderedElementsAre("offset, projector 0 held out", "fit, projector 0 held out",
                                   "offset, projector 1 held out", "fit, projector 1 held out",
                                   "offset, projector 2 held out", "fit, projector 2 held out", "standard errors"));
  EXPECT_EQ(errors.back(), "standard errors");
  // What is judged of a fit is no part of it.
  const std::vector<std::string> full = runs("--full-evaluation");
  EXPECT_THAT(full, IsSupersetOf({"fit, projector 0 held out", "compare, projector 0 held out",
                                  "fit, projectors_permuted, projector 3 held out", "shape, of the truth",
                                  "compare, projector 3 held out, true geometry"}));
  for (const std::string& label : full)
    EXPECT_TRUE(label != "decode" && label != "shape" && label != "srd" && label != "separate" && label != "normals" &&
                label != "skin" && label != "fit, projector 3 held out")
        << label;
  EXPECT_THAT(runs("--heldout 1"), Not(Contains("srd")));
  EXPECT_TRUE(StateOf(store) == before);
  // One artifact of the evaluation is gone: that one runs.
  fs::remove_all(Artifact(store, "compare", "compare.json"));
  EXPECT_THAT(runs(""), ElementsAre("compare, projector 3 held out"));
  EXPECT_EQ(Fit(store, Options("run")).code, 0) << "the fit has its figures";
}

}  // namespace
}  // namespace stratalux
