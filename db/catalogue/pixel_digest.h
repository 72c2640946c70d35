// SPDX-License-Identifier: Apache-2.0
// What a session shows, in one name that no codec changes: by it fits know their input.
#pragma once

#include <string>
#include <vector>

#include "db/catalogue/session_store.h"
#include "shared/base/result.h"

namespace stratalux::db {

// XXH3-128, 32 hex digits, of the frames' pixel hashes in the order given. A frame of before pixel hashes is decoded
// and hashed here, so that a transcode, which records the hash, leaves the digest as it is; of an encrypted session,
// whose payloads no transcode touches, its payload hash counts instead, and no key is needed.
// kIntegrity for a frame that cannot be decoded. Reentrant for different stores.
[[nodiscard]] Result<std::string> PixelDigest(const SessionStore& store, const SessionRow& session,
                                              const std::vector<FrameRow>& frames);

}  // namespace stratalux::db
