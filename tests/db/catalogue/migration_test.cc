// SPDX-License-Identifier: Apache-2.0
// Stores of schema 1, as version 0.1 left them, and of schemas 4 and 5 open for ever.
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <latch>
#include <sstream>
#include <thread>

#include <gmock/gmock.h>

#include "db/base/sqlite.h"
#include "db/care/reindex.h"
#include "db/care/transcode.h"
#include "db/care/verify.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/deletions.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/read_only_index.h"
#include "db/catalogue/session_index.h"
#include "db/catalogue/session_store.h"
#include "db/ledger/old_tombstones.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

std::string SchemaOne() {
  std::ifstream file(std::string(STRATALUX_SOURCE_DIR) + "/db/catalogue/migrations/0001_initial.sql");
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

// Two sessions, 30 frames, one calibration, one fit; frozen.
constexpr const char* kRowsOfSchemaOne = R"(
  INSERT INTO calibrations VALUES ('c0ffee', '{"source": "calibration session s000001-aaaaaaaa"}');
  INSERT INTO sessions VALUES (1, 's000001-aaaaaaaa', 'calibration', 'bench', '', '', 0, 0, 1000000000, 'complete', '[]',
                               '0.1.0', '', NULL);
  INSERT INTO sessions VALUES (2, 's000002-bbbbbbbb', 'visitor', 'bench', 'v7', 'text 3', 0, 0, 86401000000000, 'degraded',
                               '["no proven frame for step 3"]', '0.1.0', '{}', 'c0ffee');
  WITH RECURSIVE n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i < 29)
    INSERT INTO frames SELECT 1 + i / 20, i % 20, 1, 64 + 500 * i, 100 + i, x'00112233445566778899aabbccddeeff', i % 20, i % 4,
                              'sweep', 'white', 0, 1 FROM n;
  INSERT INTO fits VALUES ('f1', 2, '{}', '{"fit": {"divergence": 0.5}}', 86402000000000);
  INSERT INTO jobs VALUES (1, 2, 'fit', 'done', '{}', '');
)";

class MigrationTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    for (const char* name : {"index.sqlite", "index.sqlite-wal", "index.sqlite-shm"})
      std::filesystem::remove(folder_ / name);
    Connection connection = Open(Connection::Mode::kCreate);
    for (const std::string& sql : {std::string("PRAGMA journal_mode = WAL"), SchemaOne(), std::string(kRowsOfSchemaOne),
                                   std::string("PRAGMA application_id = 1397512241; PRAGMA user_version = 1")}) {
      const Status status = connection.Execute(sql);
      ASSERT_TRUE(status.ok()) << status.message();
    }
  }
  [[nodiscard]] Connection Open(Connection::Mode mode, const std::string& name = "index.sqlite") const {
    auto connection = Connection::Open(folder_ / name, mode);
    EXPECT_TRUE(connection.ok()) << connection.status().message();
    return std::move(connection).value();
  }
  static int64_t Integer(Connection& connection, const std::string& sql) {
    const auto value = connection.QueryInteger(sql);
    EXPECT_TRUE(value.ok()) << sql << ": " << value.status().message();
    return value.ok() ? *value : -1;
  }
  // Every cell of the columns that schema 1 has, as one text.
  static std::string Contents(Connection& connection) {
    std::string all;
    // Schema 5 calls what a job says last an error.
    const bool old = Integer(connection, "PRAGMA user_version") < 5;
    const char* columns_of_jobs = old ? "id, session, kind, state, options_json, message FROM jobs"
                                      : "id, session, kind, state, options_json, last_error FROM jobs";
    for (const char* columns :
         {"id, record_json FROM calibrations",
          "session, frame, segment, offset, stored_bytes, hex(hash), step, projector,"
          " phase, pattern, retry, level_check FROM frames",
          "id, session, options_json, metrics_json, created_wall_ns FROM"
          " fits",
          columns_of_jobs,
          "number, id, kind, rig, visitor, consent, simulated, seed, started_wall_ns, status, reasons_json,"
          " program_version, plan_json, calibration_id FROM sessions"}) {
      auto select = connection.Prepare("SELECT " + std::string(columns) + " ORDER BY 1, 2");
      EXPECT_TRUE(select.ok()) << select.status().message();
      const auto count = std::count(columns, columns + std::string(columns).find(" FROM"), ',') + 1;
      while (*select->Step())
        for (int c = 0; c < count; ++c) all += select->Text(c) + "|";
    }
    return all;
  }
};

