// SPDX-License-Identifier: Apache-2.0
// PNG files, as they lie there and with the checksum of each chunk made to fit.
#include <cstring>
#include <vector>

#include <zlib.h>

#include "shared/image/png.h"
#include "tests/fuzz/target.h"

namespace {

constexpr size_t kSignature = 8, kHead = 8, kSum = 4;  // bytes

uint32_t BigEndian(const uint8_t* at) {
  return uint32_t{at[0]} << 24 | uint32_t{at[1]} << 16 | uint32_t{at[2]} << 8 | uint32_t{at[3]};
}

void MakeChecksumsFit(std::vector<uint8_t>& bytes) {
  for (size_t at = kSignature; at + kHead + kSum <= bytes.size();) {
    const size_t length = BigEndian(bytes.data() + at);
    if (length > bytes.size() - at - kHead - kSum) return;
    const auto sum = static_cast<uint32_t>(crc32(0, bytes.data() + at + 4, static_cast<uInt>(length + 4)));
    for (size_t k = 0; k < kSum; ++k) bytes[at + kHead + length + k] = static_cast<uint8_t>(sum >> (24 - 8 * k));
    at += kHead + length + kSum;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace stratalux;
  static const fuzz::InputFolder folder;
  int bits = 0;
  (void)fuzz::Judge(ReadPng(folder.Put("a.png", {data, size}), &bits));
  std::vector<uint8_t> bytes(data, data + size);
  MakeChecksumsFit(bytes);
  const auto image = ReadPng(folder.Put("a.png", bytes), &bits);
  if (fuzz::Judge(image) && ((bits != 8 && bits != 16) || (image->channels() != 1 && image->channels() != 3)))
    fuzz::Fault("an image that no reader promises");
  return 0;
}
