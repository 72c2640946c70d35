// SPDX-License-Identifier: Apache-2.0
// What becomes of a session whose writer is gone (docs/file-formats.md, "What the store promises"). Internal to db/.
//
// A session that had its manifest ends as the manifest says. Any other is cut behind its last acknowledged frame and
// ends `failed`. Each step is on the disk before the next, so that a second power cut finds the same session again.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/catalogue/session_index.h"

namespace stratalux::db {

// For people: what was cut, ended or found missing, one line each, naming session and file.
using RecoveryNotes = std::vector<std::string>;

// Every session left `recording`. Does nothing while a writer is alive; only tells where the disk cannot be written. A
// session that cannot be ended is a note, too: the others need not wait for it.
Result<RecoveryNotes> RecoverSessions(SessionIndex& index, const std::filesystem::path& store);
// What RecoverSessions would do; writes nothing.
Result<RecoveryNotes> FindUnfinished(SessionIndex& index, const std::filesystem::path& store);
// Cuts one session and ends it as failed. The caller holds the write lock. `doubtful`: names of segments whose last
// sync failed; of these only what was acknowledged stays, whatever memory shows.
Status AbandonSession(SessionIndex& index, const std::filesystem::path& store, const SessionRow& session,
                      const std::string& reason, const std::vector<std::string>& doubtful, RecoveryNotes& notes);

}  // namespace stratalux::db
