// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/db/image_file_peers.h"

#include <algorithm>
#include <cstdio>
#include <cstring>

#include <png.h>
#include <tiffio.h>

#include "shared/base/check.h"

namespace stratalux::bench {
namespace {

// A file that lies in memory, as libtiff wants to see one.
struct MemoryFile {
  std::vector<uint8_t>& bytes;
  size_t at = 0;
};
MemoryFile& FileOf(thandle_t handle) { return *static_cast<MemoryFile*>(handle); }
tmsize_t Read(thandle_t handle, void* data, tmsize_t size) {
  MemoryFile& f = FileOf(handle);
  const size_t count = std::min(static_cast<size_t>(size), f.bytes.size() - std::min(f.at, f.bytes.size()));
  std::memcpy(data, f.bytes.data() + f.at, count);
  f.at += count;
  return static_cast<tmsize_t>(count);
}
tmsize_t Write(thandle_t handle, void* data, tmsize_t size) {
  MemoryFile& f = FileOf(handle);
  if (f.bytes.size() < f.at + static_cast<size_t>(size)) f.bytes.resize(f.at + static_cast<size_t>(size));
  std::memcpy(f.bytes.data() + f.at, data, static_cast<size_t>(size));
  f.at += static_cast<size_t>(size);
  return size;
}
toff_t Seek(thandle_t handle, toff_t offset, int whence) {
  MemoryFile& f = FileOf(handle);
  f.at = whence == SEEK_SET ? offset : whence == SEEK_CUR ? f.at + offset : f.bytes.size() + offset;
  return f.at;
}
int Close(thandle_t) { return 0; }
toff_t Size(thandle_t handle) { return FileOf(handle).bytes.size(); }

}  // namespace

size_t EncodePng(ImageView<const uint16_t> pixels, std::vector<uint8_t>& file) {
  file.clear();
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  SLX_CHECK(png != nullptr && info != nullptr);
  png_set_write_fn(
      png, &file,
      [](png_structp p, png_bytep data, size_t size) {
        auto* out = static_cast<std::vector<uint8_t>*>(png_get_io_ptr(p));
        out->insert(out->end(), data, data + size);
      },
      [](png_structp) {});
  png_set_compression_level(png, 1);
  png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
  png_set_IHDR(png, info, static_cast<png_uint_32>(pixels.width()), static_cast<png_uint_32>(pixels.height()), 16,
               PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  png_set_swap(png);
  for (int y = 0; y < pixels.height(); ++y) png_write_row(png, reinterpret_cast<png_const_bytep>(pixels.row(y)));
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
  return file.size();
}

size_t EncodeTiff(ImageView<const uint16_t> pixels, TiffCompression compression, std::vector<uint8_t>& file) {
  file.clear();
  MemoryFile memory{file};
  TIFF* tiff = TIFFClientOpen("memory", "w", &memory, Read, Write, Seek, Close, Size, nullptr, nullptr);
  SLX_CHECK(tiff != nullptr);
  TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, static_cast<uint32_t>(pixels.width()));
  TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, static_cast<uint32_t>(pixels.height()));
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 16);
  TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 1);
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK);
  TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, 64U);
  const bool zstd = compression == TiffCompression::kZstd;
  SLX_CHECK(TIFFSetField(tiff, TIFFTAG_COMPRESSION, zstd ? COMPRESSION_ZSTD : COMPRESSION_ADOBE_DEFLATE) == 1);
  TIFFSetField(tiff, TIFFTAG_PREDICTOR, PREDICTOR_HORIZONTAL);
  TIFFSetField(tiff, zstd ? TIFFTAG_ZSTD_LEVEL : TIFFTAG_ZIPQUALITY, 1);
  std::vector<uint16_t> row(static_cast<size_t>(pixels.width()));  // libtiff predicts in place
  for (int y = 0; y < pixels.height(); ++y) {
    std::copy_n(pixels.row(y), row.size(), row.begin());
    SLX_CHECK(TIFFWriteScanline(tiff, row.data(), static_cast<uint32_t>(y), 0) == 1);
  }
  TIFFClose(tiff);
  return file.size();
}

}  // namespace stratalux::bench
