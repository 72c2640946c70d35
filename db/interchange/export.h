// SPDX-License-Identifier: Apache-2.0
// Sessions as ordinary image files with their proof, for other programs and for the person they show
// (docs/file-formats.md, "Export").
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "db/catalogue/session_store.h"
#include "shared/base/log.h"

namespace stratalux::db {

enum class ExportFormat { kPng, kTiff };

struct ExportOptions {
  std::filesystem::path out;
  ExportFormat format = ExportFormat::kPng;
  std::optional<CapturePhase> phase;  // these frames only
  std::optional<int> projector;
};

struct ExportReport {
  int64_t sessions = 0;
  int64_t written = 0;  // frames
  int64_t kept = 0;     // frames that an interrupted export had written
};

// OUT/frames/NNNNNN-pattern.png (8-bit frames as 8 bits; 12-bit values << 4 and 16-bit ones in 16 bits),
// frames.json (the whole proof of each frame, its file and how its values lie), session.json (manifest with plan and
// calibration), import.toml (reads the folder back with `import`), .stratalux-export-<id>.json (all files, for
// `forget`). A row of the access log comes first. An export into the same folder goes on where it was interrupted;
// kUsage for a folder that holds anything else, kIntegrity for a file there that is not what would be written. Nothing
// is replaced.
[[nodiscard]] Result<ExportReport> ExportSession(const SessionStore& store, const SessionRow& session,
                                                 const ExportOptions& options, Logger& logger);

// One person's data: OUT/<session>/ as above with fits/ for each session of the pseudonym, visitor.json (consents),
// README.txt for that person, who may have withdrawn. kNotFound for an unknown pseudonym.
[[nodiscard]] Result<ExportReport> ExportVisitor(const SessionStore& store, const std::string& visitor,
                                                 const ExportOptions& options, Logger& logger);

}  // namespace stratalux::db
