// SPDX-License-Identifier: Apache-2.0
#include "shared/image/png.h"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <string>

#include <png.h>

#include "shared/base/read_file.h"

namespace stratalux {
namespace {

// libpng's simplified API keeps its own error text and needs png_image_free on every path.
struct PngImage {
  png_image image{};
  PngImage() { image.version = PNG_IMAGE_VERSION; }
  ~PngImage() { png_image_free(&image); }
  PngImage(const PngImage&) = delete;
  PngImage& operator=(const PngImage&) = delete;
};

Status WriteFile(const std::filesystem::path& file, const std::vector<uint8_t>& bytes) {
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  out.flush();
  if (!out) return Status::Failed("cannot write " + file.string() + ": " + std::strerror(errno));
  return Status::Ok();
}

Result<std::vector<uint8_t>> Encode(const void* pixels, int width, int height, int channels, png_uint_32 linear_flag,
                                    PngEffort effort) {
  const bool alpha = channels == 2 || channels == 4;
  if (channels < 1 || channels > 4 || (alpha && linear_flag != 0))
    return Status::Failed("PNG takes 1 or 3 channels, of 8 bits alpha with them, not " + std::to_string(channels));
  PngImage png;
  png.image.width = static_cast<png_uint_32>(width);
  png.image.height = static_cast<png_uint_32>(height);
  png.image.flags = effort == PngEffort::kFast ? PNG_IMAGE_FLAG_FAST : 0U;
  png.image.format = (channels >= 3 ? PNG_FORMAT_FLAG_COLOR : 0U) | (alpha ? PNG_FORMAT_FLAG_ALPHA : 0U) | linear_flag;
  // Asked for the size it needs, libpng would compress all of it for the answer.
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(png.image);
  std::vector<uint8_t> bytes(size);
  if (png_image_write_to_memory(&png.image, bytes.data(), &size, 0, pixels, 0, nullptr) == 0)
    return Status::Failed(std::string("PNG: ") + png.image.message);
  bytes.resize(size);
  return bytes;
}

// Reads rows through the classic API, whose samples are untouched (the simplified one converts gamma).
struct Reader {
  png_structp png = nullptr;
  png_infop info = nullptr;
  const std::string* bytes = nullptr;
  size_t position = 0;
  std::string error;
  ~Reader() { png_destroy_read_struct(&png, &info, nullptr); }
};

void OnError(png_structp png, png_const_charp message) {
  static_cast<Reader*>(png_get_error_ptr(png))->error = message;
  png_longjmp(png, 1);
}
void OnWarning(png_structp, png_const_charp) {}
void OnRead(png_structp png, png_bytep out, png_size_t count) {
  auto* reader = static_cast<Reader*>(png_get_io_ptr(png));
  if (reader->position + count > reader->bytes->size()) png_error(png, "file is truncated");
  std::memcpy(out, reader->bytes->data() + reader->position, count);
  reader->position += count;
}

// Deflate makes at most 1032 bytes of one: a header that claims more pixels than the file can hold is a lie, and must
// not be given the memory it asks for.
constexpr size_t kDeflateAtMost = 1032;

// Returns false on error; between setjmp and the end no object with a destructor is created here.
bool Decode(Reader& reader, Image<uint16_t>& image, std::vector<uint8_t>& raw, std::vector<png_bytep>& rows,
            int& depth) {
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_set_read_fn(reader.png, &reader, OnRead);
  png_read_info(reader.png, reader.info);
  const size_t stored = png_get_rowbytes(reader.png, reader.info) * png_get_image_height(reader.png, reader.info);
  if (stored / kDeflateAtMost > reader.bytes->size()) png_error(reader.png, "file is truncated");
  if (uint64_t{png_get_image_width(reader.png, reader.info)} * png_get_image_height(reader.png, reader.info) >
      kMostImagePixels)
    png_error(reader.png, "more pixels than the 268435456 that are read");
  png_set_expand(reader.png);
  png_set_strip_alpha(reader.png);
  depth = png_get_bit_depth(reader.png, reader.info) == 16 ? 16 : 8;
  if (depth == 16) png_set_swap(reader.png);
  png_read_update_info(reader.png, reader.info);
  const int width = static_cast<int>(png_get_image_width(reader.png, reader.info));
  const int height = static_cast<int>(png_get_image_height(reader.png, reader.info));
  const size_t stride = png_get_rowbytes(reader.png, reader.info);
  image = Image<uint16_t>(width, height, png_get_channels(reader.png, reader.info));
  raw.resize(stride * static_cast<size_t>(height));
  rows.resize(static_cast<size_t>(height));
  for (int y = 0; y < height; ++y) rows[y] = raw.data() + stride * static_cast<size_t>(y);
  png_read_image(reader.png, rows.data());
  png_read_end(reader.png, nullptr);
  return true;
}

}  // namespace

Result<Image<uint16_t>> ReadPng(const std::filesystem::path& file, int* bit_depth) {
  SLX_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(file, kMostPictureBytes));
  if (bytes.size() < 8 || png_sig_cmp(reinterpret_cast<png_const_bytep>(bytes.data()), 0, 8) != 0)
    return Status::Usage(file.string() + ": not a PNG file");
  Reader reader;
  reader.bytes = &bytes;
  reader.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &reader, OnError, OnWarning);
  reader.info = reader.png != nullptr ? png_create_info_struct(reader.png) : nullptr;
  if (reader.info == nullptr) return Status::Failed(file.string() + ": libpng cannot start");
  Image<uint16_t> image;
  std::vector<uint8_t> raw;
  std::vector<png_bytep> rows;
  int depth = 0;
  if (!Decode(reader, image, raw, rows, depth)) return Status::Integrity(file.string() + ": " + reader.error);
  if (depth == 16) {
    std::memcpy(image.data(), raw.data(), image.size() * sizeof(uint16_t));
  } else {
    for (size_t i = 0; i < image.size(); ++i) image.data()[i] = raw[i];
  }
  if (bit_depth != nullptr) *bit_depth = depth;
  return image;
}

Result<std::vector<uint8_t>> EncodePng8(ImageView<const uint8_t> image, PngEffort effort) {
  return Encode(image.data(), image.width(), image.height(), image.channels(), 0, effort);
}

Status WritePng8(const std::filesystem::path& file, ImageView<const uint8_t> image) {
  SLX_ASSIGN_OR_RETURN(const auto bytes, EncodePng8(image));
  return WriteFile(file, bytes);
}

Status WritePng16(const std::filesystem::path& file, ImageView<const uint16_t> image) {
  SLX_ASSIGN_OR_RETURN(const auto bytes, Encode(image.data(), image.width(), image.height(), image.channels(),
                                                PNG_FORMAT_FLAG_LINEAR, PngEffort::kSmall));
  return WriteFile(file, bytes);
}

}  // namespace stratalux
