// SPDX-License-Identifier: Apache-2.0
// A session's key, of its own each time.
#pragma once

#include <memory>
#include <utility>

#include <sodium.h>

#include "db/keys/key_store.h"

namespace stratalux::db {

[[nodiscard]] inline SessionKey RandomKey() {
  SessionKey key;
  auto secret = std::make_shared<SecretKey>();
  randombytes_buf(key.id.data(), key.id.size());
  randombytes_buf(secret->bytes.data(), secret->bytes.size());
  key.key = std::move(secret);
  return key;
}

}  // namespace stratalux::db
