// SPDX-License-Identifier: Apache-2.0
// Opening, migrating and writing the index; session_index_select.cc asks it.
#include "db/catalogue/session_index.h"

#include <chrono>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <optional>
#include <random>
#include <set>

#include "db/base/durable_file.h"
#include "db/base/retry.h"
#include "db/catalogue/calibration_store.h"
#include "db/catalogue/fit_metrics.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/schema_check.h"
#include "db/migration_0001.h"
#include "db/migration_0002.h"
#include "db/migration_0003.h"
#include "db/migration_0004.h"
#include "db/migration_0005.h"
#include "db/migration_0006.h"
#include "db/migration_0007.h"
#include "db/migration_0008.h"
#include "db/migration_0009.h"
#include "db/segment/pixel_hash.h"
#include "db/session_tables.h"
#include "shared/capture/plan.h"

namespace stratalux::db {
namespace {

constexpr int64_t kApplicationId = 0x534c5831;  // "SLX1"
constexpr PixelHash kNotRecorded{};

template <size_t N>
std::string TextOf(const char (&text)[N]) {
  return {text, strnlen(text, N)};
}

// An index whose creation was cut short: no table yet, and nobody else's mark.
bool IsUnborn(const std::filesystem::path& file) {
  auto connection = Connection::Open(file, Connection::Mode::kReadWrite);
  if (!connection.ok()) return false;
  const auto marks = connection->QueryInteger(
      "SELECT count(*) + (SELECT application_id FROM pragma_application_id) + (SELECT user_version FROM "
      "pragma_user_version) FROM sqlite_master");
  return marks.ok() && *marks == 0;
}

// As long as a large index takes to be copied and migrated by another program.
constexpr std::chrono::minutes kPatience{1};

// A whole copy or none, also when an earlier attempt was cut short. Through a connection of its own, as the other one
// is in a transaction, which has changed nothing yet and keeps all others from writing.
Status BackUp(const std::filesystem::path& index, const std::filesystem::path& file) {
  std::filesystem::path beside = file;
  beside += ".new";
  std::error_code error;
  std::filesystem::remove(beside, error);
  SLX_ASSIGN_OR_RETURN(auto reader, Connection::Open(index, Connection::Mode::kReadOnly));
  SLX_RETURN_IF_ERROR(reader.CopyInto(beside));
  return KeepFile(beside, file);
}

bool HasSessions(const std::filesystem::path& folder) {
  std::error_code error;
  const std::filesystem::directory_iterator sessions(folder / "sessions", error);
  return !error && sessions != std::filesystem::directory_iterator();
}

// The index is gone, what it spoke of is not.
bool IsLost(const std::filesystem::path& folder) {
  std::error_code error;
  const auto log_bytes = std::filesystem::file_size(folder / "index.sqlite-wal", error);
  return (!error && log_bytes > 0) || HasSessions(folder);
}

Status LostIndex(const std::filesystem::path& folder) {
  return Status::Integrity((folder / "index.sqlite").string() +
                           " is missing, but sessions are there; restore it from a copy or rebuild it with"
                           " `stratalux-db reindex` (the frames in sessions/ are not touched)");
}

Status WriteMetrics(Connection& connection, int64_t number, const std::string& fit, const std::string& metrics_json) {
  SLX_ASSIGN_OR_RETURN(auto clear, connection.Prepare("DELETE FROM metrics WHERE session = ?1 AND fit = ?2"));
  SLX_RETURN_IF_ERROR(clear.Bind(1, number).Bind(2, fit).Run());
  SLX_ASSIGN_OR_RETURN(auto insert,
                       connection.Prepare("INSERT INTO metrics (session, fit, name, value) VALUES (?1, ?2, ?3, ?4)"));
  for (const auto& [name, value] : FlattenMetrics(metrics_json))
    SLX_RETURN_IF_ERROR(insert.Bind(1, number).Bind(2, fit).Bind(3, name).Bind(4, value).Run());
  return Status::Ok();
}

// Fits registered before schema 3 have their figures in metrics_json alone.
Status WriteMetricsOfAllFits(Connection& connection) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT session, id, metrics_json FROM fits"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return Status::Ok();
    SLX_RETURN_IF_ERROR(WriteMetrics(connection, select.Integer(0), select.Text(1), select.Text(2)));
  }
}

// Of the plan that PlanOptionsToJson wrote; nullopt where the text is no plan, or one of another version.
std::optional<int64_t> PlannedSteps(const std::string& plan_json) {
  const auto options = PlanOptionsFromJson(plan_json);
  if (!options.ok()) return std::nullopt;
  const auto plan = BuildPlan(*options);
  if (!plan.ok()) return std::nullopt;
  return static_cast<int64_t>(plan->steps.size());
}

