// SPDX-License-Identifier: Apache-2.0
// Whole files as text, for tests that look at what a program wrote or give it something to read.
#pragma once

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

namespace stratalux {

// Empty where there is no such file.
[[nodiscard]] inline std::string ReadText(const std::filesystem::path& file) {
  const std::ifstream in(file, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();  // within the library: a test is compiled without optimisation, and takes seconds by iterators
  return std::move(text).str();
}

// Over what is there.
inline void WriteText(const std::filesystem::path& file, const std::string& text) {
  std::ofstream(file, std::ios::binary) << text;
}

}  // namespace stratalux
