// SPDX-License-Identifier: Apache-2.0
// verify proves what is true, not only what was written: the index says what the files say, in every column, and the
// manifest, the segments and the pixels agree.
#include <set>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "db/care/row_comparison.h"
#include "db/care/session_rebuild.h"
#include "db/care/verify.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/manifest.h"
#include "shared/capture/rig_calibration.h"
#include "tests/db/forged_segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using Json = nlohmann::ordered_json;
using Lines = std::vector<std::string>;

class TruthTest : public StoreTest {
 protected:
  // A session with everything that a row can speak of.
  void SetUp() override {
    StoreTest::SetUp();
    Consent consent;
    consent.text_version = "3";
    consent.language = "de";
    consent.fit = true;
    consent.given_wall = {4'000};
    ASSERT_TRUE(GiveConsent(folder_, "v-5f3a91a1", consent).ok());
    SessionInfo info = SimulatedVisit();
    info.visitor = "v-5f3a91a1";
    info.rig = "bench";
    info.started_wall = {5'000};
    info.calibration_json = Record().ToJson();
    info.visit = "evening";
    info.attempt = 1;
    SessionStore store = OpenStore();
    id_ = Capture(store, info, Encryption::kPerSession);
    WriteSealed(store, "f1");
    ASSERT_TRUE(store.RegisterFit({"f1", id_, "{}", R"({"fit": {"divergence": 0.5}})", {6'000}}).ok());
    info = SimulatedVisit();
    info.kind = SessionKind::kCalibration;
    const std::string boards = Capture(store, info, Encryption::kNone);
    fs::create_directories(store.FitFolder(boards, "c1"));
    WriteText(store.FitFolder(boards, "c1") / "calibration.json", Record().ToJson() + "\n");
    ASSERT_TRUE(store.RegisterFit({"c1", boards, "{}", "{}", {6'500}}).ok());
  }
  static std::string Capture(SessionStore& store, const SessionInfo& info, Encryption encryption) {
    auto writer = store.BeginSession(info, {.encryption = encryption});
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete, {}, SomeFindings()).ok());
    return writer->info().id;
  }
  // A fit of the encrypted visit, with a map.
  void WriteSealed(const SessionStore& store, const std::string& fit) const {
    const fs::path plain = folder_.string() + ".plain";
    fs::create_directories(store.FitFolder(id_, fit));
    WriteText(plain, "map");
    auto seal = FindSeal(store, id_);
    ASSERT_TRUE(seal.ok()) << seal.status().message();
    EXPECT_TRUE(seal->Seal(plain, "fits/" + fit + "/map.exr", store.FitFolder(id_, fit) / "map.exr").ok());
    fs::remove(plain);
  }
  static RigCalibration Record() {
    RigCalibration record;
    record.camera.model = {64, 48, 100, 100, 31.5, 23.5, {}};
    record.projectors.emplace_back();
    record.projectors[0].model = {32, 24, 90, 90, 15.5, 11.5, {}};
    record.projectors[0].white_dn_mm2_per_ms = {1, 1, 1};
    record.made_wall.ns = 5'500;
    return record;
  }
  [[nodiscard]] Lines Problems(VerifyDepth depth = VerifyDepth::kHeaders) const {
    const auto store = SessionStore::Open(folder_, AccessMode::kReadOnly);
    if (!store.ok()) return {store.status().message()};
    Lines all;
    const auto whole = VerifyStore(*store, {depth});
    if (!whole.ok()) return {whole.status().message()};
    all = whole->problems;
    const auto sessions = store->ListSessions();
    if (!sessions.ok()) return {sessions.status().message()};
    for (const SessionSummary& session : *sessions) {
      const auto row = store->FindSession(session.info.id);
      if (!row.ok()) return {row.status().message()};
      const auto report = VerifySession(*store, *row, {depth});
      if (!report.ok()) return {report.status().message()};
      all.insert(all.end(), report->problems.begin(), report->problems.end());
    }
    return all;
  }
  [[nodiscard]] Connection Index() const {
    return std::move(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)).value();
  }
  [[nodiscard]] static Lines Column(Connection& connection, const std::string& sql) {
    Lines values;
    auto select = connection.Prepare(sql);
    EXPECT_TRUE(select.ok()) << select.status().message();
    while (*select->Step()) values.push_back(select->Text(0));
    return values;
  }
  [[nodiscard]] Lines Columns(const std::string& table) const {
    Connection index = Index();
    return Column(index, "SELECT name FROM pragma_table_info('" + table + "')");
  }
  // Some other value of the same type in one row.
  void ChangeFirst(const std::string& table, const std::string& column) const {
    Connection index = Index();
    ASSERT_TRUE(index.Execute("PRAGMA foreign_keys = OFF; PRAGMA ignore_check_constraints = ON").ok());
    const std::string name = "\"" + column + "\"";
    const Lines literals = Column(index, "SELECT quote(" + name + ") FROM " + table + " LIMIT 1");
    ASSERT_FALSE(literals.empty()) << table << " has no row to change";
    const Status done =
        index.Execute("UPDATE " + table + " SET " + name + " = CASE typeof(" + name + ") WHEN 'text' THEN " + name +
                      " || 'x' WHEN 'blob' THEN x'00' WHEN 'null' THEN" + " 12 ELSE (SELECT max(" + name + ") FROM " +
                      table + ") + 1 END WHERE " + name + " IS " + literals[0]);
    ASSERT_TRUE(done.ok()) << table << "." << column << ": " << done.message();
  }
  [[nodiscard]] fs::path Session() const { return folder_ / "sessions" / id_; }
  void ChangeManifest(const std::function<void(Json&)>& change) const {
    const auto bytes = ReadBytes(Session() / "manifest.json");
    Json json = Json::parse(bytes);
    change(json);
    json.erase("hash");
    WriteText(Session() / "manifest.json", WithOwnHash(json.dump(1)));
  }
  std::string id_;
};

TEST_F(TruthTest, AStoreThatIsAsItWasMadeHasNoProblem) {
  EXPECT_THAT(Problems(), IsEmpty());
  EXPECT_THAT(Problems(VerifyDepth::kDeep), IsEmpty());
}

TEST_F(TruthTest, EveryTableOfTheSchemaIsComparedOrExcused) {
  std::set<std::string> known;
  for (const auto& rule : SessionTables()) known.insert(rule.table);
  for (const auto& table : StoreTables()) known.insert(table.table);
  Connection index = Index();
  for (const std::string& table : Column(index, "SELECT name FROM sqlite_master WHERE type = 'table'"))
    EXPECT_TRUE(known.contains(table)) << table << ": say in row_comparison.cc how `verify` proves its rows";
}

// What `verify` makes in memory for each session, against what the migrations make on the disk.
TEST_F(TruthTest, TheTablesInMemoryAreThoseOfTheSchema) {
  Connection index = Index();
  auto memory = SessionIndex::TablesInMemory();
  ASSERT_TRUE(memory.ok()) << memory.status().message();
  std::set<std::string> made;
  for (const std::string& table : Column(memory->connection(), "SELECT name FROM sqlite_schema WHERE type = 'table'"))
    if (!table.starts_with("sqlite_")) made.insert(table);
  std::set<std::string> wanted;
  for (const auto& rule : SessionTables()) wanted.insert(rule.table);
  EXPECT_EQ(made, wanted);
  for (const std::string& table : made) {
    const std::string text = "SELECT sql FROM sqlite_schema WHERE name = '" + table + "'";
    EXPECT_EQ(Column(memory->connection(), text), Column(index, text))
        << "copy the second into db/catalogue/schema/session_tables.sql";
  }
}

// Also of a column that a later migration adds: nobody has to think of it.
TEST_F(TruthTest, EveryColumnThatIsChangedWithSqlIsNamed) {
  const auto intact = ReadBytes(folder_ / "index.sqlite");
  int changed = 0;
  for (const auto& rule : SessionTables()) {
    const std::string table = rule.table;
    for (const std::string& column : Columns(table)) {
      if ((", " + std::string(rule.left_out) + ",").find(", " + column + ",") != std::string::npos) continue;
      ChangeFirst(table, column);
      EXPECT_THAT(Problems(), Contains(HasSubstr(table))) << table << "." << column;
      ++changed;
      WriteBytes(folder_ / "index.sqlite", intact);
    }
  }
  EXPECT_THAT(Problems(), IsEmpty()) << "each change was taken back";
  EXPECT_GT(changed, 50);
}

// A registration that was broken off left figures that the index has not; a time alone that differs is damage.
TEST_F(TruthTest, AFitThatIsNewerThanItsRowIsANoteOnlyWithFiguresOfItsOwn) {
  const fs::path fit = Session() / "fits" / "f2";
  FitRow row{"f2", id_, "{}", R"({"fit": {"divergence": 0.25}})", {7'000}};
  {
    SessionStore store = OpenStore();
    WriteSealed(store, "f2");
    ASSERT_TRUE(store.RegisterFit(row).ok());
  }
  ASSERT_THAT(Problems(), IsEmpty());
  ASSERT_TRUE(Index().Execute("UPDATE fits SET created_wall_ns = 17 WHERE id = 'f2'").ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("fits")));
  ASSERT_TRUE(Index().Execute("UPDATE fits SET created_wall_ns = 7000 WHERE id = 'f2'").ok());
  row.created_wall.ns = 8'000;
  WriteText(fit / "fit.json", *FitRecordOf(fit, row));
  EXPECT_THAT(Problems(), Contains(HasSubstr("fits"))) << "the time of the record alone";
  row.metrics_json = R"({"fit": {"divergence": 0.125}})";
  WriteText(fit / "fit.json", *FitRecordOf(fit, row));
  EXPECT_THAT(Problems(), IsEmpty());
}

TEST_F(TruthTest, RowsThatAreGoneOrTooManyAreNamed) {
  Connection index = Index();
  ASSERT_TRUE(index.Execute("DELETE FROM metrics").ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("metrics lacks the row")));
  ASSERT_TRUE(
      index.Execute("INSERT INTO metrics SELECT session, id, 'fit.divergence', 0.5 FROM fits WHERE id = 'f1'").ok());
  EXPECT_THAT(Problems(), IsEmpty());
  ASSERT_TRUE(index.Execute("INSERT INTO metrics SELECT session, id, 'more', 0.5 FROM fits").ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("metrics has the row")));
}

TEST_F(TruthTest, TheSchemaItselfIsCompared) {
  Connection index = Index();
  ASSERT_TRUE(index.Execute("DROP VIEW session_overview; CREATE VIEW mine AS SELECT 1").ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("the view session_overview of the schema is missing")));
  EXPECT_THAT(Problems(), Contains(HasSubstr("the view mine is not of the schema")));
}

TEST_F(TruthTest, WhatBelongsToNoSessionIsHeldAgainstItsFiles) {
  Connection index = Index();
  ASSERT_TRUE(index.Execute("UPDATE sqlite_sequence SET seq = 0 WHERE name = 'sessions'").ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("sqlite_sequence.seq of sessions is 0, but the number 2 was given")));
  ASSERT_TRUE(index
                  .Execute("UPDATE sqlite_sequence SET seq = 2 WHERE name = 'sessions';"
                           "UPDATE calibrations SET rig = 'another'")
                  .ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("calibrations.rig")));
  ASSERT_TRUE(index.Execute("UPDATE calibrations SET rig = 'bench', made_wall_ns = 7").ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("calibrations.made_wall_ns")));
  ASSERT_TRUE(
      index.Execute("UPDATE calibrations SET made_wall_ns = 5500; UPDATE visitors SET created_wall_ns = 9").ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("visitors.created_wall_ns")));
  ASSERT_TRUE(index
                  .Execute("UPDATE visitors SET created_wall_ns = 4000;"
                           "INSERT INTO deletions VALUES ('s000009-0badcafe', 5, 'forget', '{}')")
                  .ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("s000009-0badcafe")));
  ASSERT_TRUE(index.Execute("DELETE FROM deletions; UPDATE consents SET withdrawn_wall_ns = 7000").ok());
  EXPECT_THAT(Problems(), Contains(HasSubstr("consents.withdrawn_wall_ns of 'v-5f3a91a1' is 7000")));
}

