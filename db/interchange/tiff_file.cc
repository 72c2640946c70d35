// SPDX-License-Identifier: Apache-2.0
// TIFF through libtiff, from and to memory: the library's messages become ours, and nothing goes to stderr.
#include <cstdarg>
#include <cstdio>
#include <cstring>
#include <memory>
#include <vector>

#include <tiffio.h>

#include "db/base/durable_file.h"
#include "db/interchange/image_file.h"

namespace stratalux::db {
namespace {

// The file as libtiff sees it: bytes to read, or a buffer that grows.
struct Memory {
  std::span<const uint8_t> in;
  std::vector<uint8_t> out;
  uint64_t at = 0, furthest = 0;
  bool writes = false;
  std::string complaint;
  [[nodiscard]] uint64_t size() const { return writes ? out.size() : in.size(); }
};

tsize_t ReadSome(thandle_t handle, tdata_t data, tsize_t size) {
  auto& m = *static_cast<Memory*>(handle);
  if (m.at >= m.size()) return 0;
  const uint64_t count = std::min<uint64_t>(static_cast<uint64_t>(size), m.size() - m.at);
  std::memcpy(data, (m.writes ? m.out.data() : m.in.data()) + m.at, count);
  m.at += count;
  m.furthest = std::max(m.furthest, m.at);
  return static_cast<tsize_t>(count);
}
tsize_t WriteSome(thandle_t handle, tdata_t data, tsize_t size) {
  auto& m = *static_cast<Memory*>(handle);
  if (!m.writes || size <= 0) return 0;
  const uint64_t end = m.at + static_cast<uint64_t>(size);
  if (end > m.out.size()) m.out.resize(end);
  std::memcpy(m.out.data() + m.at, data, static_cast<size_t>(size));
  m.at = end;
  return size;
}
toff_t Seek(thandle_t handle, toff_t offset, int whence) {
  auto& m = *static_cast<Memory*>(handle);
  m.at = whence == SEEK_SET ? offset : whence == SEEK_CUR ? m.at + offset : m.size() + offset;
  return m.at;
}
int CloseNothing(thandle_t) { return 0; }
toff_t SizeOf(thandle_t handle) { return static_cast<Memory*>(handle)->size(); }
int MapNothing(thandle_t, tdata_t*, toff_t*) { return 0; }
void UnmapNothing(thandle_t, tdata_t, toff_t) {}

int Complain(TIFF*, void* user, const char* module, const char* format, va_list arguments) {
  auto& m = *static_cast<Memory*>(user);
  char text[256];
  std::vsnprintf(text, sizeof text, format, arguments);
  if (m.complaint.empty()) m.complaint = std::string(module == nullptr ? "TIFF" : module) + ": " + text;
  return 1;  // said
}
int Hush(TIFF*, void*, const char*, const char*, va_list) { return 1; }

using Tiff = std::unique_ptr<TIFF, decltype(&TIFFClose)>;

Tiff Open(Memory& memory, const char* mode) {
  TIFFOpenOptions* options = TIFFOpenOptionsAlloc();
  TIFFOpenOptionsSetErrorHandlerExtR(options, &Complain, &memory);
  TIFFOpenOptionsSetWarningHandlerExtR(options, &Hush, &memory);
  TIFFOpenOptionsSetMaxSingleMemAlloc(options, tmsize_t{1} << 30);
  Tiff tiff(TIFFClientOpenExt("memory", mode, &memory, ReadSome, WriteSome, Seek, CloseNothing, SizeOf, MapNothing,
                              UnmapNothing, options),
            &TIFFClose);
  TIFFOpenOptionsFree(options);
  return tiff;
}

Status Damaged(const Memory& m, const std::string& file) {
  return Status::Integrity(file + ", offset " + std::to_string(m.furthest) +
                           ": damaged TIFF: " + (m.complaint.empty() ? "truncated" : m.complaint));
}

struct TiffLayout {
  uint32_t width = 0, height = 0;
  uint16_t bits = 1, samples = 1, planar = PLANARCONFIG_CONTIG, photometric = PHOTOMETRIC_MINISBLACK, format = 1;
};

Result<TiffLayout> ReadTiffLayout(TIFF* tiff, const Memory& memory, const std::string& file) {
  TiffLayout l;
  if (TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &l.width) != 1 || TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &l.height) != 1)
    return Damaged(memory, file);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &l.bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &l.samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &l.planar);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &l.format);
  TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &l.photometric);
  const bool grey = l.photometric == PHOTOMETRIC_MINISBLACK && (l.samples == 1 || l.samples == 2);
  const bool colour = l.photometric == PHOTOMETRIC_RGB && (l.samples == 3 || l.samples == 4);
  if ((l.bits != 8 && l.bits != 16) || (!grey && !colour) || l.planar != PLANARCONFIG_CONTIG ||
      TIFFIsTiled(tiff) != 0 || l.format != SAMPLEFORMAT_UINT)
    return Status::Usage(file + ": TIFF with " + std::to_string(l.samples) + " samples of " + std::to_string(l.bits) +
                         " bits; only grey (0 = black) and RGB of 8 or 16 bits unsigned, in strips, can be read");
  if (l.width == 0 || l.height == 0 || l.width > kLargestSide || l.height > kLargestSide)
    return Status::Integrity(file + ": impossible size " + std::to_string(l.width) + "x" + std::to_string(l.height) +
                             ", allowed: 1 .. " + std::to_string(kLargestSide) + " a side");
  SLX_RETURN_IF_ERROR(CheckPixelCount(l.width, l.height, file));
  return l;
}

}  // namespace

