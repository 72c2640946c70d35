// SPDX-License-Identifier: Apache-2.0
// frames.csv of a session in a crate: each frame with its whole proof (docs/file-formats.md, "Crates"). Internal to
// db/interchange.
#pragma once

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

struct CrateFrame {
  FrameRow row;            // offset and stored_bytes stay 0: they are the store's affair
  std::string file;        // relative to the session's folder: "frames/000012-gray-columns-bit-3-10.tif"
  std::string pixel_hash;  // XXH3-128 of the samples, 32 hex digits
};

// XXH3-128 of the samples, rows top to bottom, channels interleaved, one byte a sample of mono8 and two of the others,
// little-endian; in its canonical form, as hex digits.
[[nodiscard]] std::string CratePixelHash(PixelFormat format, const Image<uint16_t>& image);

// A line of a table with its end; texts are quoted where they must be (RFC 4180).
[[nodiscard]] std::string CsvLine(const std::vector<std::string>& cells);
// The shortest text that reads back as the same number.
[[nodiscard]] std::string ShortestText(double value);

[[nodiscard]] std::string CrateFramesHeader();
[[nodiscard]] std::string CrateFrameLine(const CrateFrame& frame);

// Reads frames.csv from its beginning to its end, one frame a call. kIntegrity with file:line for what no writer of
// ours makes; kNewerSchema for a table with columns that this program does not know.
class CrateFrameReader {
 public:
  [[nodiscard]] static Result<CrateFrameReader> Open(const std::filesystem::path& file);
  // False behind the last frame.
  [[nodiscard]] Result<bool> Next(CrateFrame& frame);

 private:
  CrateFrameReader() = default;
  [[nodiscard]] Result<bool> ReadLine(std::string& line);
  [[nodiscard]] Status Wrong(const std::string& what) const;
  std::ifstream in_;
  std::string file_;
  int64_t line_ = 0, last_frame_ = -1, segment_ = 0;
};

}  // namespace stratalux::db