TEST_F(TruthTest, AFlippedBitAnywhereInAManifestIsRefused) {
  const fs::path manifest = Session() / "manifest.json";
  const size_t size = ReadBytes(manifest).size();
  for (size_t i = 0; i < size; ++i) {
    const auto mask = static_cast<uint8_t>(1U << (i % 8));
    FlipBits(manifest, i, mask);
    const Status status = ReadManifest(Session()).status();
    EXPECT_TRUE(status.code() == StatusCode::kIntegrity || status.code() == StatusCode::kNewerSchema) << "byte " << i;
    EXPECT_THAT(status.message(), HasSubstr("manifest.json"));
    FlipBits(manifest, i, mask);
  }
  EXPECT_TRUE(ReadManifest(Session()).ok());
}

TEST_F(TruthTest, AManifestThatLostItsHashIsRefusedAndOlderOnesAreRead) {
  const auto bytes = ReadBytes(Session() / "manifest.json");
  Json json = Json::parse(bytes);
  json.erase("hash");
  WriteText(Session() / "manifest.json", json.dump(1) + "\n");
  EXPECT_EQ(ReadManifest(Session()).status().code(), StatusCode::kIntegrity);
  json.erase("files");
  for (const int schema : {2, 1}) {
    json["schema"] = schema;
    if (schema == 1) json["consent"] = "3";
    WriteText(Session() / "manifest.json", json.dump(1) + "\n");
    const auto info = ReadManifest(Session());
    ASSERT_TRUE(info.ok()) << info.status().message();
    EXPECT_EQ(info->consent.text_version, "3");
    EXPECT_TRUE(ReadManifestContents(Session())->files.empty());
  }
  json["schema"] = 5;
  WriteText(Session() / "manifest.json", json.dump(1) + "\n");
  EXPECT_EQ(ReadManifest(Session()).status().code(), StatusCode::kNewerSchema);
}

