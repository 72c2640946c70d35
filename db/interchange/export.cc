// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/export.h"

#include <algorithm>
#include <map>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "db/catalogue/manifest.h"
#include "db/catalogue/session_index.h"
#include "db/catalogue/shortfall.h"
#include "db/interchange/export_files.h"
#include "db/privacy/export_marker.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

std::vector<FrameRow> Chosen(std::vector<FrameRow> frames, const ExportOptions& options) {
  std::erase_if(frames, [&options](const FrameRow& f) {
    return (options.phase && f.record.phase != *options.phase) ||
           (options.projector && f.record.projector != *options.projector);
  });
  return frames;
}

// Files below the session's fits/, relative to it; what a running fit makes is left out.
std::vector<fs::path> FilesOfFits(const fs::path& fits) {
  std::vector<fs::path> files;
  std::error_code error;
  for (auto entry = fs::recursive_directory_iterator(fits, error);
       !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
    if (entry->path().extension() == ".partial") entry.disable_recursion_pending();
    if (entry->is_regular_file(error)) files.push_back(entry->path().lexically_relative(fits));
  }
  std::sort(files.begin(), files.end());
  return files;
}

// One fit, or what lies beside fits, to out/fits/; of an encrypted visit unsealed, with a record of the plain files.
Status ExportFit(const SessionStore& store, const SessionRow& session, const fs::path& out, const std::string& fit,
                 const std::vector<fs::path>& files) {
  const fs::path folder = store.SessionFolder(session.info.id) / "fits" / fit;
  SLX_ASSIGN_OR_RETURN(auto reader,
                       FitReader::Open(folder, session.info.id, SealOf(store.folder(), session.info, session.key_id)));
  for (const fs::path& file : files) {
    if (reader.sealed() && file == kFitRecordFile) continue;
    SLX_ASSIGN_OR_RETURN(const auto plain, reader.Read(file.string()));
    SLX_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(plain.path, kAnyFileSize));
    SLX_RETURN_IF_ERROR(MakeFolder((out / fit / file).parent_path()));
    SLX_RETURN_IF_ERROR(WriteTextOnce(out / fit / file, bytes).status());
  }
  if (!reader.sealed()) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const std::string record, reader.RecordOfCopy(out / fit));
  return WriteTextOnce(out / fit / kFitRecordFile, record).status();
}

// The visitor gets the fits, too.
Result<ExportReport> ExportOne(const SessionStore& store, const SessionRow& session, const ExportOptions& options,
                               ExportFor whom, Logger& logger) {
  const std::string& id = session.info.id;
  if (const std::string text = Shortfall(session.info); !text.empty()) logger.Warning(text);
  SLX_ASSIGN_OR_RETURN(auto all, store.ListFrames(id));
  const auto frames = Chosen(std::move(all), options);
  const auto fit_files =
      whom == ExportFor::kVisitor ? FilesOfFits(store.SessionFolder(id) / "fits") : std::vector<fs::path>();
  std::vector<std::string> names = {"frames.json", "session.json", "import.toml"};
  // So that the pictures can be held against what the rig signed.
  std::error_code error;
  const fs::path signature = store.SessionFolder(id) / "signature.json";
  const bool is_signed = fs::exists(signature, error);
  if (is_signed) names.emplace_back("signature.json");
  for (const FrameRow& f : frames) names.push_back("frames/" + ExportedName(f, options.format));
  for (const fs::path& file : fit_files) names.push_back("fits/" + file.string());
  SLX_RETURN_IF_ERROR(PrepareExportFolder(options.out, id));
  ExportReport report;
  report.sessions = 1;
  const auto write = [&]() -> Status {
    Progress progress(logger, "export", static_cast<int64_t>(frames.size()));
    for (const FrameRow& frame : frames) {
      SLX_ASSIGN_OR_RETURN(auto image, store.ReadFrame(id, frame));
      SLX_ASSIGN_OR_RETURN(const Written written,
                           WriteFrameOnce(options.out / "frames" / ExportedName(frame, options.format), options.format,
                                          frame.record.format, std::move(image)));
      ++(written == Written::kNow ? report.written : report.kept);
      progress.Advance();
    }
    std::map<std::string, std::vector<fs::path>> files_of;
    for (const fs::path& file : fit_files) {
      const fs::path fit = file.has_parent_path() ? *file.begin() : fs::path();
      files_of[fit.string()].push_back(fit.empty() ? file : file.lexically_relative(fit));
    }
    for (const auto& [fit, files] : files_of)
      SLX_RETURN_IF_ERROR(ExportFit(store, session, options.out / "fits", fit, files));
    SLX_ASSIGN_OR_RETURN(const std::string manifest, ReadFile(store.SessionFolder(id) / "manifest.json"));
    SLX_RETURN_IF_ERROR(WriteTextOnce(options.out / "session.json", manifest).status());
    if (is_signed) {
      SLX_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(signature));
      SLX_RETURN_IF_ERROR(WriteTextOnce(options.out / "signature.json", bytes).status());
    }
    SLX_RETURN_IF_ERROR(WriteTextOnce(options.out / "frames.json", FramesJson(frames, options.format)).status());
    SessionInfo info = session.info;
    info.devices = store.DevicesOf(id);
    const std::string toml = ImportToml(info, frames, options.format);
    if (toml.empty()) {
      logger.Info("no import.toml: there are no frames, or they differ in depth or colours");
    } else {
      SLX_RETURN_IF_ERROR(WriteTextOnce(options.out / "import.toml", toml).status());
    }
    return Status::Ok();
  };
  SLX_RETURN_IF_ERROR(WriteExport(store.folder(), "export", id, options.out, names, write, whom));
  return report;
}

