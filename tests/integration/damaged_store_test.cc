// SPDX-License-Identifier: Apache-2.0
// A store that lost bytes, was swapped or comes from the future: said by every program, made worse by none.
#include <array>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/catalogue/session_store.h"
#include "tests/integration/tiny_session.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using Json = nlohmann::json;

class DamagedStore : public TinyStore {
 protected:
  void SetUp() override {
    TinyStore::SetUp();
    segment_ = Session("s000001") / "frames-0001.seg";
    id_ = Session("s000001").filename().string();
    intact_ = ReadText(segment_);
    frames_ = Json::parse(Run("stratalux-db frames s000001 --json").out);
  }
  [[nodiscard]] size_t Offset(size_t frame) const { return frames_[frame]["offset"].get<size_t>(); }

  // The report of `verify` is data, on stdout; the sessions beside the damaged one stay sound.
  void ExpectFoundByVerify(const std::vector<std::string>& parts) const {
    const auto before = Contents(store_);
    const Outcome outcome = Run("stratalux-db verify --deep");
    EXPECT_EQ(outcome.code, 6) << outcome.err;
    for (const std::string& part : parts) EXPECT_THAT(outcome.out, HasSubstr(part));
    EXPECT_THAT(outcome.out, HasSubstr(Session("s000002").filename().string() + ": ok"));
    EXPECT_EQ(Run("stratalux-db ls").code, 0);
    EXPECT_EQ(Run("stratalux-db verify s000002").code, 0);
    EXPECT_TRUE(Contents(store_) == before);
  }
  // Refused by whoever needs the frames.
  void ExpectFramesRefused(const std::vector<std::string>& parts) const {
    ExpectRefused("stratalux-db frames s000001 --extract " + (folder_ / "pictures").string(), 6, parts);
    ExpectFitsRefused(parts);
  }
  void ExpectFitsRefused(const std::vector<std::string>& parts) const {
    ExpectRefused("stratalux-fit run s000001", 6, parts);
    ExpectRefused("stratalux-fit decode s000001", 6, parts);
  }

  fs::path segment_;
  std::string id_, intact_;
  Json frames_;
};

TEST_F(DamagedStore, AMissingSegment) {
  fs::remove(segment_);
  ExpectFramesRefused({segment_.string(), "No such file", "restore sessions/" + id_});
  ExpectFoundByVerify({segment_.string()});
}

TEST_F(DamagedStore, ASegmentCutAnywhereBeforeItsLastFrameEnds) {
  const size_t last = frames_.size() - 1, middle = last / 2;
  for (const size_t length :
       {size_t{0}, size_t{10}, Offset(0) + 100, Offset(middle), Offset(middle) + 320 + 1000, Offset(last) + 319}) {
    SCOPED_TRACE(length);
    WriteText(segment_, intact_.substr(0, length));
    ExpectFramesRefused({segment_.string(), "truncated", "restore sessions/" + id_});
    ExpectFoundByVerify({segment_.string(), "truncated"});
  }
}

TEST_F(DamagedStore, ASegmentCutInItsFooterKeepsItsFrames) {
  for (const size_t length : {intact_.size() - 1, intact_.size() - 24, intact_.size() - 1000}) {
    WriteText(segment_, intact_.substr(0, length));
    ExpectFoundByVerify({segment_.string(), "footer"});
    EXPECT_EQ(Run("stratalux-db frames s000001 --phase reference --extract " + (folder_ / "pictures").string()).code,
              0);
  }
}

TEST_F(DamagedStore, AFlippedBitOfAPayloadNamesItsFrame) {
  const Json* white = nullptr;
  for (const Json& f : frames_)
    if (f["phase"] == "reference" && f["projector"] == 0 && white == nullptr) white = &f;
  ASSERT_NE(white, nullptr);
  const size_t offset = (*white)["offset"];
  std::string bytes = intact_;
  bytes[offset + 320 + 1234] ^= 4;
  WriteText(segment_, bytes);
  const std::vector<std::string> parts = {segment_.string(), "offset " + std::to_string(offset),
                                          "payload of frame " + (*white)["frame"].dump(), "hash"};
  ExpectFitsRefused({parts[0], parts[1], parts[2], parts[3], "restore sessions/" + id_});
  ExpectFoundByVerify(parts);
  // The sound frames before it have left the store: the log knows.
  const Outcome extract = Run("stratalux-db frames s000001 --extract " + (folder_ / "pictures").string());
  EXPECT_EQ(extract.code, 6);
  for (const std::string& part : parts) EXPECT_THAT(extract.err, HasSubstr(part));
  EXPECT_EQ(Json::parse(Run("stratalux-db access --json").out).size(), 1U);
}