// Sessions of before schema 5. Those of a rig share a few plans: each is built once.
Status WritePlannedStepsOfAllSessions(Connection& connection) {
  std::set<std::string> plans;
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT DISTINCT plan_json FROM sessions"));
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) break;
    plans.insert(select.Text(0));
  }
  SLX_ASSIGN_OR_RETURN(auto update, connection.Prepare("UPDATE sessions SET planned_steps = ?1 WHERE plan_json = ?2"));
  for (const std::string& plan : plans)
    if (const auto steps = PlannedSteps(plan)) SLX_RETURN_IF_ERROR(update.Bind(1, *steps).Bind(2, plan).Run());
  return Status::Ok();
}

}  // namespace

std::string SegmentName(int64_t number) {
  char name[32];
  std::snprintf(name, sizeof name, "frames-%04lld.seg", static_cast<long long>(number));
  return name;
}

Status SessionIndex::Create(const std::filesystem::path& folder) {
  if (const Status made = MakeFolder(folder / "sessions"); !made.ok())
    return made.WithContext("cannot create store " + folder.string());
  const auto file = folder / "index.sqlite";
  std::error_code error;
  if (std::filesystem::exists(file, error) && (HasSessions(folder) || !IsUnborn(file)))
    return Open(folder, AccessMode::kReadWrite).status();
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(file, Connection::Mode::kCreate));
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA journal_mode = WAL"));
  return FillWithSchema(connection);
}

Status SessionIndex::CreateNew(const std::filesystem::path& folder) {
  std::error_code error;
  if (!std::filesystem::exists(folder / "index.sqlite", error) && IsLost(folder)) return LostIndex(folder);
  return Create(folder);
}

// Several programs may find the store of an older one at once: the first to begin a transaction copies and migrates it.
Status SessionIndex::Migrate(Connection& connection, const std::filesystem::path& folder) {
  return RetryWhileBusy(kPatience, [&] { return MigrateOnce(connection, folder); });
}

Status SessionIndex::MigrateOnce(Connection& connection, const std::filesystem::path& folder) {
  SLX_ASSIGN_OR_RETURN(int64_t version, connection.QueryInteger("PRAGMA user_version"));
  if (version == kSchemaVersion) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SLX_ASSIGN_OR_RETURN(version, connection.QueryInteger("PRAGMA user_version"));  // of what nobody changes any more
  if (version == kSchemaVersion) return Status::Ok();
  if (version > kSchemaVersion) return NewerIndex(folder, version);
  if (version > 0)
    SLX_RETURN_IF_ERROR(
        BackUp(folder / "index.sqlite", folder / ("index-before-" + std::to_string(kSchemaVersion) + ".sqlite")));
  if (version < 1) SLX_RETURN_IF_ERROR(connection.Execute(kMigration0001));
  if (version < 2) SLX_RETURN_IF_ERROR(connection.Execute(kMigration0002));
  if (version < 3) {
    SLX_RETURN_IF_ERROR(connection.Execute(kMigration0003));
    SLX_RETURN_IF_ERROR(WriteMetricsOfAllFits(connection));
  }
  if (version < 4) SLX_RETURN_IF_ERROR(connection.Execute(kMigration0004));
  if (version < 5) {
    SLX_RETURN_IF_ERROR(connection.Execute(kMigration0005));
    SLX_RETURN_IF_ERROR(WritePlannedStepsOfAllSessions(connection));
  }
  if (version < 6) SLX_RETURN_IF_ERROR(connection.Execute(kMigration0006));
  if (version < 7) SLX_RETURN_IF_ERROR(connection.Execute(kMigration0007));
  if (version < 8) SLX_RETURN_IF_ERROR(connection.Execute(kMigration0008));
  if (version < 9) SLX_RETURN_IF_ERROR(connection.Execute(kMigration0009));
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA application_id = " + std::to_string(kApplicationId)));
  SLX_RETURN_IF_ERROR(connection.Execute("PRAGMA user_version = " + std::to_string(kSchemaVersion)));
  return transaction.Commit();
}

