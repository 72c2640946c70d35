// SPDX-License-Identifier: Apache-2.0
// Crates that were changed, damaged or made to do harm: refused with the file's name, and the store stays as it was.
#include <functional>
#include <random>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/stat.h>

#include "db/interchange/crate_files.h"
#include "tests/db/interchange/crate_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;
using ::testing::HasSubstr;

class HostileCrates : public CrateTest {
 protected:
  void SetUp() override {
    CrateTest::SetUp();
    id_ = Flats();
    ASSERT_TRUE(Export({id_}).ok());
    ASSERT_TRUE(SessionStore::Open(other_, AccessMode::kReadWrite).ok());
  }
  [[nodiscard]] fs::path In(const std::string& name) const { return crate_ / "sessions" / id_ / name; }
  void ExpectRefused(StatusCode code, const std::string& complaint) {
    const auto report = Import();
    ASSERT_FALSE(report.ok()) << complaint;
    EXPECT_EQ(report.status().code(), code) << report.status().message();
    EXPECT_THAT(report.status().message(), HasSubstr(complaint));
    ExpectNothing();
  }
  void ExpectNothing() {
    const auto store = SessionStore::Open(other_, AccessMode::kReadWrite);
    ASSERT_TRUE(store.ok());
    EXPECT_TRUE(store->ListSessions()->empty());
    for (const char* folder : {"sessions", "incoming"}) {
      EXPECT_TRUE(!fs::exists(other_ / folder) || fs::is_empty(other_ / folder)) << folder;
    }
    EXPECT_FALSE(fs::exists(base_ / "x"));
  }
  void Edit(const fs::path& file, const std::function<void(ordered_json&)>& change) {
    auto json = ordered_json::parse(TextOfFile(file));
    change(json);
    WriteText(file, json.dump(1));
  }
  void Replace(const fs::path& file, const std::string& from, const std::string& to) {
    std::string text = TextOfFile(file);
    ASSERT_NE(text.find(from), std::string::npos) << from;
    WriteText(file, text.replace(text.find(from), from.size(), to));
  }
  std::string id_;
};

TEST_F(HostileCrates, EveryChangedFileIsNamed) {
  const auto files = ListCrateFiles(crate_);
  ASSERT_GE(files->size(), 10U);
  for (const auto& [path, sum] : *files) {
    if (sum.bytes == 0) continue;
    FlipBits(crate_ / path, static_cast<size_t>(sum.bytes / 2), 0x10);
    const auto report = Import();
    EXPECT_EQ(report.status().code(), StatusCode::kIntegrity) << path;
    EXPECT_THAT(report.status().message(), HasSubstr(path));
    FlipBits(crate_ / path, static_cast<size_t>(sum.bytes / 2), 0x10);
  }
  ExpectNothing();
  EXPECT_TRUE(Import().ok()) << "and as it was, it is taken";
}

TEST_F(HostileCrates, MissingAndSurplusFilesAreNamed) {
  WriteText(In("surplus.txt"), "x");
  ExpectRefused(StatusCode::kIntegrity, "surplus.txt is not in manifest-sha256.txt");
  fs::remove(In("surplus.txt"));
  fs::rename(In("frames.csv"), base_ / "frames.csv");
  ExpectRefused(StatusCode::kIntegrity, "frames.csv is missing");
  fs::rename(base_ / "frames.csv", In("frames.csv"));
  fs::remove(crate_ / kCrateFormatFile);
  ExpectRefused(StatusCode::kNotFound, "not a crate that");
}

TEST_F(HostileCrates, NoNameLeadsOutside) {
  const std::string manifest = TextOfFile(crate_ / kCrateManifestFile);
  for (const char* name : {"../x", "/etc/passwd", "a/../../x", "a//b", "./a", "a\\b", ""}) {
    WriteText(crate_ / kCrateManifestFile, manifest + std::string(64, '0') + "  " + name + "\n");
    ExpectRefused(StatusCode::kIntegrity, "not '<sha256>  <path inside the crate>'");
  }
  WriteText(crate_ / kCrateManifestFile, manifest + manifest.substr(0, manifest.find('\n') + 1));
  ExpectRefused(StatusCode::kIntegrity, "is listed twice");
  WriteText(crate_ / kCrateManifestFile, manifest);
  Edit(crate_ / kCrateFormatFile, [](auto& json) { json["sessions"] = {"../../x"}; });
  Reseal();
  ExpectRefused(StatusCode::kIntegrity, "is not a session id");
}

