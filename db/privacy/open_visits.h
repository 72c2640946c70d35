// SPDX-License-Identifier: Apache-2.0
// STORE/visits/<visit>.open: of whom a kiosk has sessions, or is about to, without having given the code that removes
// them. What a killed program leaves here belongs to nobody and is forgotten.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/base/file_lock.h"
#include "shared/base/result.h"

namespace stratalux::db {

// Durable when it returns: before the visit's first capture. `visit` names the file and tells nothing of the visitor,
// whose pseudonym is its content. kOk where there is one: another attempt of the visit.
Status NoteOpenVisit(const std::filesystem::path& store, const std::string& visit, const std::string& visitor);
// Wiped; kOk where there is none.
Status CloseVisit(const std::filesystem::path& store, const std::string& visit);

struct OpenVisit {
  std::string visit, visitor;  // `visitor` is empty where the note was torn: then no capture had begun
};
[[nodiscard]] Result<std::vector<OpenVisit>> OpenVisits(const std::filesystem::path& store);

// Whose visits they are: held by a kiosk from its first note, or since it found one, until it ends, since it forgets
// all notes that are not its own. Makes the folder. kBusy while another holds it.
Result<FileLock> LockVisits(const std::filesystem::path& store);
// Whether nobody holds it; writes nothing.
Status CheckVisitsAreFree(const std::filesystem::path& store);
[[nodiscard]] bool HasVisits(const std::filesystem::path& store);

}  // namespace stratalux::db
