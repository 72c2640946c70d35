// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_metadata.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <set>

#include <nlohmann/json.hpp>

#include "db/catalogue/consent.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

Json Reference(const std::string& id) { return {{"@id", id}}; }

// A single value, where there is but one: the compacted form.
Json References(const std::vector<std::string>& ids) {
  if (ids.size() == 1) return Reference(ids[0]);
  Json list = Json::array();
  for (const std::string& id : ids) list.push_back(Reference(id));
  return list;
}

std::string Local(const std::string& what, const std::string& name) { return "#" + what + "-" + UriOf(name); }
std::string SoftwareId(const std::string& version) { return Local("stratalux", version.empty() ? "unknown" : version); }
std::string LicenceId(const std::string& licence) {
  return licence.empty() ? "#no-licence" : "https://spdx.org/licenses/" + licence;
}

std::string EncodingOf(const std::string& path) {
  static const std::map<std::string, const char*> kEncodings = {
      {".tif", "image/tiff"},        {".png", "image/png"},         {".jpg", "image/jpeg"},
      {".json", "application/json"}, {".csv", "text/csv"},          {".txt", "text/plain"},
      {".html", "text/html"},        {".exr", "image/x-exr"},       {".npy", "application/x-npy"},
      {".obj", "model/obj"},         {".ply", "application/x-ply"}, {".svg", "image/svg+xml"},
      {".toml", "application/toml"}, {".md", "text/markdown"}};
  const auto found = kEncodings.find(std::filesystem::path(path).extension().string());
  return found == kEncodings.end() ? "application/octet-stream" : found->second;
}

// What a file of a session is for; by its place.
std::string PurposeOf(const std::string& in_session) {
  static const std::map<std::string, const char*> kPurposes = {
      {"session.json", "What the session says of itself: kind, rig, times, status, consent"},
      {"frames.csv", "Every frame with its proof: pattern, light, exposure, times in nanoseconds, hash of its pixels"},
      {"plan.json", "The plan by which the frames were captured"},
      {"fits.csv", "The fits of the session"},
      {"metrics.csv", "The figures of the fits"},
      {"calibration/calibration.json", "Calibration of camera and projectors: geometry and light"},
      {"calibration/cameras.txt", "Calibration in COLMAP's text format: models of camera and projectors"},
      {"calibration/images.txt", "Calibration in COLMAP's text format: poses, world to camera, mm"},
      {"calibration/points3D.txt", "Calibration in COLMAP's text format: no points"}};
  const auto found = kPurposes.find(in_session);
  if (found != kPurposes.end()) return found->second;
  if (in_session.starts_with("frames/")) return "A frame as the sensor read it: exact digital numbers";
  if (in_session.starts_with("truth/")) return "A map of the truth behind a simulated capture";
  return "A file of a fit";
}

class Writer {
 public:
  Writer(const std::filesystem::path& file, const CrateDescription& crate, const CrateFiles& files)
      : file_(file), crate_(crate), files_(files), out_(file, std::ios::binary | std::ios::trunc) {}

  Status Write() {
    out_ << "{\n \"@context\": \"" << kRoCrateContext << "\",\n \"@graph\": [";
    Add({{"@id", kCrateMetadataFile},
         {"@type", "CreativeWork"},
         {"conformsTo", Reference(kRoCrateSpecification)},
         {"about", Reference("./")},
         {"description", "RO-Crate Metadata Descriptor (this file)"}});
    AddRoot();
    AddShared();
    for (const DescribedSession& session : crate_.sessions) AddSession(session);
    out_ << "\n ]\n}\n";
    out_.close();
    if (!out_.good()) return Status::Failed("cannot write " + file_.string() + "; is the disk full?");
    return Status::Ok();
  }