TEST_F(HostileCrates, LinksAndDevicesAreNotFollowed) {
  fs::rename(In("frames.csv"), base_ / "frames.csv");
  fs::create_symlink(base_ / "frames.csv", In("frames.csv"));
  ExpectRefused(StatusCode::kIntegrity, "is a symbolic link");
  fs::remove(In("frames.csv"));
  ASSERT_EQ(mkfifo(In("frames.csv").c_str(), 0600), 0);
  ExpectRefused(StatusCode::kIntegrity, "is not an ordinary file");
  fs::remove(In("frames.csv"));
  fs::rename(base_ / "frames.csv", In("frames.csv"));
  for (const char* name : {kCrateFormatFile, kCrateManifestFile}) {
    fs::rename(crate_ / name, base_ / name);
    fs::create_symlink("/dev/zero", crate_ / name);
    ExpectRefused(StatusCode::kIntegrity, name);
    fs::remove(crate_ / name);
    fs::rename(base_ / name, crate_ / name);
  }
  EXPECT_TRUE(Import().ok());
}

TEST_F(HostileCrates, OfLaterVersionsAreLeftToLaterPrograms) {
  const auto with = [&](const fs::path& file, const std::string& from, const std::string& to) {
    const std::string before = TextOfFile(file);
    Replace(file, from, to);
    Reseal();
    ExpectRefused(StatusCode::kNewerSchema, file.filename().string());
    WriteText(file, before);
    Reseal();
  };
  with(crate_ / kCrateFormatFile, "\"version\": 1", "\"version\": 2");
  with(crate_ / kCrateMetadataFile, "crate/1.3\"", "crate/1.4\"");
  with(crate_ / kCrateMetadataFile, "crate/1.3\"", "crate/2.0\"");
  with(In("session.json"), "\"schema\": 2", "\"schema\": 3");
  with(In("session.json"), "\"kind\": \"moved\"", "\"kind\": \"sneezed\"");
  with(In("frames.csv"), "stored_xxh3_128\n", "stored_xxh3_128,temperature\n");
  EXPECT_TRUE(Import().ok());
}

TEST_F(HostileCrates, OddDescriptionsAreRefused) {
  const fs::path file = crate_ / kCrateMetadataFile;
  const std::string before = TextOfFile(file);
  const auto with = [&](const std::function<void(ordered_json&)>& change, const std::string& complaint) {
    Edit(file, change);
    Reseal();
    ExpectRefused(StatusCode::kIntegrity, complaint);
    WriteText(file, before);
  };
  with([](auto& json) { json["@graph"].push_back(json["@graph"][1]); }, "two entities have the @id './'");
  with([](auto& json) { json["@graph"][1]["hasPart"].push_back({{"@id", "./"}}); }, "a part of itself");
  with([](auto& json) { json["@graph"][1]["hasPart"].push_back({{"@id", "#nothing"}}); }, "is not described");
  with([](auto& json) { json["@graph"][1]["hasPart"] = "all"; }, "names no @id");
  with([](auto& json) { json["@graph"].erase(0); }, "no metadata descriptor");
  with([](auto& json) { json["@graph"][0]["about"] = {{"@id", "#x"}}; }, "a root Dataset");
  with([](auto& json) { json["@graph"][2].erase("@type"); }, "has no @type");
  with([](auto& json) { json["@graph"][2]["@id"] = 7; }, "has no @id");
  with([](auto& json) { json["@graph"] = 7; }, "flat @graph");
  with([](auto& json) { json["@graph"].push_back({{"@id", "..%2Fx"}, {"@type", "File"}}); }, "outside the crate");
  with([](auto& json) { json["@graph"].push_back({{"@id", "none.txt"}, {"@type", "File"}}); }, "not in the crate");
  WriteText(file, std::string(100000, '['));
  Reseal();
  ExpectRefused(StatusCode::kIntegrity, "nests deeper");
  WriteText(file, "[1, 2");
  Reseal();
  ExpectRefused(StatusCode::kIntegrity, "not JSON");
}