Result<SessionIndex> SessionIndex::Open(const std::filesystem::path& folder, AccessMode mode) {
  const auto file = folder / "index.sqlite";
  std::error_code error;
  const auto type = std::filesystem::status(file, error).type();
  if (type == std::filesystem::file_type::not_found && IsLost(folder)) return LostIndex(folder);
  if (type == std::filesystem::file_type::not_found)
    return Status::NotFound("no store in " + folder.string() + " (make one with `stratalux-db init --store " +
                            folder.string() + "`)");
  if (type == std::filesystem::file_type::none)
    return Status::Failed("cannot open store " + folder.string() + ": " + error.message());
  const bool write = mode == AccessMode::kReadWrite;
  SLX_ASSIGN_OR_RETURN(auto connection,
                       Connection::Open(file, write ? Connection::Mode::kReadWrite : Connection::Mode::kReadOnly));
  auto identity = connection.QueryInteger("PRAGMA application_id");
  if (identity.status().code() == StatusCode::kIntegrity)
    return identity.status().WithContext("damaged, or not a Stratalux index");
  if (!identity.ok()) return identity.status();
  SLX_ASSIGN_OR_RETURN(const int64_t version, connection.QueryInteger("PRAGMA user_version"));
  if (*identity != kApplicationId)
    return Status::Integrity(file.string() + " is not a Stratalux index (application id " + std::to_string(*identity) +
                             "); restore it from a copy (the frames in sessions/ are not touched)");
  if (version > kSchemaVersion) return NewerIndex(folder, version);
  if (!write && version < kSchemaVersion) {
    SLX_ASSIGN_OR_RETURN(auto writer, Connection::Open(file, Connection::Mode::kReadWrite));
    SLX_RETURN_IF_ERROR(
        Migrate(writer, folder)
            .WithContext("the store has schema " + std::to_string(version) + " and must be migrated first"));
  }
  SLX_RETURN_IF_ERROR(
      connection.Execute("PRAGMA foreign_keys = ON; PRAGMA synchronous = FULL; PRAGMA secure_delete = ON"));
  if (write) SLX_RETURN_IF_ERROR(Migrate(connection, folder));
  return SessionIndex(std::move(connection));
}

Status SessionIndex::FillWithSchema(Connection& connection) {
  // The migrations take longer than all else that is done to a small store: once for the whole process.
  static std::mutex mutex;
  static std::optional<Connection> migrated;
  const std::lock_guard lock(mutex);
  if (!migrated) {
    SLX_ASSIGN_OR_RETURN(auto first, Connection::Open(":memory:", Connection::Mode::kReadWrite));
    SLX_RETURN_IF_ERROR(Migrate(first, {}));
    migrated.emplace(std::move(first));
  }
  return connection.FillFrom(*migrated);
}

Result<SessionIndex> SessionIndex::InMemory() {
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(":memory:", Connection::Mode::kReadWrite));
  SLX_RETURN_IF_ERROR(FillWithSchema(connection));
  return SessionIndex(std::move(connection));
}

Result<SessionIndex> SessionIndex::TablesInMemory() {
  SLX_ASSIGN_OR_RETURN(auto connection, Connection::Open(":memory:", Connection::Mode::kReadWrite));
  SLX_RETURN_IF_ERROR(connection.Execute(kSessionTables));
  return SessionIndex(std::move(connection));
}

