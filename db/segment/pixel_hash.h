// SPDX-License-Identifier: Apache-2.0
// What a frame shows, in 16 bytes that no codec changes: the proof that a decoded frame is the one that was captured,
// and the name by which fits know it.
//
// The samples, rows top to bottom, channels interleaved, each at its format's own width (mono8: 1 byte, mono12 and
// mono16: 2, f32: 4), little-endian: XXH3-128 of them in its canonical form; of an encrypted session keyed BLAKE2b-128
// under the session's key, so that who lacks the key cannot try out pictures on the hash.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "db/keys/key_store.h"
#include "db/segment/segment.h"
#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::db {

using PixelHash = std::array<uint8_t, 16>;  // all zero: not recorded, as in segments of before schema 5

// `key`: of the encrypted session, else null. Reentrant.
[[nodiscard]] PixelHash HashPixels(PixelFormat format, std::span<const uint16_t> samples, const SecretKey* key);
// Of samples that are bytes already: mono8, or float maps as they lie in memory.
[[nodiscard]] PixelHash HashPixels(std::span<const uint8_t> bytes, const SecretKey* key);

[[nodiscard]] PixelHash PixelHashOf(const FrameHeader& header);
void SetPixelHash(FrameHeader& header, const PixelHash& hash);
[[nodiscard]] bool HasPixelHash(const FrameHeader& header);

// kIntegrity where the header records another hash than that of the decoded image; kOk where it records none.
[[nodiscard]] Status CheckPixels(const FrameHeader& header, const Image<uint16_t>& image, const SecretKey* key);

}  // namespace stratalux::db
