// SPDX-License-Identifier: Apache-2.0
// A crate of ours against the RO-Crate 1.3 specification (https://w3id.org/ro/crate/1.3), by rules written here from
// its text and by none of the code that writes crates; and COLMAP's text against our own projection.
#include <algorithm>
#include <map>
#include <random>
#include <regex>
#include <set>
#include <sstream>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sodium.h>

#include "tests/db/interchange/crate_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::HasSubstr;

// The terms that we use, as the 1.3 context defines them: docs/_specification/1.3/context.jsonld of
// github.com/ResearchObject/ro-crate ("version": "1.3"), each http://schema.org/<term> but for File, which is
// http://schema.org/MediaObject, and conformsTo, which is http://purl.org/dc/terms/conformsTo.
const std::set<std::string> kContextTypes = {"CreateAction",      "CreativeWork", "Dataset", "File",
                                             "IndividualProduct", "Organization", "Person",  "SoftwareApplication"};
const std::set<std::string> kContextProperties = {
    "about",       "agent",          "author",    "conformsTo", "contentSize", "dateCreated", "datePublished",
    "description", "encodingFormat", "endTime",   "hasPart",    "identifier",  "inLanguage",  "instrument",
    "isRelatedTo", "keywords",       "license",   "mentions",   "name",        "object",      "result",
    "sha256",      "startTime",      "usageInfo", "version"};

class CrateSpecification : public CrateTest {
 protected:
  void SetUp() override {
    CrateTest::SetUp();
    CrateOptions options;
    options.scope = CrateScope::kResearch;
    options.licence = "CC-BY-4.0";
    options.title = "Faces & \"lights\"";
    ids_ = {Visit(), Flats(), Simulated()};
    const auto report = Export(ids_, options);
    ASSERT_TRUE(report.ok()) << report.status().message();
    document_ = json::parse(TextOfFile(crate_ / "ro-crate-metadata.json"));
    for (const json& entity : document_["@graph"]) {
      ASSERT_TRUE(entity.contains("@id") && entity["@id"].is_string()) << entity;
      EXPECT_TRUE(entities_.emplace(entity["@id"].get<std::string>(), entity).second) << "twice: " << entity["@id"];
    }
  }
  [[nodiscard]] static std::vector<std::string> Ids(const json& value) {
    std::vector<std::string> ids;
    for (const json& one : value.is_array() ? value : json::array({value})) ids.push_back(one.at("@id"));
    return ids;
  }
  [[nodiscard]] std::set<std::string> Reachable() const {
    std::set<std::string> seen;
    std::vector<std::string> open = {"./"};
    while (!open.empty()) {
      const std::string id = open.back();
      open.pop_back();
      if (!seen.insert(id).second || !entities_.contains(id) || !entities_.at(id).contains("hasPart")) continue;
      for (const std::string& part : Ids(entities_.at(id).at("hasPart"))) open.push_back(part);
    }
    return seen;
  }
  std::vector<std::string> ids_;
  json document_;
  std::map<std::string, json> entities_;
};

TEST_F(CrateSpecification, DescriptorAndRootAreAsRequired) {
  EXPECT_EQ(document_["@context"], "https://w3id.org/ro/crate/1.3/context");
  EXPECT_EQ(document_.size(), 2U);
  const json& descriptor = entities_.at("ro-crate-metadata.json");
  EXPECT_EQ(descriptor["@type"], "CreativeWork");
  EXPECT_EQ(descriptor["about"], json({{"@id", "./"}}));
  EXPECT_EQ(descriptor["conformsTo"], json({{"@id", "https://w3id.org/ro/crate/1.3"}}));
  const json& root = entities_.at("./");
  EXPECT_EQ(root["@type"], "Dataset");
  EXPECT_EQ(root["name"], "Faces & \"lights\"");
  for (const char* required : {"description", "datePublished", "license", "author", "hasPart"})
    EXPECT_TRUE(root.contains(required)) << required;
  const json& licence = entities_.at(root["license"]["@id"]);
  EXPECT_EQ(root["license"]["@id"], "https://spdx.org/licenses/CC-BY-4.0");
  EXPECT_EQ(licence["@type"], "CreativeWork");
  EXPECT_TRUE(licence.contains("name") && licence.contains("description"));
}

