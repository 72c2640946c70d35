// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/image_file.h"

#include <algorithm>
#include <cctype>

#include "shared/base/read_file.h"
#include "shared/image/png.h"

namespace stratalux::db {
namespace {

bool IsTga(const std::filesystem::path& file) {
  std::string end = file.extension().string();
  std::transform(end.begin(), end.end(), end.begin(), [](unsigned char c) { return std::tolower(c); });
  return end == ".tga";
}

}  // namespace

Status CheckPixelCount(uint64_t width, uint64_t height, const std::string& file) {
  if (width == 0 || height == 0 || width <= kMostImagePixels / height) return Status::Ok();
  return Status::Usage(file + ": " + std::to_string(width) + "x" + std::to_string(height) + " pixels, at most " +
                       std::to_string(kMostImagePixels) + " are read");
}

Result<ImageFile> ReadImageFile(const std::filesystem::path& file) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadFile(file, kMostPictureBytes));
  const auto bytes = std::span(reinterpret_cast<const uint8_t*>(text.data()), text.size());
  const std::string name = file.string();
  if (text.empty()) return Status::Integrity(name + ": empty, 0 bytes");
  if (text.starts_with("\x89PNG")) {
    ImageFile read;
    SLX_ASSIGN_OR_RETURN(read.image, ReadPng(file, &read.bits));
    return read;
  }
  if (text.starts_with("II*") || text.starts_with("MM") || text.starts_with("II+")) return DecodeTiff(bytes, name);
  if (text[0] == 'P' && text.size() > 1 && text[1] >= '1' && text[1] <= '7') return DecodePnm(bytes, name);
  if (IsTga(file)) return DecodeTga(bytes, name);
  return Status::Usage(name + ": neither PNG, TIFF, TGA (*.tga) nor PGM/PPM");
}

}  // namespace stratalux::db
