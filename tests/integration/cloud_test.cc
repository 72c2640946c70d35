// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit cloud`: points from codes and a calibration alone.
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "shared/capture/rig_calibration.h"
#include "shared/image/png.h"
#include "tests/fitter/export/read_export.h"
#include "tests/integration/tiny_session.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/test_data.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

class Cloud : public TinyStore {
 protected:
  // The record that the visitor was captured with, and a change of it, as a file.
  [[nodiscard]] Json Record() const {
    return Json::parse(ReadText(Session("s000001-") / "manifest.json")).at("calibration");
  }
  [[nodiscard]] std::string RecordFile(const Json& record) const { return File("rig.json", record.dump()); }
  [[nodiscard]] std::string To(const fs::path& out) const { return " --out " + (folder_ / out).string(); }
  // The visitor once more, from image files, without those of which `left_out` is part of the pattern: s000003.
  void ImportWithout(const std::string& left_out) const {
    const fs::path files = folder_ / "files";
    ASSERT_EQ(Run("stratalux-db export s000001 --out " + files.string()).code, 0);
    std::string toml = ReadText(files / "import.toml"), kept;
    for (size_t at = 0, next = 0; at < toml.size(); at = next) {
      next = std::min(toml.find("[[file]]", at + 1), toml.size());
      const std::string part = toml.substr(at, next - at);
      if (part.find(left_out) == std::string::npos) kept += part;
    }
    ASSERT_LT(kept.size(), toml.size());
    const size_t kind = kept.find("kind = \"visitor\"");
    ASSERT_NE(kind, std::string::npos);
    kept.replace(kind, 16, "kind = \"calibration\"");
    if (const size_t visitor = kept.find("visitor = "); visitor < kept.find("[["))
      kept.erase(visitor, kept.find('\n', visitor) - visitor);
    WriteText(files / "import.toml", kept);
    const Outcome imported = Run("stratalux-db import --manifest " + (files / "import.toml").string());
    ASSERT_EQ(imported.code, 0) << imported.err;
  }
};

// What `reconstruct` and `export` make of the same codes by way of the stages.
TEST_F(Cloud, IsTheSurfaceOfTheShapeStage) {
  const Outcome made = Run("stratalux-fit cloud s000001 --json" + To("points"));
  ASSERT_EQ(made.code, 0) << made.err;
  const Json said = Json::parse(made.out);
  EXPECT_THAT(said.at("session").get<std::string>(), HasSubstr("s000001-"));
  const Json& cloud = said.at("clouds").at(0);
  EXPECT_EQ(cloud.at("file"), "cloud.ply");
  EXPECT_EQ(cloud.at("projectors"), Json({0, 1, 2, 3}));
  ASSERT_EQ(Run("stratalux-fit reconstruct s000001").code, 0);
  ASSERT_EQ(Run("stratalux-fit export s000001 --format cloud" + To("export")).code, 0);
  const fit::PlyRead ours = fit::ReadPly(folder_ / "points" / "cloud.ply"),
                     exported = fit::ReadPly(folder_ / "export" / "cloud.ply");
  ASSERT_GT(ours.columns.at("x").size(), 100U);
  EXPECT_EQ(cloud.at("points"), ours.columns.at("x").size());
  for (const char* column : {"x", "y", "z", "cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"})
    EXPECT_TRUE(ours.columns.at(column) == exported.columns.at(column)) << column;
  for (const char* column : {"nx", "ny", "nz"})  // which `export` brings to length 1 once more
    for (size_t v = 0; v < ours.columns.at(column).size(); ++v)
      EXPECT_NEAR(ours.columns.at(column)[v], exported.columns.at(column)[v], 1e-6) << column << " " << v;
}