TEST_F(MigrationTest, KeepsEveryRowOfSchemaOne) {
  std::string before;
  {
    Connection old = Open(Connection::Mode::kReadOnly);
    before = Contents(old);
  }
  const auto store = SessionStore::Open(folder_, AccessMode::kReadOnly);
  ASSERT_TRUE(store.ok()) << store.status().message();
  Connection now = Open(Connection::Mode::kReadOnly);
  EXPECT_EQ(Integer(now, "PRAGMA user_version"), kSchemaVersion);
  EXPECT_EQ(Integer(now, "SELECT count(*) FROM pragma_integrity_check WHERE integrity_check <> 'ok'"), 0);
  EXPECT_EQ(Integer(now, "SELECT count(*) FROM pragma_foreign_key_check"), 0);
  EXPECT_EQ(Contents(now), before);
  EXPECT_GT(before.size(), 2000U);
}

TEST_F(MigrationTest, FillsWhatTheNewSchemaAdds) {
  ASSERT_TRUE(SessionStore::Open(folder_, AccessMode::kReadWrite).ok());
  Connection now = Open(Connection::Mode::kReadOnly);
  EXPECT_EQ(Integer(now, "SELECT frame_count FROM sessions WHERE number = 1"), 20);
  EXPECT_EQ(Integer(now, "SELECT frame_count FROM sessions WHERE number = 2"), 10);
  EXPECT_EQ(Integer(now, "SELECT stored_bytes FROM sessions WHERE number = 2"), 10 * 100 + (20 + 29) * 5);
  EXPECT_EQ(Integer(now, "SELECT count(*) FROM visitors WHERE id = 'v7'"), 1);
  EXPECT_EQ(
      Integer(now, "SELECT value * 100 FROM metrics WHERE session = 2 AND fit = 'f1' AND name = 'fit.divergence'"), 50);
  EXPECT_EQ(Integer(now, "SELECT since_wall_ns FROM calibration_overview WHERE id = 'c0ffee' AND rig = 'bench'"),
            1000000000)
      << "made by the session its source names";
}

TEST_F(MigrationTest, CountsTheStepsOfOldPlans) {
  PlanOptions options;
  options.guards = 3;
  const auto steps = static_cast<int64_t>(BuildPlan(options)->steps.size());
  {
    Connection old = Open(Connection::Mode::kReadWrite);
    ASSERT_TRUE(old.Execute("UPDATE sessions SET plan_json = '" + PlanOptionsToJson(options) +
                            "' WHERE number = 1; UPDATE sessions SET plan_json = 'no plan' WHERE number = 2")
                    .ok());
  }
  ASSERT_TRUE(SessionStore::Open(folder_, AccessMode::kReadWrite).ok());
  Connection now = Open(Connection::Mode::kReadOnly);
  EXPECT_EQ(Integer(now, "SELECT planned_steps FROM sessions WHERE number = 1"), steps);
  EXPECT_EQ(Integer(now, "SELECT planned_steps IS NULL FROM sessions WHERE number = 2"), 1);
}

TEST_F(MigrationTest, MakesABackupOfTheOldIndexFirst) {
  std::string before;
  {
    Connection old = Open(Connection::Mode::kReadOnly);
    before = Contents(old);
  }
  ASSERT_TRUE(SessionStore::Open(folder_, AccessMode::kReadWrite).ok());
  Connection backup = Open(Connection::Mode::kReadOnly, "index-before-" + std::to_string(kSchemaVersion) + ".sqlite");
  EXPECT_EQ(Integer(backup, "PRAGMA user_version"), 1);
  EXPECT_EQ(Contents(backup), before);
}