TEST_F(TruthTest, AManifestChangedWithItsHashDisagreesWithTheIndex) {
  for (const char* key : {"kind", "rig", "visitor", "retention", "status", "program_version"}) {
    const auto before = ReadBytes(Session() / "manifest.json");
    ChangeManifest([key](Json& json) {
      const std::string text = key;
      json[key] = text == "kind" ? "flat" : text == "retention" ? "keep" : text == "status" ? "degraded" : "other";
    });
    EXPECT_THAT(Problems(), Contains(HasSubstr(std::string("sessions.") + key))) << key;
    WriteBytes(Session() / "manifest.json", before);
  }
  EXPECT_THAT(Problems(), IsEmpty());
}

TEST_F(TruthTest, ASegmentThatWasSealedAnewIsNotTheOneOfTheManifest) {
  ForgeHeaders(Segment(id_), [](FrameHeader& header) { header.crop_x = 99; });
  EXPECT_THAT(Problems(), Contains(HasSubstr("frames-0001.seg is not the file that the manifest describes")));
}

class PlainTruthTest : public StoreTest {
 protected:
  // Every level made anew: manifest and rows.
  void EnterAgain(const std::string& id) const {
    ASSERT_TRUE(ReplaceSegments(folder_ / "sessions" / id, {"frames-0001.seg"}).ok());
    auto index = SessionIndex::Open(folder_, AccessMode::kReadWrite);
    const auto session = RebuildSession(folder_ / "sessions" / id);
    ASSERT_TRUE(session.ok()) << session.status().message();
    const int64_t number = *index->NumberOf(id);
    ASSERT_TRUE(index->connection().Execute("DELETE FROM sessions").ok());
    ASSERT_TRUE(InsertRebuilt(*index, *session, number).ok());
  }
  [[nodiscard]] Lines Problems(VerifyDepth depth) const {
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    return VerifySession(store, *store.FindSession("latest"), {depth})->problems;
  }
};

