// SPDX-License-Identifier: Apache-2.0
#include "db/care/session_gate.h"

#include <algorithm>
#include <cstring>

#include <nlohmann/json.hpp>

#include "db/segment/header_check.h"

namespace stratalux::db {
namespace {

// What fits into a segment's header, and names a folder and nothing else.
bool IsSessionId(const std::string& id) {
  return !id.empty() && id.size() < 40 && id[0] != '.' &&
         std::all_of(id.begin(), id.end(), [](unsigned char c) { return c > ' ' && c < 0x7f && c != '/'; });
}

Status CheckInfo(const SessionInfo& info) {
  if (!IsSessionId(info.id)) return Status::Integrity("'" + info.id + "' is no session id");
  for (const auto& [name, text] : {std::pair<const char*, const std::string*>{"rig", &info.rig},
                                   {"visitor", &info.visitor},
                                   {"program version", &info.program_version},
                                   {"consent", &info.consent.text_version},
                                   {"language", &info.consent.language}})
    if (text->find('\0') != std::string::npos) return Status::Integrity(std::string(name) + " holds a zero byte");
  for (const auto& [name, time] : {std::pair{"start", info.started_wall.ns},
                                   {"end", info.finished_wall.ns},
                                   {"consent's time", info.consent.given_wall.ns}})
    if (time < 0) return Status::Integrity(std::string(name) + " " + std::to_string(time) + " ns lies before 1970");
  if (!info.plan_json.empty()) {
    const auto plan = PlanOptionsFromJson(info.plan_json);
    // What no version plans is damage, not somebody's wrong flag.
    if (!plan.ok() && plan.status().code() != StatusCode::kNewerSchema)
      return Status::Integrity(plan.status().message());
    SLX_RETURN_IF_ERROR(plan.status());
  }
  if (!info.calibration_json.empty() &&
      !nlohmann::ordered_json::parse(info.calibration_json, nullptr, false).is_object())
    return Status::Integrity("its calibration is no JSON object");
  return Status::Ok();
}

// One key, or none, for the whole session.
Status CheckKeys(const RebuiltSession& session) {
  for (const auto& [segment, frame] : session.frames) {
    const FrameHeader& first = session.frames.front().second.header;
    if (frame.header.cipher != first.cipher || std::memcmp(frame.header.key_id, first.key_id, sizeof first.key_id) != 0)
      return Status::Integrity("frame " + std::to_string(frame.header.frame) + " has another key than frame " +
                               std::to_string(first.frame));
  }
  return Status::Ok();
}

}  // namespace

Status CheckSession(const RebuiltSession& session) {
  const std::string where = "session " + session.info.id;
  SLX_RETURN_IF_ERROR(CheckInfo(session.info).WithContext(where));
  for (const auto& [segment, frame] : session.frames)
    SLX_RETURN_IF_ERROR(CheckHeader(frame.header).WithContext(where + ", " + SegmentName(segment)));
  SLX_RETURN_IF_ERROR(CheckKeys(session).WithContext(where));
  for (const FitRow& fit : session.fits)
    if (fit.created_wall.ns < 0) return Status::Integrity(where + ": fit " + fit.id + " was made before 1970");
  return Status::Ok();
}

}  // namespace stratalux::db
