// SPDX-License-Identifier: Apache-2.0
// Whole files as text, for tests that look at what a program wrote or give it something to read.
#pragma once

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

namespace stratalux {

// Empty where there is no such file.
[[nodiscard]] inline std::string ReadText(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

// Over what is there.
inline void WriteText(const std::filesystem::path& file, const std::string& text) {
  std::ofstream(file, std::ios::binary) << text;
}

}  // namespace stratalux