// By the calibration that it was captured with nobody moved; by one of a rig in which projector 2 was turned it did.
TEST_F(Cloud, NamesAProjectorThatWasTurnedSinceTheCalibration) {
  const auto drift_of = [&](const Json& record, std::string& err) {
    const Outcome made = Run("stratalux-fit cloud s000001 --json --calibration " + RecordFile(record) + To("points"));
    EXPECT_EQ(made.code, 0) << made.err;
    err = made.err;
    return Json::parse(made.out).at("clouds").at(0).at("drift");
  };
  std::string err;
  const Json still = drift_of(Record(), err);
  EXPECT_EQ(still.at("warning"), "") << err;
  EXPECT_THAT(err, Not(HasSubstr("recalibration is due")));
  ASSERT_EQ(still.at("projectors").size(), 4U);
  for (const Json& projector : still.at("projectors")) EXPECT_TRUE(projector.at("judged")) << projector;
  Json record = Record();
  const auto rig = RigCalibration::FromJson(record.dump());
  ASSERT_TRUE(rig.ok());
  auto turned = *rig;
  turned.projectors[2].camera_from_projector.rotation =
      turned.projectors[2].camera_from_projector.rotation * Eigen::AngleAxisd(0.015, Eigen::Vector3d::UnitX());
  const Json moved = drift_of(Json::parse(turned.ToJson()), err);
  EXPECT_THAT(moved.at("warning").get<std::string>(), HasSubstr("the light of projector 2 falls"));
  EXPECT_TRUE(moved.at("projectors").at(2).at("moved"));
  EXPECT_THAT(err, HasSubstr("recalibration is due"));
}

TEST_F(Cloud, IsLoggedMarkedAndForgotten) {
  ASSERT_EQ(Run("stratalux-fit cloud s000001" + To("points")).code, 0);
  EXPECT_THAT(Run("stratalux-db access s000001").out, HasSubstr("cloud"));
  ASSERT_TRUE(fs::exists(folder_ / "points" / "cloud.ply"));
  EXPECT_EQ(Run("stratalux-db forget s000001 --yes").code, 0);
  EXPECT_FALSE(fs::exists(folder_ / "points"));
}

// Images in folders and a record: no plan, no manifest's calibration, noise by the bit depth.
TEST_F(Cloud, OfImportedImagesLiesWhereTheCapturesDoes) {
  ASSERT_EQ(Run("stratalux-fit cloud s000001" + To("points")).code, 0);
  ASSERT_NO_FATAL_FAILURE(ImportWithout("comb"));
  ExpectRefused("stratalux-fit cloud s000003" + To("no"), 2, {"s000003", "carries no calibration", "--calibration"});
  const Outcome made = Run("stratalux-fit cloud s000003 --json --calibration " + RecordFile(Record()) + To("imported"));
  ASSERT_EQ(made.code, 0) << made.err;
  const Json motion = Json::parse(made.out).at("clouds").at(0).at("motion");
  EXPECT_FALSE(motion.at("known"));
  EXPECT_THAT(motion.at("text").get<std::string>(), HasSubstr("not looked for"));
  const fit::PlyRead captured = fit::ReadPly(folder_ / "points" / "cloud.ply"),
                     imported = fit::ReadPly(folder_ / "imported" / "cloud.ply");
  // By the quad's ray, of which quads have some 0.006 between them.
  std::vector<double> off_sigmas;
  const auto ray = [](const fit::PlyRead& ply, size_t v, const char* axis) {
    return ply.columns.at(axis)[v] / ply.columns.at("z")[v];
  };
  for (size_t v = 0; v < imported.columns.at("x").size(); ++v)
    for (size_t w = 0; w < captured.columns.at("x").size(); ++w) {
      if (std::hypot(ray(imported, v, "x") - ray(captured, w, "x"), ray(imported, v, "y") - ray(captured, w, "y")) >
          1e-3)
        continue;
      off_sigmas.push_back(std::abs(imported.columns.at("z")[v] - captured.columns.at("z")[w]) /
                           std::sqrt(imported.columns.at("cov_zz")[v] + captured.columns.at("cov_zz")[w]));
    }
  ASSERT_GE(off_sigmas.size(), captured.columns.at("x").size() * 95 / 100);
  std::ranges::sort(off_sigmas);
  std::printf("%zu points, %.3f sigmas apart (median), %.3f at most\n", off_sigmas.size(),
              off_sigmas[off_sigmas.size() / 2], off_sigmas.back());
  EXPECT_LT(off_sigmas[off_sigmas.size() / 2], 1.0);
  EXPECT_LT(off_sigmas.back(), 4.0);
}