Result<int64_t> SessionIndex::InsertSession(SessionInfo& info, std::optional<int64_t> known_number) {
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection_));
  if (!info.calibration_json.empty()) {
    SLX_ASSIGN_OR_RETURN(auto calibration,
                         connection_.Prepare("INSERT OR IGNORE INTO calibrations (id, record_json, rig)"
                                             " VALUES (?1, ?2, ?3)"));
    SLX_RETURN_IF_ERROR(calibration.Bind(1, CalibrationId(info.calibration_json))
                            .Bind(2, info.calibration_json)
                            .Bind(3, info.rig)
                            .Run());
  }
  if (!info.visitor.empty()) {
    SLX_ASSIGN_OR_RETURN(auto visitor,
                         connection_.Prepare("INSERT OR IGNORE INTO visitors (id, created_wall_ns) VALUES (?1, ?2)"));
    SLX_RETURN_IF_ERROR(visitor.Bind(1, info.visitor).Bind(2, info.started_wall.ns).Run());
  }
  SLX_ASSIGN_OR_RETURN(
      auto insert,
      connection_.Prepare(
          "INSERT INTO sessions (id, kind, rig, visitor, consent, simulated, seed, started_wall_ns, status,"
          " reasons_json, program_version, plan_json, calibration_id, consent_json, retention, number, planned_steps,"
          " visit, attempt, findings_json, faults_json) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13,"
          " ?14, ?15, ?16, ?17, ?18, ?19, ?20, ?21)"));
  std::random_device random;
  char suffix[16];
  std::snprintf(suffix, sizeof suffix, "%08x", random());
  const bool named = !info.id.empty();
  insert.Bind(1, named ? info.id : std::string("pending-") + suffix)
      .Bind(2, std::string(ToString(info.kind)))
      .Bind(3, info.rig);
  insert.Bind(4, info.visitor)
      .Bind(5, info.consent.text_version)
      .Bind(6, int64_t{info.simulated})
      .Bind(7, static_cast<int64_t>(info.seed));
  insert.Bind(8, info.started_wall.ns)
      .Bind(9, std::string(ToString(info.status)))
      .Bind(10, ReasonsToJson(info.reasons));
  insert.Bind(11, info.program_version).Bind(12, info.plan_json);
  if (!info.calibration_json.empty()) insert.Bind(13, CalibrationId(info.calibration_json));
  insert.Bind(14, ConsentToJson(info.consent)).Bind(15, std::string(ToString(info.retention)));
  if (known_number) insert.Bind(16, *known_number);
  if (const auto steps = PlannedSteps(info.plan_json)) insert.Bind(17, *steps);
  insert.Bind(18, info.visit).Bind(19, int64_t{info.attempt});
  insert.Bind(20, FindingsToJson(info.found.findings)).Bind(21, FaultsToJson(info.found.faults));
  SLX_RETURN_IF_ERROR(insert.Run());
  const int64_t number = connection_.LastInsertId();
  if (named) {
    SLX_RETURN_IF_ERROR(transaction.Commit());
    return number;
  }
  char id[40];
  std::snprintf(id, sizeof id, "s%06lld-%s", static_cast<long long>(number), suffix);
  info.id = id;
  SLX_ASSIGN_OR_RETURN(auto name, connection_.Prepare("UPDATE sessions SET id = ?1 WHERE number = ?2"));
  SLX_RETURN_IF_ERROR(name.Bind(1, info.id).Bind(2, number).Run());
  SLX_RETURN_IF_ERROR(transaction.Commit());
  return number;
}

SessionIndex::Ending EndingOf(const SessionInfo& info) {
  return {info.status, info.reasons, info.finished_wall, info.found};
}

Status SessionIndex::SetStatus(int64_t number, const Ending& ending) {
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection_));
  SLX_ASSIGN_OR_RETURN(auto update, connection_.Prepare("UPDATE sessions SET status = ?1, reasons_json = ?2,"
                                                        " finished_wall_ns = ?3, findings_json = ?5, faults_json = ?6"
                                                        " WHERE number = ?4"));
  SLX_RETURN_IF_ERROR(update.Bind(1, std::string(ToString(ending.status)))
                          .Bind(2, ReasonsToJson(ending.reasons))
                          .Bind(3, ending.finished_wall.ns)
                          .Bind(4, number)
                          .Bind(5, FindingsToJson(ending.found.findings))
                          .Bind(6, FaultsToJson(ending.found.faults))
                          .Run());
  SLX_RETURN_IF_ERROR(WithdrawFrames(number, ending.found.findings));
  return transaction.Commit();
}

Status SessionIndex::WithdrawFrames(int64_t number, const std::vector<Finding>& findings) {
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection_));
  SLX_ASSIGN_OR_RETURN(auto update, connection_.Prepare("UPDATE frames SET level_check = ?1"
                                                        " WHERE session = ?2 AND step = ?3 AND level_check <> ?1"));
  for (const int step : WithdrawnSteps(findings))
    SLX_RETURN_IF_ERROR(
        update.Bind(1, static_cast<int64_t>(LevelCheck::kFailed)).Bind(2, number).Bind(3, int64_t{step}).Run());
  return transaction.Commit();
}

Status SessionIndex::SetKeyId(int64_t number, std::span<const uint8_t> key_id) {
  SLX_ASSIGN_OR_RETURN(auto update, connection_.Prepare("UPDATE sessions SET key_id = ?1 WHERE number = ?2"));
  return update.Bind(1, key_id).Bind(2, number).Run();
}