TEST_F(DamagedStore, AFlippedBitOfAHeaderIsFoundAndReadByItsCopyWhileThereIsOne) {
  const auto pictures = [this](const std::string& name) {
    EXPECT_EQ(Run("stratalux-db frames s000001 --extract " + (folder_ / name).string()).code, 0);
    auto files = Contents(folder_ / name);
    std::erase_if(files, [](const auto& file) { return !file.first.ends_with(".png"); });
    EXPECT_EQ(files.size(), frames_.size());
    return files;
  };
  const auto whole = pictures("whole");
  std::string bytes = intact_;
  bytes[Offset(5) + 17] ^= 1;
  WriteText(segment_, bytes);
  EXPECT_TRUE(pictures("copied") == whole);
  ExpectFoundByVerify({segment_.string(), "header is damaged"});
  WriteText(segment_, bytes.substr(0, bytes.size() - 24));  // no footer, no copy
  ExpectFramesRefused({segment_.string(), "offset " + std::to_string(Offset(5)), "header is damaged", "restore"});
}

TEST_F(DamagedStore, ASegmentOfANewerProgramIsNotCalledDamaged) {
  std::string bytes = intact_;
  bytes[8] = 2;
  WriteText(segment_, bytes);
  for (const char* verb : {"stratalux-db frames s000001", "stratalux-fit run s000001"})
    ExpectRefused(verb, 7, {segment_.string(), "version 2 is newer"});
}

TEST_F(DamagedStore, AnotherSessionsSegmentIsNotMistakenForItsOwn) {
  fs::copy_file(Session("s000002") / "frames-0001.seg", segment_, fs::copy_options::overwrite_existing);
  ExpectRefused("stratalux-db frames s000001", 6, {"frames-0001.seg"});
  ExpectRefused("stratalux-fit run s000001", 6, {"frames-0001.seg"});
  ExpectFoundByVerify({"belongs to session " + Session("s000002").filename().string()});
}

TEST_F(DamagedStore, AManifestThatIsNoneIsFoundAndTheFramesStayReadable) {
  const fs::path manifest = Session("s000001") / "manifest.json";
  const std::string intact = ReadText(manifest);
  std::string kind = intact;
  kind.replace(kind.find("\"visitor\""), 9, "\"partygo\"");
  Json next = Json::parse(intact);
  next["schema"] = 99;
  const std::string newer = next.dump(1);
  const std::array<std::array<std::string, 2>, 6> cases = {{{"", "parse error at line 1"},
                                                            {intact.substr(0, 100), "parse error at line "},
                                                            {"[1, 2]\n", "not a JSON object"},
                                                            {"{\"schema\": \"one\"}", "'schema' is not a number"},
                                                            {kind, "does not match its own hash"},
                                                            {newer, "schema 99 is newer"}}};
  for (const auto& [text, part] : cases) {
    WriteText(manifest, text);
    ExpectFoundByVerify({manifest.string() + ": ", part, text == newer ? ": 2 problem(s)" : ": 1 problem(s)"});
    EXPECT_EQ(Run("stratalux-db frames s000001").code, 0);
  }
  fs::remove(manifest);
  ExpectFoundByVerify({manifest.string() + ": No such file"});
  fs::create_directory(manifest);
  ExpectFoundByVerify({manifest.string()});
}

