// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/pattern_memory_file.h"

#include <cmath>
#include <fstream>

#include "shared/base/check.h"

namespace stratalux::rig {
namespace {

void AppendU32(std::vector<uint8_t>& bytes, uint32_t value) {
  for (int k = 0; k < 4; ++k) bytes.push_back(static_cast<uint8_t>(value >> (8 * k)));
}

}  // namespace

int PlanesOf(const Pattern& pattern) { return pattern.HasLevels() ? 8 : 1; }

std::vector<uint8_t> PackPatterns(const std::vector<Pattern>& patterns, int planes, int width, int height) {
  const auto row_bytes = static_cast<size_t>((width + 7) / 8);
  const size_t plane_bytes = row_bytes * static_cast<size_t>(height);
  std::vector<uint8_t> bytes(patterns.size() * static_cast<size_t>(planes) * plane_bytes);
  for (size_t n = 0; n < patterns.size(); ++n) {
    SLX_CHECK(PlanesOf(patterns[n]) <= planes);
    const Image<float> picture = patterns[n].Render(width, height);
    for (int plane = 0; plane < planes; ++plane) {
      uint8_t* out = bytes.data() + (n * static_cast<size_t>(planes) + static_cast<size_t>(plane)) * plane_bytes;
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
          const long level = planes == 1 ? std::lround(picture(x, y)) : std::lround(255.0F * picture(x, y));
          const bool lit = ((level >> (planes - 1 - plane)) & 1) != 0;
          if (!lit) continue;
          uint8_t& byte = out[static_cast<size_t>(y) * row_bytes + static_cast<size_t>(x / 8)];
          byte = static_cast<uint8_t>(byte | 0x80U >> (x % 8));
        }
    }
  }
  return bytes;
}

Status WritePatternMemory(const std::filesystem::path& file, const std::vector<Pattern>& patterns, int planes,
                          int width, int height) {
  std::vector<uint8_t> header = {'S', 'L', 'X', 'P', 'A', 'T', 0, 1};
  AppendU32(header, static_cast<uint32_t>(width));
  AppendU32(header, static_cast<uint32_t>(height));
  AppendU32(header, static_cast<uint32_t>((width + 7) / 8));
  AppendU32(header, static_cast<uint32_t>(planes));
  AppendU32(header, static_cast<uint32_t>(patterns.size()));
  AppendU32(header, 0);
  const std::vector<uint8_t> bytes = PackPatterns(patterns, planes, width, height);
  std::ofstream out(file, std::ios::binary);
  out.write(reinterpret_cast<const char*>(header.data()), static_cast<std::streamsize>(header.size()));
  out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  out.close();
  return out ? Status::Ok() : Status::Failed("cannot write " + file.string());
}

}  // namespace stratalux::rig
