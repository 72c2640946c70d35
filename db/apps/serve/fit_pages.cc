// SPDX-License-Identifier: Apache-2.0
// A fit: its figures, its files, its report.
#include <algorithm>
#include <filesystem>
#include <vector>

#include "db/apps/display_text.h"
#include "db/apps/serve/html.h"
#include "db/apps/serve/site.h"
#include "db/apps/table_output.h"
#include "db/catalogue/fit_reader.h"
#include "shared/http/static_files.h"
#include "shared/http/target.h"

namespace stratalux::db {
namespace {

using http::Request;
using http::Response;

constexpr size_t kMostFiles = 500;
constexpr int kDeepest = 4;

// A report is one page with everything inside: its own styles and scripts may run, in an origin of its own that reaches
// nothing of this server and nothing outside.
constexpr const char* kReportPolicy =
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
    " blob:; font-src data:; media-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
// Anything else that a browser might show as a page, such as SVG.
constexpr const char* kFilePolicy =
    "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'";

std::string FitPlace(const Request& request) {
  return SessionPlace(request.Wildcard("session")) + "/fits/" + http::PercentEncode(request.Wildcard("fit"));
}

// kNotFound where the index knows no such fit: what lies there unregistered is nobody's result.
Result<ResultTable> FiguresOf(ReadOnlyIndex& index, const ServedSession& session, const std::string& fit) {
  SLX_ASSIGN_OR_RETURN(const auto known, index.Run("SELECT 1 FROM fits WHERE session = :number AND id = :fit",
                                                   {{"number", session.number}, {"fit", fit}}));
  if (known.rows.empty()) return Status::NotFound("session " + session.info.id + " has no fit '" + fit + "'");
  return index.Run("SELECT name AS figure, value FROM metrics WHERE session = :number AND fit = :fit ORDER BY name",
                   {{"number", session.number}, {"fit", fit}});
}

struct FileEntry {
  std::string name;  // below the fit's folder
  int64_t bytes = 0;
};

// Regular files alone, links to nowhere.
std::vector<FileEntry> FilesOf(const std::filesystem::path& folder) {
  std::vector<FileEntry> files;
  std::error_code error;
  if (std::filesystem::is_symlink(folder, error)) return files;
  std::filesystem::recursive_directory_iterator entries(folder, error), end;
  for (; !error && entries != end && files.size() < kMostFiles; entries.increment(error)) {
    std::error_code unreadable;
    if (entries.depth() >= kDeepest) entries.disable_recursion_pending();
    if (entries->symlink_status(unreadable).type() != std::filesystem::file_type::regular) continue;
    const auto bytes = entries->file_size(unreadable);
    if (!unreadable)
      files.push_back({entries->path().lexically_relative(folder).string(), static_cast<int64_t>(bytes)});
  }
  std::sort(files.begin(), files.end(), [](const auto& a, const auto& b) { return a.name < b.name; });
  return files;
}

std::string FilePlace(const std::string& fit_place, const std::string& name) {
  std::string place = fit_place + "/files";
  for (const auto& part : std::filesystem::path(name)) place += "/" + http::PercentEncode(part.string());
  return place;
}

std::string FileList(const std::string& place, const std::vector<FileEntry>& files) {
  std::string rows, report;
  for (const FileEntry& file : files) {
    if (file.name == "report/index.html")
      report = "<p class=\"report\">" + Link(FilePlace(place, file.name), "Open the report") + "</p>";
    if (file.name == "calibration_report.html" && report.empty())
      report = "<p class=\"report\">" + Link(FilePlace(place, file.name), "Open the calibration's report") + "</p>";
    rows += "<tr><th scope=\"row\">" + Link(FilePlace(place, file.name), file.name) + "</th><td class=\"number\">" +
            Escape(SizeText(file.bytes)) + "</td></tr>";
  }
  return report + "<h2>Files</h2>" + TableFrame("Files of the fit", {"file", "size"}, rows);
}

Result<std::string> ShowFit(Site& site, const Request& request) {
  const std::string id = request.Wildcard("session"), fit = request.Wildcard("fit");
  SLX_ASSIGN_OR_RETURN(auto index, site.OpenIndex());
  SLX_ASSIGN_OR_RETURN(const auto session, site.Find(index, id));
  SLX_ASSIGN_OR_RETURN(const auto figures, FiguresOf(index, session, fit));
  const std::string files =
      session.withheld.empty()
          ? FileList(FitPlace(request), FilesOf(site.store() / "sessions" / id / "fits" / fit))
          : "<p class=\"problem\">Pictures and reports are not shown: " + Escape(session.withheld) + ".</p>";
  return "<p>" + Link(SessionPlace(id), "Session " + id) + "</p>" + files + "<h2>Figures</h2>" +
         HtmlTable(figures, "Figures of the fit");
}

// What an encrypted visit's fit keeps sealed, out of memory; any other file as it is.
Result<http::FileBody> Unsealed(const Site& site, const ServedSession& session, const Request& request,
                                http::FileBody file) {
  const std::string& id = session.info.id;
  const auto folder = site.store() / "sessions" / id / "fits" / request.Wildcard("fit");
  SLX_ASSIGN_OR_RETURN(auto reader, FitReader::Open(folder, id, SealOf(site.store(), session.info, session.key_id)));
  SLX_ASSIGN_OR_RETURN(auto plain, reader.Read(request.Wildcard("file")));
  if (!plain.memory.ok()) return file;
  std::error_code error;
  const uint64_t bytes = std::filesystem::file_size(plain.path, error);
  if (error) return Status::Failed("cannot read " + plain.path.string() + ": " + error.message());
  return http::FileBody{std::move(plain.memory), bytes};
}

Result<http::FileBody> OpenFile(Site& site, const Request& request) {
  const std::string id = request.Wildcard("session"), fit = request.Wildcard("fit");
  SLX_ASSIGN_OR_RETURN(auto index, site.OpenIndex());
  SLX_ASSIGN_OR_RETURN(const auto session, site.Find(index, id));
  SLX_RETURN_IF_ERROR(FiguresOf(index, session, fit).status());
  SLX_ASSIGN_OR_RETURN(
      auto file, http::OpenBelow(site.store() / "sessions", id + "/fits/" + fit + "/" + request.Wildcard("file")));
  return Unsealed(site, session, request, std::move(file));
}

Response ShowFile(Site& site, const Request& request) {
  auto file = OpenFile(site, request);
  if (!file.ok()) return Problem(file.status());
  const Status shown =
      site.Disclose(request.Wildcard("session"), "fit " + request.Wildcard("fit"), request.peer).status();
  if (shown.code() == StatusCode::kUsage)
    return Page("", "Withheld", "<p class=\"problem\">" + Escape(shown.message()) + "</p>", 403);
  if (!shown.ok()) return Problem(shown);
  const std::string type = http::ContentTypeOf(request.Wildcard("file"));
  Response response;
  response.body = std::move(*file);
  response.With("Content-Type", type);
  response.With("Content-Security-Policy", type.starts_with("text/html") ? kReportPolicy : kFilePolicy);
  if (type == "application/octet-stream") response.With("Content-Disposition", "attachment");
  return response;
}

}  // namespace

void AddFitPages(Site& site, http::Router& router) {
  router.Add(http::Method::kGet, "/sessions/{session}/fits/{fit}", [&site](const Request& request) {
    const auto main = ShowFit(site, request);
    return main.ok() ? Page("Sessions", "Fit " + request.Wildcard("fit"), *main) : Problem(main.status());
  });
  router.Add(http::Method::kGet, "/sessions/{session}/fits/{fit}/files/{file...}",
             [&site](const Request& request) { return ShowFile(site, request); });
}

}  // namespace stratalux::db
