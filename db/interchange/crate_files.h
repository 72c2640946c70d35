// SPDX-License-Identifier: Apache-2.0
// Files of a crate: names that stay inside, checksums, the manifest of all of them. Internal to db/interchange.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>

#include "shared/base/result.h"

namespace stratalux::db {

inline constexpr const char* kCrateMetadataFile = "ro-crate-metadata.json";
inline constexpr const char* kCratePreviewFile = "ro-crate-preview.html";
inline constexpr const char* kCratePreviewFolder = "ro-crate-preview_files";
inline constexpr const char* kCrateManifestFile = "manifest-sha256.txt";
inline constexpr const char* kCrateFormatFile = "stratalux-crate.json";
inline constexpr int kCrateFormatVersion = 1;

struct CrateChecksum {
  int64_t bytes = 0;
  std::string sha256;  // 64 hex digits
};

// Files by their path in the crate, '/' between folders.
using CrateFiles = std::map<std::string, CrateChecksum>;

// Relative, of plain parts (neither "", "." nor ".."), no backslash, no control character, at most 1024 bytes.
[[nodiscard]] bool IsCratePath(std::string_view path);
// As an @id or a link names it: escaped but for unreserved characters and '/'; and back (empty where it is none).
[[nodiscard]] std::string UriOf(std::string_view path);
[[nodiscard]] std::string PathOfUri(std::string_view uri);
[[nodiscard]] std::string HtmlOf(std::string_view text);

// Of an ordinary file, read piece by piece; a link or a device is refused (kIntegrity) and never followed.
[[nodiscard]] Result<CrateChecksum> ChecksumOf(const std::filesystem::path& file);
// The whole of an ordinary file of at most `limit` bytes; kIntegrity, naming the file, for anything else.
[[nodiscard]] Result<std::string> ReadCrateFile(const std::filesystem::path& file, int64_t limit);

// "<sha256>  <path>" a line, sorted; the manifest itself is in none.
[[nodiscard]] std::string CrateManifestText(const CrateFiles& files);
// The files that lie in the crate, with their sizes and no checksum. kIntegrity for links, devices and names that are
// no crate paths. Our own marks of exports (db/privacy/export_marker.h) are no part of a crate and left out.
[[nodiscard]] Result<CrateFiles> ListCrateFiles(const std::filesystem::path& crate);
// The checksums of the manifest: kIntegrity for a line that is none, a name twice, a listed file that is not in
// `present`, or one of `present` that is not listed.
[[nodiscard]] Result<CrateFiles> ReadCrateManifest(const std::filesystem::path& crate, const CrateFiles& present);

}  // namespace stratalux::db
