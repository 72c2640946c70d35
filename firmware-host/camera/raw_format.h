// SPDX-License-Identifier: Apache-2.0
// The raw formats of cameras by their FourCC, as V4L2 names them.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "firmware-host/camera/raw_unpack.h"

namespace stratalux::rig {

// "Y12 " and the like as a number, first letter lowest; a big-endian format has bit 31 set besides ("Y16 -BE").
[[nodiscard]] std::string FourccText(uint32_t fourcc);  // without trailing blanks: "Y12", "BG12", "Y16-BE"

// nullopt: a format that is not raw, or packed in a way of its own.
[[nodiscard]] std::optional<RawFormat> RawFormatOf(const std::string& fourcc_text);

// A raw format by libcamera's name for it ("SBGGR12"); `green_of_bgr`: no raw format at all.
struct StreamFormat {
  RawFormat raw;
  bool green_of_bgr = false;
};
[[nodiscard]] std::optional<StreamFormat> StreamFormatOf(const std::string& name);

}  // namespace stratalux::rig
