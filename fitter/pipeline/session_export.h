// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit export`: the surface of a session out of the store, as files in a folder.
//
// They are made in OUT/.stratalux-export.partial and get their names together once all are whole and synced; the record
// export.json goes first and comes last, so that a folder that has it has the files that it names. A failure, Ctrl-C or
// a full disk before that leaves the folder's earlier files as they were; what a kill leaves half made, the next export
// to that folder removes, and `forget`.
#pragma once

#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "fitter/stages/surface_export.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::fit {

struct SessionExportOptions {
  std::string store, session = "latest", fit;  // fit empty: the newest, else what a shape stage has made
  std::filesystem::path out;
  std::set<ExportFormat> formats;
};

struct SessionExportOutcome {
  std::string session, fit;  // fit empty: there was none
  bool sealed = false;       // the session is encrypted; the files are not
  std::string record;        // of export.json (docs/file-formats.md)
  std::vector<std::filesystem::path> files;
};

// kNotFound: no such session or fit, nothing reconstructed yet, or the key is not here. kIntegrity names the file of
// the store that is damaged. kBusy: another export writes to the folder.
[[nodiscard]] Result<SessionExportOutcome> ExportSession(const SessionExportOptions& options, Logger& logger);

}  // namespace stratalux::fit
