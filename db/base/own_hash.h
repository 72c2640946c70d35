// SPDX-License-Identifier: Apache-2.0
// A JSON file that carries its own hash, as its last member (docs/file-formats.md, "manifest.json"):
//
//   ...,\n "hash": "<32 hex digits>"\n}\n
//
// XXH3-128, canonical, of the file's bytes without `,\n "hash": "<32 hex digits>"`: any changed byte is found. It tells
// accidents, not forgers, who can write the hash anew.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

#include "shared/base/result.h"

namespace stratalux::db {

// `json`: an object as nlohmann's dump(1) writes it, with at least one member; the result ends with a line feed.
[[nodiscard]] std::string WithOwnHash(const std::string& json);

enum class OwnHash { kNone, kRight, kWrong };
// kNone: the text has no member "hash" at all. kWrong also where one stands elsewhere than at the end.
[[nodiscard]] OwnHash CheckOwnHash(const std::string& text);

// XXH3-128, canonical, as 32 hex digits.
[[nodiscard]] std::string HashHex(std::span<const uint8_t> bytes);
[[nodiscard]] std::string HashHex(const std::string& bytes);

}  // namespace stratalux::db
