// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit export`: what leaves the store is what the fit holds, as files that other programs accept; whatever
// ends it, the folder holds whole files.
#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/catalogue/artifact_record.h"
#include "db/privacy/access_log.h"
#include "fitter/export/exr_file.h"
#include "fitter/pipeline/key_lock.h"
#include "fitter/stages/surface_export.h"
#include "shared/image/png.h"
#include "tests/fitter/export/read_export.h"
#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using Json = nlohmann::json;

const std::vector<std::string> kFiles = {"mesh.ply", "mesh.glb",  "cloud.ply",  "depth.tif", "normal.tif",
                                         "skin.tif", "depth.exr", "normal.exr", "skin.exr",  "export.json"};

class Export : public SmallFit {
 protected:
  [[nodiscard]] static std::string To(const fs::path& out) { return "export latest --out " + out.string(); }
  static fs::path FitOf(const fs::path& store) {
    for (const auto& entry : fs::directory_iterator(Session(store) / "fits")) return entry.path();
    ADD_FAILURE() << "no fit";
    return {};
  }
  static Image<float> Exr(const fs::path& file, const std::vector<std::string>& channels) {
    auto image = fit::ReadExr(file, channels);
    EXPECT_TRUE(image.ok()) << image.status().message();
    return image.ok() ? std::move(*image) : Image<float>();
  }
  static std::map<std::string, std::string> FilesIn(const fs::path& folder) {
    std::map<std::string, std::string> files;
    for (const auto& entry : fs::recursive_directory_iterator(folder))
      if (entry.is_regular_file()) files[fs::relative(entry.path(), folder).string()] = ReadText(entry.path());
    return files;
  }
  // The record's files are there, whole.
  static void ExpectWhole(const fs::path& out, const std::string& where) {
    const Json record = Json::parse(ReadText(out / "export.json"), nullptr, false);
    ASSERT_TRUE(record.is_object()) << where;
    for (const Json& file : record.at("files")) {
      const fs::path path = out / file.at("name").get<std::string>();
      EXPECT_EQ(fs::file_size(path), file.at("bytes")) << where << ": " << path;
      EXPECT_EQ(Shell("sha256sum < " + path.string()).out.substr(0, 64), file.at("sha256").get<std::string>())
          << where << ": " << path;
    }
  }
  // `fault` as tests/db/crash/preload.cc reads it, on the folder of the files.
  static Outcome Disturbed(const fs::path& store, const fs::path& out, const std::string& fault,
                           const fs::path& count = "/dev/null") {
    Running run({"stratalux-fit", "export", "latest", "--store", store.string(), "--out", out.string()},
                store.parent_path() / "log",
                {std::string("LD_PRELOAD=") + STRATALUX_FAULT_LAYER, "ASAN_OPTIONS=verify_asan_link_order=0",
                 "STORE_FAULT=" + fault + " " + out.string(), "STORE_FAULT_COUNT=" + count.string()});
    return run.Wait();
  }
  // Moments of an undisturbed export, as file calls: spread over it, and all of its end, where files get their names.
  static std::vector<int64_t> Moments(const fs::path& store, const fs::path& out) {
    const fs::path count = store.parent_path() / "count";
    EXPECT_EQ(Disturbed(store, out, "death " + std::to_string(kNever) + " once", count).code, 0);
    const int64_t calls = std::atoll(ReadText(count).c_str());
    std::vector<int64_t> moments;
    for (int64_t k = 0; k < 20; ++k) moments.push_back(calls * k / 20);
    for (int64_t call = std::max<int64_t>(0, calls - 30); call < calls; call += 2) moments.push_back(call);
    return moments;
  }
};

