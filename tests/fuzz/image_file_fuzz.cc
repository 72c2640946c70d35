// SPDX-License-Identifier: Apache-2.0
// Pictures of other rigs that an import names: TIFF, TGA, PGM and PPM (PNG has a target of its own).
#include "db/interchange/image_file.h"
#include "tests/fuzz/target.h"

namespace {

void Check(const stratalux::Result<stratalux::db::ImageFile>& read) {
  if (!stratalux::fuzz::Judge(read)) return;
  const auto& image = read->image;
  if ((read->bits != 8 && read->bits != 16) || (image.channels() != 1 && image.channels() != 3) || image.empty())
    stratalux::fuzz::Fault("an image that no reader promises");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace stratalux;
  static const fuzz::InputFolder folder;
  Check(db::DecodeTiff({data, size}, "a.tiff"));
  Check(db::DecodeTga({data, size}, "a.tga"));
  Check(db::DecodePnm({data, size}, "a.pgm"));
  Check(db::ReadImageFile(folder.Put("a.tga", {data, size})));
  return 0;
}
