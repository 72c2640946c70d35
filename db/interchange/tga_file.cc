// SPDX-License-Identifier: Apache-2.0
// Truevision TGA 2.0: types 2, 3 (uncompressed) and 10, 11 (run lengths); 8 bit grey, 24 and 32 bit colour.
#include <algorithm>

#include "db/interchange/image_file.h"

namespace stratalux::db {
namespace {

constexpr size_t kHeader = 18;

struct TgaLayout {
  int width = 0, height = 0;
  size_t sample_bytes = 0;  // of a pixel in the file
  bool runs = false, top_first = false, right_first = false;
  size_t data = 0;  // offset of the first pixel
};

Status Damaged(const std::string& file, size_t offset, const std::string& what) {
  return Status::Integrity(file + ", offset " + std::to_string(offset) + ": " + what);
}

Result<TgaLayout> ReadLayout(std::span<const uint8_t> b, const std::string& file) {
  if (b.size() < kHeader) return Damaged(file, b.size(), "truncated within the TGA header");
  auto word = [&b](size_t at) { return b[at] | (b[at + 1] << 8); };
  const int type = b[2], depth = b[16];
  const bool grey = (type == 3 || type == 11) && depth == 8;
  const bool colour = (type == 2 || type == 10) && (depth == 24 || depth == 32);
  if (b[1] != 0 || (!grey && !colour))
    return Status::Usage(file + ": TGA of type " + std::to_string(type) + " with " + std::to_string(depth) +
                         " bits; only 8 bit grey and 24 or 32 bit colour, plain or run-length encoded, can be read");
  TgaLayout layout;
  layout.width = word(12);
  layout.height = word(14);
  if (layout.width == 0 || layout.height == 0) return Damaged(file, 12, "size 0");
  SLX_RETURN_IF_ERROR(CheckPixelCount(static_cast<uint64_t>(layout.width), static_cast<uint64_t>(layout.height), file));
  layout.sample_bytes = static_cast<size_t>(depth / 8);
  layout.runs = type >= 10;
  layout.top_first = (b[17] & 0x20) != 0;
  layout.right_first = (b[17] & 0x10) != 0;
  layout.data = kHeader + b[0];
  if (layout.data > b.size()) return Damaged(file, b.size(), "truncated within the TGA id");
  return layout;
}

// The pixels one behind the other, `sample_bytes` each.
Result<std::vector<uint8_t>> Unpack(std::span<const uint8_t> b, const TgaLayout& layout, const std::string& file) {
  const size_t n = layout.sample_bytes;
  const size_t wanted = static_cast<size_t>(layout.width) * static_cast<size_t>(layout.height) * n;
  // A run packet makes at most 128 pixels of 1 + n bytes.
  if ((b.size() - layout.data) * (layout.runs ? 128 : 1) < wanted)
    return Damaged(
        file, b.size(),
        "truncated: too short for " + std::to_string(layout.width) + "x" + std::to_string(layout.height) + " pixels");
  if (!layout.runs)
    return std::vector<uint8_t>(b.begin() + static_cast<ptrdiff_t>(layout.data),
                                b.begin() + static_cast<ptrdiff_t>(layout.data + wanted));
  std::vector<uint8_t> pixels;
  pixels.reserve(wanted);
  size_t at = layout.data;
  while (pixels.size() < wanted) {
    if (at >= b.size()) return Damaged(file, at, "truncated within the pixels");
    const size_t count = (b[at] & 0x7FU) + 1U;
    const bool run = (b[at] & 0x80U) != 0;
    const size_t stored = run ? n : count * n;
    if (at + 1 + stored > b.size()) return Damaged(file, at, "truncated within a packet");
    if (pixels.size() + count * n > wanted) return Damaged(file, at, "a packet goes beyond the last pixel");
    const auto first = b.begin() + static_cast<ptrdiff_t>(at + 1);
    for (size_t i = 0; i < (run ? count : 1); ++i)
      pixels.insert(pixels.end(), first, first + static_cast<ptrdiff_t>(stored));
    at += 1 + stored;
  }
  return pixels;
}

}  // namespace

Result<ImageFile> DecodeTga(std::span<const uint8_t> bytes, const std::string& file) {
  SLX_ASSIGN_OR_RETURN(const TgaLayout layout, ReadLayout(bytes, file));
  SLX_ASSIGN_OR_RETURN(const auto pixels, Unpack(bytes, layout, file));
  const int channels = layout.sample_bytes == 1 ? 1 : 3;
  ImageFile read{Image<uint16_t>(layout.width, layout.height, channels), 8};
  for (int y = 0; y < layout.height; ++y)
    for (int x = 0; x < layout.width; ++x) {
      const int from_y = layout.top_first ? y : layout.height - 1 - y;
      const int from_x = layout.right_first ? layout.width - 1 - x : x;
      const size_t at =
          (static_cast<size_t>(from_y) * static_cast<size_t>(layout.width) + static_cast<size_t>(from_x)) *
          layout.sample_bytes;
      for (int c = 0; c < channels; ++c)  // stored as B, G, R
        read.image(x, y, c) = pixels[at + static_cast<size_t>(channels - 1 - c)];
    }
  return read;
}

}  // namespace stratalux::db
