// SPDX-License-Identifier: Apache-2.0
// The skin table in its file: of every two directions that reciprocity makes equal only the one with incidence <= exit;
// what is expected of a code is the neighbouring node's (the nodes share their photons).
#include <array>
#include <memory>
#include <mutex>
#include <optional>

#include <sys/stat.h>

#include "firmware-host/simulated/skin/packed_table.h"
#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {
namespace {

using G = SkinGrid;
constexpr PackedTableKind kKind = {"skin table", "SLXSKIN", '3', "`stratalux-skin-table generate`, for wax with --wax"};

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

// Codes of a file, a node of skin.
constexpr size_t kStored = size_t{kSkinChannels} * (G::kThetas * (G::kThetas + 1) / 2) * G::kAzimuths * G::kCells;

uint16_t Predicted(const std::vector<uint16_t>& codes, size_t first, size_t from, int cell) {
  if (from != SIZE_MAX) return codes[from + cell];
  return cell > 0 ? codes[first + cell - 1] : uint16_t{0};
}

std::vector<uint16_t> DifferencesOf(const std::vector<uint16_t>& codes, int nodes) {
  std::vector<uint16_t> differences;
  differences.reserve(kStored * nodes);
  ForEachStoredKernel(nodes, [&](size_t first, size_t from) {
    for (int k = 0; k < G::kCells; ++k)
      differences.push_back(static_cast<uint16_t>(codes[first + k] - Predicted(codes, first, from, k)));
  });
  return differences;
}

std::vector<uint16_t> CodesOf(const std::vector<uint16_t>& differences, int nodes) {
  std::vector<uint16_t> codes(G::kDirections * nodes * G::kCells);
  size_t at = 0;
  ForEachStoredKernel(nodes, [&](size_t first, size_t from) {
    for (int k = 0; k < G::kCells; ++k, ++at)
      codes[first + k] = static_cast<uint16_t>(Predicted(codes, first, from, k) + differences[at]);
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
  return WritePackedTable(path, kKind, {scatterings(), manifest(), DifferencesOf(contents_->codes, nodes())}, level);
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

// Wax has one node and no axis.
Result<std::shared_ptr<const SkinTable::Contents>> SkinTable::Read(const std::string& path) {
  SLX_ASSIGN_OR_RETURN(PackedTable table, ReadPackedTable(path, kKind));
  auto contents = std::make_shared<Contents>();
  if (!table.scatterings.empty()) contents->nodes = static_cast<int>(table.scatterings.size()) * G::kNodes;
  if (table.differences.size() != kStored * contents->nodes) return OfAnotherGrid(path, kKind);
  contents->scatterings = std::move(table.scatterings);
  contents->manifest = std::move(table.manifest);
  contents->codes = CodesOf(table.differences, contents->nodes);
  return std::shared_ptr<const Contents>(std::move(contents));
}

}  // namespace stratalux::rig
