// SPDX-License-Identifier: Apache-2.0
// PNG files with their alpha, which ReadPng leaves out.
#pragma once

#include <cstdint>
#include <filesystem>

#include <gtest/gtest.h>
#include <png.h>

#include "shared/image/image.h"

namespace stratalux {

// Four channels, straight alpha, grey as three equal ones; of a file without alpha 255. A file that is none is a
// failure of the test.
inline Image<uint8_t> ReadPngRgba(const std::filesystem::path& file) {
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  EXPECT_NE(png_image_begin_read_from_file(&png, file.c_str()), 0) << file << ": " << png.message;
  png.format = PNG_FORMAT_RGBA;
  Image<uint8_t> image(static_cast<int>(png.width), static_cast<int>(png.height), 4);
  EXPECT_NE(png_image_finish_read(&png, nullptr, image.data(), 0, nullptr), 0) << file << ": " << png.message;
  return image;
}

}  // namespace stratalux