 private:
  // An @id that several sessions share is described once.
  void Add(const Json& entity) {
    if (!ids_.insert(entity.at("@id").get<std::string>()).second) return;
    out_ << (ids_.size() == 1 ? "\n  " : ",\n  ") << entity.dump(-1, ' ', false, Json::error_handler_t::replace);
  }
  void AddFile(const std::string& path, const std::string& description) {
    const CrateChecksum& sum = files_.at(path);
    Add({{"@id", UriOf(path)},
         {"@type", "File"},
         {"name", std::filesystem::path(path).filename().string()},
         {"description", description},
         {"encodingFormat", EncodingOf(path)},
         {"contentSize", std::to_string(sum.bytes)},
         {"sha256", sum.sha256}});
  }
  void AddRoot() {
    std::vector<std::string> parts = {kCrateFormatFile}, mentions = {"#export"}, rigs;
    for (const DescribedSession& s : crate_.sessions) {
      parts.push_back(Folder(s));
      mentions.push_back(Local("capture", s.info.id));
      const std::string rig = Operators(s);
      if (std::find(rigs.begin(), rigs.end(), rig) == rigs.end()) rigs.push_back(rig);
    }
    Add({{"@id", "./"},
         {"@type", "Dataset"},
         {"name", crate_.name},
         {"description", crate_.description},
         {"datePublished", ToIso8601(crate_.published)},
         {"license", Reference(LicenceId(crate_.licence))},
         {"author", References(rigs)},
         {"hasPart", References(parts)},
         {"mentions", References(mentions)}});
  }
  void AddShared() {
    if (crate_.licence.empty())
      Add({{"@id", LicenceId("")},
           {"@type", "CreativeWork"},
           {"name", "No licence"},
           {"description", "Nothing is granted beyond what the consents of the sessions allow."}});
    else
      Add({{"@id", LicenceId(crate_.licence)},
           {"@type", "CreativeWork"},
           {"name", crate_.licence},
           {"identifier", crate_.licence},
           {"description", "Licence " + crate_.licence +
                               " of the SPDX list. What the consents of the sessions do not " +
                               "allow it does not allow either."}});
    AddSoftware(kVersion);
    Add({{"@id", "#export"},
         {"@type", "CreateAction"},
         {"name", "Export out of the store"},
         {"agent", Reference(SoftwareId(kVersion))},
         {"instrument", Reference(SoftwareId(kVersion))},
         {"endTime", ToIso8601(crate_.published)},
         {"result", Reference("./")}});
    Add({{"@id", kCratePreviewFile},
         {"@type", "CreativeWork"},
         {"name", "The crate as a page to look at"},
         {"about", Reference("./")}});
    AddFile(kCrateFormatFile, "What `stratalux-db import --crate` begins with: format, version, sessions");
  }
  void AddSoftware(const std::string& version) {
    Add({{"@id", SoftwareId(version)},
         {"@type", "SoftwareApplication"},
         {"name", "Stratalux"},
         {"description", "Captures and stores faces under structured light"},
         {"version", version.empty() ? "unknown" : version}});
  }
  static std::string Folder(const DescribedSession& s) { return "sessions/" + UriOf(s.info.id) + "/"; }
  static std::string RigName(const DescribedSession& s) { return s.info.rig.empty() ? "unnamed" : s.info.rig; }
  static std::string Operators(const DescribedSession& s) { return Local("operators", RigName(s)); }

  void AddSession(const DescribedSession& s) {
    std::vector<std::string> parts, frames;
    const std::string prefix = "sessions/" + s.info.id + "/";
    for (auto file = files_.lower_bound(prefix); file != files_.end() && file->first.starts_with(prefix); ++file) {
      const std::string in_session = file->first.substr(prefix.size());
      AddFile(file->first, PurposeOf(in_session));
      (in_session.starts_with("frames/") ? frames : parts).push_back(UriOf(file->first));
    }
    if (!frames.empty()) {
      parts.push_back(Folder(s) + "frames/");
      Add({{"@id", Folder(s) + "frames/"},
           {"@type", "Dataset"},
           {"name", "Frames of session " + s.info.id},
           {"description", FramesText(s)},
           {"hasPart", References(frames)}});
    }
    Json session = {{"@id", Folder(s)},
                    {"@type", "Dataset"},
                    {"name", "Session " + s.info.id},
                    {"description", SessionText(s)},
                    {"identifier", s.info.id},
                    {"dateCreated", ToIso8601(s.info.started_wall)},
                    {"hasPart", References(parts)}};
    if (!s.info.consent.text_version.empty()) session["usageInfo"] = Reference(Local("consent", s.info.id));
    Add(session);
    AddPeople(s);
    AddRig(s);
    AddCapture(s, frames.empty() ? Folder(s) : Folder(s) + "frames/");
  }
  static std::string FramesText(const DescribedSession& s) {
    return std::to_string(s.frames) + " frames, 16 bits a sample holding the raw digital numbers of " +
           std::to_string(s.bit_depth) + "-bit readings as they are; " +
           (s.cfa == "mono" ? "no colour filter" : "colour filter array " + s.cfa + ", not demosaiced") +
           ". frames.csv says what each one shows.";
  }
  static std::string SessionText(const DescribedSession& s) {
    return std::string(s.info.simulated ? "A simulated" : "A") + " session of kind " + ToString(s.info.kind) +
           " of rig '" + RigName(s) + "', status " + ToString(s.info.status) + ", " + std::to_string(s.frames) +
           " frames.";
  }
  void AddPeople(const DescribedSession& s) {
    Add({{"@id", Operators(s)}, {"@type", "Organization"}, {"name", "Operators of rig '" + RigName(s) + "'"}});
    const Consent& consent = s.info.consent;
    if (!s.info.visitor.empty())
      Add({{"@id", Local("person", s.info.visitor)},
           {"@type", "Person"},
           {"name", s.info.visitor},
           {"description", "The person captured, by a pseudonym"}});
    if (consent.text_version.empty()) return;
    Json entity = {
        {"@id", Local("consent", s.info.id)},
        {"@type", "CreativeWork"},
        {"name", "Consent to session " + s.info.id},
        {"description",
         "The person captured agreed to: " + ScopeText(consent) + ". This crate was made for: " +
             std::string(crate_.scope == CrateScope::kNotStated ? "no stated purpose" : ToString(crate_.scope)) +
             ". Consent may be withdrawn: ask the operators before a new use."},
        {"version", consent.text_version},
        {"inLanguage", consent.language},
        {"keywords", ScopeText(consent)},
        {"dateCreated", ToIso8601(consent.given_wall)}};
    if (!s.info.visitor.empty()) entity["author"] = Reference(Local("person", s.info.visitor));
    Add(entity);
  }
  void AddRig(const DescribedSession& s) {
    const std::string rig = Local("rig", RigName(s)), kind = s.info.simulated ? "simulated " : "";
    Add({{"@id", rig},
         {"@type", "IndividualProduct"},
         {"name", RigName(s)},
         {"description", "A " + kind + "rig of one camera and several projectors"}});
    Add({{"@id", Local("camera", RigName(s))},
         {"@type", "IndividualProduct"},
         {"name", "Camera of rig '" + RigName(s) + "'"},
         {"isRelatedTo", Reference(rig)}});
    for (int k = 0; k < s.projectors; ++k)
      Add({{"@id", Local("projector-" + std::to_string(k), RigName(s))},
           {"@type", "IndividualProduct"},
           {"name", "Projector " + std::to_string(k) + " of rig '" + RigName(s) + "'"},
           {"isRelatedTo", Reference(rig)}});
  }
  void AddCapture(const DescribedSession& s, const std::string& result) {
    AddSoftware(s.info.program_version);
    std::vector<std::string> instruments = {Local("rig", RigName(s)), Local("camera", RigName(s))};
    for (int k = 0; k < s.projectors; ++k) instruments.push_back(Local("projector-" + std::to_string(k), RigName(s)));
    Json capture = {{"@id", Local("capture", s.info.id)},
                    {"@type", "CreateAction"},
                    {"name", "Capture of session " + s.info.id},
                    {"agent", Reference(SoftwareId(s.info.program_version))},
                    {"instrument", References(instruments)},
                    {"startTime", ToIso8601(s.info.started_wall)},
                    {"result", Reference(result)}};
    if (s.info.finished_wall.ns != 0) capture["endTime"] = ToIso8601(s.info.finished_wall);
    if (!s.info.visitor.empty()) capture["object"] = Reference(Local("person", s.info.visitor));
    Add(capture);
  }