Result<Json> VisitorJson(const SessionStore& store, const std::string& visitor,
                         const std::vector<SessionSummary>& sessions) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store.folder(), AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(auto select,
                       index.connection().Prepare("SELECT text_version, language, fit, research, publication,"
                                                  " given_wall_ns, withdrawn_wall_ns IS NOT NULL, withdrawn_wall_ns"
                                                  " FROM consents WHERE visitor = ?1 ORDER BY number"));
  select.Bind(1, visitor);
  Json consents = Json::array();
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) break;
    consents.push_back({{"text_version", select.Text(0)},
                        {"language", select.Text(1)},
                        {"fit", select.Integer(2) != 0},
                        {"research", select.Integer(3) != 0},
                        {"publication", select.Integer(4) != 0},
                        {"given", ToIso8601(WallNs{select.Integer(5)})},
                        {"withdrawn", select.Integer(6) != 0 ? Json(ToIso8601(WallNs{select.Integer(7)})) : Json()}});
  }
  Json json = {{"pseudonym", visitor}, {"consents", consents}, {"sessions", Json::array()}};
  for (const SessionSummary& row : sessions)
    json["sessions"].push_back({{"session", row.info.id},
                                {"started", ToIso8601(row.info.started_wall)},
                                {"status", ToString(row.info.status)},
                                {"frames", row.frames},
                                {"consent", Json::parse(ConsentToJson(row.info.consent), nullptr, false)}});
  for (Json& session : json["sessions"])
    if (session["consent"].is_discarded()) session["consent"] = nullptr;
  return json;
}

std::string ReadmeFor(const std::string& visitor, const std::vector<SessionSummary>& sessions, ExportFormat format) {
  std::string text =
      "Your data\n=========\n\nThis folder holds everything that was recorded of you under the name '" + visitor +
      "', which stands for you\nin place of your own.\n\n"
      "visitor.json        what you agreed to and when, and the list of your visits\n"
      "<visit>/frames/     the camera's pictures, in the order they were taken (" +
      std::string(format == ExportFormat::kPng ? "PNG" : "TIFF") +
      " files;\n                    gray, as the sensor sees, each under another pattern of light)\n"
      "<visit>/frames.json what each picture shows: pattern, light, time, exposure\n"
      "<visit>/session.json the visit: when, with which device, under which consent, how it was planned\n"
      "<visit>/fits/       what was computed from the pictures: shape, skin, and report/index.html to look at\n"
      "<visit>/import.toml for programs\n\nYour visits:\n";
  for (const SessionSummary& row : sessions)
    text += "  " + row.info.id + "  " + ToIso8601(row.info.started_wall) + "  " + std::to_string(row.frames) +
            " pictures\n";
  return text +
         "\nYou may withdraw what you agreed to, and have all of this deleted, at any time: tell those who recorded "
         "it,\n"
         "and name the pseudonym above. This copy is yours; whoever has it sees your face.\n";
}

}  // namespace

Result<ExportReport> ExportSession(const SessionStore& store, const SessionRow& session, const ExportOptions& options,
                                   Logger& logger) {
  return ExportOne(store, session, options, ExportFor::kOthers, logger);
}

Result<ExportReport> ExportVisitor(const SessionStore& store, const std::string& visitor, const ExportOptions& options,
                                   Logger& logger) {
  SLX_ASSIGN_OR_RETURN(auto sessions, store.ListSessionsOf(visitor));
  std::reverse(sessions.begin(), sessions.end());
  SLX_ASSIGN_OR_RETURN(const Json json, VisitorJson(store, visitor, sessions));
  if (visitor.empty() || (sessions.empty() && json["consents"].empty()))
    return Status::NotFound("no visitor '" + visitor + "' in " + store.folder().string());
  const fs::path known = options.out / "visitor.json", readme = options.out / "README.txt";
  std::error_code error;
  if (fs::exists(options.out, error) && !fs::is_empty(options.out, error) && !fs::exists(known, error) &&
      ExportsIn(options.out).empty())
    return Status::Usage(options.out.string() + " is not empty and not an interrupted export; choose another folder");
  SLX_RETURN_IF_ERROR(MakeFolder(options.out));
  // Both speak of every session, and name the visitor: they go with whichever is forgotten first, as in a crate.
  const std::vector<std::string> of_all = {known.filename().string(), readme.filename().string()};
  std::vector<std::string> together;
  for (const SessionSummary& session : sessions) together.push_back(session.info.id);
  for (const std::string& session : together)
    SLX_RETURN_IF_ERROR(
        BeginExport(store.folder(), "export", session, options.out, of_all, together, ExportFor::kVisitor));
  ExportReport total;
  const auto write = [&]() -> Status {
    SLX_RETURN_IF_ERROR(WriteTextOnce(known, json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n").status());
    SLX_RETURN_IF_ERROR(WriteTextOnce(readme, ReadmeFor(visitor, sessions, options.format)).status());
    for (const SessionSummary& session : sessions) {
      ExportOptions one = options;
      one.out = options.out / session.info.id;
      SLX_ASSIGN_OR_RETURN(const SessionRow row, store.FindSession(session.info.id));
      SLX_ASSIGN_OR_RETURN(const ExportReport report, ExportOne(store, row, one, ExportFor::kVisitor, logger));
      total.sessions += report.sessions;
      total.written += report.written;
      total.kept += report.kept;
    }
    return Status::Ok();
  };
  const Status written = write();
  Status stays;  // of all, also behind a failure: that may be a forgetting's
  for (const SessionSummary& session : sessions)
    if (Status ended = EndExport(store.folder(), session.info.id, options.out, of_all, ExportFor::kVisitor); stays.ok())
      stays = std::move(ended);
  if (!stays.ok()) return stays;
  if (!written.ok()) return written;
  return total;
}

}  // namespace stratalux::db
