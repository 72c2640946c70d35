// SPDX-License-Identifier: Apache-2.0
// What the kinds of change share. Internal to the mutators.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/db/mutants/mutators.h"

namespace stratalux::db {

[[nodiscard]] inline size_t Below(Random& random, size_t n) { return n == 0 ? 0 : random() % n; }
template <typename T>
const T& OneOf(const std::vector<T>& all, Random& random) {
  return all[Below(random, all.size())];
}

// A number (or bytes) at a place of a header.
struct Field {
  const char* name;
  size_t offset, size;
  bool real = false;
};
void ChangeField(const Field& field, uint8_t* at, Random& random);

// Those that MutableFiles() gives whose names end so.
[[nodiscard]] std::vector<std::filesystem::path> FilesOf(const std::filesystem::path& folder,
                                                         const std::string& ending);
// Of its own, or in the manifest, fit.json or artifact.json beside it.
[[nodiscard]] bool HasHash(const std::filesystem::path& file);
// Within the store.
[[nodiscard]] std::string Short(const std::filesystem::path& folder, const std::filesystem::path& file);
// The session's rows as its files now have them.
bool EnterAgain(const std::filesystem::path& store, const std::string& id);

// Any file: bits, bytes, length.
[[nodiscard]] Mutant ChangeBytes(const std::filesystem::path& folder, Random& random);
// Of a segment, hashes made anew up to some level: a header; a payload.
[[nodiscard]] Mutant ChangeHeader(const std::filesystem::path& folder, Random& random);
[[nodiscard]] Mutant ChangePayload(const std::filesystem::path& folder, Random& random);
// A sealed file, by one who knows the format and has no key; its record made anew or not. Another file where none is
// sealed.
[[nodiscard]] Mutant ChangeSealed(const std::filesystem::path& folder, Random& random);

}  // namespace stratalux::db
