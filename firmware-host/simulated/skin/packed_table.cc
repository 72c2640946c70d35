// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/skin/packed_table.h"

#include <array>
#include <cstring>

#include <xxhash.h>
#include <zstd.h>

#include "db/base/durable_file.h"
#include "firmware-host/simulated/skin/skin_table.h"
#include "shared/base/read_file.h"

namespace stratalux::rig {
namespace {

constexpr size_t kMagicBytes = 8;             // with the version
constexpr uint64_t kMostCodes = 1ULL << 26U;  // twice the largest grid's

// Low bytes, then high bytes, of numbers that are small whatever their sign was.
std::vector<uint8_t> PlanesOf(const std::vector<uint16_t>& differences) {
  std::vector<uint8_t> planes(2 * differences.size());
  for (size_t k = 0; k < differences.size(); ++k) {
    const auto d = static_cast<int16_t>(differences[k]);
    const auto zigzag = static_cast<uint16_t>((d << 1) ^ (d >> 15));
    planes[k] = static_cast<uint8_t>(zigzag & 0xffU);
    planes[differences.size() + k] = static_cast<uint8_t>(zigzag >> 8);
  }
  return planes;
}

std::vector<uint16_t> DifferencesOf(const std::vector<uint8_t>& planes) {
  std::vector<uint16_t> differences(planes.size() / 2);
  for (size_t k = 0; k < differences.size(); ++k) {
    const unsigned zigzag = planes[k] | unsigned{planes[differences.size() + k]} << 8;
    differences[k] = static_cast<uint16_t>((zigzag >> 1) ^ (0U - (zigzag & 1U)));
  }
  return differences;
}

std::string Remedy(const PackedTableKind& kind) { return " (make one with " + std::string(kind.generate) + ")"; }

Status Damaged(const std::string& path, const PackedTableKind& kind, const std::string& how) {
  return Status::Integrity(std::string(kind.name) + " " + path + ": " + how + Remedy(kind));
}

}  // namespace

Status WritePackedTable(const std::string& path, const PackedTableKind& kind, const PackedTable& table, int level) {
  const std::vector<uint8_t> planes = PlanesOf(table.differences);
  std::vector<char> packed(ZSTD_compressBound(planes.size()));
  const size_t size = ZSTD_compress(packed.data(), packed.size(), planes.data(), planes.size(), level);
  if (ZSTD_isError(size) != 0) return Status::Failed(std::string("zstd: ") + ZSTD_getErrorName(size));
  std::string body(table.scatterings.size() * sizeof(double), '\0');
  std::memcpy(body.data(), table.scatterings.data(), body.size());
  body += table.manifest;
  body.append(packed.data(), size);
  const uint64_t header[] = {table.differences.size(), size, XXH3_64bits(body.data(), body.size()),
                             table.manifest.size(), table.scatterings.size()};
  std::string file(kind.magic);
  file += kind.version;
  file.append(reinterpret_cast<const char*>(header), sizeof header);
  return db::ReplaceFile(path, file + body);
}

Status OfAnotherGrid(const std::string& path, const PackedTableKind& kind) {
  return Damaged(path, kind, "truncated, or with another grid");
}

Result<PackedTable> ReadPackedTable(const std::string& path, const PackedTableKind& kind) {
  const std::string table_of = std::string(kind.name) + " " + path, what = table_of + ": ";
  const auto read = ReadFile(path, kMostPictureBytes);
  if (read.status().code() == StatusCode::kNotFound) return Status::NotFound(read.status().message() + Remedy(kind));
  SLX_RETURN_IF_ERROR(read.status().WithContext(table_of));
  const std::string& bytes = *read;
  if (bytes.size() < kMagicBytes || std::string_view(bytes.data(), kMagicBytes - 1) != kind.magic)
    return Damaged(path, kind, "not a " + std::string(kind.name));
  const char version = bytes[kMagicBytes - 1];
  if (version < '1' || version > '9') return Damaged(path, kind, "not a " + std::string(kind.name));
  const std::string versions = what + "version " + version + ", this program reads " + kind.version;
  if (version > kind.version) return Status(StatusCode::kNewerSchema, versions);
  if (version < kind.version) return Status::Usage(versions + Remedy(kind));
  uint64_t header[5] = {};
  constexpr size_t kBegin = kMagicBytes + sizeof header;
  const Status cut = OfAnotherGrid(path, kind);
  if (bytes.size() < kBegin) return cut;
  std::memcpy(header, bytes.data() + kMagicBytes, sizeof header);
  const auto [count, packed_bytes, hash, manifest_bytes, scatterings] = std::to_array(header);
  if (scatterings > uint64_t{SkinGrid::kMostScatterings} || packed_bytes > bytes.size() ||
      manifest_bytes > bytes.size())
    return cut;
  const size_t axis = scatterings * sizeof(double);
  if (kBegin + axis + manifest_bytes + packed_bytes != bytes.size()) return cut;
  const char* body = bytes.data() + kBegin;
  if (XXH3_64bits(body, bytes.size() - kBegin) != hash) return Damaged(path, kind, "hash mismatch");
  PackedTable table;
  table.scatterings.resize(scatterings);
  if (axis > 0) {
    std::memcpy(table.scatterings.data(), body, axis);
    SLX_RETURN_IF_ERROR(CheckScatterings(table.scatterings).WithContext(table_of));
  }
  table.manifest.assign(body + axis, manifest_bytes);
  const char* packed = body + axis + manifest_bytes;
  if (count > kMostCodes || ZSTD_getFrameContentSize(packed, packed_bytes) != 2 * count) return cut;
  std::vector<uint8_t> planes(2 * count);
  if (ZSTD_decompress(planes.data(), planes.size(), packed, packed_bytes) != planes.size())
    return Damaged(path, kind, "cannot be decompressed");
  table.differences = DifferencesOf(planes);
  return table;
}

}  // namespace stratalux::rig
