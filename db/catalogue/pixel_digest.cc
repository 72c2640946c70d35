// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/pixel_digest.h"

#include <algorithm>
#include <iterator>

#include <xxhash.h>

#include "db/segment/pixel_hash.h"

namespace stratalux::db {
namespace {

std::string Hex(const PixelHash& hash) {
  uint8_t bytes[16];
  std::copy(hash.begin(), hash.end(), std::begin(bytes));
  return HashText(bytes);
}

}  // namespace

Result<std::string> PixelDigest(const SessionStore& store, const SessionRow& session,
                                const std::vector<FrameRow>& frames) {
  std::string all;
  for (const FrameRow& row : frames) {
    std::string hash = row.pixel_hash;
    if (hash.empty() && !session.key_id.empty()) hash = row.hash;
    if (hash.empty()) {
      SLX_ASSIGN_OR_RETURN(const auto image, store.ReadFrame(session.info.id, row));
      hash = Hex(HashPixels(row.record.format, image.pixels(), nullptr));
    }
    all += hash;
  }
  uint8_t digest[16];
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(all.data(), all.size()));
  std::copy(std::begin(canonical.digest), std::end(canonical.digest), digest);
  return HashText(digest);
}

}  // namespace stratalux::db
