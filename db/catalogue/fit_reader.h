// SPDX-License-Identifier: Apache-2.0
// The files of fits as whoever shows or copies them reads them. Those of an encrypted visit are sealed
// (db/segment/sealed_file.h) but for fit.json and metrics.json: figures of the index, for which nobody needs the key.
#pragma once

#include <filesystem>
#include <set>
#include <string>

#include "db/catalogue/session_store.h"
#include "db/segment/sealed_file.h"
#include "shared/base/unique_fd.h"

namespace stratalux::db {

// Of what is derived from a session's frames: artifacts, fits. Active for encrypted visits: other encrypted sessions
// show boards and targets, nobody's skin, and their fits are the calibrations that every later session needs.
[[nodiscard]] FileSeal SealOf(const std::filesystem::path& store, const SessionInfo& session,
                              const std::string& key_id);

// The same of a session by its id. kNotFound.
[[nodiscard]] Result<FileSeal> FindSeal(const SessionStore& store, const std::string& session_id);

// Of an encrypted visit's fit: {fit.json, metrics.json}.
[[nodiscard]] const std::set<std::string>& FitFilesLeftPlain();
// Within the session's folder: "fits/ID".
[[nodiscard]] std::string PlaceOfFit(const std::string& fit);
// Where a file of the fit may have been sealed for: the fit itself, or an artifact that it is made of.
[[nodiscard]] std::set<std::string> PlacesOfFitFile(const FitRow& fit, const std::string& name);

// A path that gives plain bytes for as long as this lives: the file's own, or one of memory alone.
struct ReadableFile {
  UniqueFd memory;
  std::filesystem::path path;
};

// Thread-bound.
class FitReader {
 public:
  // kIntegrity where a sealed fit has no record that says what it is made of.
  static Result<FitReader> Open(const std::filesystem::path& folder, const std::string& session_id, FileSeal seal);
  [[nodiscard]] bool sealed() const { return seal_.active(); }
  // `name`: below the fit's folder. kNotFound without the session's key; kIntegrity as FileSeal::Open.
  [[nodiscard]] Result<ReadableFile> Read(const std::string& name);
  // fit.json of a plain copy of the fit in `copy`: with sizes and hashes of the files there.
  [[nodiscard]] Result<std::string> RecordOfCopy(const std::filesystem::path& copy) const;

 private:
  FitReader(std::filesystem::path folder, FileSeal seal) : folder_(std::move(folder)), seal_(std::move(seal)) {}
  std::filesystem::path folder_;
  FileSeal seal_;
  FitRow fit_;  // of a sealed one
};

}  // namespace stratalux::db