// As a rig's programs do that start together behind an update.
TEST_F(MigrationTest, ProgramsThatOpenItAtOnceMigrateItOnceAndKeepOneWholeCopy) {
  std::string before;
  {
    Connection old = Open(Connection::Mode::kReadOnly);
    before = Contents(old);
  }
  constexpr int kPrograms = 4;
  for (int round = 0; round < 10; ++round) {
    const auto store = folder_ / std::to_string(round);
    std::filesystem::create_directory(store);
    std::filesystem::copy_file(folder_ / "index.sqlite", store / "index.sqlite");
    std::latch start(kPrograms);
    std::vector<Status> opened(kPrograms);
    {
      std::vector<std::jthread> programs;
      for (int i = 0; i < kPrograms; ++i)
        programs.emplace_back([&, i] {
          start.arrive_and_wait();
          const AccessMode mode = i % 2 == 0 ? AccessMode::kReadWrite : AccessMode::kReadOnly;
          opened[static_cast<size_t>(i)] = SessionIndex::Open(store, mode).status();
        });
    }
    for (const Status& status : opened) EXPECT_TRUE(status.ok()) << status.message();
    Connection now = Open(Connection::Mode::kReadOnly, std::to_string(round) + "/index.sqlite");
    EXPECT_EQ(Integer(now, "PRAGMA user_version"), kSchemaVersion);
    EXPECT_EQ(Contents(now), before);
    const std::string kept = std::to_string(round) + "/index-before-" + std::to_string(kSchemaVersion) + ".sqlite";
    Connection copy = Open(Connection::Mode::kReadOnly, kept);
    EXPECT_EQ(Integer(copy, "PRAGMA user_version"), 1);
    EXPECT_EQ(Contents(copy), before);
    EXPECT_FALSE(std::filesystem::exists(folder_ / (kept + ".new")));
  }
}

TEST_F(MigrationTest, LeavesTheOldSchemaWhenItFailsHalfWay) {
  std::string before;
  {
    // Schema 2 goes in whole; then the name of one of schema 3's views is taken.
    Connection old = Open(Connection::Mode::kReadWrite);
    ASSERT_TRUE(old.Execute("CREATE TABLE frame_overview (a)").ok());
    before = Contents(old);
  }
  const auto store = SessionStore::Open(folder_, AccessMode::kReadWrite);
  ASSERT_FALSE(store.ok());
  EXPECT_THAT(store.status().message(), HasSubstr("frame_overview"));
  Connection now = Open(Connection::Mode::kReadWrite);
  EXPECT_EQ(Integer(now, "PRAGMA user_version"), 1);
  EXPECT_EQ(Integer(now, "SELECT count(*) FROM sqlite_schema WHERE name IN ('visitors', 'proofs', 'fit_overview')"), 0);
  EXPECT_EQ(Contents(now), before);
  // What stood in the way gone, it migrates: the backup of the first attempt is no obstacle.
  ASSERT_TRUE(now.Execute("DROP TABLE frame_overview").ok());
  const auto again = SessionStore::Open(folder_, AccessMode::kReadWrite);
  EXPECT_TRUE(again.ok()) << again.status().message();
}

TEST_F(MigrationTest, RefusesANewerSchema) {
  ASSERT_TRUE(Open(Connection::Mode::kReadWrite).Execute("PRAGMA user_version = 99").ok());
  EXPECT_EQ(SessionStore::Open(folder_, AccessMode::kReadOnly).status().code(), StatusCode::kNewerSchema);
  EXPECT_EQ(ReadOnlyIndex::Open(folder_).status().exit_code(), 7);
}

