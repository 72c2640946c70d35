// SPDX-License-Identifier: Apache-2.0
// The files of an export, each written once. Internal to db/interchange.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/interchange/export.h"

namespace stratalux::db {

enum class Written { kNow, kBefore };

// Where `file` is there already it must hold the same pixels or bytes: kIntegrity otherwise, nothing is replaced.
[[nodiscard]] Result<Written> WriteFrameOnce(const std::filesystem::path& file, ExportFormat format, PixelFormat pixels,
                                             Image<uint16_t> image);
[[nodiscard]] Result<Written> WriteTextOnce(const std::filesystem::path& file, const std::string& text);

// "000012-gray-columns-bit-3-10.png".
[[nodiscard]] std::string ExportedName(const FrameRow& frame, ExportFormat format);
[[nodiscard]] std::string FramesJson(const std::vector<FrameRow>& frames, ExportFormat format);
// The import manifest that reads the folder's frames that count back; empty where no one manifest can (mixed depths,
// colour frames).
[[nodiscard]] std::string ImportToml(const SessionInfo& info, const std::vector<FrameRow>& frames, ExportFormat format);

// Makes the folder of an export of this session, or finds an interrupted one. kUsage for a folder with other files.
Status PrepareExportFolder(const std::filesystem::path& folder, const std::string& session_id);

}  // namespace stratalux::db