TEST_F(CrateSpecification, TheGraphIsFlatCompactAndItsTermsAreTheContexts) {
  const std::regex uri("(#|https?://|\\./)?([A-Za-z0-9._~/:-]|%[0-9A-F]{2})*");
  for (const auto& [id, entity] : entities_) {
    EXPECT_TRUE(std::regex_match(id, uri)) << id;
    EXPECT_EQ(id.find("../"), std::string::npos) << id;
    ASSERT_TRUE(entity["@type"].is_string()) << id;
    EXPECT_TRUE(kContextTypes.contains(entity["@type"])) << entity["@type"];
    for (const auto& [property, value] : entity.items()) {
      if (property.starts_with('@')) continue;
      EXPECT_TRUE(kContextProperties.contains(property)) << property;
      if (value.is_array()) EXPECT_GT(value.size(), 1U) << id << " " << property << ": a single value is no list";
      for (const json& one : value.is_array() ? value : json::array({value})) {
        if (!one.is_object()) {
          EXPECT_TRUE(one.is_string()) << id << " " << property;
          continue;
        }
        ASSERT_EQ(one.size(), 1U) << id << " " << property << ": nested entity";
        EXPECT_TRUE(entities_.contains(one.at("@id")) || one["@id"] == "https://w3id.org/ro/crate/1.3")
            << "dangling: " << one;
      }
    }
  }
}

TEST_F(CrateSpecification, EveryEntityIsReferredTo) {
  std::set<std::string> named = {"ro-crate-metadata.json", "ro-crate-preview.html"};
  for (const auto& [id, entity] : entities_)
    for (const auto& [property, value] : entity.items())
      for (const json& one : value.is_array() ? value : json::array({value}))
        if (one.is_object()) named.insert(one.at("@id"));
  for (const auto& [id, entity] : entities_) EXPECT_TRUE(named.contains(id)) << id;
}

TEST_F(CrateSpecification, DatesAreIso8601) {
  const std::regex date("\\d{4}-\\d{2}-\\d{2}T\\d{2}:\\d{2}:\\d{2}(\\.\\d+)?Z");
  int dates = 0;
  for (const auto& [id, entity] : entities_)
    for (const char* property : {"datePublished", "dateCreated", "startTime", "endTime"}) {
      if (!entity.contains(property)) continue;
      ++dates;
      EXPECT_TRUE(std::regex_match(entity[property].get<std::string>(), date)) << id << " " << entity[property];
    }
  EXPECT_GE(dates, 10);
}

TEST_F(CrateSpecification, DataEntitiesAreOnTheDiskAndAllFilesAreDataEntities) {
  const std::set<std::string> reachable = Reachable();
  for (const auto& [id, entity] : entities_) {
    const bool data = entity["@type"] == "File" || entity["@type"] == "Dataset";
    if (!data || id == "./") continue;
    EXPECT_TRUE(reachable.contains(id)) << id << " is no part of the root";
    if (entity["@type"] == "Dataset") {
      EXPECT_TRUE(id.ends_with('/') && fs::is_directory(crate_ / id)) << id;
      continue;
    }
    const std::string bytes = TextOfFile(crate_ / id);
    EXPECT_EQ(entity["contentSize"], std::to_string(fs::file_size(crate_ / id))) << id;
    unsigned char hash[crypto_hash_sha256_BYTES];
    char hex[2 * sizeof hash + 1];
    crypto_hash_sha256(hash, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
    EXPECT_EQ(entity["sha256"], sodium_bin2hex(hex, sizeof hex, hash, sizeof hash)) << id;
    for (const char* recommended : {"name", "description", "encodingFormat"})
      EXPECT_TRUE(entity.contains(recommended)) << id;
  }
  int files = 0;
  for (const auto& entry : fs::recursive_directory_iterator(crate_)) {
    const std::string name = entry.path().lexically_relative(crate_).string();
    // The website is no payload and must not be a part; the manifest and our marks are bookkeeping beside it.
    if (!entry.is_regular_file() || name.starts_with("ro-crate-") || name == "manifest-sha256.txt" ||
        name.starts_with(".stratalux-export-"))
      continue;
    ++files;
    EXPECT_TRUE(reachable.contains(name)) << name;
  }
  EXPECT_GT(files, 20);
  for (const std::string& id : reachable) EXPECT_FALSE(id.starts_with("ro-crate-preview")) << id;
}

TEST_F(CrateSpecification, TheCaptureIsAnActionOfTheRigAndCarriesItsConsent) {
  const json& capture = entities_.at("#capture-" + ids_[0]);
  EXPECT_EQ(capture["@type"], "CreateAction");
  EXPECT_EQ(capture["startTime"], "2026-10-05T21:09:27Z");
  EXPECT_TRUE(capture.contains("endTime"));
  EXPECT_EQ(entities_.at(capture["agent"]["@id"])["@type"], "SoftwareApplication");
  EXPECT_EQ(entities_.at(capture["agent"]["@id"])["version"], "0.9-test");
  EXPECT_EQ(Ids(capture["instrument"]).size(), 4U) << "rig, camera, two projectors";
  const json& session = entities_.at("sessions/" + ids_[0] + "/");
  const json& consent = entities_.at(session["usageInfo"]["@id"]);
  EXPECT_EQ(consent["version"], "text-3");
  EXPECT_EQ(consent["inLanguage"], "de");
  EXPECT_EQ(consent["keywords"], "fit,research");
  EXPECT_THAT(consent["description"].get<std::string>(), HasSubstr("made for: research"));
  EXPECT_EQ(entities_.at(consent["author"]["@id"])["@type"], "Person");
  EXPECT_FALSE(entities_.at("sessions/" + ids_[1] + "/").contains("usageInfo"));
}

TEST_F(CrateSpecification, ThePreviewIsAStaticPageOfAllSessions) {
  const std::string html = TextOfFile(crate_ / "ro-crate-preview.html");
  EXPECT_TRUE(html.starts_with("<!DOCTYPE html>"));
  EXPECT_THAT(html, HasSubstr("Faces &amp; &quot;lights&quot;"));
  EXPECT_EQ(html.find("<script"), std::string::npos);
  for (const std::string& id : ids_) {
    EXPECT_THAT(html, HasSubstr("sessions/" + id + "/session.json"));
    EXPECT_THAT(html, HasSubstr("ro-crate-preview_files/" + id + ".png"));
    EXPECT_TRUE(fs::exists(crate_ / "ro-crate-preview_files" / (id + ".png")));
  }
}

TEST_F(CrateSpecification, TheManifestIsWhatSha256sumReads) {
  const Outcome checked = Shell("cd " + crate_.string() + " && sha256sum --strict --quiet -c manifest-sha256.txt 2>&1");
  EXPECT_EQ(checked.code, 0) << checked.out;
}

// COLMAP's FULL_OPENCV as its documentation defines it (src/colmap/sensor/models.h).
Eigen::Vector2d ColmapProject(const std::vector<double>& p, const Eigen::Vector3d& x) {
  const double u = x.x() / x.z(), v = x.y() / x.z(), r2 = u * u + v * v, r4 = r2 * r2, r6 = r4 * r2;
  const double radial = (1 + p[4] * r2 + p[5] * r4 + p[8] * r6) / (1 + p[9] * r2 + p[10] * r4 + p[11] * r6);
  const double du = u * radial + 2 * p[6] * u * v + p[7] * (r2 + 2 * u * u) - u;
  const double dv = v * radial + 2 * p[7] * u * v + p[6] * (r2 + 2 * v * v) - v;
  return {p[0] * (u + du) + p[2], p[1] * (v + dv) + p[3]};
}

std::vector<std::string> DataLines(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);)
    if (!line.empty() && line[0] != '#') lines.push_back(line);
  return lines;
}

