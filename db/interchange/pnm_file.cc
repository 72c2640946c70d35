// SPDX-License-Identifier: Apache-2.0
// Netpbm greymaps and pixmaps: P2, P3 (text), P5, P6 (binary; two bytes a sample, high one first, above 255).
#include <cctype>
#include <optional>

#include "db/interchange/image_file.h"

namespace stratalux::db {
namespace {

class Reader {
 public:
  Reader(std::span<const uint8_t> bytes, const std::string& file) : bytes_(bytes), file_(file) {}

  [[nodiscard]] Status Damaged(const std::string& what) const {
    return Status::Integrity(file_ + ", offset " + std::to_string(at_) + ": " + what);
  }
  // The next decimal number, behind blanks and comments.
  Result<int64_t> Number(const char* of, int64_t lowest, int64_t highest) {
    SkipBlanks();
    if (at_ >= bytes_.size()) return Damaged(std::string("truncated: no ") + of);
    int64_t value = 0;
    const size_t start = at_;
    for (; at_ < bytes_.size() && std::isdigit(bytes_[at_]) != 0 && value <= highest; ++at_)
      value = value * 10 + (bytes_[at_] - '0');
    if (at_ == start) return Damaged(std::string("no number where ") + of + " should be");
    if (value < lowest || value > highest)
      return Damaged(std::string(of) + " is " + std::to_string(value) + ", allowed: " + std::to_string(lowest) +
                     " .. " + std::to_string(highest));
    return value;
  }
  // The one blank between header and binary samples.
  Status SkipOne() {
    if (at_ >= bytes_.size() || std::isspace(bytes_[at_]) == 0) return Damaged("no blank after the header");
    ++at_;
    return Status::Ok();
  }
  void Skip(size_t count) { at_ += count; }
  [[nodiscard]] std::span<const uint8_t> rest() const { return bytes_.subspan(at_); }

 private:
  void SkipBlanks() {
    while (at_ < bytes_.size()) {
      if (bytes_[at_] == '#') {
        while (at_ < bytes_.size() && bytes_[at_] != '\n') ++at_;
      } else if (std::isspace(bytes_[at_]) != 0) {
        ++at_;
      } else {
        return;
      }
    }
  }

  std::span<const uint8_t> bytes_;
  const std::string& file_;
  size_t at_ = 0;
};

Status ReadBinary(Reader& reader, int64_t top, ImageFile& read) {
  SLX_RETURN_IF_ERROR(reader.SkipOne());
  const auto samples = reader.rest();
  const size_t width = read.bits == 8 ? 1 : 2;
  for (size_t i = 0; i < read.image.size(); ++i) {
    const auto value = static_cast<uint16_t>(width == 1 ? samples[i] : (samples[2 * i] << 8) | samples[2 * i + 1]);
    if (value > top) {
      reader.Skip(i * width);
      return reader.Damaged("sample " + std::to_string(value) + " exceeds the maximum " + std::to_string(top));
    }
    read.image.data()[i] = value;
  }
  return Status::Ok();
}

}  // namespace

Result<ImageFile> DecodePnm(std::span<const uint8_t> bytes, const std::string& file) {
  Reader reader(bytes, file);
  const char kind = bytes.size() > 1 ? static_cast<char>(bytes[1]) : '?';
  if (kind != '2' && kind != '3' && kind != '5' && kind != '6')
    return Status::Usage(file + ": Netpbm P" + std::string(1, kind) + "; only P2, P3, P5 and P6 can be read");
  reader.Skip(2);
  SLX_ASSIGN_OR_RETURN(const int64_t width, reader.Number("the width", 1, kLargestSide));
  SLX_ASSIGN_OR_RETURN(const int64_t height, reader.Number("the height", 1, kLargestSide));
  SLX_ASSIGN_OR_RETURN(const int64_t top, reader.Number("the maximum", 1, 65535));
  SLX_RETURN_IF_ERROR(CheckPixelCount(static_cast<uint64_t>(width), static_cast<uint64_t>(height), file));
  const int channels = kind == '2' || kind == '5' ? 1 : 3;
  const bool text = kind == '2' || kind == '3';
  const int bits = top > 255 ? 16 : 8;
  // Text: a digit and a blank a sample; the last one needs no blank.
  const size_t samples = static_cast<size_t>(width) * static_cast<size_t>(height) * static_cast<size_t>(channels);
  const size_t needed = text ? samples * 2 : samples * static_cast<size_t>(bits / 8) + 1;
  if (reader.rest().size() < needed) {
    reader.Skip(reader.rest().size());
    return reader.Damaged("truncated: " + std::to_string(width) + "x" + std::to_string(height) + " pixels need more");
  }
  ImageFile read{Image<uint16_t>(static_cast<int>(width), static_cast<int>(height), channels), bits};
  if (!text) {
    SLX_RETURN_IF_ERROR(ReadBinary(reader, top, read));
    return read;
  }
  for (uint16_t& sample : read.image.pixels()) {
    SLX_ASSIGN_OR_RETURN(const int64_t value, reader.Number("a sample", 0, top));
    sample = static_cast<uint16_t>(value);
  }
  return read;
}

}  // namespace stratalux::db
