// SPDX-License-Identifier: Apache-2.0
#include "tests/db/interchange/crate_fixture.h"

#include <fstream>
#include <iterator>

#include <nlohmann/json.hpp>

#include "db/catalogue/consent.h"
#include "db/catalogue/session_index.h"
#include "db/interchange/crate_files.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

Status AppendFrame(SessionWriter& writer, int step, PixelFormat format, int width, int height) {
  FrameRecord record = RecordFor(step, format, width, height);
  record.retake_cause = step % 2 == 0 ? "" : "late, \"by\" 3 ms";
  record.retry = step % 2;
  record.exposure_ms = 16.1 + step / 3.0;
  const auto image = PixelsFor(record);
  if (format != PixelFormat::kMono8) return writer.Append(record, image.view());
  Image<uint8_t> narrow(width, height);
  for (size_t i = 0; i < image.size(); ++i) narrow.data()[i] = static_cast<uint8_t>(image.data()[i]);
  return writer.Append(record, std::as_const(narrow).view());
}

}  // namespace

RigCalibration SomeCalibration() {
  RigCalibration calibration;
  calibration.id = "c-1";
  calibration.source = "calibration session s000001";
  calibration.made_wall = {1'790'000'000'000'000'000};
  calibration.camera.model = {1440, 1080, 1500.25, 1499.75, 719.4, 541.3, {-0.11, 0.07, 1.5e-3, -0.9e-3, -0.02}};
  for (int k = 0; k < 2; ++k) {
    ProjectorCalibration projector;
    projector.name = "left or right " + std::to_string(k);
    projector.model = {1024, 768, 1900.5 + k, 1898.0, 511.2, 700.0, {0.03, -0.01, 2e-4, 3e-4, 0.001}};
    projector.camera_from_projector =
        LookAt({k == 0 ? -300.0 : 280.0, 15.0, -12.0}, {0.0, 5.0, 900.0}, {0.1, 1.0, 0.05});
    projector.white_dn_mm2_per_ms = {1e7, 1e7, 1e7};
    calibration.projectors.push_back(projector);
  }
  return calibration;
}

