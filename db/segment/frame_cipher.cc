// SPDX-License-Identifier: Apache-2.0
#include "db/segment/frame_cipher.h"

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <utility>

#include <sodium.h>

#include "db/keys/session_key.h"

namespace stratalux::db {
namespace {

static_assert(crypto_aead_xchacha20poly1305_ietf_KEYBYTES == sizeof(SecretKey::bytes));
static_assert(crypto_aead_xchacha20poly1305_ietf_NPUBBYTES == sizeof(FrameHeader::nonce));
static_assert(crypto_aead_xchacha20poly1305_ietf_ABYTES == kCipherTagBytes);

struct AssociatedData {
  char session[40];
  FrameHeader header;
};
static_assert(sizeof(AssociatedData) == 360, "no padding: its bytes are what is authenticated");

AssociatedData DataOf(const std::string& session_id, const FrameHeader& header) {
  AssociatedData data{};
  std::memcpy(data.session, session_id.data(), std::min(session_id.size(), sizeof data.session));
  data.header = header;
  std::memset(data.header.payload_hash, 0, sizeof data.header.payload_hash);
  data.header.header_hash = 0;
  return data;
}

const unsigned char* BytesOf(const AssociatedData& data) { return reinterpret_cast<const unsigned char*>(&data); }

}  // namespace

KeyId KeyIdOf(const FrameHeader& header) {
  KeyId id{};
  std::copy(std::begin(header.key_id), std::end(header.key_id), id.begin());
  return id;
}

FrameSealer::FrameSealer(std::string session_id, SessionKey key)
    : session_id_(std::move(session_id)), key_(std::move(key)) {
  randombytes_buf(prefix_.data(), prefix_.size());
}

Result<std::vector<uint8_t>> FrameSealer::Seal(FrameHeader& header, std::span<const uint8_t> plain) {
  header.cipher = kCipherXChaCha20Poly1305;
  header.payload_bytes = plain.size() + kCipherTagBytes;
  std::copy(key_.id.begin(), key_.id.end(), std::begin(header.key_id));
  // Counted before it is used: also a frame whose writing fails has had its nonce.
  const uint64_t count = sealed_++;
  std::copy(prefix_.begin(), prefix_.end(), std::begin(header.nonce));
  std::memcpy(header.nonce + prefix_.size(), &count, sizeof count);
  const AssociatedData data = DataOf(session_id_, header);
  std::vector<uint8_t> stored(plain.size() + kCipherTagBytes);
  unsigned long long bytes = 0;
  if (crypto_aead_xchacha20poly1305_ietf_encrypt(stored.data(), &bytes, plain.data(), plain.size(), BytesOf(data),
                                                 sizeof data, nullptr, header.nonce, key_.key->bytes.data()) != 0)
    return Status::Failed("frame " + std::to_string(header.frame) + " could not be encrypted");
  return stored;
}

Result<std::vector<uint8_t>> FrameOpener::Open(const std::string& session_id, const FrameHeader& header,
                                               std::vector<uint8_t> stored) {
  if (header.cipher == 0) return stored;
  const std::string frame = "frame " + std::to_string(header.frame);
  if (header.cipher != kCipherXChaCha20Poly1305)
    return Status(StatusCode::kNewerSchema, frame + ": cipher " + std::to_string(header.cipher) +
                                                " is newer than this program; use a newer stratalux");
  SLX_ASSIGN_OR_RETURN(const SecretKey* key, KeyOf(session_id, header));
  const AssociatedData data = DataOf(session_id, header);
  unsigned long long bytes = 0;
  if (stored.size() < kCipherTagBytes ||
      crypto_aead_xchacha20poly1305_ietf_decrypt(stored.data(), &bytes, nullptr, stored.data(), stored.size(),
                                                 BytesOf(data), sizeof data, header.nonce, key->bytes.data()) != 0)
    return Status::Integrity(frame + " does not open with its key: the frame or its header was changed after capture");
  stored.resize(bytes);
  return stored;
}

Result<const SecretKey*> FrameOpener::KeyOf(const std::string& session_id, const FrameHeader& header) {
  if (header.cipher == 0) return static_cast<const SecretKey*>(nullptr);
  const KeyId id = KeyIdOf(header);
  if (key_.key == nullptr || key_.id != id) {
    SLX_ASSIGN_OR_RETURN(key_, FindKeyOf(store_, session_id, id));
  }
  return key_.key.get();
}

}  // namespace stratalux::db
