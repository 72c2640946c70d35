// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_frame_files.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <fstream>
#include <new>

#include "db/interchange/crate_files.h"
#include "db/interchange/image_file.h"
#include "shared/image/png.h"

namespace stratalux::db {
namespace {

struct Size {
  uint32_t width = 0, height = 0;
};

uint32_t LittleEndian(const uint8_t* bytes, int count) {
  uint32_t value = 0;
  for (int i = count - 1; i >= 0; --i) value = value << 8 | bytes[i];
  return value;
}
uint32_t BigEndian32(const uint8_t* b) {
  return uint32_t{b[0]} << 24 | uint32_t{b[1]} << 16 | uint32_t{b[2]} << 8 | uint32_t{b[3]};
}

// Width and height as the header of a PNG or of a classic little-endian TIFF states them; nothing is decoded.
Result<Size> StatedSize(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::array<uint8_t, 26> head{};
  in.read(reinterpret_cast<char*>(head.data()), head.size());
  if (in.gcount() != static_cast<std::streamsize>(head.size()))
    return Status::Integrity(file.string() + " is too short for an image");
  constexpr std::array<uint8_t, 8> kPng = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
  if (std::equal(kPng.begin(), kPng.end(), head.begin()))
    return Size{BigEndian32(head.data() + 16), BigEndian32(head.data() + 20)};
  if (std::memcmp(head.data(), "II*\0", 4) != 0) return Status::Integrity(file.string() + " is neither PNG nor TIFF");
  in.seekg(LittleEndian(head.data() + 4, 4));
  std::array<uint8_t, 2> count{};
  in.read(reinterpret_cast<char*>(count.data()), count.size());
  Size size;
  for (uint32_t i = 0; in.good() && i < LittleEndian(count.data(), 2); ++i) {
    std::array<uint8_t, 12> entry{};
    in.read(reinterpret_cast<char*>(entry.data()), entry.size());
    const uint32_t tag = LittleEndian(entry.data(), 2), type = LittleEndian(entry.data() + 2, 2);
    const uint32_t value = LittleEndian(entry.data() + 8, type == 3 ? 2 : 4);
    if (tag == 256) size.width = value;
    if (tag == 257) size.height = value;
  }
  if (!in.good()) return Status::Integrity(file.string() + ": damaged TIFF: its directory is cut off");
  return size;
}

}  // namespace

Status WriteCrateFrame(const std::filesystem::path& file, ExportFormat format, const Image<uint16_t>& image) {
  return format == ExportFormat::kPng ? WritePng16(file, image.view()) : WriteTiff16(file, image.view());
}

Result<Image<uint16_t>> ReadCrateFrame(const std::filesystem::path& file, const CrateFrame& frame) {
  const FrameRecord& r = frame.row.record;
  const auto wrong = [&file](const std::string& what) { return Status::Integrity(file.string() + ": " + what); };
  SLX_ASSIGN_OR_RETURN(const Size size, StatedSize(file));
  const std::string row_size = std::to_string(r.width) + "x" + std::to_string(r.height);
  if (size.width != static_cast<uint32_t>(r.width) || size.height != static_cast<uint32_t>(r.height))
    return wrong("is " + std::to_string(size.width) + "x" + std::to_string(size.height) + ", frames.csv says " +
                 row_size);
  std::error_code error;
  const uintmax_t bytes = std::filesystem::file_size(file, error);
  const uintmax_t samples = uintmax_t{size.width} * size.height * static_cast<uintmax_t>(r.channels);
  // Deflate's own limit is some thousand to one: a header of few bytes cannot ask for memory beyond that.
  if (error || bytes > 4 * samples + (1U << 20) || samples * 2 / 4096 > bytes)
    return wrong("has " + std::to_string(bytes) + " bytes, which is not the size of a frame of " + row_size);
  try {
    auto read = ReadImageFile(file);
    if (!read.ok()) return wrong(read.status().message());
    Image<uint16_t>& image = read->image;
    if (image.width() != r.width || image.height() != r.height || image.channels() != r.channels || read->bits != 16)
      return wrong("is not a frame of " + row_size + " with " + std::to_string(r.channels) + " channel(s) of 16 bits");
    const unsigned top = (1U << BitDepth(r.format)) - 1U;
    if (std::any_of(image.pixels().begin(), image.pixels().end(), [top](uint16_t v) { return v > top; }))
      return wrong("has samples above " + std::to_string(top) + ", the highest of its bit depth");
    if (CratePixelHash(r.format, image) != frame.pixel_hash)
      return wrong("its pixels do not match their hash in frames.csv");
    return std::move(image);
  } catch (const std::bad_alloc&) {
    return wrong("not enough memory for an image of " + row_size);
  }
}

Status WriteThumbnail(const std::filesystem::path& file, const Image<uint16_t>& image) {
  constexpr int kWidest = 320;
  // Whole blocks of even size, so that each holds all colours of the mosaic.
  const int block = image.width() <= kWidest ? 1 : 2 * ((image.width() + 2 * kWidest - 1) / (2 * kWidest));
  const int width = std::max(1, image.width() / block), height = std::max(1, image.height() / block);
  Image<uint32_t> sums(width, height);
  uint32_t most = 1;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      uint64_t sum = 0;
      for (int v = 0; v < block; ++v)
        for (int u = 0; u < block; ++u) {
          const int from_x = std::min(x * block + u, image.width() - 1);
          sum += image(from_x, std::min(y * block + v, image.height() - 1), 0);
        }
      sums(x, y) = static_cast<uint32_t>(sum / (static_cast<uint64_t>(block) * static_cast<uint64_t>(block)));
      most = std::max(most, sums(x, y));
    }
  Image<uint8_t> small(width, height);
  for (size_t i = 0; i < small.size(); ++i)
    small.data()[i] = static_cast<uint8_t>(uint64_t{sums.data()[i]} * 255 / most);
  return WritePng8(file, std::as_const(small).view());
}

}  // namespace stratalux::db