Result<ImageFile> DecodeTiff(std::span<const uint8_t> bytes, const std::string& file) {
  Memory memory;
  memory.in = bytes;
  const Tiff tiff = Open(memory, "rm");
  if (!tiff) return Damaged(memory, file);
  SLX_ASSIGN_OR_RETURN(const TiffLayout l, ReadTiffLayout(tiff.get(), memory, file));
  // No compression of these makes more than some thousand bytes of one.
  const auto row_bytes = static_cast<uint64_t>(TIFFScanlineSize64(tiff.get()));
  if (row_bytes != uint64_t{l.width} * l.samples * (l.bits / 8U) || row_bytes * l.height / 4096 > bytes.size())
    return Status::Integrity(file + ": its size does not fit its " + std::to_string(bytes.size()) + " bytes");
  const int channels = l.samples >= 3 ? 3 : 1;
  ImageFile read{Image<uint16_t>(static_cast<int>(l.width), static_cast<int>(l.height), channels), l.bits};
  std::vector<uint8_t> row(row_bytes);
  for (uint32_t y = 0; y < l.height; ++y) {
    if (TIFFReadScanline(tiff.get(), row.data(), y, 0) != 1) return Damaged(memory, file);
    for (uint32_t x = 0; x < l.width; ++x)
      for (int c = 0; c < channels; ++c) {
        const size_t at = static_cast<size_t>(x) * l.samples + static_cast<size_t>(c);
        uint16_t value = row[l.bits == 8 ? at : 0];
        if (l.bits == 16) std::memcpy(&value, row.data() + 2 * at, 2);
        read.image(static_cast<int>(x), static_cast<int>(y), c) = value;
      }
  }
  if (!memory.complaint.empty()) return Damaged(memory, file);
  return read;
}

namespace {

Status Encode(const std::filesystem::path& file, const void* pixels, int width, int height, int channels, int bits,
              const std::string& description) {
  Memory memory;
  memory.writes = true;
  const auto row_bytes = static_cast<size_t>(width) * static_cast<size_t>(channels) * static_cast<size_t>(bits / 8);
  bool written = false;
  {
    const Tiff tiff = Open(memory, "wl");
    if (!tiff) return Status::Failed("cannot write " + file.string() + ": " + memory.complaint);
    TIFFSetField(tiff.get(), TIFFTAG_IMAGEWIDTH, static_cast<uint32_t>(width));
    TIFFSetField(tiff.get(), TIFFTAG_IMAGELENGTH, static_cast<uint32_t>(height));
    TIFFSetField(tiff.get(), TIFFTAG_BITSPERSAMPLE, bits);
    TIFFSetField(tiff.get(), TIFFTAG_SAMPLESPERPIXEL, channels);
    TIFFSetField(tiff.get(), TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
    TIFFSetField(tiff.get(), TIFFTAG_PHOTOMETRIC, channels == 1 ? PHOTOMETRIC_MINISBLACK : PHOTOMETRIC_RGB);
    TIFFSetField(tiff.get(), TIFFTAG_COMPRESSION, COMPRESSION_ADOBE_DEFLATE);
    TIFFSetField(tiff.get(), TIFFTAG_PREDICTOR, PREDICTOR_HORIZONTAL);
    TIFFSetField(tiff.get(), TIFFTAG_ZIPQUALITY, 1);
    if (!description.empty()) TIFFSetField(tiff.get(), TIFFTAG_IMAGEDESCRIPTION, description.c_str());
    TIFFSetField(tiff.get(), TIFFTAG_ROWSPERSTRIP, TIFFDefaultStripSize(tiff.get(), 0));
    written = true;
    std::vector<uint8_t> row(row_bytes);  // the predictor works in place
    for (int y = 0; y < height && written; ++y) {
      std::memcpy(row.data(), static_cast<const uint8_t*>(pixels) + static_cast<size_t>(y) * row_bytes, row_bytes);
      written = TIFFWriteScanline(tiff.get(), row.data(), static_cast<uint32_t>(y), 0) == 1;
    }
    written = written && TIFFFlush(tiff.get()) == 1;
  }
  if (!written || !memory.complaint.empty())
    return Status::Failed("cannot write " + file.string() + ": " + memory.complaint);
  return ReplaceFile(file, std::string(memory.out.begin(), memory.out.end()));
}

}  // namespace

Status WriteTiff8(const std::filesystem::path& file, ImageView<const uint8_t> image) {
  return Encode(file, image.data(), image.width(), image.height(), image.channels(), 8, "");
}
Status WriteTiff16(const std::filesystem::path& file, ImageView<const uint16_t> image, const std::string& description) {
  return Encode(file, image.data(), image.width(), image.height(), image.channels(), 16, description);
}

}  // namespace stratalux::db
