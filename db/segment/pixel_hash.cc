// SPDX-License-Identifier: Apache-2.0
#include "db/segment/pixel_hash.h"

#include <algorithm>
#include <bit>
#include <iterator>
#include <string>
#include <vector>

#include <sodium.h>
#include <xxhash.h>

#include "shared/base/check.h"

namespace stratalux::db {
namespace {

static_assert(std::endian::native == std::endian::little, "samples are hashed as they lie in memory");
static_assert(crypto_generichash_BYTES_MIN <= sizeof(PixelHash));
static_assert(sizeof(SecretKey::bytes) >= crypto_generichash_KEYBYTES_MIN &&
              sizeof(SecretKey::bytes) <= crypto_generichash_KEYBYTES_MAX);

PixelHash Plain(std::span<const uint8_t> bytes) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, XXH3_128bits(bytes.data(), bytes.size()));
  PixelHash hash;
  std::copy(std::begin(canonical.digest), std::end(canonical.digest), hash.begin());
  return hash;
}

PixelHash Keyed(std::span<const uint8_t> bytes, const SecretKey& key) {
  PixelHash hash;
  SLX_CHECK(crypto_generichash(hash.data(), hash.size(), bytes.data(), bytes.size(), key.bytes.data(),
                               key.bytes.size()) == 0);
  return hash;
}

}  // namespace

PixelHash HashPixels(std::span<const uint8_t> bytes, const SecretKey* key) {
  return key == nullptr ? Plain(bytes) : Keyed(bytes, *key);
}

PixelHash HashPixels(PixelFormat format, std::span<const uint16_t> samples, const SecretKey* key) {
  if (format != PixelFormat::kMono8)
    return HashPixels({reinterpret_cast<const uint8_t*>(samples.data()), samples.size_bytes()}, key);
  std::vector<uint8_t> narrow(samples.size());  // 8-bit frames are widened when they are decoded
  std::transform(samples.begin(), samples.end(), narrow.begin(), [](uint16_t v) { return static_cast<uint8_t>(v); });
  return HashPixels(narrow, key);
}

PixelHash PixelHashOf(const FrameHeader& header) {
  PixelHash hash;
  std::copy(std::begin(header.pixel_hash), std::end(header.pixel_hash), hash.begin());
  return hash;
}

void SetPixelHash(FrameHeader& header, const PixelHash& hash) {
  std::copy(hash.begin(), hash.end(), std::begin(header.pixel_hash));
}

bool HasPixelHash(const FrameHeader& header) { return PixelHashOf(header) != PixelHash{}; }

Status CheckPixels(const FrameHeader& header, const Image<uint16_t>& image, const SecretKey* key) {
  if (!HasPixelHash(header)) return Status::Ok();
  if (HashPixels(static_cast<PixelFormat>(header.format), image.pixels(), key) == PixelHashOf(header))
    return Status::Ok();
  return Status::Integrity("the pixels of frame " + std::to_string(header.frame) +
                           " do not match the pixel hash in its header");
}

}  // namespace stratalux::db
