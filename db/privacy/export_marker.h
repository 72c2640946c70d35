// SPDX-License-Identifier: Apache-2.0
// What left the store as files, so that `forget` finds it: FOLDER/.stratalux-export-<session>.json names the files that
// were written there, and nothing else of that folder is ever touched.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::db {

[[nodiscard]] std::filesystem::path ExportMarker(const std::filesystem::path& folder, const std::string& session_id);

// Whether the session's marker in the file's folder names it.
[[nodiscard]] bool IsInExport(const std::filesystem::path& file, const std::string& session_id);
// Written before the files themselves, so that an export that broke off is known, too. `files`: relative to the folder;
// those of an earlier export of the session to the same folder stay listed. kUsage for a name that leaves the folder.
Status WriteExportMarker(const std::filesystem::path& folder, const std::string& session_id,
                         const std::vector<std::string>& files);

// kVisitor: whom the session shows gets a copy, also after having withdrawn.
enum class ExportFor { kOthers, kVisitor };

// What every export calls before its first file: the row of the access log (access_log.h), then the marker. kUsage for
// a session that was forgotten, or whose consent was withdrawn; and, before anything is written, for a file that the
// marker of another session lists, but for the sessions `together` with which this one shares files of one export.
Status BeginExport(const std::filesystem::path& store, const std::string& action, const std::string& session_id,
                   const std::filesystem::path& folder, const std::vector<std::string>& files,
                   const std::vector<std::string>& together = {}, ExportFor whom = ExportFor::kOthers);
// And behind its last: of a session that was forgotten or withdrawn meanwhile `files` are deleted, and that is kUsage.
Status EndExport(const std::filesystem::path& store, const std::string& session_id, const std::filesystem::path& folder,
                 const std::vector<std::string>& files, ExportFor whom = ExportFor::kOthers);
// One of them that takes the place of an earlier one whole: `write` makes it beside, under a name that the marker lists
// as well.
Status WriteExportedFile(const std::filesystem::path& file,
                         const std::function<Status(const std::filesystem::path& beside)>& write);
// The one, `write`, and the other: also behind a failure, for that may be the forgetting's.
Status WriteExport(const std::filesystem::path& store, const std::string& action, const std::string& session_id,
                   const std::filesystem::path& folder, const std::vector<std::string>& files,
                   const std::function<Status()>& write, ExportFor whom = ExportFor::kOthers);

// The sessions that have a marker in this folder.
[[nodiscard]] std::vector<std::string> ExportsIn(const std::filesystem::path& folder);

// "host:/absolute/folder", the detail of an export in the access log, and back: nullopt on another host.
[[nodiscard]] std::string ExportPlace(const std::filesystem::path& folder);
[[nodiscard]] std::optional<std::filesystem::path> LocalFolder(const std::string& place);

// kNoFolder: not even the folder is there, which may lie on a disk that is not mounted.
enum class ExportState { kDeleted, kElsewhere, kNotThere, kNoFolder, kKept };
// "deleted", "on another machine", "no export there any more", "its folder is not there (a disk that is not mounted?)",
// "could not be deleted".
[[nodiscard]] const char* ToString(ExportState state);

// Whether the folder has the session's marker. kFailed where that cannot be seen: no permission, or a unit of systemd
// has another /tmp or no /home.
[[nodiscard]] Result<bool> IsExportThere(const std::filesystem::path& folder, const std::string& session_id);
// What is said of one whose marker is not there: kNotThere or kNoFolder.
[[nodiscard]] ExportState StateWithoutMarker(const std::filesystem::path& folder);
// The mount point that hides the folder from this process, as systemd makes it so: by the text of
// /proc/self/mountinfo. Empty: none does.
[[nodiscard]] std::string HiddenBy(const std::string& mountinfo, const std::filesystem::path& folder);

// Deletes the files the marker names, whole and half written, then the marker, then the folder if nothing else is in
// it. Never kKept: what could not be deleted, or looked for, is an error that says why.
[[nodiscard]] Result<ExportState> RemoveExport(const std::string& place, const std::string& session_id);

}  // namespace stratalux::db
