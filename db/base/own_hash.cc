// SPDX-License-Identifier: Apache-2.0
#include "db/base/own_hash.h"

#include <xxhash.h>

namespace stratalux::db {
namespace {

constexpr std::string_view kStart = ",\n \"hash\": \"", kEnd = "\"\n}\n", kBareEnd = "\n}\n";
constexpr size_t kDigits = 32;

}  // namespace

std::string HashHex(std::span<const uint8_t> bytes) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(bytes.data(), bytes.size()));
  constexpr const char* kHex = "0123456789abcdef";
  std::string text;
  for (const uint8_t byte : canonical.digest) {
    text += kHex[byte >> 4];
    text += kHex[byte & 15U];
  }
  return text;
}

std::string HashHex(const std::string& bytes) {
  return HashHex(std::span(reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()));
}

std::string WithOwnHash(const std::string& json) {
  const std::string bare = json + "\n";
  std::string text = bare.substr(0, bare.size() - kBareEnd.size());
  text += kStart;
  text += HashHex(bare);
  return text + std::string(kEnd);
}

OwnHash CheckOwnHash(const std::string& text) {
  const size_t tail = kStart.size() + kDigits + kEnd.size();
  if (text.size() <= tail || !text.ends_with(kEnd) || text.compare(text.size() - tail, kStart.size(), kStart) != 0)
    return text.find("\"hash\"") == std::string::npos ? OwnHash::kNone : OwnHash::kWrong;
  const std::string digits = text.substr(text.size() - kEnd.size() - kDigits, kDigits);
  const std::string bare = text.substr(0, text.size() - tail) + std::string(kBareEnd);
  return HashHex(bare) == digits ? OwnHash::kRight : OwnHash::kWrong;
}

}  // namespace stratalux::db