// A downgrade behind a migration, as docs/install.md has it: the copy of before takes the index's place, and a reindex
// lists what was captured since.
TEST_F(StoreTest, ANewerIndexIsRefusedWithTheWayBack) {
  const std::string before = StoreSession(3);
  // As Migrate() keeps it; of these two, only the first is one that we read.
  const auto copy = folder_ / ("index-before-" + std::to_string(kSchemaVersion + 1) + ".sqlite");
  const auto later = folder_ / ("index-before-" + std::to_string(kSchemaVersion + 2) + ".sqlite");
  const auto execute = [](const std::filesystem::path& file, const std::string& sql) {
    auto connection = Connection::Open(file, Connection::Mode::kReadWrite);
    return connection.ok() ? connection->Execute(sql) : connection.status();
  };
  ASSERT_TRUE(execute(folder_ / "index.sqlite", "VACUUM INTO '" + copy.string() + "'").ok());
  ASSERT_TRUE(execute(folder_ / "index.sqlite", "VACUUM INTO '" + later.string() + "'").ok());
  ASSERT_TRUE(execute(later, "PRAGMA user_version = " + std::to_string(kSchemaVersion + 1)).ok());
  const std::string since = StoreSession(2);
  ASSERT_TRUE(execute(folder_ / "index.sqlite", "PRAGMA user_version = " + std::to_string(kSchemaVersion + 2)).ok());

  for (const AccessMode mode : {AccessMode::kReadOnly, AccessMode::kReadWrite}) {
    const Status refused = SessionStore::Open(folder_, mode).status();
    EXPECT_EQ(refused.code(), StatusCode::kNewerSchema);
    EXPECT_THAT(refused.message(), HasSubstr("use a newer stratalux, or go back to " + copy.string()));
  }

  const std::filesystem::path aside = folder_.string() + "-newer";
  std::filesystem::create_directory(aside);
  for (const char* name : {"index.sqlite", "index.sqlite-wal", "index.sqlite-shm"})
    if (std::filesystem::exists(folder_ / name)) std::filesystem::rename(folder_ / name, aside / name);
  std::filesystem::copy_file(copy, folder_ / "index.sqlite");
  Logger logger(LogLevel::kError);
  const auto report = Reindex(folder_, logger);
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_TRUE(report->problems.empty());
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  for (const std::string& id : {before, since}) EXPECT_TRUE(store.FindSession(id).ok()) << id;
  std::filesystem::remove_all(aside);
}

// A store that a program of an older schema left, packed with what it said of itself: rows of every table, the samples
// of every frame, the verdict of `verify --deep` (tests/db/samples/README.md).
class FrozenStoreTest : public StoreTest {
 protected:
  explicit FrozenStoreTest(std::string name) : name_(std::move(name)) {}
  void SetUp() override {
    StoreTest::SetUp();
    const std::string unpack =
        "tar -xzf " STRATALUX_SOURCE_DIR "/tests/db/samples/" + name_ + ".tar.gz -C " + folder_.string();
    ASSERT_EQ(std::system(unpack.c_str()), 0);
    store_ = folder_ / name_;
    std::ifstream expected(folder_ / "expected.txt");
    for (std::string line; std::getline(expected, line);) expected_.push_back(line);
    ASSERT_GT(expected_.size(), 80U);
  }
  // Lines that begin with this word, without it.
  [[nodiscard]] std::vector<std::string> Expected(const std::string& word) const {
    std::vector<std::string> lines;
    for (const std::string& line : expected_)
      if (line.starts_with(word + " ")) lines.push_back(line.substr(word.size() + 1));
    return lines;
  }
  static std::string OneLine(std::string text) {
    for (size_t at = 0; (at = text.find('\n', at)) != std::string::npos;) text.replace(at, 1, "\\n");
    return text;
  }
  void ExpectEveryRow() const {
    auto connection = Connection::Open(store_ / "index.sqlite", Connection::Mode::kReadOnly);
    ASSERT_TRUE(connection.ok());
    EXPECT_EQ(*connection->QueryInteger("PRAGMA user_version"), kSchemaVersion);
    EXPECT_EQ(*connection->QueryInteger("SELECT count(*) FROM pragma_foreign_key_check"), 0);
    std::vector<std::string> found;
    for (const std::string& line : expected_) {
      if (!line.starts_with("? ")) continue;
      found.push_back(line);
      auto select = connection->Prepare(line.substr(2));
      ASSERT_TRUE(select.ok()) << select.status().message();
      while (*select->Step()) found.push_back("= " + OneLine(select->Text(0)));
    }
    std::vector<std::string> said;
    for (const std::string& line : expected_)
      if (line.starts_with("? ") || line.starts_with("= ")) said.push_back(line);
    ASSERT_EQ(found.size(), said.size());
    for (size_t i = 0; i < said.size(); ++i)
      EXPECT_TRUE(SameRow(found[i], said[i])) << "line " << i << "\nfound " << found[i] << "\nsaid  " << said[i];
  }
  // Field by field: quote() of an older SQLite writes a number's last digits out of which a newer one makes fewer.
  static bool SameRow(const std::string& found, const std::string& said) {
    std::istringstream a(found), b(said);
    std::string x, y;
    while (std::getline(a, x, '|'))
      if (!std::getline(b, y, '|') || (x != y && !SameNumber(x, y))) return false;
    return !std::getline(b, y, '|');
  }
  static bool SameNumber(const std::string& x, const std::string& y) {
    char *x_end = nullptr, *y_end = nullptr;
    const double a = std::strtod(x.c_str(), &x_end), b = std::strtod(y.c_str(), &y_end);
    return a == b && !x.empty() && !y.empty() && *x_end == '\0' && *y_end == '\0';
  }
  // Returns how many there are.
  int ExpectEveryFrame(const SessionStore& store) const {
    int frames = 0;
    for (const std::string& line : Expected("pixels")) {
      std::istringstream in(line);
      std::string session;
      size_t frame = 0;
      in >> session >> frame;
      const std::vector<uint16_t> samples{std::istream_iterator<uint16_t>(in), {}};
      const auto rows = store.ListFrames(session);
      EXPECT_TRUE(rows.ok() && frame < rows->size()) << rows.status().message();
      if (!rows.ok() || frame >= rows->size()) continue;
      const auto image = store.ReadFrame(session, (*rows)[frame]);
      EXPECT_TRUE(image.ok()) << image.status().message();
      EXPECT_TRUE(image.ok() &&
                  std::equal(samples.begin(), samples.end(), image->pixels().begin(), image->pixels().end()))
          << session << " frame " << frame;
      ++frames;
    }
    return frames;
  }
  void ExpectEveryVerdict(const SessionStore& store) const {
    for (const std::string& verdict : Expected("verdict")) {
      ASSERT_THAT(verdict, HasSubstr("\"problems\": []"));
      const size_t at = verdict.find(": \"") + 3;
      const auto row = store.FindSession(verdict.substr(at, verdict.find('"', at) - at));
      ASSERT_TRUE(row.ok()) << row.status().message();
      const auto report = VerifySession(store, *row, {VerifyDepth::kDeep});
      EXPECT_THAT(report->problems, ::testing::IsEmpty());
      const bool was_signed =
          verdict.find("signed_by") != std::string::npos && verdict.find("\"signed_by\": null") == std::string::npos;
      EXPECT_EQ(report->signed_by.has_value(), was_signed) << verdict;
    }
  }

