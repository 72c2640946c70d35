// SPDX-License-Identifier: Apache-2.0
// A secret key in a text file of its own (mode 0600): a line that says what it is, and one of 64 hexadecimal digits.
// Internal to db/keys.
#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "db/keys/locked_bytes.h"
#include "shared/base/result.h"

namespace stratalux::db {

struct SecretFileKind {
  const char* first_line;
  const char* name;            // "rig key"
  const char* made_by;         // what to do where there is none
  const char* never_replaced;  // why not
};

enum class SecretFileGuard {
  kOwnMode,  // nobody but its owner may read the file
  kFolder  // systemd's credentials: nobody else enters their folder, and an access list shows as a group that may read
};

// kNotFound with kind.made_by; kFailed where others may read the file; kIntegrity where it is damaged.
[[nodiscard]] Result<std::shared_ptr<const SecretKey>> ReadSecretFile(
    const std::filesystem::path& file, const SecretFileKind& kind, SecretFileGuard guard = SecretFileGuard::kOwnMode);
// Whole under its own name, or not there; kUsage, with kind.never_replaced, where something is there.
Status PlaceSecretFile(const std::filesystem::path& file, const SecretFileKind& kind, const SecretKey& key);

// Without the blanks and ends of line behind it.
[[nodiscard]] std::string Unspaced(std::string text);

}  // namespace stratalux::db
