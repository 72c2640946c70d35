// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/session_filter.h"

#include <array>
#include <utility>

namespace stratalux::db {
namespace {

constexpr const char* kSelect = R"(
WITH calibration AS MATERIALIZED (SELECT id, since_wall_ns FROM calibration_overview),
listed AS (
  SELECT s.number, s.id AS session, s.started_wall_ns AS started, s.kind, s.rig, s.visitor, s.status,
         s.frame_count AS frames, s.stored_bytes AS bytes, s.reasons_json AS reasons, s.simulated, s.retention,
         (SELECT o.consent FROM session_overview o WHERE o.number = s.number) AS consent,
         s.calibration_id AS calibration, s.finished_wall_ns AS finished, s.visit, s.attempt,
         (SELECT count(*) FROM fits f WHERE f.session = s.number) AS fits,
         (SELECT f.id FROM fits f WHERE f.session = s.number ORDER BY f.created_wall_ns DESC, f.id DESC LIMIT 1)
           AS newest_fit,
         (s.started_wall_ns - c.since_wall_ns) / 86400e9 AS calibration_age_days
  FROM sessions s LEFT JOIN calibration c ON c.id = s.calibration_id
  WHERE true)";

constexpr const char* kListColumns = R"(
SELECT session, started, kind, rig, visitor, status, frames, bytes, fits,
       (SELECT m.value FROM metrics m WHERE m.session = number AND m.fit = newest_fit AND m.name = :nrmse) AS nrmse,
       calibration_age_days, reasons, simulated, retention, consent, calibration, finished, newest_fit, visit, attempt
FROM listed
WHERE true)";

constexpr std::array<std::pair<const char*, const char*>, 6> kShortNames = {{
    {"nrmse", "prediction.stripe.tied.total.separated.reconstructed.nrmse"},
    {"ssim", "prediction.stripe.tied.total.separated.reconstructed.ssim"},
    {"psnr_db", "prediction.stripe.tied.total.separated.reconstructed.psnr_db"},
    {"white_nrmse", "prediction.white.tied.total.separated.reconstructed.nrmse"},
    {"divergence", "fit.divergence"},
    {"depth_rms_mm", "truth.depth_rms_mm"},
}};

const char* OrderOf(SortKey key) {
  switch (key) {
    case SortKey::kStarted:
      return "started";
    case SortKey::kFrames:
      return "frames";
    case SortKey::kBytes:
      return "bytes";
    case SortKey::kFits:
      return "fits";
    case SortKey::kNrmse:
      return "nrmse";
    case SortKey::kCalibrationAge:
      return "calibration_age_days";
    case SortKey::kNumber:
      break;
  }
  return "number";
}

// Adds conditions; values go in as parameters, never as text.
class Conditions {
 public:
  explicit Conditions(QueryParameters& parameters) : parameters_(parameters) {}
  // The name of a new parameter, with its colon.
  std::string Bind(Cell value) {
    const std::string name = "p" + std::to_string(parameters_.size());
    parameters_[name] = std::move(value);
    return ":" + name;
  }
  void And(const std::string& condition) { sql_ += " AND " + condition; }
  void AndOneOf(const std::string& column, const std::vector<std::string>& values) {
    std::string list;
    for (const std::string& value : values) list += (list.empty() ? "" : ", ") + Bind(value);
    if (!values.empty()) And(column + " IN (" + list + ")");
  }
  [[nodiscard]] const std::string& sql() const { return sql_; }

 private:
  QueryParameters& parameters_;
  std::string sql_;
};

template <typename T>
std::vector<std::string> Names(const std::vector<T>& values) {
  std::vector<std::string> names;
  for (const T value : values) names.emplace_back(ToString(value));
  return names;
}

std::string SessionConditions(const SessionFilter& filter, QueryParameters& parameters) {
  Conditions where(parameters);
  if (filter.since) where.And("s.started_wall_ns >= " + where.Bind(filter.since->ns));
  if (filter.until) where.And("s.started_wall_ns < " + where.Bind(filter.until->ns));
  where.AndOneOf("s.status", Names(filter.statuses));
  where.AndOneOf("s.kind", Names(filter.kinds));
  where.AndOneOf("s.rig", filter.rigs);
  where.AndOneOf("s.visitor", filter.visitors);
  where.AndOneOf("s.visit", filter.visits);
  if (filter.calibration && filter.calibration->empty()) where.And("s.calibration_id IS NULL");
  if (filter.calibration && !filter.calibration->empty()) {
    const std::string prefix = where.Bind(*filter.calibration);
    where.And("substr(s.calibration_id, 1, length(" + prefix + ")) = " + prefix);
  }
  return where.sql();
}

std::string FitConditions(const SessionFilter& filter, QueryParameters& parameters) {
  Conditions where(parameters);
  if (filter.fitted == Fitted::kYes) where.And("fits > 0");
  if (filter.fitted == Fitted::kNo) where.And("fits = 0");
  for (const FitBound& bound : filter.bounds) {
    const std::string name = where.Bind(MetricName(bound.metric));
    const char* side = bound.side == FitBound::Side::kAtMost ? " <= " : " >= ";
    where.And("(SELECT m.value FROM metrics m WHERE m.session = number AND m.fit = newest_fit AND m.name = " + name +
              ")" + side + where.Bind(bound.value));
  }
  return where.sql();
}

}  // namespace

std::string MetricName(const std::string& name) {
  for (const auto& [brief, full] : kShortNames)
    if (name == brief) return full;
  return name;
}

SessionQuery QueryOf(const SessionFilter& filter) {
  SessionQuery query;
  query.parameters["nrmse"] = MetricName("nrmse");
  query.sql = kSelect + SessionConditions(filter, query.parameters) + ")" + kListColumns +
              FitConditions(filter, query.parameters);
  const char* order = filter.order == SortOrder::kAscending ? "" : " DESC";
  query.sql += std::string("\nORDER BY ") + OrderOf(filter.sort) + order + " NULLS LAST, number DESC";
  query.parameters["limit"] = filter.limit.value_or(-1);
  query.sql += "\nLIMIT :limit";
  return query;
}

Result<ResultTable> ListSessions(ReadOnlyIndex& index, const SessionFilter& filter) {
  const SessionQuery query = QueryOf(filter);
  QueryLimits limits;
  limits.rows = INT64_MAX;
  limits.bytes = INT64_MAX;
  SLX_ASSIGN_OR_RETURN(auto table, index.Run(query.sql, query.parameters, limits));
  for (Column& column : table.columns) {
    if (column.name == "started" || column.name == "finished") column.kind = ColumnKind::kWallTime;
    if (column.name == "bytes") column.kind = ColumnKind::kBytes;
    if (column.name == "calibration_age_days") column.kind = ColumnKind::kDays;
    if (column.name == "simulated") column.kind = ColumnKind::kBoolean;
    if (column.name == "reasons" || column.name == "consent") column.kind = ColumnKind::kJson;
  }
  for (size_t c = 11; c < table.columns.size(); ++c) table.columns[c].place = ColumnPlace::kDetail;
  return table;
}

}  // namespace stratalux::db
