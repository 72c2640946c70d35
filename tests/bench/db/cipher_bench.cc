// SPDX-License-Identifier: Apache-2.0
// What encryption costs a frame of the full camera (1392 x 1042, 12 bit packed), on one core. The peers: the hash that
// every frame pays anyway (XXH3-128), and AES-256-GCM where the processor has its instructions.
#include <memory>
#include <vector>

#include <benchmark/benchmark.h>
#include <sodium.h>
#include <xxhash.h>

#include "db/segment/frame_cipher.h"

namespace stratalux::db {
namespace {

constexpr size_t kFrameBytes = size_t{1392} * 1042 * 3 / 2;

std::vector<uint8_t> Noise() {
  std::vector<uint8_t> bytes(kFrameBytes);
  randombytes_buf(bytes.data(), bytes.size());
  return bytes;
}

SessionKey AnyKey() {
  auto secret = std::make_shared<SecretKey>();
  randombytes_buf(secret->bytes.data(), secret->bytes.size());
  return {KeyId{1}, std::move(secret)};
}

void Report(benchmark::State& state) {
  const auto frames = static_cast<int64_t>(state.iterations());
  state.SetBytesProcessed(frames * static_cast<int64_t>(kFrameBytes));
  state.counters["frames/s"] = benchmark::Counter(static_cast<double>(frames), benchmark::Counter::kIsRate);
}

void BM_Seal(benchmark::State& state) {
  const auto plain = Noise();
  FrameSealer sealer("s000017-0badcafe", AnyKey());
  FrameHeader header{};
  for (auto _ : state) benchmark::DoNotOptimize(sealer.Seal(header, plain));
  Report(state);
}
BENCHMARK(BM_Seal)->Unit(benchmark::kMillisecond);

void BM_Hash(benchmark::State& state) {
  const auto plain = Noise();
  for (auto _ : state) benchmark::DoNotOptimize(XXH3_128bits(plain.data(), plain.size()));
  Report(state);
}
BENCHMARK(BM_Hash)->Unit(benchmark::kMillisecond);

void BM_SealAndHash(benchmark::State& state) {
  const auto plain = Noise();
  FrameSealer sealer("s000017-0badcafe", AnyKey());
  FrameHeader header{};
  for (auto _ : state) {
    const auto stored = sealer.Seal(header, plain);
    benchmark::DoNotOptimize(XXH3_128bits(stored->data(), stored->size()));
  }
  Report(state);
}
BENCHMARK(BM_SealAndHash)->Unit(benchmark::kMillisecond);

void BM_OpenWithXChaCha20(benchmark::State& state) {
  auto stored = Noise();
  unsigned char key[32] = {1}, nonce[24] = {2};
  std::vector<uint8_t> sealed(stored.size() + kCipherTagBytes), plain(stored.size());
  unsigned long long bytes = 0;
  crypto_aead_xchacha20poly1305_ietf_encrypt(sealed.data(), &bytes, stored.data(), stored.size(), nullptr, 0, nullptr,
                                             nonce, key);
  for (auto _ : state)
    benchmark::DoNotOptimize(crypto_aead_xchacha20poly1305_ietf_decrypt(plain.data(), &bytes, nullptr, sealed.data(),
                                                                        sealed.size(), nullptr, 0, nonce, key));
  Report(state);
}
BENCHMARK(BM_OpenWithXChaCha20)->Unit(benchmark::kMillisecond);

void BM_PeerAes256Gcm(benchmark::State& state) {
  if (crypto_aead_aes256gcm_is_available() == 0) {
    state.SkipWithError("this processor has no AES instructions");
    return;
  }
  const auto plain = Noise();
  unsigned char key[32] = {1}, nonce[12] = {2};
  std::vector<uint8_t> sealed(plain.size() + crypto_aead_aes256gcm_ABYTES);
  unsigned long long bytes = 0;
  for (auto _ : state)
    benchmark::DoNotOptimize(crypto_aead_aes256gcm_encrypt(sealed.data(), &bytes, plain.data(), plain.size(), nullptr,
                                                           0, nullptr, nonce, key));
  Report(state);
}
BENCHMARK(BM_PeerAes256Gcm)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace stratalux::db

int main(int argc, char** argv) {
  if (sodium_init() < 0) return 1;
  benchmark::Initialize(&argc, argv);
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
