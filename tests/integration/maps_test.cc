// SPDX-License-Identifier: Apache-2.0
// Maps from all projectors through `stratalux-fit run`: made beside the fit that leaves one out, used by what shows
// skin, and by nothing that judges the fit.
#include <set>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

class Maps : public SmallFit {
 protected:
  static std::string Options(const std::string& verb) { return verb + " latest " + kSmallFitOptions; }
  // Fits of the store's session; the one that has maps, or has none.
  static fs::path FitOf(const fs::path& store, bool with_maps) {
    for (const auto& entry : fs::directory_iterator(Session(store) / "fits"))
      if (fs::exists(entry.path() / "maps") == with_maps) return entry.path();
    ADD_FAILURE() << "no fit " << (with_maps ? "with" : "without") << " maps";
    return {};
  }
  static Json Metrics(const fs::path& fit) { return Json::parse(ReadText(fit / "metrics.json")); }
};

TEST_F(Maps, AreMadeByDefaultAndSayWhereTheyComeFrom) {
  const fs::path store = Fitted("store"), fit = FitOf(store, true);
  const Json maps = Json::parse(ReadText(fit / "maps" / "maps.json"));
  EXPECT_EQ(maps["provenance"], "from four projectors");
  EXPECT_EQ(maps["heldout_of_fit"], 3);
  EXPECT_GT(maps["profiles"]["fitted"], 100);
  for (const char* file : {"layers_weight.exr", "quality.exr", "total_weight.exr", "mean_depth_mm.exr"})
    EXPECT_NE(ReadText(fit / "maps" / file), ReadText(fit / file)) << file;
  EXPECT_EQ(Json::parse(ReadText(fit / "layers.json"))["training_projectors"], Json({0, 1, 2}));
  EXPECT_EQ(Json::parse(ReadText(fit / "maps" / "layers.json"))["training_projectors"], Json({0, 1, 2, 3}));
  const std::string page = ReadText(fit / "report" / "index.html");
  EXPECT_THAT(page, HasSubstr("layer maps from four projectors"));
  EXPECT_THAT(page, HasSubstr("Layers fitted on all projectors but 3"));
  // Known to the record, to what checks files and to what frees them.
  const Json record = Json::parse(ReadText(fit / "fit.json"));
  EXPECT_TRUE(record["artifacts"].contains("maps"));
  EXPECT_EQ(Db(store, "verify --deep").code, 0);
  EXPECT_THAT(Fit(store, "clean latest").out, Not(HasSubstr("maps-")));
  WriteText(fit / "maps" / "maps.json", "{}");
  const Outcome verify = Db(store, "verify --deep");
  EXPECT_EQ(verify.code, 6);
  EXPECT_THAT(verify.out, HasSubstr("maps/maps.json"));
  EXPECT_EQ(Db(store, "forget latest --yes").code, 0);
  EXPECT_FALSE(fs::exists(fit));
}

TEST_F(Maps, ADryRunListsThemAndTheirVerbMakesThem) {
  const fs::path store = Captured("store");
  const Outcome plan = Fit(store, Options("run") + " --dry-run");
  EXPECT_THAT(plan.out, HasSubstr("maps, all projectors: runs: never run"));
  EXPECT_THAT(Fit(store, Options("run") + " --dry-run --maps off").out, Not(HasSubstr("maps")));
  EXPECT_THAT(Fit(store, Options("run") + " --dry-run --mode free").out, Not(HasSubstr("maps")));
  const Outcome free = Fit(store, Options("maps") + " --mode free");
  EXPECT_EQ(free.code, 2);
  EXPECT_THAT(free.out, HasSubstr("--mode free"));
  const Outcome made = Execute("stratalux-fit " + Options("maps") + " --store " + store.string(), Show::kStdout);
  ASSERT_EQ(made.code, 0) << made.out;
  EXPECT_TRUE(fs::exists(fs::path(made.out.substr(0, made.out.find('\n'))) / "maps" / "layers_weight.exr"));
  EXPECT_FALSE(fs::exists(Session(store) / "fits"));
}

