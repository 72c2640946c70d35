// SPDX-License-Identifier: Apache-2.0
// One line of a chain: its text, its hash, and what can be read of a damaged one (docs/file-formats.md, "Ledger").
// Internal to db/ledger.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "db/ledger/ledger.h"

namespace stratalux::db {

inline constexpr int64_t kLedgerSchema = 1;

// 64 hexadecimal digits of BLAKE2b-256.
[[nodiscard]] std::string LedgerHash(std::string_view bytes);
// What the first entry of a store's chain follows: the hash of the store's id, so that a chain under the name of
// another store is seen.
[[nodiscard]] std::string ChainStart(const std::string& store_id);

// Where the next entry of a chain goes.
struct ChainEnd {
  int64_t entries = 0;
  std::string hash;  // of the last
};

// Without the newline. Moves `end` on.
[[nodiscard]] std::string MakeLine(const LedgerEntry& entry, ChainEnd& end);

enum class LineState {
  kWhole,
  kDamaged,  // does not match its hash; `entry` may still be readable, and then binds (a certificate as a begun
             // forgetting: its words are nobody's)
  kNewer     // written as it should be by a later version
};

struct LedgerLine {
  LineState state = LineState::kDamaged;
  std::optional<LedgerEntry> entry;
  int64_t n = 0;
  std::string prev, hash;  // the line's own words; of a damaged one `hash` is that of its bytes
};
[[nodiscard]] LedgerLine ParseLine(std::string_view line);

}  // namespace stratalux::db