  std::string name_;
  std::filesystem::path store_;
  std::vector<std::string> expected_;
};

class SchemaFourTest : public FrozenStoreTest {
 protected:
  SchemaFourTest() : FrozenStoreTest("store-schema4") {}
};

TEST_F(SchemaFourTest, KeepsEveryRow) {
  ASSERT_TRUE(SessionStore::Open(store_, AccessMode::kReadWrite).ok());
  ExpectEveryRow();
}

TEST_F(SchemaFourTest, KeepsEveryFrameAndEveryVerdict) {
  const auto store = SessionStore::Open(store_, AccessMode::kReadOnly);
  ASSERT_TRUE(store.ok()) << store.status().message();
  EXPECT_TRUE(store->notes().empty());
  EXPECT_EQ(ExpectEveryFrame(*store), 17);
  EXPECT_EQ(Expected("verdict").size(), 4U);
  ExpectEveryVerdict(*store);
  const std::string forgotten = Expected("forgotten").at(0);
  EXPECT_TRUE(*IsForgotten(store_, forgotten));
  EXPECT_EQ(store->FindSession(forgotten).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(store->ListFits(store->FindSession("s000001")->info.id)->size(), 2U);
  const auto consents = ListConsents(store_, "v-2b");
  ASSERT_TRUE(consents.ok());
  EXPECT_TRUE(consents->at(0).withdrawn);
}

// What only reads takes no tombstone over, and must not call the rows of the forgotten damage for it.
TEST_F(SchemaFourTest, IsSoundAsAWholeBeforeItsLedgerIsMadeAndAfter) {
  bool made = false;
  for (const AccessMode mode : {AccessMode::kReadOnly, AccessMode::kReadWrite, AccessMode::kReadOnly}) {
    const auto store = SessionStore::Open(store_, mode);
    ASSERT_TRUE(store.ok()) << store.status().message();
    const auto report = VerifyStore(*store, {VerifyDepth::kDeep});
    ASSERT_TRUE(report.ok()) << report.status().message();
    EXPECT_THAT(report->problems, ::testing::IsEmpty());
    EXPECT_THAT(report->notes, ::testing::IsEmpty());
    made |= mode == AccessMode::kReadWrite;
    EXPECT_EQ(ReadOldTombstones(store_)->empty(), made);
  }
}

// Of schema 5: manifests of schema 3, one signed; a session that its writer left when it was killed.
class SchemaFiveTest : public FrozenStoreTest {
 protected:
  SchemaFiveTest() : FrozenStoreTest("store-schema5") {}
  // All of each row of `sessions`, as one text.
  [[nodiscard]] std::vector<std::string> Sessions() const {
    auto connection = *Connection::Open(store_ / "index.sqlite", Connection::Mode::kReadOnly);
    auto columns = *connection.Prepare(
        "SELECT group_concat('quote(' || name || ')', '||''|''||') FROM pragma_table_info('sessions')");
    EXPECT_TRUE(*columns.Step());
    auto select = *connection.Prepare("SELECT " + columns.Text(0) + " FROM sessions ORDER BY number");
    std::vector<std::string> rows;
    while (*select.Step()) rows.push_back(select.Text(0));
    return rows;
  }
};

TEST_F(SchemaFiveTest, KeepsEveryRowAndFindsNothing) {
  ASSERT_TRUE(SessionStore::Open(store_, AccessMode::kReadOnly).ok());  // which ends no session
  ExpectEveryRow();
  auto now = *Connection::Open(store_ / "index.sqlite", Connection::Mode::kReadOnly);
  EXPECT_EQ(*now.QueryInteger("SELECT count(*) FROM sessions WHERE visit = '' AND attempt = 0 AND findings_json = '[]'"
                              " AND faults_json = '{}'"),
            5);
  EXPECT_EQ(*now.QueryInteger("SELECT (SELECT count(*) FROM session_findings) + (SELECT count(*) FROM session_faults)"),
            0);
}

TEST_F(SchemaFiveTest, EndsWhatWasRecordedAndKeepsEveryFrameAndVerdict) {
  const auto store = SessionStore::Open(store_, AccessMode::kReadWrite);
  ASSERT_TRUE(store.ok()) << store.status().message();
  EXPECT_THAT(store->notes(), ::testing::Contains(HasSubstr("ended as failed")));
  EXPECT_EQ(ExpectEveryFrame(*store), 15);
  EXPECT_EQ(Expected("verdict").size(), 5U);
  ExpectEveryVerdict(*store);
  const auto report = VerifyStore(*store, {VerifyDepth::kDeep});
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_THAT(report->problems, ::testing::IsEmpty());
  EXPECT_TRUE(*IsForgotten(store_, Expected("forgotten").at(0)));
  EXPECT_TRUE(ListConsents(store_, "v-2b")->at(0).withdrawn);
}

TEST_F(SchemaFiveTest, ItsManifestsRebuildToEqualRows) {
  ASSERT_TRUE(SessionStore::Open(store_, AccessMode::kReadWrite).ok());
  const auto before = Sessions();
  ASSERT_EQ(before.size(), 5U);
  Logger quiet(LogLevel::kError);
  const auto report = Reindex(store_, quiet);
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_THAT(report->problems, ::testing::IsEmpty());
  EXPECT_EQ(Sessions(), before);
}

// A transcode raises the manifest's schema and adds no member: what was signed is what stands there.
TEST_F(SchemaFiveTest, ASignatureOutlivesTheManifestsNewSchema) {
  const auto store = SessionStore::Open(store_, AccessMode::kReadWrite);
  ASSERT_TRUE(store.ok()) << store.status().message();
  const auto row = store->FindSession("s000001");
  ASSERT_TRUE(row.ok()) << row.status().message();
  EXPECT_EQ(ReadManifestContents(store->SessionFolder(row->info.id))->schema, 3);
  Logger quiet(LogLevel::kError);
  Progress progress(quiet, "transcode", row->frames);
  const auto done = TranscodeSession(*store, *row, {.codec = StoreCodec::kRaw12}, progress);
  ASSERT_TRUE(done.ok()) << done.status().message();
  EXPECT_EQ(ReadManifestContents(store->SessionFolder(row->info.id))->schema, 4);
  const auto report = VerifySession(*store, *store->FindSession("s000001"), {VerifyDepth::kDeep});
  EXPECT_THAT(report->problems, ::testing::IsEmpty());
  EXPECT_TRUE(report->signed_by);
}

}  // namespace
}  // namespace stratalux::db