// Whatever judges a fit is made of the same with maps and without, and no stage that it is made of has read them.
TEST_F(Maps, NoHeldOutFigureReadsThem) {
  const fs::path store = Fitted("store");
  ASSERT_EQ(Fit(store, Options("run") + " --full-evaluation --standard-errors").code, 0);
  std::map<std::string, Json> inputs;  // by key
  std::map<std::string, std::string> stage_of;
  for (const auto& entry : fs::directory_iterator(Session(store) / "artifacts")) {
    const Json record = Json::parse(ReadText(entry.path() / "artifact.json"));
    const std::string stage = record["stage"], key = entry.path().filename().string().substr(stage.size() + 1);
    inputs[key] = record["inputs"];
    stage_of[key] = stage;
  }
  int judged = 0, maps = 0;
  for (const auto& [key, stage] : stage_of) {
    maps += stage == "maps" ? 1 : 0;
    std::set<std::string> seen;
    std::vector<std::string> open = {key};
    while (!open.empty()) {
      const std::string at = open.back();
      open.pop_back();
      if (!seen.insert(at).second || !inputs.contains(at)) continue;
      // Nothing that is judged reads diffuse normals, either, or it would come to the maps by them.
      EXPECT_TRUE(at == key || stage_of[at] != "maps" || stage == "diffuse_normals") << stage << " reads the maps";
      for (const auto& [name, input] : inputs[at].items()) open.push_back(input.get<std::string>());
    }
    judged += stage == "compare" || stage == "predict" ? 1 : 0;
  }
  EXPECT_EQ(maps, 1);
  EXPECT_GT(judged, 15);

  const fs::path without = Fitted("without");
  ASSERT_EQ(Fit(without, Options("run") + " --maps off").code, 0);
  const Json with_maps = Metrics(FitOf(without, true)), no_maps = Metrics(FitOf(without, false));
  EXPECT_FALSE(with_maps["prediction"].empty());
  for (const char* figures : {"prediction", "coverage", "srd_centroid", "fit"})
    EXPECT_EQ(with_maps[figures], no_maps[figures]) << figures;
  EXPECT_EQ(with_maps["artifacts"]["fit"], no_maps["artifacts"]["fit"]);
}

TEST_F(Maps, PicturesAreOfThemWhereTheFitHasThemAndSaySo) {
  const fs::path store = Fitted("store");
  ASSERT_EQ(Fit(store, Options("run") + " --maps off").code, 0);
  const std::string with_maps = FitOf(store, true).filename(), without = FitOf(store, false).filename();
  const auto lit = [&](const std::string& options, const std::string& name) {
    const fs::path out = folder_ / name;
    const Outcome outcome = Fit(store, "render latest --direction=0.3,0,-1 " + options + " --out " + out.string());
    EXPECT_EQ(outcome.code, 0) << outcome.out;
    return std::pair(ReadText(out / "total.exr"), Json::parse(ReadText(out / "relit.json")));
  };
  const auto [best, of_best] = lit("--fit " + with_maps, "best");
  const auto [on, of_on] = lit("--maps on --fit " + with_maps, "on");
  const auto [off, of_off] = lit("--maps off --fit " + with_maps, "off");
  const auto [none, of_none] = lit("--fit " + without, "none");
  EXPECT_TRUE(best == on);
  EXPECT_FALSE(best == off);
  EXPECT_TRUE(off == none) << "the fit's own layers, with maps beside them and without";
  EXPECT_EQ(of_best["layers"], "from four projectors");
  EXPECT_EQ(of_best["fit"], with_maps);
  EXPECT_EQ(of_off["layers"], "from three projectors, projector 3 held out");
  EXPECT_EQ(of_none["layers"], of_off["layers"]);
  EXPECT_THAT(ReadText(FitOf(store, false) / "report" / "index.html"),
              HasSubstr("layer maps from three projectors, projector 3 held out"));
  const Outcome missing = Fit(store, "render latest --direction=0,0,-1 --maps on --fit " + without + " --out " +
                                         (folder_ / "missing").string());
  EXPECT_EQ(missing.code, 4) << missing.out;
  EXPECT_THAT(missing.out, HasSubstr("--maps off"));
  EXPECT_FALSE(fs::exists(folder_ / "missing"));
}

// A fit on the true surface is told of by that surface, though its mask of skin is of the reconstructed one.
TEST_F(Maps, WhatIsToldOfATrueSurfaceIsOfIt) {
  const fs::path store = Fitted("store");
  ASSERT_EQ(Fit(store, Options("run") + " --maps off --geometry truth").code, 0);
  const Json metrics = Metrics(FitOf(store, false)), reconstructed = Metrics(FitOf(store, true));
  EXPECT_LT(metrics["normals"]["surface"]["rms_deg"], 0.1);
  EXPECT_GT(reconstructed["normals"]["surface"]["rms_deg"], 1.0);  // what a mix-up would say
  EXPECT_EQ(metrics["skin"], reconstructed["skin"]);
}

}  // namespace
}  // namespace stratalux