TEST_F(Export, HoldsWhatTheFitHolds) {
  const fs::path store = Fitted("store"), folder = FitOf(store), out = folder_ / "face";
  const Outcome outcome = Execute("stratalux-fit " + To(out) + " --json --store " + store.string(), Show::kStdout);
  ASSERT_EQ(outcome.code, 0) << outcome.out;
  const Json said = Json::parse(outcome.out);
  EXPECT_EQ(said.at("fit"), folder.filename().string());
  EXPECT_EQ(said.at("session"), Session(store).filename().string());
  EXPECT_EQ(said.at("layers"), "from four projectors");
  EXPECT_EQ(said.at("sealed"), false);
  EXPECT_EQ(said.at("files").size() + 1, kFiles.size());
  ExpectWhole(out, "the first");

  const Image<float> position = Exr(folder / "position.exr", {"X", "Y", "Z"}),
                     sigma = Exr(folder / "depth_sigma.exr", {"Y"}), mask = Exr(folder / "masks.exr", {"surface"}),
                     skin = Exr(folder / "skin.exr", {"skin"}), skin_out = Exr(out / "skin.exr", {"skin"}),
                     fused = Exr(folder / "normal_fused.exr", {"X", "Y", "Z"}), depth = Exr(out / "depth.exr", {"Z"}),
                     normal = Exr(out / "normal.exr", {"X", "Y", "Z"}),
                     diffuse = Exr(folder / "normal_diffuse.exr", {"Y.X", "Y.Y", "Y.Z"}),
                     diffuse_out = Exr(out / "normal.exr", {"Y.X", "Y.Y", "Y.Z"});
  const fit::PlyRead mesh = fit::ReadPly(out / "mesh.ply"), cloud = fit::ReadPly(out / "cloud.ply"),
                     stored = fit::ReadPly(folder / "mesh.ply");
  const fit::GlbRead glb = fit::ReadGlb(out / "mesh.glb");
  EXPECT_EQ(mesh.faces, stored.faces);
  // A clear coat where the fit knows how the surface itself reflects.
  const bool coated = !Json::parse(ReadText(folder / "layers.json")).at("surface").is_null();
  EXPECT_EQ(!glb.coat_normal_png.empty(), coated);
  WriteText(folder_ / "normals.png", coated ? glb.coat_normal_png : glb.normal_png);
  const auto texture = ReadPng(folder_ / "normals.png", nullptr);
  ASSERT_TRUE(texture.ok()) << texture.status().message();
  size_t v = 0, of_skin = 0, shaded_as_fused = 0;
  for (int j = 0; j < mask.height(); ++j)
    for (int i = 0; i < mask.width(); ++i) {
      EXPECT_EQ(std::isfinite(depth(i, j)), mask(i, j) != 0.0F);
      EXPECT_EQ(std::isfinite(skin_out(i, j)), mask(i, j) != 0.0F);
      if (mask(i, j) == 0.0F) continue;
      const Eigen::Vector3d x(position(i, j, 0), position(i, j, 1), position(i, j, 2)), ray = x.normalized();
      EXPECT_EQ(depth(i, j), position(i, j, 2));
      EXPECT_EQ(skin_out(i, j), skin(i, j));
      EXPECT_EQ(cloud.columns.at("skin")[v], skin(i, j));
      of_skin += skin(i, j) != 0.0F ? 1 : 0;
      EXPECT_EQ(mesh.columns.at("z")[v], position(i, j, 2));
      EXPECT_FLOAT_EQ(glb.positions.at(v)[2], -position(i, j, 2) / 1000.0F);
      if (std::isfinite(fused(i, j, 0))) {
        EXPECT_NEAR(normal(i, j, 0), fused(i, j, 0), 1e-6);
      }
      for (int c = 0; c < 3; ++c) EXPECT_EQ(diffuse_out(i, j, c), diffuse(i, j, c));
      const Eigen::Vector3d turned(normal(i, j, 0), -normal(i, j, 1), -normal(i, j, 2));
      shaded_as_fused += turned.dot(fit::ShadedNormal(glb, *texture, v)) > std::cos(0.5 * M_PI / 180.0) ? 1 : 0;
      const auto& c = cloud.columns;
      Eigen::Matrix3d covariance;
      covariance << c.at("cov_xx")[v], c.at("cov_xy")[v], c.at("cov_xz")[v], c.at("cov_xy")[v], c.at("cov_yy")[v],
          c.at("cov_yz")[v], c.at("cov_xz")[v], c.at("cov_yz")[v], c.at("cov_zz")[v];
      EXPECT_GT(covariance.llt().matrixL().toDenseMatrix().diagonal().minCoeff(), 0.0);
      EXPECT_NEAR(std::sqrt(ray.dot(covariance * ray)), sigma(i, j), 2e-3 * sigma(i, j));
      ++v;
    }
  EXPECT_EQ(v, said.at("points"));
  EXPECT_GT(shaded_as_fused, 0.98 * static_cast<double>(v)) << "but for silhouettes";
  EXPECT_EQ(of_skin, said.at("points_of_skin"));
  EXPECT_EQ(said.at("skin_told"), true);
  EXPECT_EQ(v, glb.positions.size());
  EXPECT_EQ(glb.triangles.size(), said.at("triangles"));
  EXPECT_EQ(glb.json.at("asset").at("extras").at("session"), said.at("session"));
  // A fitted texture: not one colour.
  EXPECT_GT(glb.png.size(), 400U);
  EXPECT_THAT(fit::FaultsOf(glb), IsEmpty());
}

