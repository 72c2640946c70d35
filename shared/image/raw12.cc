// SPDX-License-Identifier: Apache-2.0
#include "shared/image/raw12.h"

namespace stratalux {

void PackRaw12Row(const uint16_t* pixels, int width, uint8_t* bytes) {
  const int pairs = width / 2;
  for (int i = 0; i < pairs; ++i) {
    const unsigned a = pixels[2 * i];
    const unsigned b = pixels[2 * i + 1];
    bytes[3 * i] = static_cast<uint8_t>(a >> 4);
    bytes[3 * i + 1] = static_cast<uint8_t>(b >> 4);
    bytes[3 * i + 2] = static_cast<uint8_t>((b & 15U) << 4 | (a & 15U));
  }
  if (width % 2 == 0) return;
  bytes[3 * pairs] = static_cast<uint8_t>(pixels[width - 1] >> 4);
  bytes[3 * pairs + 1] = static_cast<uint8_t>(pixels[width - 1] & 15U);
}

void UnpackRaw12Row(const uint8_t* bytes, int width, uint16_t* pixels) {
  const int pairs = width / 2;
  for (int i = 0; i < pairs; ++i) {
    const unsigned low = bytes[3 * i + 2];
    pixels[2 * i] = static_cast<uint16_t>(bytes[3 * i] << 4 | (low & 15U));
    pixels[2 * i + 1] = static_cast<uint16_t>(bytes[3 * i + 1] << 4 | low >> 4);
  }
  if (width % 2 == 0) return;
  pixels[width - 1] = static_cast<uint16_t>(bytes[3 * pairs] << 4 | (bytes[3 * pairs + 1] & 15U));
}

}  // namespace stratalux
