// SPDX-License-Identifier: Apache-2.0
// The skin table's file: magic and version, header of five 64-bit numbers (entries, bytes packed, XXH3 of all behind
// the header, bytes of the manifest, scatterings), the scatterings (64-bit floats), manifest (JSON), packed entries.
// Version 2 had no scatterings: four numbers, the XXH3 of the packed bytes alone. Packed: of every two directions that
// reciprocity makes equal only the one with incidence <= exit; each entry as its difference from the neighbouring
// node's (the nodes share their photons, so these are small), low bytes, then high bytes, zstd.
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <memory>
#include <mutex>
#include <optional>

#include <sys/stat.h>
#include <xxhash.h>
#include <zstd.h>

#include "db/base/durable_file.h"
#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {
namespace {

using G = SkinGrid;
constexpr char kMagic[8] = {'S', 'L', 'X', 'S', 'K', 'I', 'N', '3'};
constexpr char kOldest = '2';

// Calls visit(first cell, first cell of the node that predicts it or SIZE_MAX) in the order of the file.
template <typename Visit>
void ForEachStoredKernel(int nodes, const Visit& visit) {
  constexpr int kE = static_cast<int>(G::kEpidermisMm.size()), kB = static_cast<int>(G::kBlood.size());
  for (int c = 0; c < kSkinChannels; ++c)
    for (int in = 0; in < G::kThetas; ++in)
      for (int out = in; out < G::kThetas; ++out)
        for (int az = 0; az < G::kAzimuths; ++az)
          for (int node = 0; node < nodes; ++node) {
            const size_t first = G::DirectionIndex(c, in, out, az) * nodes;
            const int skin = node % G::kNodes, of_scattering = node - skin;
            const int e = skin % kE, b = skin / kE % kB, m = skin / kE / kB;
            const int from = e > 0   ? node - 1
                             : b > 0 ? of_scattering + G::NodeIndex(m, b - 1, e)
                             : m > 0 ? of_scattering + G::NodeIndex(m - 1, b, e)
                                     : -1;
            visit((first + node) * G::kCells, from < 0 ? SIZE_MAX : (first + from) * G::kCells);
          }
}

// Entries of a file, a node.
constexpr size_t kStored = size_t{kSkinChannels} * (G::kThetas * (G::kThetas + 1) / 2) * G::kAzimuths * G::kCells;

uint16_t Predicted(const std::vector<uint16_t>& codes, size_t first, size_t from, int cell) {
  if (from != SIZE_MAX) return codes[from + cell];
  return cell > 0 ? codes[first + cell - 1] : uint16_t{0};
}

std::vector<uint8_t> ToPlanes(const std::vector<uint16_t>& codes, int nodes) {
  const size_t stored = kStored * nodes;
  std::vector<uint8_t> planes(2 * stored);
  size_t at = 0;
  ForEachStoredKernel(nodes, [&](size_t first, size_t from) {
    for (int k = 0; k < G::kCells; ++k, ++at) {
      const auto d = static_cast<int16_t>(codes[first + k] - Predicted(codes, first, from, k));
      const auto zigzag = static_cast<uint16_t>((d << 1) ^ (d >> 15));  // small of either sign: small
      planes[at] = static_cast<uint8_t>(zigzag & 0xffU);
      planes[stored + at] = static_cast<uint8_t>(zigzag >> 8);
    }
  });
  return planes;
}

std::vector<uint16_t> FromPlanes(const std::vector<uint8_t>& planes, int nodes) {
  const size_t stored = kStored * nodes;
  std::vector<uint16_t> codes(G::kDirections * nodes * G::kCells);
  size_t at = 0;
  ForEachStoredKernel(nodes, [&](size_t first, size_t from) {
    for (int k = 0; k < G::kCells; ++k, ++at) {
      const unsigned zigzag = planes[at] | unsigned{planes[stored + at]} << 8;
      const unsigned d = (zigzag >> 1) ^ (0U - (zigzag & 1U));
      codes[first + k] = static_cast<uint16_t>(Predicted(codes, first, from, k) + d);
    }
  });
  for (int c = 0; c < kSkinChannels; ++c)
    for (int in = 0; in < G::kThetas; ++in)
      for (int out = 0; out < in; ++out)
        for (int az = 0; az < G::kAzimuths; ++az)
          for (int node = 0; node < nodes; ++node) {
            const uint16_t* from = codes.data() + (G::DirectionIndex(c, out, in, az) * nodes + node) * G::kCells;
            uint16_t* to = codes.data() + (G::DirectionIndex(c, in, out, az) * nodes + node) * G::kCells;
            for (int k = 0; k < G::kCells; ++k) to[k] = from[k - k % G::kPolar + G::ReciprocalPsi(az, k % G::kPolar)];
          }
  return codes;
}

// Device, file, bytes, time of the last change; a file that is written anew in place changes the last of them.
using FileIdentity = std::optional<std::array<int64_t, 5>>;
FileIdentity IdentityOf(const std::string& path) {
  struct stat s {};
  if (stat(path.c_str(), &s) != 0) return std::nullopt;
  return std::array<int64_t, 5>{static_cast<int64_t>(s.st_dev), static_cast<int64_t>(s.st_ino), s.st_size,
                                s.st_mtim.tv_sec, s.st_mtim.tv_nsec};
}

}  // namespace