TEST_F(HostileCrates, OddFactsAreRefused) {
  const fs::path file = In("session.json");
  const std::string before = TextOfFile(file);
  const ordered_json facts = ordered_json::parse(before);
  for (const auto& entry : facts.items()) {
    const std::string key = entry.key();
    if (key == "started" || key == "finished" || key == "exported_for") continue;  // for people only
    for (const ordered_json& value :
         {ordered_json(), ordered_json(-1.5), ordered_json("\x1b["), ordered_json::array({1})}) {
      if (entry.value() == value || (key == "consent" && value.is_null())) continue;
      if ((key == "rig" || key == "program_version" || key == "visit") && value.is_string()) continue;  // free texts
      if (key == "reasons" && value.is_array()) continue;
      Edit(file, [&](auto& json) { json[key] = value; });
      Reseal();
      SCOPED_TRACE(key + " = " + value.dump(-1, ' ', true));
      // A word where one of several stands may be of a later version.
      const bool word = (key == "kind" || key == "retention" || key == "status") && value.is_string();
      ExpectRefused(word ? StatusCode::kNewerSchema : StatusCode::kIntegrity, "session.json");
    }
    Edit(file, [&](auto& json) { json.erase(key); });
    Reseal();
    ExpectRefused(StatusCode::kIntegrity, "session.json");
    WriteText(file, before);
  }
  // Of sessions of which they are known.
  for (const ordered_json& devices : {ordered_json(), ordered_json::array({1}), ordered_json{{"projector_width", -5}},
                                      ordered_json{{"saturation_dn", "4095"}}}) {
    Edit(file, [&](auto& json) { json["devices"] = devices; });
    Reseal();
    SCOPED_TRACE("devices = " + devices.dump());
    ExpectRefused(StatusCode::kIntegrity, "session.json");
    WriteText(file, before);
  }
}

// Crates of before schema 2 know neither visits nor findings.
TEST_F(HostileCrates, OfTheFirstSchemaAreTakenAndMeanTheDefaults) {
  Edit(In("session.json"), [](auto& json) {
    json["schema"] = 1;
    for (const char* key : {"visit", "attempt", "findings", "faults"}) json.erase(key);
  });
  Reseal();
  const auto report = Import();
  ASSERT_TRUE(report.ok()) << report.status().message();
  const SessionInfo info = SessionStore::Open(other_, AccessMode::kReadOnly)->FindSession(id_)->info;
  EXPECT_EQ(info.visit, "");
  EXPECT_EQ(info.attempt, 0);
  EXPECT_EQ(info.found, CaptureFindings());
  EXPECT_EQ(info.reasons.size(), 2U);
}

// Each value is one that its file may hold; together they are a session that no index takes (CheckSession).
TEST_F(HostileCrates, PassTheGateIntoTheIndexOrStayOutside) {
  const fs::path facts = In("session.json"), table = In("frames.csv");
  const std::string facts_before = TextOfFile(facts), table_before = TextOfFile(table);
  const auto with_fact = [&](const std::string& key, const ordered_json& value, const std::string& complaint) {
    Edit(facts, [&](auto& json) { json[key] = value; });
    Reseal();
    ExpectRefused(StatusCode::kIntegrity, complaint);
    WriteText(facts, facts_before);
  };
  with_fact("rig", std::string("a\0b", 3), "rig holds a zero byte");
  with_fact("program_version", std::string("a\0b", 3), "program version holds a zero byte");
  with_fact("visit", std::string("a\0b", 3), "visit holds a zero byte");
  with_fact("started_wall_ns", -7, "start -7 ns lies before 1970");
  const auto with_cell = [&](const std::string& column, const std::string& value, const std::string& complaint) {
    const std::string head = table_before.substr(0, table_before.find('\n'));
    const size_t at = head.find("," + column + ",");
    ASSERT_NE(at, std::string::npos) << column;
    const auto index = std::count(head.begin(), head.begin() + static_cast<std::ptrdiff_t>(at) + 1, ',');
    size_t begin = head.size() + 1;
    for (std::ptrdiff_t k = 0; k < index; ++k) begin = table_before.find(',', begin) + 1;
    std::string text = table_before;
    WriteText(table, text.replace(begin, text.find(',', begin) - begin, value));
    Reseal();
    ExpectRefused(StatusCode::kIntegrity, complaint);
    WriteText(table, table_before);
  };
  with_cell("step", "-1", "frame 0: step -1 is out of range");
  with_cell("projector", "-2", "frame 0: projector -2 is out of range");
  with_cell("exposure_ms", "-0.5", "frame 0: exposure");
  Reseal();
  EXPECT_TRUE(Import().ok());
}