TEST_F(Export, IsTheSameFromTheSameFitAndOnlyWhatIsAsked) {
  const fs::path store = Fitted("store"), out = folder_ / "face", again = folder_ / "again";
  ASSERT_EQ(Fit(store, To(out)).code, 0);
  ASSERT_EQ(Fit(store, To(again) + " --format cloud,glb --fit " + FitOf(store).filename().string()).code, 0);
  auto few = FilesIn(again);
  EXPECT_EQ(few.size(), 4U) << "with export.json and the marker";
  for (const char* name : {"mesh.glb", "cloud.ply"}) EXPECT_EQ(few[name], ReadText(out / name));
  // What another export put there stays, and is replaced by the next one of its own.
  const Outcome into = Fit(store, To(again) + " --format exr");
  EXPECT_EQ(into.code, 0) << into.out;
  EXPECT_TRUE(fs::exists(again / "mesh.glb"));
  ExpectWhole(again, "formats one after the other");

  EXPECT_EQ(Fit(store, To(folder_ / "no") + " --format obj").code, 2);
  const Outcome unknown = Fit(store, To(folder_ / "no") + " --fit 0123456789abcdef");
  EXPECT_EQ(unknown.code, 4);
  EXPECT_THAT(unknown.out, HasSubstr("no fit 0123456789abcdef"));
  // Nor does `render` take a name for a path.
  for (const std::string& fit : {std::string("0123456789abcdef"), "../fits/" + FitOf(store).filename().string()}) {
    const Outcome picture =
        Fit(store, "render latest --direction=0,0,-1 --out " + (folder_ / "no").string() + " --fit " + fit);
    EXPECT_EQ(picture.code, 4) << picture.out;
    EXPECT_THAT(picture.out, HasSubstr("no fit " + fit));
  }
  EXPECT_EQ(Fit(store, "export latest").code, 2) << "without a folder";
  EXPECT_FALSE(fs::exists(folder_ / "no"));
}

TEST_F(Export, OfASessionWithoutAFitIsItsSurface) {
  const fs::path store = Captured("store"), out = folder_ / "face";
  const Outcome nothing = Fit(store, To(out));
  EXPECT_EQ(nothing.code, 4);
  EXPECT_THAT(nothing.out, HasSubstr("`stratalux-fit run"));
  EXPECT_FALSE(fs::exists(out));
  ASSERT_EQ(Fit(store, "reconstruct latest").code, 0);
  const Outcome bare = Fit(store, To(out));
  EXPECT_EQ(bare.code, 0) << bare.out;
  EXPECT_THAT(bare.out, HasSubstr("without colour"));
  ExpectWhole(out, "bare");
  const Json record = Json::parse(ReadText(out / "export.json"));
  EXPECT_FALSE(record.contains("fit"));
  EXPECT_EQ(record.at("points_without_albedo"), record.at("points"));
  EXPECT_EQ(record.at("points_of_skin"), record.at("points"));
  EXPECT_EQ(record.at("skin_told"), false);
  EXPECT_THAT(fit::FaultsOf(fit::ReadGlb(out / "mesh.glb")), IsEmpty());

  // Of its artifact, too, a file that is not what its record says is named.
  for (const auto& entry : fs::directory_iterator(Session(store) / "artifacts")) {
    if (!entry.path().filename().string().starts_with("shape-")) continue;
    const fs::path file = entry.path() / "position.exr";
    fs::permissions(entry.path(), fs::perms::owner_all);
    fs::remove(file);
    WriteText(file, "no map");
    const Outcome damaged = Fit(store, To(folder_ / "no"));
    EXPECT_EQ(damaged.code, 6);
    EXPECT_THAT(damaged.out, HasSubstr(file.string()));
    EXPECT_FALSE(fs::exists(folder_ / "no"));
  }
}

