// SPDX-License-Identifier: Apache-2.0
#include "shared/base/read_file.h"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <vector>

namespace stratalux {

Result<std::string> ReadFile(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) return Status::NotFound("cannot read " + file.string() + ": " + std::strerror(errno));
  std::string bytes;
  std::vector<char> block(size_t{1} << 16);
  // read(), not stream iterators: they throw where the operating system refuses, as it does for a folder.
  while (in.read(block.data(), static_cast<std::streamsize>(block.size())) || in.gcount() > 0)
    bytes.append(block.data(), static_cast<size_t>(in.gcount()));
  if (in.bad()) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
  return bytes;
}

}  // namespace stratalux