std::string TextOfFile(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

void CrateTest::SetUp() {
  StoreTest::SetUp();
  base_ = folder_.string() + "-crates";
  crate_ = base_ / "crate";
  other_ = base_ / "other";
  fs::create_directories(base_);
  ASSERT_TRUE(SessionStore::Create(other_).ok());
}

void CrateTest::TearDown() {
  fs::remove_all(base_);
  StoreTest::TearDown();
}

std::string CrateTest::Visit() {
  const Consent consent{"text-3", "de", true, true, false, {1'780'000'000'000'000'001}};
  EXPECT_TRUE(GiveConsent(folder_, kVisitor, consent).ok());
  SessionStore store = OpenStore();
  SessionInfo info;
  info.rig = "lab";
  info.visitor = kVisitor;
  info.started_wall = {1'791'234'567'891'234'567};
  info.program_version = "0.9-test";
  info.plan_json = PlanOptionsToJson({});
  info.calibration_json = SomeCalibration().ToJson();
  info.visit = "evening";
  info.attempt = 2;
  info.devices = {50, 40, 1280, 800, 4092.0};
  auto writer = store.BeginSession(info);
  EXPECT_TRUE(writer.ok()) << writer.status().message();
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(AppendFrame(*writer, i, PixelFormat::kMono12, 40, 30).ok());
  EXPECT_TRUE(
      writer->Finish(SessionStatus::kDegraded, {"only four steps of the plan were captured"}, SomeFindings()).ok());
  const std::string id = writer->info().id;
  const fs::path fit = store.FitFolder(id, "0badcafe") / "report";
  fs::create_directories(fit);
  WriteText(fit / "index.html", std::string("<h1>Visitor ") + kVisitor + "</h1>");
  WriteText(fit.parent_path() / "normal.exr", "v/1\x01 not really");
  WriteText(fit.parent_path() / "named.bin", std::string("raw ") + kVisitor + " bytes");
  const std::string metrics = R"({"fit": {"tau": 2.5}, "who": "v-77ab3f"})";
  WriteText(fit.parent_path() / "metrics.json", metrics);
  EXPECT_TRUE(store.RegisterFit({"0badcafe", id, "{\"a\":1}", metrics, {1'791'300'000'000'000'000}}).ok());
  return id;
}

std::string CrateTest::Flats() {
  SessionStore store = OpenStore();
  SessionInfo info;
  info.kind = SessionKind::kFlat;
  info.rig = "lab";
  info.seed = UINT64_MAX;
  info.retention = Retention::kLong;
  auto writer = store.BeginSession(info, {.codec = StoreCodec::kRaw12, .max_segment_bytes = 4000});
  EXPECT_TRUE(writer.ok()) << writer.status().message();
  int step = 0;
  for (const PixelFormat format : {PixelFormat::kMono8, PixelFormat::kMono12, PixelFormat::kMono16})
    for (int i = 0; i < 2; ++i) EXPECT_TRUE(AppendFrame(*writer, step++, format, 41, 31).ok());
  EXPECT_TRUE(
      writer->Finish(SessionStatus::kDegraded, {"lamp 2 flickered", "a \"quoted\" reason"}, SomeFindings()).ok());
  return writer->info().id;
}

std::string CrateTest::Simulated() {
  SessionStore store = OpenStore();
  SessionInfo info = SimulatedVisit();
  info.rig = "bench";
  info.seed = 42;
  auto writer = store.BeginSession(info);
  EXPECT_TRUE(writer.ok()) << writer.status().message();
  EXPECT_TRUE(AppendFrame(*writer, 0, PixelFormat::kMono12, 40, 30).ok());
  Image<float> depth(5, 4), normal(5, 4, 3);
  for (size_t i = 0; i < depth.size(); ++i) depth.data()[i] = 900.5F + static_cast<float>(i) / 3.0F;
  for (size_t i = 0; i < normal.size(); ++i) normal.data()[i] = static_cast<float>(i) / -7.0F;
  EXPECT_TRUE(writer->AppendTruth("depth", std::as_const(depth).view()).ok());
  EXPECT_TRUE(writer->AppendTruth("subsurface stripe 2", std::as_const(normal).view()).ok());
  EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  return writer->info().id;
}

Result<CrateReport> CrateTest::Export(const std::vector<std::string>& ids, CrateOptions options) {
  if (options.out.empty()) options.out = crate_;
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  std::vector<SessionRow> rows;
  for (const std::string& id : ids) {
    SLX_ASSIGN_OR_RETURN(auto row, store.FindSession(id));
    rows.push_back(std::move(row));
  }
  return ExportCrate(store, rows, options, logger_);
}

Result<CrateImportReport> CrateTest::Import() {
  SLX_ASSIGN_OR_RETURN(const auto store, SessionStore::Open(other_, AccessMode::kReadWrite));
  return ImportCrate(store, crate_, logger_);
}

void CrateTest::Reseal() {
  auto files = ListCrateFiles(crate_);
  ASSERT_TRUE(files.ok()) << files.status().message();
  for (auto& [path, sum] : *files) {
    if (path != kCrateMetadataFile) sum = *ChecksumOf(crate_ / path);
  }
  auto document = nlohmann::ordered_json::parse(TextOfFile(crate_ / kCrateMetadataFile), nullptr, false);
  if (document.is_object() && document.contains("@graph"))
    for (auto& entity : document["@graph"]) {
      const auto file = entity.contains("sha256") && entity["@id"].is_string()
                            ? files->find(PathOfUri(entity["@id"].get<std::string>()))
                            : files->end();
      if (file == files->end()) continue;
      entity["sha256"] = file->second.sha256;
      entity["contentSize"] = std::to_string(file->second.bytes);
    }
  if (document.is_object()) WriteText(crate_ / kCrateMetadataFile, document.dump(1));
  (*files)[kCrateMetadataFile] = *ChecksumOf(crate_ / kCrateMetadataFile);
  WriteText(crate_ / kCrateManifestFile, CrateManifestText(*files));
}

std::string CrateTest::RowsOf(const fs::path& store, const std::string& id) {
  auto index = SessionIndex::Open(store, AccessMode::kReadOnly);
  EXPECT_TRUE(index.ok()) << index.status().message();
  Connection& connection = index->connection();
  std::string rows;
  for (const std::string table : {"sessions", "frames", "proofs", "fits", "metrics", "consents", "calibrations"}) {
    auto columns = connection.Prepare(
        "SELECT group_concat('quote(\"' || name || '\")', ' || ''|'' || ') FROM"
        " pragma_table_info(?1) WHERE name NOT IN ('number', 'session', 'since_session')");
    columns->Bind(1, table);
    EXPECT_TRUE(columns->Step().ok());
    const std::string where = table == "sessions"       ? "id = ?1"
                              : table == "consents"     ? "visitor = (SELECT visitor FROM sessions WHERE id = ?1)"
                              : table == "calibrations" ? "id = (SELECT calibration_id FROM sessions WHERE id = ?1)"
                                                        : "session = (SELECT number FROM sessions WHERE id = ?1)";
    auto select =
        connection.Prepare("SELECT " + columns->Text(0) + " FROM " + table + " WHERE " + where + " ORDER BY 1");
    EXPECT_TRUE(select.ok()) << select.status().message();
    select->Bind(1, id);
    for (auto more = select->Step(); more.ok() && *more; more = select->Step())
      rows += table + ": " + select->Text(0) + "\n";
  }
  return rows;
}

Outcome CrateTest::Db(const std::string& arguments) const {
  return Shell("STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR + "/stratalux-db " + arguments +
               " 2>&1");
}

}  // namespace stratalux::db