Status SkinTable::Save(const std::string& path, int level) const {
  const std::vector<uint8_t> planes = ToPlanes(contents_->codes, nodes());
  std::vector<char> packed(ZSTD_compressBound(planes.size()));
  const size_t size = ZSTD_compress(packed.data(), packed.size(), planes.data(), planes.size(), level);
  if (ZSTD_isError(size) != 0) return Status::Failed(std::string("zstd: ") + ZSTD_getErrorName(size));
  std::string body(scatterings().size() * sizeof(double), '\0');
  std::memcpy(body.data(), scatterings().data(), body.size());
  body += manifest();
  body.append(packed.data(), size);
  const uint64_t header[5] = {kStored * nodes(), size, XXH3_64bits(body.data(), body.size()), manifest().size(),
                              scatterings().size()};
  std::string file(kMagic, sizeof kMagic);
  file.append(reinterpret_cast<const char*>(header), sizeof header);
  return db::ReplaceFile(path, file + body);
}

Result<SkinTable> SkinTable::Load(const std::string& path) {
  static std::mutex mutex;
  static FileIdentity last_file;
  static std::shared_ptr<const Contents> last;
  const FileIdentity file = IdentityOf(path);
  const std::lock_guard lock(mutex);
  if (last == nullptr || !file.has_value() || file != last_file) {
    SLX_ASSIGN_OR_RETURN(last, Read(path));
    last_file = file;
  }
  return SkinTable(last);
}

Result<std::shared_ptr<const SkinTable::Contents>> SkinTable::Read(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in)
    return Status::NotFound("skin table " + path + ": " + std::strerror(errno) +
                            " (make one with `stratalux-skin-table generate`)");
  const std::vector<char> bytes((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  if (bytes.size() < sizeof kMagic || std::memcmp(bytes.data(), kMagic, sizeof kMagic - 1) != 0)
    return Status::Integrity("skin table " + path + ": not a skin table");
  const char version = bytes[7];
  if (version > kMagic[7])
    return Status(StatusCode::kNewerSchema, "skin table " + path + ": version " + version + ", this program reads " +
                                                kOldest + " and " + kMagic[7]);
  if (version < kOldest)
    return Status::Usage("skin table " + path + ": version " + version + ", this program reads " + kOldest + " and " +
                         kMagic[7] + " (make it again with `stratalux-skin-table generate`)");
  // Entries, bytes packed, hash, bytes of the manifest, scatterings.
  uint64_t header[5] = {};
  const size_t header_bytes = (version == kOldest ? 4 : 5) * sizeof(uint64_t), begin = sizeof kMagic + header_bytes;
  const Status cut = Status::Integrity("skin table " + path + ": truncated, or of another grid");
  if (bytes.size() < begin) return cut;
  std::memcpy(header, bytes.data() + sizeof kMagic, header_bytes);
  if (header[4] > uint64_t{G::kMostScatterings} || header[1] > bytes.size() || header[3] > bytes.size()) return cut;
  std::vector<double> scatterings(header[4]);
  const size_t axis = scatterings.size() * sizeof(double);
  if (begin + axis + header[3] + header[1] != bytes.size()) return cut;
  const char* body = bytes.data() + begin;
  const char* packed = body + axis + header[3];
  const char* hashed = version == kOldest ? packed : body;
  if (XXH3_64bits(hashed, static_cast<size_t>(bytes.data() + bytes.size() - hashed)) != header[2])
    return Status::Integrity("skin table " + path + ": hash mismatch");
  if (axis > 0) std::memcpy(scatterings.data(), body, axis);
  // Wax has one node and no axis; before there was an axis, skin scattered as tissue samples do.
  if (version == kOldest && header[0] != kStored) scatterings = {1.0};
  if (!scatterings.empty()) SLX_RETURN_IF_ERROR(CheckScatterings(scatterings).WithContext("skin table " + path));
  const int nodes = scatterings.empty() ? 1 : static_cast<int>(scatterings.size()) * G::kNodes;
  if (header[0] != kStored * nodes) return cut;
  std::vector<uint8_t> planes(2 * kStored * nodes);
  if (ZSTD_decompress(planes.data(), planes.size(), packed, header[1]) != planes.size())
    return Status::Integrity("skin table " + path + ": cannot be decompressed");
  auto contents = std::make_shared<Contents>();
  contents->nodes = nodes;
  contents->scatterings = std::move(scatterings);
  contents->manifest.assign(body + axis, header[3]);
  contents->codes = FromPlanes(planes, nodes);
  return std::shared_ptr<const Contents>(std::move(contents));
}

}  // namespace stratalux::rig
