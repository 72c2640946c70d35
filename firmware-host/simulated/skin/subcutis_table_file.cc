// SPDX-License-Identifier: Apache-2.0
// The table of other subcutis in its file: what is expected of a code is that of the node before (nodes share their
// photons).
#include <memory>

#include "firmware-host/simulated/skin/packed_table.h"
#include "firmware-host/simulated/skin/subcutis_table.h"

namespace stratalux::rig {
namespace {

constexpr PackedTableKind kSubcutisKind = {"table of other subcutis", "SLXSUBC", '1',
                                           "`stratalux-skin-table generate --subcutis`"};
constexpr int kPackedLevel = 19;
constexpr size_t kNodeCodes = size_t{SubcutisGrid::kKinds} * SubcutisGrid::kKindCodes;

}  // namespace

Status SubcutisTable::Save(const std::string& path) const {
  std::vector<uint16_t> differences(codes().size());
  for (size_t k = 0; k < differences.size(); ++k)
    differences[k] = static_cast<uint16_t>(codes()[k] - (k >= kNodeCodes ? codes()[k - kNodeCodes] : 0));
  return WritePackedTable(path, kSubcutisKind, {scatterings(), manifest(), std::move(differences)}, kPackedLevel);
}

Result<SubcutisTable> SubcutisTable::Load(const std::string& path) {
  SLX_ASSIGN_OR_RETURN(PackedTable table, ReadPackedTable(path, kSubcutisKind));
  if (table.scatterings.empty() ||
      table.differences.size() != kSkinChannels * table.scatterings.size() * SkinGrid::kNodes * kNodeCodes)
    return OfAnotherGrid(path, kSubcutisKind);
  auto contents = std::make_shared<Contents>();
  contents->scatterings = std::move(table.scatterings);
  contents->manifest = std::move(table.manifest);
  std::vector<int16_t>& codes = contents->codes;
  for (size_t k = 0; k < table.differences.size(); ++k)
    codes.push_back(static_cast<int16_t>(table.differences[k] + (k >= kNodeCodes ? codes[k - kNodeCodes] : 0)));
  return SubcutisTable(std::shared_ptr<const Contents>(std::move(contents)));
}

}  // namespace stratalux::rig
