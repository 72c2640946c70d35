// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdio>
#include <string>

#include <jpeglib.h>

#include "shared/image/image.h"

namespace stratalux {

// Ends the program where `bytes` are no JPEG: they are the test's own.
inline Image<uint8_t> DecodeJpeg(const std::string& bytes) {
  jpeg_decompress_struct jpeg{};
  jpeg_error_mgr errors{};
  jpeg.err = jpeg_std_error(&errors);
  jpeg_create_decompress(&jpeg);
  jpeg_mem_src(&jpeg, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
  jpeg_read_header(&jpeg, TRUE);
  jpeg_start_decompress(&jpeg);
  Image<uint8_t> image(static_cast<int>(jpeg.output_width), static_cast<int>(jpeg.output_height),
                       jpeg.output_components);
  while (jpeg.output_scanline < jpeg.output_height) {
    JSAMPLE* row = image.row(static_cast<int>(jpeg.output_scanline));
    jpeg_read_scanlines(&jpeg, &row, 1);
  }
  jpeg_finish_decompress(&jpeg);
  jpeg_destroy_decompress(&jpeg);
  return image;
}

}  // namespace stratalux
