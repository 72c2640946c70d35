// SPDX-License-Identifier: Apache-2.0
// What is derived from an encrypted visit must be sealed, and its key to whom it should be. Internal to db/care.
#pragma once

#include "db/care/verify.h"

namespace stratalux::db {

// A problem for each artifact and each listed fit that holds plain files, or files sealed for another session or place;
// kHeaders: by their headers, without the key. kDeep: or files that do not open, whatever hashes say of them; where the
// key is not here a note says so. Nothing is asked of sessions that are not encrypted, or show nobody.
void CheckSeals(const SessionStore& store, const SessionRow& session, VerifyDepth depth, VerifyReport& report);

// A problem for each sealed key beside the session that is cut, changed, another's, or of a reader that was taken away;
// a note for each reader of the store that it is not sealed to, though its key is here.
void CheckSealedKeys(const SessionStore& store, const SessionRow& session, VerifyReport& report);

}  // namespace stratalux::db
