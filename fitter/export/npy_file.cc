// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/npy_file.h"

#include <bit>
#include <cstring>
#include <fstream>
#include <string>

#include "shared/base/check.h"

namespace stratalux::fit {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr char kMagic[] = "\x93NUMPY\x01\x00";  // version 1.0
constexpr size_t kMagicBytes = 8, kAlignment = 64;

template <typename T>
Status Write(const std::filesystem::path& file, const char* type, std::span<const T> values, int64_t columns) {
  const auto count = static_cast<int64_t>(values.size());
  SLX_CHECK(columns == 0 || count % columns == 0);
  const std::string shape =
      columns == 0 ? std::to_string(count) + "," : std::to_string(count / columns) + ", " + std::to_string(columns);
  std::string header = std::string("{'descr': '") + type + "', 'fortran_order': False, 'shape': (" + shape + "), }";
  const size_t before = kMagicBytes + 2;
  header.append(kAlignment - (before + header.size() + 1) % kAlignment, ' ');
  header += '\n';
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out.write(kMagic, kMagicBytes);
  const auto length = static_cast<uint16_t>(header.size());
  out.write(reinterpret_cast<const char*>(&length), sizeof length);
  out.write(header.data(), static_cast<std::streamsize>(header.size()));
  out.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(values.size_bytes()));
  out.flush();
  return out ? Status::Ok() : Status::Failed("cannot write " + file.string());
}

// A file behind its header.
struct Values {
  std::ifstream in;
  int64_t count = 0;
};

template <typename T>
Result<Values> Open(const std::filesystem::path& file, const std::string& type) {
  Values values{std::ifstream(file, std::ios::binary | std::ios::ate)};
  std::ifstream& in = values.in;
  if (!in) return Status::NotFound("cannot read " + file.string());
  const auto size = static_cast<int64_t>(in.tellg());
  in.seekg(0);
  char magic[kMagicBytes];
  uint16_t length = 0;
  in.read(magic, kMagicBytes);
  in.read(reinterpret_cast<char*>(&length), sizeof length);
  std::string header(length, '\0');
  in.read(header.data(), length);
  const int64_t bytes = size - static_cast<int64_t>(kMagicBytes + sizeof length + length);
  if (!in || std::memcmp(magic, kMagic, kMagicBytes) != 0 || bytes < 0 ||
      bytes % static_cast<int64_t>(sizeof(T)) != 0 || header.find("'descr': '" + type + "'") == std::string::npos)
    return Status::Integrity(file.string() + " is not an array of " + type);
  values.count = bytes / static_cast<int64_t>(sizeof(T));
  return values;
}

template <typename T>
Result<std::vector<T>> ReadHere(Values& from, int64_t count, const std::filesystem::path& file) {
  std::vector<T> values(static_cast<size_t>(count));
  from.in.read(reinterpret_cast<char*>(values.data()), count * static_cast<int64_t>(sizeof(T)));
  if (!from.in) return Status::Failed("cannot read " + file.string());
  return values;
}

template <typename T>
Result<std::vector<T>> Read(const std::filesystem::path& file, const std::string& type) {
  SLX_ASSIGN_OR_RETURN(Values from, Open<T>(file, type));
  return ReadHere<T>(from, from.count, file);
}

}  // namespace

Status WriteNpy(const std::filesystem::path& file, std::span<const float> values, int64_t columns) {
  return Write(file, "<f4", values, columns);
}
Status WriteNpy(const std::filesystem::path& file, std::span<const int32_t> values, int64_t columns) {
  return Write(file, "<i4", values, columns);
}
Result<std::vector<float>> ReadNpyFloats(const std::filesystem::path& file) { return Read<float>(file, "<f4"); }
Result<std::vector<int32_t>> ReadNpyIntegers(const std::filesystem::path& file) { return Read<int32_t>(file, "<i4"); }

Result<std::vector<float>> ReadNpyFloats(const std::filesystem::path& file, int64_t first, int64_t count) {
  SLX_ASSIGN_OR_RETURN(Values from, Open<float>(file, "<f4"));
  if (first < 0 || count < 0 || first > from.count - count)
    return Status::Integrity(file.string() + " has " + std::to_string(from.count) + " values, fewer than are needed");
  from.in.seekg(first * static_cast<int64_t>(sizeof(float)), std::ios::cur);
  return ReadHere<float>(from, count, file);
}

}  // namespace stratalux::fit