// A run that ended between two hold-outs has placed the surface by some of the lights last.
TEST_F(Export, OfASessionWithoutAFitIsTheSurfaceByAllLights) {
  const fs::path store = Fitted("store"), artifacts = Session(store) / "artifacts";
  const auto records = [&](const std::string& stage) {
    std::vector<db::ArtifactRecord> of_stage;
    for (const auto& entry : fs::directory_iterator(artifacts))
      if (entry.path().filename().string().starts_with(stage + "-"))
        of_stage.push_back(*db::ReadArtifactRecord(entry.path()));
    return of_stage;
  };
  // `record`'s files under another identity, finished a second later; of the surface they are no surface.
  const auto put = [&](const db::ArtifactRecord& record, db::ArtifactIdentity identity) {
    db::ArtifactRecord other = record;
    other.identity = std::move(identity);
    other.finished_wall.ns += 1'000'000'000;
    const fs::path folder = artifacts / other.identity.FolderName();
    fs::copy(artifacts / record.identity.FolderName(), folder);
    fs::permissions(folder, fs::perms::owner_all);
    fs::remove(folder / "artifact.json");
    WriteText(folder / "artifact.json", db::ToJson(other));
    if (other.identity.stage != "placed_shape") return;
    fs::remove(folder / "position.exr");
    WriteText(folder / "position.exr", "no map");
  };
  const auto offsets = records("offset"), all_placed = records("placed_shape");
  const auto by_all = std::ranges::find_if(offsets, [](const db::ArtifactRecord& each) {
    return Json::parse(each.identity.options_json).at("heldout") == -1;
  });
  ASSERT_NE(by_all, offsets.end());
  const db::ArtifactRecord offset = *by_all;
  const auto on_it = std::ranges::find_if(all_placed, [&](const db::ArtifactRecord& each) {
    return each.identity.inputs.at("offset") == offset.identity.Key();
  });
  ASSERT_NE(on_it, all_placed.end());
  const db::ArtifactRecord placed = *on_it;
  Json options = Json::parse(offset.identity.options_json);
  options["heldout"] = 1;
  db::ArtifactIdentity blind = offset.identity, blind_placed = placed.identity;
  blind.options_json = options.dump();
  blind_placed.inputs["offset"] = blind.Key();
  put(offset, blind);
  put(placed, blind_placed);
  fs::remove_all(Session(store) / "fits");
  EXPECT_THAT(Db(store, "reindex").out, HasSubstr("it is no longer listed"));
  const Outcome bare = Fit(store, To(folder_ / "face"));
  EXPECT_EQ(bare.code, 0) << bare.out;
  EXPECT_THAT(bare.out, HasSubstr("the surface of its stage placed_shape"));
}

// Fits of programs that had no skin stage.
TEST_F(Export, OfAFitWithoutASkinMaskAllIsSkin) {
  const fs::path fit = folder_ / "older";
  fs::copy(FitOf(Fitted("store")), fit, fs::copy_options::recursive);
  const auto whole = fit::LoadFittedSurface(fit);
  ASSERT_TRUE(whole.ok()) << whole.status().message();
  EXPECT_TRUE(whole->skin_told);
  for (const char* name : {"skin.exr", "skin.json"}) EXPECT_TRUE(fs::remove(fit / name)) << name;
  const auto older = fit::LoadFittedSurface(fit);
  ASSERT_TRUE(older.ok()) << older.status().message();
  EXPECT_FALSE(older->skin_told);
  EXPECT_TRUE(std::ranges::equal(older->skin.pixels(), older->surface.mask.pixels()));
}