TEST_F(Cloud, OneAxisIsEnoughAndAMissingFrameIsNamed) {
  ASSERT_NO_FATAL_FAILURE(ImportWithout("gray rows"));
  const std::string record = RecordFile(Record());
  const Outcome columns = Run("stratalux-fit cloud s000003 --json --calibration " + record + To("columns"));
  ASSERT_EQ(columns.code, 0) << columns.err;
  for (const Json& projector : Json::parse(columns.out).at("clouds").at(0).at("drift").at("projectors"))
    EXPECT_TRUE(projector.at("judged")) << projector;
  EXPECT_GT(fit::ReadPly(folder_ / "columns" / "cloud.ply").columns.at("x").size(), 100U);
  fs::remove_all(folder_ / "files");
  ASSERT_NO_FATAL_FAILURE(ImportWithout("gray columns bit=3/7\""));
  // Its inverse tells the bit by white and black.
  const Outcome without = Run("stratalux-fit cloud s000004 --calibration " + record + To("without"));
  EXPECT_EQ(without.code, 0) << without.err;
  EXPECT_THAT(without.err, HasSubstr("'gray columns bit=3/7' is missing"));
  fs::remove_all(folder_ / "files");
  ASSERT_NO_FATAL_FAILURE(ImportWithout("gray "));
  ExpectRefused("stratalux-fit cloud s000005 --calibration " + record + To("no"), 4, {"s000005", "no codes"});
  EXPECT_FALSE(fs::exists(folder_ / "no"));
}

TEST_F(Cloud, ACalibrationOfAnotherRigIsRefused) {
  const auto refused = [&](const Json& record, int code, const std::vector<std::string>& parts) {
    ExpectRefused("stratalux-fit cloud s000001 --calibration " + RecordFile(record) + To("no"), code, parts);
  };
  Json wider = Record();
  wider["camera"]["model"]["width"] = 98;
  refused(wider, 2, {"s000001-", "96x72", "98x72", "of another rig"});
  Json fewer = Record();
  fewer["projectors"].erase(3);
  refused(fewer, 2, {"projector 3 shows codes", "has only 3 projectors", "of another rig"});
  Json finer = Record();
  finer["projectors"][2]["model"]["height"] = 768;
  refused(finer, 2, {"projector 2 has codes of 7 bits", "768 rows", "of another rig"});
  Json moved = Record();
  for (Json& projector : moved["projectors"])
    for (Json& length : projector["camera_from_projector"]["translation_mm"]) length = -length.get<double>();
  refused(moved, 1, {"contradict the calibration", "calibrate again"});
  EXPECT_FALSE(fs::exists(folder_ / "no"));
}

TEST_F(Cloud, WhatIsMissingOrNoRecordIsNamed) {
  const std::string none = (folder_ / "none.json").string(), text = File("text.json", "no record"),
                    cloud = "stratalux-fit cloud s000001 --calibration ";
  ExpectRefused(cloud + none + To("no"), 4, {none});
  ExpectRefused(cloud + text + To("no"), 6, {text});
  ExpectRefused("stratalux-fit cloud s000001 --pose 7" + To("no"), 4, {"no codes of pose 7"});
  EXPECT_EQ(Run("stratalux-fit cloud s000001").code, 2) << "without a folder";
  EXPECT_FALSE(fs::exists(folder_ / "no"));
}

