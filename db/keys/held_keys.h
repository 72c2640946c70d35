// SPDX-License-Identifier: Apache-2.0
// Keys of sessions that this process was handed by the one that started it, through a pipe: on a machine of a cluster,
// or in a worker, which need the keys of their visitors and no others. They stand in memory alone.
#pragma once

#include <vector>

#include "db/keys/key_store.h"

namespace stratalux::db {

// Names the descriptor of a pipe with keys, in the environment of a program.
inline constexpr const char* kHeldKeysVariable = "STRATALUX_KEYS_FD";

// kUsage for anything but a pipe or a socket: no key lands in a file, or on a terminal.
Status CheckKeyPipe(int fd);
// kUsage as above.
Status WriteKeys(int fd, const std::vector<SessionKey>& keys);
// All of them, until the other side closes. kUsage as above; kIntegrity for bytes that are none, or not all.
[[nodiscard]] Result<std::vector<SessionKey>> ReadKeys(int fd);

// This process has them from now on. Thread-safe; so is the next.
void HoldKeys(const std::vector<SessionKey>& keys);
// One of those, or of $STRATALUX_KEYS_FD, which is read and closed when this is first asked. kNotFound; as ReadKeys
// where that could not be read.
[[nodiscard]] Result<SessionKey> FindHeldKey(const KeyId& id);

}  // namespace stratalux::db
