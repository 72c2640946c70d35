// SPDX-License-Identifier: Apache-2.0
// Checks a session's segments against their hashes, the index and the plan.
#pragma once

#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "shared/base/log.h"

namespace stratalux::db {

struct VerifyReport {
  int64_t frames = 0;                 // and maps
  int64_t bytes = 0;                  // of their payloads; read only with kDeep
  std::vector<std::string> problems;  // damage: each names file and offset, or step
  std::vector<std::string> notes;     // not damage: unsealed segment of a failed session, steps without a good frame
};

enum class VerifyDepth {
  kHeaders,  // every header and footer, index, manifest, plan, proofs
  kDeep,     // every byte as well, and whether complementary pairs add up
};

struct VerifyOptions {
  VerifyDepth depth = VerifyDepth::kDeep;
  Progress* progress = nullptr;  // advanced by the frames of each segment
};

// Never fails on damage: it reports it. Payloads are read on all cores (STRATALUX_THREADS); the report does not depend
// on their number.
[[nodiscard]] Result<VerifyReport> VerifySession(const SessionStore& store, const SessionRow& session,
                                                 const VerifyOptions& options = {});

// What belongs to no session: the index as a database (kDeep: each of its pages), folders without a row, folders of
// forgotten sessions, files that no program of ours makes (notes).
[[nodiscard]] Result<VerifyReport> VerifyStore(const SessionStore& store, const VerifyOptions& options = {});

}  // namespace stratalux::db