TEST_F(CrateSpecification, ColmapProjectsAsWeDo) {
  const fs::path folder = crate_ / "sessions" / ids_[0] / "calibration";
  const RigCalibration ours = SomeCalibration();
  const auto cameras = DataLines(TextOfFile(folder / "cameras.txt")),
             images = DataLines(TextOfFile(folder / "images.txt"));
  EXPECT_TRUE(DataLines(TextOfFile(folder / "points3D.txt")).empty());
  ASSERT_EQ(cameras.size(), 3U);
  ASSERT_EQ(images.size(), 3U);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> aside(-120, 120), deep(500, 1500);
  double worst = 0;
  for (size_t k = 0; k < 3; ++k) {
    std::istringstream camera(cameras[k]), image(images[k]);
    int id = 0, width = 0, height = 0, image_id = 0, camera_id = 0;
    std::string model, name;
    std::vector<double> p(12);
    camera >> id >> model >> width >> height;
    for (double& value : p) camera >> value;
    Eigen::Quaterniond q;
    Eigen::Vector3d t;
    image >> image_id >> q.w() >> q.x() >> q.y() >> q.z() >> t.x() >> t.y() >> t.z() >> camera_id >> name;
    ASSERT_TRUE(camera && image) << cameras[k] << "\n" << images[k];
    EXPECT_EQ(model, "FULL_OPENCV");
    EXPECT_EQ(camera_id, id);
    const Pinhole& pinhole = k == 0 ? ours.camera.model : ours.projectors[k - 1].model;
    EXPECT_EQ(width, pinhole.width);
    EXPECT_EQ(height, pinhole.height);
    for (int i = 0; i < 1000; ++i) {
      const Eigen::Vector3d x(aside(random), aside(random), deep(random));
      const auto expected = k == 0 ? pinhole.Project(x) : ours.projectors[k - 1].ProjectFromCamera(x);
      ASSERT_TRUE(expected);
      // Their pixel centres lie at 0.5, ours at 0.
      const Eigen::Vector2d theirs = ColmapProject(p, q.toRotationMatrix() * x + t) - Eigen::Vector2d(0.5, 0.5);
      worst = std::max(worst, (theirs - *expected).norm());
    }
  }
  EXPECT_LT(worst, 1e-9);
  RecordProperty("worst_px", std::to_string(worst));
}

}  // namespace
}  // namespace stratalux::db