TEST_F(Export, IsLoggedMarkedAndForgotten) {
  const fs::path store = Fitted("store"), out = folder_ / "face";
  const std::string session = Session(store).filename().string();
  ASSERT_EQ(Fit(store, To(out)).code, 0);
  WriteText(out / "notes.txt", "somebody's own");
  const auto log = db::ListAccess(store, session);
  ASSERT_TRUE(log.ok());
  EXPECT_EQ(log->back().action, "export");
  EXPECT_THAT(log->back().detail, HasSubstr(out.string()));
  EXPECT_EQ(Db(store, "forget latest --yes").code, 0);
  EXPECT_EQ(FilesIn(out), (std::map<std::string, std::string>{{"notes.txt", "somebody's own"}}));
}

// At many of its file calls, from the first that is written to the last that gets its name. While files get their names
// there is no record of them.
TEST_F(Export, AFullDiskLeavesTheFormerFilesAndSaysSo) {
  const fs::path store = Fitted("store"), out = folder_ / "face";
  ASSERT_EQ(Fit(store, To(out)).code, 0);
  const auto before = FilesIn(out);
  auto unrecorded = before;
  unrecorded.erase("export.json");
  int full = 0, named = 0;
  for (int call = 0; call < 60; call += 3) {
    const Outcome outcome = Disturbed(store, out, "nospace " + std::to_string(call) + " on");
    if (outcome.code == 0) break;
    ++full;
    EXPECT_EQ(outcome.code, 1) << call << ": " << outcome.out;
    EXPECT_THAT(outcome.out, HasSubstr(out.string())) << call;
    const bool naming = !fs::exists(out / "export.json");
    named += naming ? 1 : 0;
    EXPECT_TRUE(FilesIn(out) == (naming ? unrecorded : before)) << call;
    if (naming) {
      ASSERT_EQ(Fit(store, To(out)).code, 0) << call;
    }
  }
  std::printf("%d full disks, %d of them while files got their names\n", full, named);
  EXPECT_GE(full, 3);
  EXPECT_LT(named, full / 2);
}

TEST_F(Export, ADeathLeavesWholeFilesAndTheNextOneTidiesUp) {
  const fs::path store = Fitted("store"), out = folder_ / "face";
  ASSERT_EQ(Fit(store, To(out)).code, 0);
  const auto before = FilesIn(out);
  int died = 0, unrecorded = 0;
  for (const int64_t call : Moments(store, out)) {
    const Outcome outcome = Disturbed(store, out, "death " + std::to_string(call) + " once");
    died += outcome.signal == SIGKILL ? 1 : 0;
    const bool recorded = fs::exists(out / "export.json");
    unrecorded += recorded ? 0 : 1;
    if (recorded) ExpectWhole(out, "death " + std::to_string(call));
    const auto after = FilesIn(out);
    for (const std::string& name : kFiles)
      EXPECT_TRUE(name == "export.json" || after.at(name) == before.at(name)) << call << ": " << name;
  }
  std::printf("%d deaths, %d of them while files got their names\n", died, unrecorded);
  EXPECT_GE(died, 30);
  EXPECT_GE(unrecorded, 1);
  ASSERT_EQ(Fit(store, To(out)).code, 0);
  EXPECT_EQ(FilesIn(out), before) << "nothing half made stays";
  EXPECT_EQ(Disturbed(store, out, "death 10 once").signal, SIGKILL);
  EXPECT_EQ(Db(store, "forget latest --yes").code, 0);
  EXPECT_FALSE(fs::exists(out)) << "what it left goes with the rest";
}

