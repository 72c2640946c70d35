// SPDX-License-Identifier: Apache-2.0
// The frames of a session with their pictures, one frame, and the pictures themselves.
#include <algorithm>
#include <charconv>
#include <utility>

#include "db/apps/display_text.h"
#include "db/apps/serve/html.h"
#include "db/apps/serve/site.h"
#include "db/apps/table_output.h"
#include "shared/capture/reduced_picture.h"
#include "shared/http/target.h"
#include "shared/image/png.h"

namespace stratalux::db {
namespace {

using http::Request;
using http::Response;

constexpr int64_t kFramesOnAPage = 48;
constexpr int kThumbnailPx = 192;
constexpr int kPicturePx = 1024;

Result<int64_t> NumberOf(const std::string& text) {
  int64_t number = 0;
  const auto end = std::from_chars(text.data(), text.data() + text.size(), number);
  if (end.ec != std::errc() || end.ptr != text.data() + text.size() || number < 0)
    return Status::Usage("'" + text + "' is not a frame number");
  return number;
}

std::string PicturePlace(const std::string& id, int64_t frame) {
  return "/pictures/" + http::PercentEncode(id) + "/" + std::to_string(frame);
}
std::string FramesPlace(const std::string& id) { return SessionPlace(id) + "/frames"; }

struct ListedFrame {
  SessionStore store;
  FrameRow row;
};
Result<ListedFrame> FindFrame(const Site& site, const std::string& id, int64_t frame) {
  SLX_ASSIGN_OR_RETURN(auto store, SessionStore::Open(site.store(), AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto frames, store.ListFrames(id));
  const auto found = std::find_if(frames.begin(), frames.end(), [frame](const auto& f) { return f.id == frame; });
  if (found == frames.end()) return Status::NotFound("session " + id + " has no frame " + std::to_string(frame));
  return ListedFrame{std::move(store), *found};
}

Result<std::string> PngOf(const ListedFrame& frame, const std::string& id, int limit_px) {
  SLX_ASSIGN_OR_RETURN(const auto image, frame.store.ReadFrame(id, frame.row));
  const Image<uint8_t> picture = ReducedPicture(frame.row.record, image.view(), limit_px);
  SLX_ASSIGN_OR_RETURN(const auto bytes, EncodePng8(picture.view()));
  return std::string(bytes.begin(), bytes.end());
}

// Where no picture can be shown stands a word, so that a list does not look as if it were loading.
Response NoPicture(const std::string& word) {
  const std::string svg =
      "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 96 72\" width=\"96\" height=\"72\"><rect width=\"96\""
      " height=\"72\" fill=\"#5a3030\"/><text x=\"48\" y=\"41\" font-family=\"sans-serif\" font-size=\"14\""
      " fill=\"#fff\" text-anchor=\"middle\">" +
      word + "</text></svg>";
  return Response::Of("image/svg+xml", svg);
}

const char* WordOf(const Status& status) {
  return status.code() == StatusCode::kIntegrity  ? "damaged"
         : status.code() == StatusCode::kNotFound ? "not here"
                                                  : "failed";
}

Response ShowPicture(Site& site, const Request& request, int64_t frame, int limit_px) {
  const std::string id = request.Wildcard("session");
  const auto session = site.Disclose(id, "pictures", request.peer);
  if (!session.ok()) {
    if (session.status().code() == StatusCode::kUsage) return NoPicture("withheld");
    return Problem(session.status());
  }
  const auto listed = FindFrame(site, id, frame);
  if (!listed.ok()) return NoPicture(WordOf(listed.status()));
  const auto png = PngOf(*listed, id, limit_px);
  if (png.ok()) return Response::Of("image/png", *png);
  const bool no_key = !session->key_id.empty() && png.status().code() == StatusCode::kNotFound;
  return NoPicture(no_key ? "no key" : WordOf(png.status()));
}

Response ShowThumbnail(Site& site, const Request& request) {
  auto index = site.OpenIndex();
  if (!index.ok()) return Problem(index.status());
  const auto frame = FrameAtAGlance(*index, request.Wildcard("session"));
  if (!frame.ok())
    return frame.status().code() == StatusCode::kNotFound ? NoPicture("not here") : Problem(frame.status());
  return ShowPicture(site, request, *frame, kThumbnailPx);
}

std::string Card(const std::string& id, const std::vector<Cell>& row) {
  const int64_t frame = IntegerOf(row[0]);
  const std::string place = FramesPlace(id) + "/" + std::to_string(frame);
  const std::string words = TextOf(row[3]) + ", projector " + std::to_string(IntegerOf(row[2])) +
                            (IntegerOf(row[4]) > 0 ? ", retake " + std::to_string(IntegerOf(row[4])) : "");
  return "<li><a href=\"" + Escape(place) + "\"><img loading=\"lazy\" width=\"192\" height=\"144\" alt=\"\" src=\"" +
         Escape(PicturePlace(id, frame)) + "?size=small\"><span>Frame " + std::to_string(frame) + "</span></a><small>" +
         Escape(words) + "</small></li>";
}

// The place of these frames, further on or back.
std::string Turn(const std::string& id, const std::string& phase, int64_t from) {
  return FramesPlace(id) + "?from=" + std::to_string(std::max<int64_t>(0, from)) +
         (phase.empty() ? "" : "&phase=" + http::PercentEncode(phase));
}

Result<std::string> PhaseLinks(ReadOnlyIndex& index, const ServedSession& session, const std::string& chosen) {
  SLX_ASSIGN_OR_RETURN(const auto table, index.Run("SELECT phase, count(*) FROM frames WHERE session = :number"
                                                   " GROUP BY phase ORDER BY min(step)",
                                                   {{"number", session.number}}));
  const std::string id = session.info.id;
  std::string items = "<li>" + Link(FramesPlace(id), "all") + "</li>";
  for (const auto& row : table.rows) {
    const std::string phase = TextOf(row[0]);
    items += std::string("<li><a href=\"") + Escape(Turn(id, phase, 0)) + "\"" +
             (phase == chosen ? " aria-current=\"true\"" : "") + ">" + Escape(phase) + "</a> (" +
             std::to_string(IntegerOf(row[1])) + ")</li>";
  }
  return "<nav aria-label=\"Phases\"><ul class=\"phases\">" + items + "</ul></nav>";
}

Result<std::string> Grid(Site& site, const Request& request) {
  const std::string id = request.Wildcard("session"), phase = request.Query("phase");
  SLX_ASSIGN_OR_RETURN(const int64_t from, NumberOf(request.query.count("from") != 0 ? request.Query("from") : "0"));
  SLX_ASSIGN_OR_RETURN(auto index, site.OpenIndex());
  SLX_ASSIGN_OR_RETURN(const auto session, site.Find(index, id));
  SLX_ASSIGN_OR_RETURN(const std::string phases, PhaseLinks(index, session, phase));
  SLX_ASSIGN_OR_RETURN(
      const auto table,
      index.Run("SELECT frame, step, projector, pattern, retry FROM frames WHERE session = :number AND"
                " (:phase = '' OR phase = :phase) ORDER BY frame LIMIT :limit OFFSET :from",
                {{"number", session.number}, {"phase", phase}, {"limit", kFramesOnAPage + 1}, {"from", from}}));
  std::string cards;
  const auto shown = std::min<size_t>(table.rows.size(), static_cast<size_t>(kFramesOnAPage));
  for (size_t i = 0; i < shown; ++i) cards += Card(id, table.rows[i]);
  std::string turns;
  if (from > 0) turns += "<li>" + Link(Turn(id, phase, from - kFramesOnAPage), "Earlier frames") + "</li>";
  if (table.rows.size() > shown)
    turns += "<li>" + Link(Turn(id, phase, from + kFramesOnAPage), "Later frames") + "</li>";
  const std::string withheld =
      session.withheld.empty() ? ""
                               : "<p class=\"problem\">Pictures are not shown: " + Escape(session.withheld) + ".</p>";
  return "<p>" + Link(SessionPlace(id), "Session " + id) + "</p>" + phases + withheld +
         (cards.empty() ? "<p>No frames.</p>" : "<ul class=\"cards\">" + cards + "</ul>") +
         (turns.empty() ? "" : "<nav aria-label=\"More frames\"><ul>" + turns + "</ul></nav>");
}

// All that the index knows of it, name by name.
Result<std::string> ProofOf(ReadOnlyIndex& index, const ServedSession& session, int64_t frame) {
  SLX_ASSIGN_OR_RETURN(
      const auto table,
      index.Run("SELECT step, projector, phase, pattern, retry, CASE level_check WHEN 1 THEN 'passed'"
                " WHEN 2 THEN 'failed' ELSE 'not checked' END AS level_check, exposure_ms, gain,"
                " mean_dn, bracket, pose, trigger_number, trigger_ns, sync_ns, frame_ns,"
                " driver_sequence, retake_cause, printf('frames-%04d.seg', segment) AS segment, offset,"
                " stored_bytes, hash FROM frame_overview WHERE session = :number AND frame = :frame",
                {{"number", session.number}, {"frame", frame}}));
  if (table.rows.empty())
    return Status::NotFound("session " + session.info.id + " has no frame " + std::to_string(frame));
  std::vector<std::pair<std::string, std::string>> facts;
  for (size_t c = 0; c < table.columns.size(); ++c) {
    std::string name = table.columns[c].name;
    std::replace(name.begin(), name.end(), '_', ' ');
    facts.emplace_back(name, Escape(CellForPeople(table.rows.front()[c], ColumnKind::kPlain)));
  }
  return Facts(facts);
}

Status ReadFrame(const Site& site, const std::string& id, int64_t frame) {
  SLX_ASSIGN_OR_RETURN(const auto listed, FindFrame(site, id, frame));
  return listed.store.ReadFrame(id, listed.row).status();
}

Result<std::string> OneFrame(Site& site, const Request& request, int64_t frame) {
  const std::string id = request.Wildcard("session");
  SLX_ASSIGN_OR_RETURN(auto index, site.OpenIndex());
  SLX_ASSIGN_OR_RETURN(const auto session, site.Find(index, id));
  SLX_ASSIGN_OR_RETURN(const std::string proof, ProofOf(index, session, frame));
  Status readable = session.withheld.empty() ? ReadFrame(site, id, frame)
                                             : Status::Usage("pictures are not shown: " + session.withheld);
  const std::string picture = readable.ok() ? "<p><img class=\"large\" alt=\"Frame " + std::to_string(frame) +
                                                  "\" src=\"" + Escape(PicturePlace(id, frame)) +
                                                  "\"></p><p class=\"note\">Reduced, in sRGB; white is the"
                                                  " largest value of the format.</p>"
                                            : "<p class=\"problem\">" + Escape(readable.message()) + "</p>";
  std::string turns = "<li>" + Link(FramesPlace(id), "All frames") + "</li>";
  if (frame > 0) turns += "<li>" + Link(FramesPlace(id) + "/" + std::to_string(frame - 1), "Previous") + "</li>";
  if (frame + 1 < session.frames)
    turns += "<li>" + Link(FramesPlace(id) + "/" + std::to_string(frame + 1), "Next") + "</li>";
  return "<p>" + Link(SessionPlace(id), "Session " + id) + "</p><nav aria-label=\"Frames\"><ul>" + turns +
         "</ul></nav>" + picture + "<h2>Proof</h2>" + proof;
}

Response Show(const std::string& title, const Result<std::string>& main) {
  return main.ok() ? Page("Sessions", title, *main) : Problem(main.status());
}

}  // namespace

void AddFramePages(Site& site, http::Router& router) {
  router.Add(http::Method::kGet, "/sessions/{session}/frames", [&site](const Request& request) {
    return Show("Frames of " + request.Wildcard("session"), Grid(site, request));
  });
  router.Add(http::Method::kGet, "/sessions/{session}/frames/{frame}", [&site](const Request& request) {
    const auto frame = NumberOf(request.Wildcard("frame"));
    return frame.ok() ? Show("Frame " + std::to_string(*frame), OneFrame(site, request, *frame))
                      : Problem(frame.status());
  });
  router.Add(http::Method::kGet, "/pictures/{session}/{frame}", [&site](const Request& request) {
    const auto frame = NumberOf(request.Wildcard("frame"));
    const bool small = request.Query("size") == "small";
    return frame.ok() ? ShowPicture(site, request, *frame, small ? kThumbnailPx : kPicturePx) : Problem(frame.status());
  });
  router.Add(http::Method::kGet, "/thumbnails/{session}",
             [&site](const Request& request) { return ShowThumbnail(site, request); });
}

}  // namespace stratalux::db