// A strip one quad wide, round a corner: no island to triangulation, and nothing that could be smoothed.
TEST_F(Cloud, QuadsWithoutNeighboursAreNamedWhereNothingElseIsLeft) {
  const fs::path files = folder_ / "files";
  ASSERT_EQ(Run("stratalux-rig capture --simulate=plane --seed 3 --kind calibration --config " +
                File("rig.toml", kTinyConfig) + " --store " + store_.string())
                .code,
            0);
  ASSERT_EQ(Run("stratalux-db export s000003 --out " + files.string()).code, 0);
  for (const auto& entry : fs::directory_iterator(files / "frames")) {
    auto frame = ReadPng(entry.path(), nullptr);
    ASSERT_TRUE(frame.ok()) << frame.status().message();
    for (int y = 0; y < frame->height(); ++y)
      for (int x = 0; x < frame->width(); ++x) {
        const int i = x / 2, j = y / 2;
        const bool strip = (j == 32 && i >= 3 && i < 45) || (i == 3 && j >= 3 && j < 32);
        if (!strip) (*frame)(x, y) = 64;
      }
    ASSERT_TRUE(WritePng16(entry.path(), frame->view()).ok());
  }
  ASSERT_EQ(Run("stratalux-db import --manifest " + (files / "import.toml").string()).code, 0);
  const Json record = Json::parse(ReadText(Session("s000003-") / "manifest.json")).at("calibration");
  ExpectRefused("stratalux-fit cloud s000004 --calibration " + RecordFile(record) + To("no"), 1,
                {"no point is left", "pixels that no projector's code reached", "quads without neighbours"});
  EXPECT_FALSE(fs::exists(folder_ / "no"));
}

// A plane fitted to what lies within 3 mm of it at last; the first round takes all, the next those within 96 mm.
struct PlaneFit {
  double rms_mm = 0.0;
  double inliers = 0.0;  // share
};

PlaneFit FitPlane(const std::vector<Eigen::Vector3d>& points) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero(), normal = Eigen::Vector3d::Zero();
  PlaneFit fit;
  for (double limit_mm = std::numeric_limits<double>::max(); limit_mm > 2.9;
       limit_mm = limit_mm > 1e8 ? 96.0 : limit_mm / 2.0) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
    double residuals = 0.0, n = 0.0;
    for (const Eigen::Vector3d& p : points) {
      const double off = normal.dot(p - centre);
      if (std::abs(off) > limit_mm) continue;
      n += 1.0;
      residuals += off * off;
      sum += p;
      squares += p * p.transpose();
    }
    fit = {std::sqrt(residuals / n), n / static_cast<double>(points.size())};
    centre = sum / n;
    normal =
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(squares / n - centre * centre.transpose()).eigenvectors().col(0);
  }
  return fit;
}

class RealCloud : public ScratchFolderTest {
 protected:
  static Image<uint16_t> Png(const fs::path& file) {
    auto image = ReadPng(file, nullptr);
    EXPECT_TRUE(image.ok()) << image.status().message();
    return image.ok() ? std::move(*image) : Image<uint16_t>();
  }
  struct Lit {
    std::vector<Eigen::Vector3d> points;
    int64_t pixels = 0;
  };
  // Of a pose's cloud, what the calibrated camera sees where the projector lights: white less black above 40, as the
  // data's own page has it.
  [[nodiscard]] Lit LitPoints(int pose, const Eigen::Vector2d& crop_px, const fs::path& data) const {
    const std::string name = "pose" + std::to_string(pose);
    const auto rig = RigCalibration::FromJson(ReadText(folder_ / "rig.json"));
    const Image<uint16_t> white = Png(data / name / "g40.png"), black = Png(data / name / "g41.png");
    const auto columns = fit::ReadPly(folder_ / "points" / ("cloud_" + name + ".ply")).columns;
    const auto is_lit = [&](int x, int y) { return white(x, y) > black(x, y) + 40; };
    Lit lit;
    for (int y = 0; y < white.height(); ++y)
      for (int x = 0; x < white.width(); ++x) lit.pixels += is_lit(x, y) ? 1 : 0;
    for (size_t v = 0; rig.ok() && v < columns.at("x").size(); ++v) {
      const Eigen::Vector3d point(columns.at("x")[v], columns.at("y")[v], columns.at("z")[v]);
      const Eigen::Vector2d pixel = rig->camera.model.Project(point).value_or(Eigen::Vector2d::Zero()) - crop_px;
      const auto x = static_cast<int>(std::lround(pixel.x())), y = static_cast<int>(std::lround(pixel.y()));
      EXPECT_TRUE(white.view().contains(x, y));
      if (white.view().contains(x, y) && is_lit(x, y)) lit.points.push_back(point);
    }
    return lit;
  }
};

