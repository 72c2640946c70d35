// SPDX-License-Identifier: Apache-2.0
#include "db/care/session_gate.h"

#include <algorithm>
#include <cstring>

#include "db/catalogue/info_check.h"
#include "db/segment/header_check.h"

namespace stratalux::db {
namespace {

// What fits into a segment's header, and names a folder and nothing else.
bool IsSessionId(const std::string& id) {
  return !id.empty() && id.size() < 40 && id[0] != '.' &&
         std::all_of(id.begin(), id.end(), [](unsigned char c) { return c > ' ' && c < 0x7f && c != '/'; });
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
  if (!IsSessionId(session.info.id)) return Status::Integrity("'" + session.info.id + "' is not a session id");
  SLX_RETURN_IF_ERROR(CheckInfo(session.info).WithContext(where));
  for (const auto& [segment, frame] : session.frames)
    SLX_RETURN_IF_ERROR(CheckHeader(frame.header).WithContext(where + ", " + SegmentName(segment)));
  SLX_RETURN_IF_ERROR(CheckKeys(session).WithContext(where));
  for (const FitRow& fit : session.fits)
    if (fit.created_wall.ns < 0) return Status::Integrity(where + ": fit " + fit.id + " was made before 1970");
  return Status::Ok();
}

}  // namespace stratalux::db
