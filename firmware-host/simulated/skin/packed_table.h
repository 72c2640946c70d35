// SPDX-License-Identifier: Apache-2.0
// The file that a table of the simulated skin lies in: magic and version (8 bytes), a header of five 64-bit numbers
// (codes, bytes packed, XXH3 of all behind the header, bytes of the manifest, scatterings), the scatterings (64-bit
// floats), the manifest (JSON), the packed codes. Packed: each code as its difference from what is expected of it, of
// either sign but small; low bytes, then high bytes, zstd. Of this machine's byte order.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::rig {

// What kind of table a file is to hold, for its magic and for messages.
struct PackedTableKind {
  std::string_view name;      // "skin table"
  std::string_view magic;     // seven characters
  char version = '1';         // the one that is read and written
  std::string_view generate;  // what makes one, for messages
};

struct PackedTable {
  std::vector<double> scatterings;  // the nodes of that axis; none where the tissue has no parameters
  std::string manifest;
  std::vector<uint16_t> differences;  // code less expected code, modulo 2^16
};

// `level`: zstd's. kFailed, and as of db::ReplaceFile.
[[nodiscard]] Status WritePackedTable(const std::string& path, const PackedTableKind& kind, const PackedTable& table,
                                      int level);

// kNotFound, kIntegrity (no such table, damaged), kNewerSchema, kUsage (an older version; scatterings that are no
// axis), each naming the file. How many differences there are is for the caller to check.
[[nodiscard]] Result<PackedTable> ReadPackedTable(const std::string& path, const PackedTableKind& kind);
[[nodiscard]] Status OfAnotherGrid(const std::string& path, const PackedTableKind& kind);

}  // namespace stratalux::rig
