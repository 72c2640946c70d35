// SPDX-License-Identifier: Apache-2.0
// sessions/<id>/artifacts/<stage>-<key>/: what a stage of the fitter made, never changed afterwards, and its
// artifact.json (docs/file-formats.md, "Artifacts").
//
// The key is the XXH3-128 of the canonical JSON {stage, version, options, inputs, isa}, of an encrypted session with
// {seal}, too: of all that the bytes depend on. So an artifact of a key is what any run would make, and whoever finds
// one need not make it again.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "db/catalogue/recorded_files.h"
#include "shared/units/time.h"

namespace stratalux::db {

inline constexpr const char* kArtifactsFolder = "artifacts";  // of a session
inline constexpr const char* kArtifactRecordFile = "artifact.json";

// All that decides an artifact's bytes.
struct ArtifactIdentity {
  std::string stage;                          // lower-case letters and `_`
  int version = 1;                            // the stage's own: raised when its results change
  std::string options_json = "{}";            // those that the stage reads, an object
  std::map<std::string, std::string> inputs;  // name -> key of an artifact, or hash of what else it reads
  std::string isa;                            // instruction set of its kernels; empty: none that matters
  std::string seal = {};                      // id of the key its files are sealed under; empty: they are plain
  [[nodiscard]] std::string Key() const;      // 32 hex digits
  [[nodiscard]] std::string FolderName() const { return stage + "-" + Key(); }
};

struct ArtifactRecord {
  ArtifactIdentity identity;
  std::vector<RecordedFile> files;
  double seconds = 0.0, cpu_seconds = 0.0;  // of its making
  int64_t peak_rss_bytes = 0;               // of the process, up to its end
  std::string program;                      // version of the program that made it
  WallNs finished_wall;
};

[[nodiscard]] std::string ToJson(const ArtifactRecord& record);
// kNotFound: no artifact there; kIntegrity: the record is damaged or of another folder; kNewerSchema.
[[nodiscard]] Result<ArtifactRecord> ReadArtifactRecord(const std::filesystem::path& folder);
// The place within its session's folder that the artifact's file of that name is sealed for (db/segment/sealed_file.h).
[[nodiscard]] std::string PlaceOfArtifact(const std::string& folder_name, const std::string& file);
// The folder's files against the record; kIntegrity names the file.
Status CheckArtifactFiles(const std::filesystem::path& folder, const ArtifactRecord& record, FileDepth depth);

}  // namespace stratalux::db
