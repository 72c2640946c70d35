// SPDX-License-Identifier: Apache-2.0
#include "tests/db/index_rows.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <random>

#include "db/base/sqlite.h"
#include "db/catalogue/fit_metrics.h"

namespace stratalux::db {
namespace {

constexpr int64_t kDay_ns = int64_t{86400} * 1'000'000'000;

// Not a test's business: without a store there is nothing to test.
void Must(const Status& status) {
  if (status.ok()) return;
  std::fprintf(stderr, "index rows: %s\n", status.message().c_str());
  std::abort();
}
template <typename T>
T Must(Result<T> result) {
  Must(result.status());
  return std::move(result).value();
}

PlanOptions PlanOfRows() {
  PlanOptions options;
  options.brackets = {1.0, 0.5, 0.25};  // about a thousand steps
  return options;
}

std::string RealMetrics(const RowsOfSession::Fit& fit) {
  std::string text = "{\"schema\": 2, \"prediction\": [";
  char entry[400];
  bool first = true;
  for (int projector = 0; projector < 4; ++projector)
    for (const char* light : {"stripe", "white"})
      for (const char* model : {"tied", "homogeneous", "homogeneous_local_albedo", "direction_blind"})
        for (const char* part : {"total\", \"direct\": \"separated", "total\", \"direct\": \"predicted",
                                 "subsurface\", \"direct\": \"truth"}) {
          std::snprintf(entry, sizeof entry,
                        "%s{\"projector\": %d, \"light\": \"%s\", \"model\": \"%s\", \"part\": \"%s\", \"geometry\":"
                        " \"reconstructed\", \"pool\": 1, \"nrmse\": %.17g, \"nrmse_rgb\": [%.17g, %.17g, %.17g],"
                        " \"psnr_db\": 37.72381642577566, \"ssim\": %.17g, \"pixels\": 15102}",
                        first ? "" : ", ", projector, light, model, part, fit.nrmse, fit.nrmse, fit.nrmse, fit.nrmse,
                        fit.ssim);
          text += entry;
          first = false;
        }
  std::snprintf(entry, sizeof entry, "], \"fit\": {\"divergence\": %.17g, \"tau\": 0.4, \"pixels\": 86524}}",
                fit.divergence);
  return text + entry;
}

std::string FewMetrics(const RowsOfSession::Fit& fit) {
  char text[400];
  std::snprintf(
      text, sizeof text,
      "{\"prediction\": [{\"light\": \"stripe\", \"model\": \"tied\", \"part\": \"total\", \"direct\": \"separated\","
      " \"geometry\": \"reconstructed\", \"nrmse\": %.17g, \"ssim\": %.17g}], \"fit\": {\"divergence\": %.17g}}",
      fit.nrmse, fit.ssim, fit.divergence);
  return text;
}

class RowWriter {
 public:
  RowWriter(const std::filesystem::path& folder, const IndexRowsOptions& options)
      : options_(options),
        folder_(folder),
        random_(options.seed),
        plan_(Must(BuildPlan(PlanOfRows()))),
        plan_json_(PlanOptionsToJson(plan_.options)),
        connection_(Must(Connection::Open(folder / "index.sqlite", Connection::Mode::kReadWrite))) {
    Must(connection_.Execute("PRAGMA synchronous = OFF; PRAGMA foreign_keys = ON; BEGIN"));
  }

  std::vector<RowsOfSession> Write() {
    std::vector<RowsOfSession> all;
    WriteCalibrations();
    for (int i = 0; i < options_.sessions; ++i) all.push_back(WriteSession(i));
    for (int i = 0; i < options_.sessions; ++i)
      for (const auto& fit : all[static_cast<size_t>(i)].fits) WriteFit(i + 1, fit);
    Must(connection_.Execute("COMMIT"));
    return all;
  }