TEST_F(DamagedStore, WithoutTruthTheMapsAreTheSame) {
  // A mono camera sees a quad with each of its pixels: large enough a picture for surfaces and layers.
  const std::string mono = File("mono.toml", "[camera]\ncfa = \"mono\"\n");
  const std::string capture = "stratalux-rig capture --simulate=" + mono + " --seed 3 --size 64x48 --config ";
  ASSERT_EQ(Run(capture + File("rig.toml", kTinyConfig)).code, 0);
  Json metrics;
  const auto maps = [this, &metrics] {
    for (const char* made_before : {"fits", "artifacts"}) fs::remove_all(Session("s000003") / made_before);
    const Outcome run = Run("stratalux-fit run s000003 --pool 2 --layers 2 --json");
    EXPECT_EQ(run.code, 0) << run.err;
    std::map<std::string, std::string> made;
    for (const auto& [name, text] : Contents(Json::parse(run.out)["folder"].get<std::string>())) {
      if (name.ends_with(".exr")) made[name] = text;
      if (name == "metrics.json") metrics = Json::parse(text);
    }
    EXPECT_GT(metrics["fit"]["pixels"].get<int>(), 100);
    return made;
  };
  const auto before = maps();
  for (const char* map : {"position.exr", "normal_fused.exr", "direct_0.exr", "layers_weight.exr"})
    EXPECT_TRUE(before.contains(map)) << map;
  EXPECT_GT(metrics["truth"]["pixels"].get<int>(), 100);
  const fs::path truth = Session("s000003") / "truth.seg", aside = folder_ / "truth.seg";
  fs::rename(truth, aside);
  ExpectFoundByVerify({truth.string()});
  EXPECT_TRUE(maps() == before);
  EXPECT_TRUE(metrics.value("truth", Json()).is_null()) << "what nobody knows is not compared";
  ExpectRefused("stratalux-fit run s000003 --geometry truth", 2, {"s000003-", "no truth", "simulated sessions"});
  fs::rename(aside, truth);
  ExpectUnharmed();
}

class DamagedIndex : public TinyStore {
 protected:
  void ExpectRefusedByAll(int code, const std::vector<std::string>& parts) const {
    const std::string config = File("rig.toml", kTinyConfig);
    for (const std::string& command :
         {std::string("stratalux-db ls"), std::string("stratalux-db show latest"),
          std::string("stratalux-db frames s000001"), std::string("stratalux-db verify"),
          "stratalux-rig capture --simulate --config " + config, std::string("stratalux-fit run s000001"),
          std::string("stratalux-fit decode s000001"), std::string("stratalux-fit report s000001")})
      ExpectRefused(command, code, parts);
  }
  [[nodiscard]] fs::path Index() const { return store_ / "index.sqlite"; }
};

TEST_F(DamagedIndex, OfANewerSchema) {
  std::string bytes = ReadText(Index());
  bytes[63] = static_cast<char>(db::kSchemaVersion + 1);  // user_version, big-endian, at 60
  WriteText(Index(), bytes);
  ExpectRefusedByAll(
      7, {Index().string(), "schema " + std::to_string(db::kSchemaVersion + 1) + " is newer than this program's ",
          "use a newer stratalux"});
  ExpectRefused("stratalux-db init", 7, {Index().string(), "use a newer stratalux"});
}

TEST_F(DamagedIndex, ReplacedByGarbage) {
  std::string scrambled = ReadText(Index());
  for (size_t i = 100; i < scrambled.size(); i += 3) scrambled[i] = static_cast<char>(scrambled[i] ^ 0x5a);
  const std::string good = ReadText(Index());
  WriteText(Index(), std::string(5000, 'x'));
  ExpectRefusedByAll(6, {Index().string(), "not a Stratalux index", "restore it from a copy"});
  WriteText(Index(), "");
  ExpectRefusedByAll(6, {Index().string(), "not a Stratalux index", "restore it from a copy"});
  WriteText(Index(), scrambled);
  ExpectRefusedByAll(6, {Index().string(), "malformed", "restore it from a copy"});
  WriteText(Index(), good.substr(0, 5000));
  ExpectRefusedByAll(6, {Index().string(), "malformed", "restore it from a copy"});
  WriteText(Index(), good);
  ExpectUnharmed();
}

TEST_F(DamagedIndex, MissingWithItsStore) {
  const std::array<std::string, 3> places = {(folder_ / "none").string(), File("plain", "text") + "/store",
                                             folder_.string()};
  for (const std::string& place : places)
    for (const char* verb : {"stratalux-db ls", "stratalux-db verify", "stratalux-fit run latest",
                             "stratalux-fit decode latest", "stratalux-fit report latest"})
      ExpectRefused(std::string(verb) + " --store " + place, 4, {"no store in " + place, "stratalux-db init"});
  const std::string long_name = (folder_ / std::string(300, 'x')).string();
  for (const char* verb : {"stratalux-db ls --store ", "stratalux-fit run latest --store "})
    ExpectRefused(verb + long_name, 1, {long_name, "too long"});
  EXPECT_FALSE(fs::exists(folder_ / "none")) << "looking makes no store";
}

}  // namespace
}  // namespace stratalux