TEST_F(Export, AnInterruptionLeavesNothingHalf) {
  const fs::path store = Fitted("store"), out = folder_ / "face";
  int interrupted = 0;
  for (int wait_ms = 20; wait_ms <= 400; wait_ms += 20) {
    Running run({"stratalux-fit", "export", "latest", "--store", store.string(), "--out", out.string()},
                folder_ / "log");
    std::this_thread::sleep_for(std::chrono::milliseconds(wait_ms));
    run.Send(SIGTERM);
    const Outcome outcome = run.Wait();
    interrupted += outcome.signal == SIGTERM ? 1 : 0;
    if (!fs::exists(out)) continue;
    for (const auto& entry : fs::directory_iterator(out)) {
      const std::string name = entry.path().filename().string();
      EXPECT_TRUE(name.starts_with(".stratalux-export-s") ||
                  std::find(kFiles.begin(), kFiles.end(), name) != kFiles.end())
          << name;
    }
    if (fs::exists(out / "export.json")) ExpectWhole(out, std::to_string(wait_ms) + " ms");
  }
  std::printf("%d of 20 interrupted\n", interrupted);
  EXPECT_GE(interrupted, 1);
}

TEST_F(Export, TwoAtOnceDoNotMix) {
  const fs::path store = Fitted("store"), out = folder_ / "face";
  ASSERT_EQ(Fit(store, To(out)).code, 0);
  const auto before = FilesIn(out);
  {
    const auto held = fit::KeyLock::Try(out / ".stratalux-export.lock");
    ASSERT_TRUE(held.ok() && held->held());
    const Outcome second = Fit(store, To(out));
    EXPECT_EQ(second.code, 5) << second.out;
    EXPECT_THAT(second.out, HasSubstr("another export writes to"));
  }
  EXPECT_EQ(FilesIn(out), before);
  EXPECT_EQ(Fit(store, To(out)).code, 0);
}

TEST_F(Export, AReportsCopyTakesTheEarlierOnesPlaceWhole) {
  const fs::path store = Fitted("store"), out = folder_ / "report", earlier = folder_ / "earlier";
  const std::string copy = "report latest --out " + out.string();
  ASSERT_EQ(Fit(store, copy).code, 0);
  const auto files = FilesIn(out);
  fs::remove(out / "metrics.json");
  WriteText(out / "metrics.json", "earlier");
  fs::create_hard_link(out / "metrics.json", earlier);
  WriteText(out / "report" / "index.html.new", "of a killed copy");
  const Outcome again = Fit(store, copy);
  ASSERT_EQ(again.code, 0) << again.out;
  EXPECT_EQ(ReadText(earlier), "earlier") << "written in place";
  EXPECT_TRUE(FilesIn(out) == files);
}

// STRATALUX_NODE_MODULES: a folder with Khronos' validator (tests/web/package.json); ctest's web.gltf has it.
TEST_F(Export, PassesKhronosValidator) {
  const char* modules = std::getenv("STRATALUX_NODE_MODULES");
  if (modules == nullptr || !fs::exists(fs::path(modules) / "gltf-validator"))
    GTEST_SKIP() << "no gltf-validator: ctest -R web.gltf fetches it";
  const fs::path store = Fitted("store"), captured = Captured("captured"), bad = folder_ / "bad.glb";
  ASSERT_EQ(Fit(store, To(folder_ / "face") + " --format glb").code, 0);
  ASSERT_EQ(Fit(captured, "reconstruct latest").code, 0);
  ASSERT_EQ(Fit(captured, To(folder_ / "bare") + " --format glb").code, 0);
  const auto validate = [&](const fs::path& file) {
    return Shell(std::string("node ") + STRATALUX_GLTF_VALIDATOR + " " + modules + " " + file.string() + " 2>&1");
  };
  for (const char* name : {"face", "bare"}) {
    const Outcome outcome = validate(folder_ / name / "mesh.glb");
    EXPECT_EQ(outcome.code, 0) << outcome.out;
    EXPECT_THAT(outcome.out, HasSubstr("errors 0 warnings 0"));
    std::printf("%s/%s", name, outcome.out.c_str());
  }
  // It is not deaf: a byte of the bounds.
  std::string bytes = ReadText(folder_ / "face" / "mesh.glb");
  const size_t bound = bytes.find("\"max\":[");
  ASSERT_NE(bound, std::string::npos);
  bytes[bound + 9] = bytes[bound + 9] == '9' ? '8' : '9';
  WriteText(bad, bytes);
  const Outcome refused = validate(bad);
  EXPECT_EQ(refused.code, 1) << refused.out;
}

}  // namespace
}  // namespace stratalux
