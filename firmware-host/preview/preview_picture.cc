// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/preview/preview_picture.h"

#include <algorithm>
#include <array>
#include <csetjmp>
#include <cstdio>
#include <cstdlib>

#include <jpeglib.h>

#include "shared/capture/reduced_picture.h"

namespace stratalux::rig {
namespace {

constexpr int kQuality = 80;
// More would show little but noise.
constexpr double kMostGain = 6.0;

Image<uint8_t> Grey(const Image<uint8_t>& picture) {
  if (picture.channels() == 1) return picture;
  Image<uint8_t> grey(picture.width(), picture.height());
  for (int y = 0; y < grey.height(); ++y)
    for (int x = 0; x < grey.width(); ++x)
      grey(x, y) = static_cast<uint8_t>((picture(x, y, 0) + picture(x, y, 1) + picture(x, y, 2)) / 3);
  return grey;
}

void Brighten(Image<uint8_t>& grey) {
  std::array<size_t, 256> counts{};
  for (const uint8_t value : grey.pixels()) ++counts[value];
  int bright = 255;
  for (size_t above = counts[255]; bright > 1 && above * 100 < grey.size();)
    above += counts[static_cast<size_t>(--bright)];
  const double gain = std::clamp(255.0 / bright, 1.0, kMostGain);
  for (uint8_t& value : grey.pixels()) value = static_cast<uint8_t>(std::min(255.0, gain * value));
}

// libjpeg's own way out is exit().
struct ErrorExit {
  jpeg_error_mgr manager{};
  std::jmp_buf back{};
  char text[JMSG_LENGTH_MAX] = "";
};
void Leave(j_common_ptr jpeg) {
  auto* exit = reinterpret_cast<ErrorExit*>(jpeg->err);
  jpeg->err->format_message(jpeg, exit->text);
  std::longjmp(exit->back, 1);
}

// Nothing in it needs a destructor, since longjmp would run none. False: `error` says why.
bool Encode(const uint8_t* pixels, int width, int height, unsigned char** bytes, unsigned long* size,
            ErrorExit& error) {
  jpeg_compress_struct jpeg{};
  jpeg.err = jpeg_std_error(&error.manager);
  error.manager.error_exit = Leave;
  if (setjmp(error.back) != 0) {
    jpeg_destroy_compress(&jpeg);
    return false;
  }
  jpeg_create_compress(&jpeg);
  jpeg_mem_dest(&jpeg, bytes, size);
  jpeg.image_width = static_cast<JDIMENSION>(width);
  jpeg.image_height = static_cast<JDIMENSION>(height);
  jpeg.input_components = 1;
  jpeg.in_color_space = JCS_GRAYSCALE;
  jpeg_set_defaults(&jpeg);
  jpeg_set_quality(&jpeg, kQuality, TRUE);
  jpeg_start_compress(&jpeg, TRUE);
  while (jpeg.next_scanline < jpeg.image_height) {
    auto* row = const_cast<JSAMPLE*>(pixels + static_cast<size_t>(jpeg.next_scanline) * static_cast<size_t>(width));
    jpeg_write_scanlines(&jpeg, &row, 1);
  }
  jpeg_finish_compress(&jpeg);
  jpeg_destroy_compress(&jpeg);
  return true;
}

}  // namespace

Result<std::string> PreviewPicture(const FrameRecord& record, ImageView<const uint16_t> frame, int limit_px) {
  if (frame.empty() || limit_px < 1) return Status::Usage("a preview of no pixels");
  Image<uint8_t> grey = Grey(ReducedPicture(record, frame, limit_px));
  Brighten(grey);
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  ErrorExit error;
  const bool made = Encode(grey.data(), grey.width(), grey.height(), &bytes, &size, error);
  std::string jpeg(reinterpret_cast<const char*>(bytes), made ? size : 0);
  std::free(bytes);
  if (!made) return Status::Failed(std::string("the preview's JPEG: ") + error.text);
  return jpeg;
}

}  // namespace stratalux::rig
