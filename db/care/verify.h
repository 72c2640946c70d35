// SPDX-License-Identifier: Apache-2.0
// Checks a session's segments against their hashes, the index and the plan.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "db/keys/rig_key.h"
#include "shared/base/log.h"

namespace stratalux::db {

struct VerifyReport {
  int64_t frames = 0;                  // and maps
  int64_t bytes = 0;                   // of their payloads; read only with kDeep
  std::vector<std::string> problems;   // damage: each names file and offset, or step
  std::vector<std::string> notes;      // not damage: unsealed segment of a failed session, steps without a good frame
  std::optional<PublicKey> signed_by;  // by a valid signature
};

enum class VerifyDepth {
  kHeaders,  // every header and footer, every row and column of the index, manifest, plan, proofs, signature
  kDeep,  // every byte as well: decoded, held against its pixel hash; whether complementary pairs add up; files of fits
          // and artifacts, of an encrypted visit opened
};

struct VerifyOptions {
  VerifyDepth depth = VerifyDepth::kDeep;
  Progress* progress = nullptr;             // advanced by the frames of each segment
  std::optional<PublicKey> signed_by = {};  // who must have signed; nothing: a signature that is there must be valid
};

// Rebuilds the session in memory and compares every column of its rows (db/care/row_comparison.h). Never fails on
// damage: it reports it. Payloads are read on all cores (STRATALUX_THREADS); the report does not depend
// on their number.
[[nodiscard]] Result<VerifyReport> VerifySession(const SessionStore& store, const SessionRow& session,
                                                 const VerifyOptions& options = {});

// What belongs to no session: the index as a database (kDeep: each of its pages), its schema, its rows that belong to
// no session, folders without a row, folders of forgotten sessions, files that no program of ours makes (notes).
[[nodiscard]] Result<VerifyReport> VerifyStore(const SessionStore& store, const VerifyOptions& options = {});

}  // namespace stratalux::db
