// SPDX-License-Identifier: Apache-2.0
// The file of other subcutis, as the skin table's: magic and version, header of five 64-bit numbers (codes, bytes
// packed, XXH3 of all behind the header, bytes of the manifest, scatterings), the scatterings (64-bit floats), manifest
// (JSON), packed codes. Packed: each as its difference from the same code of the node before (nodes share their
// photons), low bytes, then high bytes, zstd.
#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>
#include <memory>

#include <xxhash.h>
#include <zstd.h>

#include "db/base/durable_file.h"
#include "firmware-host/simulated/skin/subcutis_table.h"

namespace stratalux::rig {
namespace {

constexpr char kSubcutisMagic[8] = {'S', 'L', 'X', 'S', 'U', 'B', 'C', '1'};
constexpr int kPackedLevel = 19;
constexpr size_t kNodeCodes = size_t{SubcutisGrid::kKinds} * SubcutisGrid::kKindCodes;

size_t CodesOf(size_t scatterings) { return size_t{kSkinChannels} * scatterings * SkinGrid::kNodes * kNodeCodes; }

std::vector<uint8_t> PlanesOf(std::span<const int16_t> codes) {
  std::vector<uint8_t> planes(2 * codes.size());
  for (size_t k = 0; k < codes.size(); ++k) {
    const int before = k >= kNodeCodes ? codes[k - kNodeCodes] : 0;
    const auto d = static_cast<int16_t>(codes[k] - before);
    const auto zigzag = static_cast<uint16_t>((d << 1) ^ (d >> 15));  // small of either sign: small
    planes[k] = static_cast<uint8_t>(zigzag & 0xffU);
    planes[codes.size() + k] = static_cast<uint8_t>(zigzag >> 8);
  }
  return planes;
}

std::vector<int16_t> CodesFrom(const std::vector<uint8_t>& planes) {
  std::vector<int16_t> codes(planes.size() / 2);
  for (size_t k = 0; k < codes.size(); ++k) {
    const unsigned zigzag = planes[k] | unsigned{planes[codes.size() + k]} << 8;
    const unsigned before = k >= kNodeCodes ? static_cast<uint16_t>(codes[k - kNodeCodes]) : 0U;
    codes[k] = static_cast<int16_t>(static_cast<uint16_t>(before + ((zigzag >> 1) ^ (0U - (zigzag & 1U)))));
  }
  return codes;
}

}  // namespace

Status SubcutisTable::Save(const std::string& path) const {
  const std::vector<uint8_t> planes = PlanesOf(codes());
  std::vector<char> packed(ZSTD_compressBound(planes.size()));
  const size_t size = ZSTD_compress(packed.data(), packed.size(), planes.data(), planes.size(), kPackedLevel);
  if (ZSTD_isError(size) != 0) return Status::Failed(std::string("zstd: ") + ZSTD_getErrorName(size));
  std::string body(scatterings().size() * sizeof(double), '\0');
  std::memcpy(body.data(), scatterings().data(), body.size());
  body += manifest();
  body.append(packed.data(), size);
  const uint64_t header[5] = {codes().size(), size, XXH3_64bits(body.data(), body.size()), manifest().size(),
                              scatterings().size()};
  std::string file(kSubcutisMagic, sizeof kSubcutisMagic);
  file.append(reinterpret_cast<const char*>(header), sizeof header);
  return db::ReplaceFile(path, file + body);
}

Result<SubcutisTable> SubcutisTable::Load(const std::string& path) {
  const std::string what = "table of other subcutis " + path + ": ";
  std::ifstream in(path, std::ios::binary);
  if (!in)
    return Status::NotFound(what + std::strerror(errno) +
                            " (make one with `stratalux-skin-table generate --subcutis`)");
  const std::vector<char> bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  if (bytes.size() < sizeof kSubcutisMagic || std::memcmp(bytes.data(), kSubcutisMagic, sizeof kSubcutisMagic - 1) != 0)
    return Status::Integrity(what + "not such a table");
  if (bytes[7] > kSubcutisMagic[7])
    return Status(StatusCode::kNewerSchema, what + "version " + bytes[7] + ", this program reads " + kSubcutisMagic[7]);
  uint64_t header[5] = {};
  constexpr size_t kBegin = sizeof kSubcutisMagic + sizeof header;
  const Status cut = Status::Integrity(what + "truncated, or of another grid");
  if (bytes[7] != kSubcutisMagic[7] || bytes.size() < kBegin) return cut;
  std::memcpy(header, bytes.data() + sizeof kSubcutisMagic, sizeof header);
  const auto [count, packed_bytes, hash, manifest_bytes, scatterings] = std::to_array(header);
  if (scatterings > uint64_t{SkinGrid::kMostScatterings} || packed_bytes > bytes.size() ||
      manifest_bytes > bytes.size())
    return cut;
  const size_t axis = scatterings * sizeof(double);
  if (kBegin + axis + manifest_bytes + packed_bytes != bytes.size() || count != CodesOf(scatterings)) return cut;
  const char* body = bytes.data() + kBegin;
  if (XXH3_64bits(body, bytes.size() - kBegin) != hash) return Status::Integrity(what + "hash mismatch");
  auto contents = std::make_shared<Contents>();
  contents->scatterings.resize(scatterings);
  if (axis > 0) std::memcpy(contents->scatterings.data(), body, axis);
  SLX_RETURN_IF_ERROR(CheckScatterings(contents->scatterings).WithContext("table of other subcutis " + path));
  contents->manifest.assign(body + axis, manifest_bytes);
  std::vector<uint8_t> planes(2 * count);
  if (ZSTD_decompress(planes.data(), planes.size(), body + axis + manifest_bytes, packed_bytes) != planes.size())
    return Status::Integrity(what + "cannot be decompressed");
  contents->codes = CodesFrom(planes);
  return SubcutisTable(std::shared_ptr<const Contents>(std::move(contents)));
}

}  // namespace stratalux::rig
