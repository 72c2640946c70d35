// SPDX-License-Identifier: Apache-2.0
// A fuzz target without a fuzzer: gives it every file of the named files and folders, and each of them cut short. Needs
// no clang. Ends by a crash, an uncaught exception or ctest's timeout where a reader breaks its law; the input is named
// before it is read.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <vector>

#include "tests/fuzz/target.h"

namespace {

namespace fs = std::filesystem;

constexpr size_t kCuts = 16;

std::vector<fs::path> FilesOf(int count, char** names) {
  std::vector<fs::path> files;
  for (int i = 1; i < count; ++i) {
    if (!fs::is_directory(names[i])) {
      files.emplace_back(names[i]);
      continue;
    }
    for (const auto& entry : fs::directory_iterator(names[i]))
      if (entry.is_regular_file()) files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace

int main(int count, char** names) {
  const auto files = FilesOf(count, names);
  if (files.empty()) {
    std::fprintf(stderr, "usage: %s FILE|FOLDER ...   (no input found)\n", names[0]);
    return 2;
  }
  for (const fs::path& file : files) {
    std::ifstream in(file, std::ios::binary);
    const std::vector<char> bytes((std::istreambuf_iterator<char>(in)), {});
    std::fprintf(stderr, "%s: %zu bytes\n", file.filename().c_str(), bytes.size());
    for (size_t cut = 0; cut <= kCuts; ++cut) {
      // A copy of its own: what is read behind the end is then found by the address sanitizer.
      const std::vector<char> part(bytes.begin(),
                                   bytes.begin() + static_cast<std::ptrdiff_t>(bytes.size() * cut / kCuts));
      LLVMFuzzerTestOneInput(reinterpret_cast<const uint8_t*>(part.data()), part.size());
    }
  }
  std::printf("%zu inputs, each also cut short at %zu places\n", files.size(), kCuts);
  return 0;
}
