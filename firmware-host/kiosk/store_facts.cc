// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/store_facts.h"

#include <algorithm>
#include <map>
#include <utility>

#include <nlohmann/json.hpp>

#include "db/catalogue/calibration_store.h"
#include "db/catalogue/read_only_index.h"
#include "db/catalogue/schema_check.h"
#include "db/catalogue/session_filter.h"
#include "db/catalogue/session_store.h"
#include "firmware-host/preview/preview_picture.h"

namespace stratalux::rig {
namespace {

constexpr int kSmallPx = 160;

using Row = std::map<std::string, db::Cell>;

std::string TextOf(const Row& row, const char* column) {
  const auto* text = std::get_if<std::string>(&row.at(column));
  return text == nullptr ? "" : *text;
}
int64_t IntegerOf(const Row& row, const char* column) {
  const auto* value = std::get_if<int64_t>(&row.at(column));
  return value == nullptr ? 0 : *value;
}

std::vector<std::string> TextsOf(const std::string& json) {
  std::vector<std::string> texts;
  const auto list = nlohmann::json::parse(json, nullptr, false);
  if (!list.is_array()) return texts;
  for (const auto& one : list)
    if (one.is_string()) texts.push_back(one.get<std::string>());
  return texts;
}

}  // namespace

Result<std::vector<RecentSession>> RecentSessions(const std::filesystem::path& store, int most) {
  SLX_RETURN_IF_ERROR(db::RequireCurrentSchema(store));
  SLX_ASSIGN_OR_RETURN(auto index, db::ReadOnlyIndex::Open(store));
  db::SessionFilter filter;
  filter.limit = most;
  SLX_ASSIGN_OR_RETURN(const auto table, db::ListSessions(index, filter));
  std::vector<RecentSession> sessions;
  for (const auto& cells : table.rows) {
    Row row;
    for (size_t i = 0; i < cells.size(); ++i) row[table.columns[i].name] = cells[i];
    sessions.push_back({TextOf(row, "session"),
                        TextOf(row, "kind"),
                        TextOf(row, "status"),
                        {IntegerOf(row, "started")},
                        IntegerOf(row, "frames"),
                        TextsOf(TextOf(row, "reasons"))});
  }
  return sessions;
}

Result<std::string> SessionPicture(const std::filesystem::path& store, const std::string& id, const std::string& peer,
                                   db::DisclosureLog& log) {
  SLX_RETURN_IF_ERROR(db::RequireCurrentSchema(store));
  SLX_ASSIGN_OR_RETURN(auto index, db::ReadOnlyIndex::Open(store));
  SLX_RETURN_IF_ERROR(db::MayBeShown(log.ledger(), index, id));
  SLX_ASSIGN_OR_RETURN(const int64_t wanted, db::FrameAtAGlance(index, id));
  SLX_ASSIGN_OR_RETURN(const auto sessions, db::SessionStore::Open(store, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto frames, sessions.ListFrames(id));
  const auto frame = std::find_if(frames.begin(), frames.end(), [wanted](const auto& one) { return one.id == wanted; });
  if (frame == frames.end()) return Status::NotFound("session '" + id + "' is being forgotten");
  SLX_ASSIGN_OR_RETURN(const Image<uint16_t> pixels, sessions.ReadFrame(id, *frame));
  SLX_RETURN_IF_ERROR(log.Enter(id, "a small picture", peer));
  return PreviewPicture(frame->record, pixels.view(), kSmallPx);
}

std::optional<int> CalibrationAgeDays(const std::filesystem::path& store, const std::string& rig, bool simulated,
                                      WallNs now) {
  const auto newest = db::FindCalibration(store, {rig, simulated}, "latest");
  return newest.ok() ? std::optional(static_cast<int>(newest->AgeDays(now))) : std::nullopt;
}

}  // namespace stratalux::rig
