// SPDX-License-Identifier: Apache-2.0
// ro-crate-metadata.json: the crate described in JSON-LD, flattened, with the terms of RO-Crate 1.3 alone. Internal to
// db/interchange.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/interchange/crate_export.h"
#include "db/interchange/crate_files.h"

namespace stratalux::db {

inline constexpr const char* kRoCrateContext = "https://w3id.org/ro/crate/1.3/context";
inline constexpr const char* kRoCrateSpecification = "https://w3id.org/ro/crate/1.3";

// What the description says of a session, beside its files.
struct DescribedSession {
  SessionInfo info;  // with the pseudonym of the crate
  int64_t frames = 0;
  std::string cfa;        // "rggb"; "" without frames
  int bit_depth = 0;      // of the samples
  int projectors = 0;     // of the calibration or the plan; 0: not known
  std::string thumbnail;  // path in the crate, "" for none
};

struct CrateDescription {
  std::string name, description, licence;
  WallNs published;
  CrateScope scope = CrateScope::kNotStated;
  std::vector<DescribedSession> sessions;
};

// Written entity by entity; `files`: all of the crate with their checksums, those of the preview and the manifest too.
Status WriteCrateMetadata(const std::filesystem::path& file, const CrateDescription& crate, const CrateFiles& files);
// ro-crate-preview.html: who looks at the folder sees what it holds; no script, nothing from elsewhere.
[[nodiscard]] std::string PreviewHtml(const CrateDescription& crate);

// What import asks of the description: one descriptor of an RO-Crate of 1.1 to 1.3, one entity an @id, parts without a
// circle, and each file it names in `files` with that size and checksum. kIntegrity names what is wrong; kNewerSchema
// for a later RO-Crate.
Status CheckCrateMetadata(const std::filesystem::path& file, const CrateFiles& files);

}  // namespace stratalux::db