// The public captures of procam-calibration, from their image folders to points: import, calibrate, cloud.
TEST_F(RealCloud, OfBoardsAtThreeMetresIsPlanes) {
  const fs::path data = TestDataFolder() / "procam_gray_kamino";
  if (!fs::exists(data / "crops.txt"))
    GTEST_SKIP() << data << " is absent; set STRATALUX_DATA to the folder of the test data";
  const std::string store = " --store " + (folder_ / "store").string(), rig = (folder_ / "rig.json").string(),
                    manifest = STRATALUX_SOURCE_DIR "/docs/examples/procam_gray_kamino.toml";
  ASSERT_EQ(Execute("stratalux-db init" + store).code, 0);
  ASSERT_EQ(Execute("stratalux-db import --manifest " + manifest + " --root " + data.string() + store).code, 0);
  // The frames are crops, and the codes could number 1024 rows: the manifest says how large camera and projector are.
  const Outcome calibrated =
      Execute("stratalux-fit calibrate latest --board chess --squares 10x8 --square-mm 75 --out " + rig + store);
  ASSERT_EQ(calibrated.code, 0) << calibrated.out;
  const auto record = RigCalibration::FromJson(ReadText(rig));
  ASSERT_TRUE(record.ok()) << record.status().message();
  EXPECT_EQ(record->camera.model.width, 1280);
  EXPECT_EQ(record->projectors[0].model.height, 768);
  EXPECT_EQ(record->camera.saturation_dn, 255.0);
  const std::string cloud = "stratalux-fit cloud latest --out " + (folder_ / "points").string() + store;
  const Outcome made = Execute(cloud + " --calibration " + rig);
  ASSERT_EQ(made.code, 0) << made.out;
  std::istringstream crops(ReadText(data / "crops.txt"));
  int poses = 0;
  for (std::string line; std::getline(crops, line);) {
    if (line.empty() || line[0] == '#') continue;
    ++poses;
    std::istringstream numbers(line);
    int pose = 0;
    Eigen::Vector2d crop_px;
    numbers >> pose >> crop_px.x() >> crop_px.y();
    const Lit lit = LitPoints(pose, crop_px, data);
    const PlaneFit plane = FitPlane(lit.points);
    const double share = static_cast<double>(lit.points.size()) / static_cast<double>(lit.pixels);
    std::printf("pose %d: %.4f of the lit pixels have a point, %.4f of them within 3 mm of a plane, rms %.3f mm\n",
                pose, share, plane.inliers, plane.rms_mm);
    EXPECT_GE(share, 0.95) << pose;
    EXPECT_GE(plane.inliers, 0.95) << pose;
    EXPECT_LE(plane.rms_mm, 0.7) << pose;
  }
  EXPECT_EQ(poses, 5);
  // A projector whose focal length is 2 % off sends most rays past each other.
  Json wrong = Json::parse(ReadText(rig));
  for (const char* f : {"fx", "fy"}) {
    double& focal = wrong["projectors"][0]["model"][f].get_ref<double&>();
    focal *= 1.02;
  }
  const fs::path wrong_file = folder_ / "wrong.json";
  WriteText(wrong_file, wrong.dump());
  const Outcome refused = Execute(cloud + " --pose 0 --calibration " + wrong_file.string());
  EXPECT_EQ(refused.code, 1) << refused.out;
  EXPECT_THAT(refused.out, HasSubstr("contradict the calibration"));
}

}  // namespace
}  // namespace stratalux