TEST_F(PlainTruthTest, PixelsThatAreNotThoseOfTheirHashAreFoundByDecodingThem) {
  const std::string id = StoreSession(3);
  ForgeHeaders(Segment(id), [](FrameHeader& header) { header.pixel_hash[3] ^= 1U; });
  EnterAgain(id);
  EXPECT_THAT(Problems(VerifyDepth::kHeaders), IsEmpty());
  EXPECT_THAT(Problems(VerifyDepth::kDeep), Contains(HasSubstr("frame 1")));
}

TEST_F(PlainTruthTest, PayloadsThatCannotBeDecodedAreFoundWhateverTheirHashes) {
  const std::string id = StoreSession(2);
  ForgeHeaders(Segment(id), [](FrameHeader& header) {
    header.codec = static_cast<decltype(header.codec)>(Codec::kDelta);  // the payload is raw
    header.width = 60;                                                  // so that its length alone does not tell
    std::fill(std::begin(header.pixel_hash), std::end(header.pixel_hash), uint8_t{0});
  });
  EnterAgain(id);
  EXPECT_THAT(Problems(VerifyDepth::kHeaders), IsEmpty());
  EXPECT_THAT(Problems(VerifyDepth::kDeep), Contains(HasSubstr("frame 0")));
}

TEST_F(PlainTruthTest, APayloadOfAnotherLengthThanItsShapeDoesNotEnter) {
  const std::string id = StoreSession(2);
  ForgeHeaders(Segment(id), [](FrameHeader& header) { header.width = 4; });  // the payload is of 6 x 4
  ASSERT_TRUE(ReplaceSegments(folder_ / "sessions" / id, {"frames-0001.seg"}).ok());
  const Status refused = RebuildSession(folder_ / "sessions" / id).status();
  EXPECT_EQ(refused.code(), StatusCode::kIntegrity);
  EXPECT_THAT(refused.message(), HasSubstr("frame 0: a payload of 36 bytes"));
}

}  // namespace
}  // namespace stratalux::db