Status SessionIndex::InsertFrames(int64_t number, const std::vector<std::pair<int64_t, SegmentFrame>>& frames) {
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection_));
  SLX_ASSIGN_OR_RETURN(auto insert,
                       connection_.Prepare("INSERT INTO frames (session, frame, segment, offset, stored_bytes, hash, "
                                           "step, projector, phase, pattern, retry,"
                                           " level_check, pixel_hash) VALUES"
                                           " (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, nullif(?13, ?14))"));
  SLX_ASSIGN_OR_RETURN(auto proof,
                       connection_.Prepare("INSERT INTO proofs (session, frame, bracket, pose, trigger_number, "
                                           "trigger_ns, sync_ns, driver_sequence, frame_ns,"
                                           " frame_clock, exposure_ms, gain, mean_dn, retake_cause)"
                                           " VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14)"));
  int64_t bytes = 0;
  for (const auto& [segment, f] : frames) {
    const FrameHeader& h = f.header;
    insert.Bind(1, number).Bind(2, h.frame).Bind(3, segment).Bind(4, f.offset);
    insert.Bind(5, static_cast<int64_t>(h.payload_bytes)).Bind(6, std::span<const uint8_t>(h.payload_hash));
    insert.Bind(7, int64_t{h.step}).Bind(8, int64_t{h.projector});
    insert.Bind(9, std::string(ToString(static_cast<CapturePhase>(h.phase)))).Bind(10, TextOf(h.pattern));
    insert.Bind(11, int64_t{h.retry}).Bind(12, int64_t{h.level_check});
    insert.Bind(13, std::span<const uint8_t>(h.pixel_hash)).Bind(14, std::span<const uint8_t>(kNotRecorded));
    SLX_RETURN_IF_ERROR(insert.Run());
    proof.Bind(1, number).Bind(2, h.frame).Bind(3, int64_t{h.bracket}).Bind(4, int64_t{h.pose});
    proof.Bind(5, h.trigger_number).Bind(6, h.trigger_ns).Bind(7, h.sync_ns).Bind(8, h.driver_sequence);
    proof.Bind(9, h.frame_ns).Bind(10, int64_t{h.frame_clock});
    proof.Bind(11, h.exposure_ms).Bind(12, h.gain).Bind(13, h.mean_dn).Bind(14, TextOf(h.retake_cause));
    SLX_RETURN_IF_ERROR(proof.Run());
    bytes += static_cast<int64_t>(h.payload_bytes);
  }
  SLX_ASSIGN_OR_RETURN(auto totals, connection_.Prepare("UPDATE sessions SET frame_count = frame_count + ?1,"
                                                        " stored_bytes = stored_bytes + ?2 WHERE number = ?3"));
  SLX_RETURN_IF_ERROR(totals.Bind(1, static_cast<int64_t>(frames.size())).Bind(2, bytes).Bind(3, number).Run());
  return transaction.Commit();
}

Status SessionIndex::MoveFrames(int64_t number, const std::vector<std::pair<int64_t, SegmentFrame>>& frames) {
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection_));
  SLX_ASSIGN_OR_RETURN(auto update,
                       connection_.Prepare("UPDATE frames SET segment = ?1, offset = ?2, stored_bytes = ?3, hash = ?4,"
                                           " pixel_hash = nullif(?7, ?8) WHERE session = ?5 AND frame = ?6"));
  int64_t bytes = 0;
  for (const auto& [segment, f] : frames) {
    const auto payload_bytes = static_cast<int64_t>(f.header.payload_bytes);
    update.Bind(1, segment).Bind(2, f.offset).Bind(3, payload_bytes);
    update.Bind(4, std::span<const uint8_t>(f.header.payload_hash)).Bind(5, number).Bind(6, f.header.frame);
    update.Bind(7, std::span<const uint8_t>(f.header.pixel_hash)).Bind(8, std::span<const uint8_t>(kNotRecorded));
    SLX_RETURN_IF_ERROR(update.Run());
    bytes += payload_bytes;
  }
  SLX_ASSIGN_OR_RETURN(auto total, connection_.Prepare("UPDATE sessions SET stored_bytes = ?1 WHERE number = ?2"));
  SLX_RETURN_IF_ERROR(total.Bind(1, bytes).Bind(2, number).Run());
  return transaction.Commit();
}

Status SessionIndex::UpsertFit(int64_t number, const FitRow& fit) {
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection_));
  SLX_ASSIGN_OR_RETURN(auto insert,
                       connection_.Prepare("INSERT OR REPLACE INTO fits (id, session, options_json, metrics_json,"
                                           " created_wall_ns) VALUES (?1, ?2, ?3, ?4, ?5)"));
  insert.Bind(1, fit.id).Bind(2, number).Bind(3, fit.options_json).Bind(4, fit.metrics_json);
  SLX_RETURN_IF_ERROR(insert.Bind(5, fit.created_wall.ns).Run());
  SLX_RETURN_IF_ERROR(WriteMetrics(connection_, number, fit.id, fit.metrics_json));
  if (!fit.calibration_json.empty()) SLX_RETURN_IF_ERROR(EnterCalibration(connection_, number, fit));
  return transaction.Commit();
}

}  // namespace stratalux::db
