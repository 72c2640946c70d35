// SPDX-License-Identifier: Apache-2.0
// What left the store as files, so that `forget` finds it: FOLDER/.stratalux-export-<session>.json names the files that
// were written there, and nothing else of that folder is ever touched.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::db {

[[nodiscard]] std::filesystem::path ExportMarker(const std::filesystem::path& folder, const std::string& session_id);

// Written before the files themselves, so that an export that broke off is known, too. `files`: relative to the folder;
// those of an earlier export of the session to the same folder stay listed. kUsage for a name that leaves the folder.
Status WriteExportMarker(const std::filesystem::path& folder, const std::string& session_id,
                         const std::vector<std::string>& files);

// What every export calls before its first file: the row of the access log (access_log.h), then the marker.
Status BeginExport(const std::filesystem::path& store, const std::string& action, const std::string& session_id,
                   const std::filesystem::path& folder, const std::vector<std::string>& files);

// The sessions that have a marker in this folder.
[[nodiscard]] std::vector<std::string> ExportsIn(const std::filesystem::path& folder);

// "host:/absolute/folder", the detail of an export in the access log, and back: nullopt on another host.
[[nodiscard]] std::string ExportPlace(const std::filesystem::path& folder);
[[nodiscard]] std::optional<std::filesystem::path> LocalFolder(const std::string& place);

enum class ExportState { kDeleted, kElsewhere, kNotThere, kKept };
// "deleted", "on another machine", "no export there any more", "could not be deleted".
[[nodiscard]] const char* ToString(ExportState state);

// Deletes the files the marker names, then the marker, then the folder if nothing else is in it. Never
// kKept: what could not be deleted is an error that says why.
[[nodiscard]] Result<ExportState> RemoveExport(const std::string& place, const std::string& session_id);

}  // namespace stratalux::db
