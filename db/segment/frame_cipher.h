// SPDX-License-Identifier: Apache-2.0
// Frames encrypted and authenticated, session by session: XChaCha20-Poly1305 of libsodium.
//
// The associated data are the session id and the frame header without its two hashes, so that an edited header, a
// header of another frame and a frame of another session fail to open. The header's payload hash is that of the stored
// bytes, so that `verify` needs no key.
//
// Nonce, 24 bytes: 16 random ones, drawn once for each writer, then its counter of frames, little-endian. A nonce used
// twice with one key would give away the difference of two frames and let frames be forged: the counter makes that
// impossible within a writer whatever the random numbers are, the prefix keeps apart the writers that may share a key
// (a session that is transcoded later starts counting at 0 again; two prefixes agree once in 2^64 writers).
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "db/keys/key_store.h"
#include "db/segment/segment.h"

namespace stratalux::db {

inline constexpr uint16_t kCipherXChaCha20Poly1305 = 1;  // FrameHeader::cipher
inline constexpr size_t kCipherTagBytes = 16;            // a payload is longer by so much

// Thread-bound.
class FrameSealer {
 public:
  FrameSealer(std::string session_id, SessionKey key);
  // Fills cipher, key id, nonce and payload_bytes of `header`, whose other fields must be final but for the hashes.
  [[nodiscard]] Result<std::vector<uint8_t>> Seal(FrameHeader& header, std::span<const uint8_t> plain);
  [[nodiscard]] const KeyId& key_id() const { return key_.id; }
  [[nodiscard]] const SecretKey& key() const { return *key_.key; }

 private:
  std::string session_id_;
  SessionKey key_;
  std::array<uint8_t, 16> prefix_{};
  uint64_t sealed_ = 0;
};

// Opens frames with the keys of one store; keeps the key it used last. Thread-bound.
class FrameOpener {
 public:
  explicit FrameOpener(std::filesystem::path store) : store_(std::move(store)) {}
  // The plain payload; `stored` itself where the frame is not encrypted. kNotFound without the key, kIntegrity where
  // the frame or its header is not what was sealed, kNewerSchema for a cipher of a later version.
  [[nodiscard]] Result<std::vector<uint8_t>> Open(const std::string& session_id, const FrameHeader& header,
                                                  std::vector<uint8_t> stored);
  // The key of the frame's session, until the next call; null where the frame is not encrypted. kNotFound, as above.
  [[nodiscard]] Result<const SecretKey*> KeyOf(const std::string& session_id, const FrameHeader& header);

 private:
  std::filesystem::path store_;
  SessionKey key_;
};

// All zero: not encrypted.
[[nodiscard]] KeyId KeyIdOf(const FrameHeader& header);

}  // namespace stratalux::db
