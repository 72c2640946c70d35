// SPDX-License-Identifier: Apache-2.0
// manifest.json of a session: enough to rebuild its row of the index.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "shared/capture/session.h"

namespace stratalux::db {

// On the disk when this returns: whole, or as it was before.
Status WriteManifest(const std::filesystem::path& session_folder, const SessionInfo& info, int64_t frames,
                     const std::vector<std::string>& segments);
Result<SessionInfo> ReadManifest(const std::filesystem::path& session_folder);
// Names other segments in a manifest and leaves the rest as it is; kOk where there is none (sessions that failed).
Status ReplaceSegments(const std::filesystem::path& session_folder, const std::vector<std::string>& segments);

// What the manifest says lies beside it.
struct ManifestContents {
  int64_t frames = 0;
  std::vector<std::string> segments;
  struct File {
    std::string name;
    int64_t bytes = 0;
    std::string hash;  // of a sealed segment's footer and trailer, of all bytes of other files; empty: not sealed
  };
  std::vector<File> files;  // since schema 3: segments, truth.seg, truth_calibration.json
  int schema = 0;
};
Result<ManifestContents> ReadManifestContents(const std::filesystem::path& session_folder);
// The same of a file as it lies in the folder now.
Result<ManifestContents::File> DescribeFile(const std::filesystem::path& session_folder, const std::string& name);
// What of the manifest a transcode leaves as it is, in one line: what a signature covers (db/catalogue/signature.h).
[[nodiscard]] std::string LastingFacts(const std::string& manifest_text);
[[nodiscard]] std::string ManifestText(const std::filesystem::path& session_folder, const SessionInfo& info,
                                       int64_t frames, const std::vector<std::string>& segments);

// {"text_version", "language", "scope": ["fit", "research", "publication"], "given_wall_ns"}; "" for no consent.
[[nodiscard]] std::string ConsentToJson(const Consent& consent);
// An empty consent for any other text.
[[nodiscard]] Consent ConsentFromJson(const std::string& text);

// {"camera_width", "camera_height", "projector_width", "projector_height", "saturation_dn"}; what is not known is left
// out. Reading: kIntegrity for another shape or what no device has.
[[nodiscard]] std::string DevicesToJson(const SessionDevices& devices);
[[nodiscard]] Result<SessionDevices> DevicesFromJson(const std::string& text);

[[nodiscard]] std::string ReasonsToJson(const std::vector<std::string>& reasons);
[[nodiscard]] std::vector<std::string> ReasonsFromJson(const std::string& text);
// Of the index's columns. Other texts are none, so that they hide no frame: `verify` names the column.
[[nodiscard]] CaptureFindings FoundFromJson(const std::string& findings_json, const std::string& faults_json);

}  // namespace stratalux::db