  const std::filesystem::path& file_;
  const CrateDescription& crate_;
  const CrateFiles& files_;
  std::ofstream out_;
  std::set<std::string> ids_;
};

}  // namespace

Status WriteCrateMetadata(const std::filesystem::path& file, const CrateDescription& crate, const CrateFiles& files) {
  return Writer(file, crate, files).Write();
}

std::string PreviewHtml(const CrateDescription& crate) {
  const std::string licence = crate.licence.empty() ? "none beyond the consents" : crate.licence;
  std::string html =
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>" + HtmlOf(crate.name) +
      "</title>\n<style>body{font-family:sans-serif;margin:2em;max-width:60em}td,th{text-align:left;padding:.3em 1em "
      ".3em 0;vertical-align:top}</style>\n</head>\n<body>\n<h1>" +
      HtmlOf(crate.name) + "</h1>\n<p>" + HtmlOf(crate.description) + "</p>\n<table>\n<tr><th>Published</th><td>" +
      ToIso8601(crate.published) + "</td></tr>\n<tr><th>Licence</th><td>" + HtmlOf(licence) +
      "</td></tr>\n<tr><th>Described by</th><td><a href=\"ro-crate-metadata.json\">ro-crate-metadata.json</a> "
      "(<a href=\"https://w3id.org/ro/crate/1.3\">RO-Crate 1.3</a>)</td></tr>\n</table>\n<h2>Sessions</h2>\n<table>\n"
      "<tr><th></th><th>Session</th><th>Kind</th><th>Rig</th><th>Started</th><th>Status</th><th>Frames</th>"
      "<th>Consent</th></tr>\n";
  for (const DescribedSession& s : crate.sessions) {
    const std::string folder = "sessions/" + UriOf(s.info.id) + "/";
    const std::string picture = s.thumbnail.empty()
                                    ? ""
                                    : "<img src=\"" + HtmlOf(UriOf(s.thumbnail)) + "\" alt=\"A frame of session " +
                                          HtmlOf(s.info.id) + "\" width=\"160\">";
    html += "<tr><td>" + picture + "</td><td><a href=\"" + folder + "session.json\">" + HtmlOf(s.info.id) + "</a>" +
            (s.info.simulated ? " (simulated)" : "") + "</td><td>" + ToString(s.info.kind) + "</td><td>" +
            HtmlOf(s.info.rig) + "</td><td>" + ToIso8601(s.info.started_wall) + "</td><td>" + ToString(s.info.status) +
            "</td><td><a href=\"" + folder + "frames.csv\">" + std::to_string(s.frames) + "</a></td><td>" +
            HtmlOf(ScopeText(s.info.consent)) + "</td></tr>\n";
  }
  return html + "</table>\n</body>\n</html>\n";
}

}  // namespace stratalux::db