TEST_F(HostileCrates, OddRowsAreRefusedWithTheirLine) {
  const fs::path file = In("frames.csv");
  const std::string before = TextOfFile(file);
  const size_t first = before.find('\n') + 1;
  const std::string row = before.substr(first, before.find('\n', first) - first);
  const auto with = [&](const std::string& changed, const std::string& complaint,
                        StatusCode code = StatusCode::kIntegrity) {
    std::string text = before;
    WriteText(file, text.replace(first, row.size(), changed));
    Reseal();
    SCOPED_TRACE(changed);
    ExpectRefused(code, complaint);
  };
  const auto cell = [&](const std::string& from, const std::string& to) {
    std::string changed = row;
    EXPECT_NE(changed.find(from), std::string::npos) << from;
    return changed.replace(changed.find(from), from.size(), to);
  };
  with(cell(",41,31,1,", ",65536,65536,1,"), "frames.csv says 65536x65536");
  with(cell(",41,31,1,", ",99999999,31,1,"), "frames.csv:2: width");
  with(cell(",41,31,1,", ",41,31,2,"), "frames.csv:2: channels");
  with(cell(",123.5,", ",nan,"), "frames.csv:2: mean_dn");
  with(cell(",123.5,", ",1e999,"), "frames.csv:2: mean_dn");
  with(cell("frames/000000", "frames/../../x"), "frames.csv:2: file");
  with(cell(",mono8,", ",mono9,"), "frames.csv:2: format", StatusCode::kNewerSchema);
  with(cell(",correspondence,", ",party,"), "frames.csv:2: phase", StatusCode::kNewerSchema);
  with(cell(",raw8,", ",zip,"), "frames.csv:2: codec", StatusCode::kNewerSchema);
  with(cell("frames-0001.seg", "frames-0003.seg"), "frames.csv:2: segment");
  with(row + ",1", "frames.csv:2: not 31 cells");
  with(row.substr(0, 30), "frames.csv:2: not 31 cells");
  with(row + "\n" + row, "out of order");
  with("\"" + row, "the table is cut off");
  with(std::string(20000, 'x'), "a line of more than");
  with(cell("frames/000000", "frames/000009"), "is not in the crate");
  WriteText(file, before.substr(0, first));
  Reseal();
  ExpectRefused(StatusCode::kIntegrity, "has 0 frames");
}

TEST_F(HostileCrates, AnotherPictureUnderARightChecksumIsFound) {
  const auto frames = In("frames");
  std::vector<fs::path> names;
  for (const auto& entry : fs::directory_iterator(frames)) names.push_back(entry.path());
  std::sort(names.begin(), names.end());
  fs::copy_file(names[4], names[5], fs::copy_options::overwrite_existing);
  Reseal();
  ExpectRefused(StatusCode::kIntegrity, "its pixels do not match their hash");
  WriteText(names[5], "II*");
  Reseal();
  ExpectRefused(StatusCode::kIntegrity, names[5].filename().string());
}

// Any byte of any text, and of a picture, changed under right checksums: refused, or harmless to a whole session.
TEST_F(HostileCrates, MutantsNeverCrashNorLeaveHalfASession) {
  std::mt19937 random(20261122);
  const auto files = *ListCrateFiles(crate_);
  fs::copy(crate_, base_ / "sound", fs::copy_options::recursive);
  std::vector<std::string> paths;
  for (const auto& [path, sum] : files)
    if (sum.bytes > 0) paths.push_back(path);
  int refused = 0, taken = 0;
  for (int i = 0; i < 200; ++i) {
    const std::string path = paths[random() % paths.size()];
    auto bytes = ReadBytes(crate_ / path);
    for (auto changes = 1 + random() % 3; changes > 0; --changes) {
      const size_t at = random() % bytes.size();
      if (random() % 4 == 0)
        bytes.resize(at + 1);
      else
        bytes[at] = static_cast<uint8_t>(random());
    }
    WriteBytes(crate_ / path, bytes);
    Reseal();
    const auto report = Import();
    if (report.ok()) {
      ++taken;
      const auto store = SessionStore::Open(other_, AccessMode::kReadWrite);
      const auto rows = store->ListSessions();
      for (const auto& row : *rows) EXPECT_EQ(row.frames, 6) << path;
      fs::remove_all(other_);
      ASSERT_TRUE(SessionStore::Create(other_).ok());
    } else {
      ++refused;
      ExpectNothing();
    }
    fs::copy(base_ / "sound", crate_, fs::copy_options::recursive | fs::copy_options::overwrite_existing);
  }
  EXPECT_GT(refused, 60);
  EXPECT_GT(taken, 0);
}

}  // namespace
}  // namespace stratalux::db