 private:
  unsigned Bits() { return static_cast<unsigned>(random_()); }
  int Below(int n) { return static_cast<int>(random_() % static_cast<uint32_t>(n)); }
  [[nodiscard]] WallNs StartOf(int i) const {
    return {options_.now.ns - (options_.sessions - i) * (kDay_ns / 3) - 1'000'000'000};
  }
  [[nodiscard]] int CalibrationOf(int i) const { return i / 20; }
  static std::string CalibrationId(int c) {
    char text[40];
    std::snprintf(text, sizeof text, "%08x%024x", static_cast<unsigned>(c) * 2654435761U, c);
    return text;
  }

  void WriteCalibrations() {
    auto insert = Must(
        connection_.Prepare("INSERT INTO calibrations (id, record_json, rig, made_wall_ns) VALUES (?1, ?2, ?3, ?4)"));
    for (int c = 0; c <= CalibrationOf(options_.sessions); ++c) {
      const std::string record = "{\"source\": \"simulation (exact)\", \"filler\": \"" + std::string(2000, 'x') + "\"}";
      insert.Bind(1, CalibrationId(c)).Bind(2, record).Bind(3, std::string("kiosk-0"));
      insert.Bind(4, StartOf(c * 20).ns - kDay_ns / 2);
      Must(insert.Run());
    }
  }

  RowsOfSession WriteSession(int i) {
    RowsOfSession s;
    SessionInfo& info = s.row.info;
    char id[32];
    std::snprintf(id, sizeof id, "s%06d-%08x", i + 1, Bits());
    info.id = id;
    info.kind = Below(10) == 0 ? SessionKind::kCalibration : SessionKind::kVisitor;
    info.rig = "kiosk-" + std::to_string(Below(3));
    info.visitor = info.kind == SessionKind::kVisitor ? "v" + std::to_string(Below(options_.sessions)) : "";
    info.started_wall = StartOf(i);
    info.visit = "visit-" + std::to_string(i / 3);
    info.attempt = 1 + i % 3;
    const int fate = Below(100);
    info.status = fate < 90 ? SessionStatus::kComplete : fate < 97 ? SessionStatus::kDegraded : SessionStatus::kFailed;
    if (Below(20) != 0) {
      s.calibration = CalibrationId(CalibrationOf(i));
      s.calibration_since = {StartOf(CalibrationOf(i) * 20).ns - kDay_ns / 2};
    }
    InsertSession(i + 1, s);
    WriteFrames(i + 1, s);
    Must(connection_.Execute("UPDATE sessions SET frame_count = " + std::to_string(s.row.frames) + ", stored_bytes = " +
                             std::to_string(s.row.bytes) + " WHERE number = " + std::to_string(i + 1)));
    if (info.kind == SessionKind::kVisitor && info.status != SessionStatus::kFailed && Below(5) != 0)
      for (int fits = 1 + Below(2); fits > 0; --fits) s.fits.push_back(NewFit(s, fits));
    return s;
  }

  void WriteFit(int number, const RowsOfSession::Fit& fit) {
    const std::string json = options_.fits == IndexRowsOptions::Fits::kReal ? RealMetrics(fit) : FewMetrics(fit);
    auto insert = Must(connection_.Prepare(
        "INSERT INTO fits (id, session, options_json, metrics_json, created_wall_ns) VALUES (?1, ?2, '{}', ?3, ?4)"));
    Must(insert.Bind(1, fit.id).Bind(2, int64_t{number}).Bind(3, json).Bind(4, fit.created.ns).Run());
    auto figure = Must(connection_.Prepare("INSERT INTO metrics (session, fit, name, value) VALUES (?1, ?2, ?3, ?4)"));
    for (const auto& [name, value] : FlattenMetrics(json))
      Must(figure.Bind(1, int64_t{number}).Bind(2, fit.id).Bind(3, name).Bind(4, value).Run());
  }

  RowsOfSession::Fit NewFit(const RowsOfSession& s, int nth) {
    char id[24];
    std::snprintf(id, sizeof id, "%08x%08x", Bits(), Bits());
    const auto share = [this] { return Below(1000) / 1000.0; };
    return {id, {s.row.info.started_wall.ns + nth * int64_t{3'600'000'000'000}}, share(), share(), share()};
  }

  void InsertSession(int number, const RowsOfSession& s) {
    const SessionInfo& info = s.row.info;
    if (!info.visitor.empty()) {
      auto visitor = Must(connection_.Prepare("INSERT OR IGNORE INTO visitors (id, created_wall_ns) VALUES (?1, 0)"));
      Must(visitor.Bind(1, info.visitor).Run());
    }
    auto insert = Must(connection_.Prepare(
        "INSERT INTO sessions (number, id, kind, rig, visitor, consent, simulated, seed, started_wall_ns, status,"
        " reasons_json, program_version, plan_json, calibration_id, consent_json, retention, finished_wall_ns,"
        " planned_steps, visit, attempt)"
        " VALUES (?1, ?2, ?3, ?4, ?5, '3', 0, 0, ?6, ?7, ?8, '0.1.0', ?9, ?10, ?11, 'long', ?12, ?13, ?14, ?15)"));
    insert.Bind(1, int64_t{number}).Bind(2, info.id).Bind(3, std::string(ToString(info.kind))).Bind(4, info.rig);
    insert.Bind(5, info.visitor).Bind(6, info.started_wall.ns).Bind(7, std::string(ToString(info.status)));
    insert.Bind(8, std::string(info.status == SessionStatus::kComplete ? "[]" : "[\"no proven frame for step 7\"]"));
    insert.Bind(9, plan_json_);
    if (!s.calibration.empty()) insert.Bind(10, s.calibration);
    insert.Bind(11, std::string(R"({"text_version":"3","language":"de","scope":["fit"],"given_wall_ns":0})"));
    insert.Bind(12, info.started_wall.ns + 33'000'000'000).Bind(13, int64_t{PlannedStepsOfRows()});
    insert.Bind(14, info.visit).Bind(15, int64_t{info.attempt});
    Must(insert.Run());
  }

  void WriteFrames(int number, RowsOfSession& s) {
    if (!frame_) {
      frame_.emplace(Must(connection_.Prepare(
          "INSERT INTO frames (session, frame, segment, offset, stored_bytes, hash, step, projector,"
          " phase, pattern, retry, level_check) VALUES (?1, ?2, 1, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)")));
      proof_.emplace(Must(connection_.Prepare(
          "INSERT INTO proofs (session, frame, bracket, pose, trigger_number, trigger_ns, sync_ns, driver_sequence,"
          " frame_ns, frame_clock, exposure_ms, gain, mean_dn, retake_cause) VALUES (?1, ?2, 0, -1, ?3, ?4, ?5, ?6, "
          "?7, 1, 16.0, 1.0, ?8, ?9)")));
    }
    const int steps = std::min(options_.frames_per_session, PlannedStepsOfRows());
    const int last = s.row.info.status == SessionStatus::kFailed ? steps / 2 : steps;
    for (int step = 0; step < last; ++step) {
      if (s.row.info.status == SessionStatus::kDegraded && (step == 7 || Below(20) == 0)) continue;
      const bool again = Below(100) == 0;
      const char* causes[] = {"wrong level", "no sync edge", "late frame"};
      if (again) WriteFrame(number, s, {step, 0, LevelCheck::kFailed, ""});
      WriteFrame(number, s, {step, again ? 1 : 0, LevelCheck::kPassed, again ? causes[Below(3)] : ""});
      s.good_steps.push_back(step);
    }
  }

  struct Shot {
    int step, retry;
    LevelCheck check;
    std::string cause;
  };
  void WriteFrame(int number, RowsOfSession& s, const Shot& shot) {
    const PlanStep& planned = plan_.steps[static_cast<size_t>(shot.step)];
    const int64_t bytes = 1'000'000 + Below(100'000);
    uint8_t hash[16];
    for (uint8_t& byte : hash) byte = static_cast<uint8_t>(random_());
    const int64_t at = s.row.info.started_wall.ns / 1000 + s.row.frames * 33'000'000;
    frame_->Bind(1, int64_t{number}).Bind(2, s.row.frames).Bind(3, 64 + s.row.bytes).Bind(4, bytes);
    frame_->Bind(5, std::span<const uint8_t>(hash)).Bind(6, int64_t{shot.step}).Bind(7, int64_t{planned.projector});
    frame_->Bind(8, std::string(ToString(planned.phase))).Bind(9, planned.pattern.ToString());
    Must(frame_->Bind(10, int64_t{shot.retry}).Bind(11, static_cast<int64_t>(shot.check)).Run());
    proof_->Bind(1, int64_t{number}).Bind(2, s.row.frames).Bind(3, s.row.frames).Bind(4, at).Bind(5, at + 100'000);
    proof_->Bind(6, s.row.frames).Bind(7, at + 200'000).Bind(8, 100.0 + Below(1000) / 10.0);
    Must(proof_->Bind(9, shot.cause).Run());
    if (!shot.cause.empty()) s.retake_causes.push_back(shot.cause);
    ++s.row.frames;
    s.row.bytes += bytes;
  }

  IndexRowsOptions options_;
  std::filesystem::path folder_;
  std::mt19937 random_;
  CapturePlan plan_;
  std::string plan_json_;
  Connection connection_;
  std::optional<Statement> frame_, proof_;
};

}  // namespace

int PlannedStepsOfRows() { return static_cast<int>(Must(BuildPlan(PlanOfRows())).steps.size()); }

std::vector<RowsOfSession> WriteIndexRows(const std::filesystem::path& folder, const IndexRowsOptions& options) {
  Must(SessionStore::Create(folder));
  return RowWriter(folder, options).Write();
}

}  // namespace stratalux::db
