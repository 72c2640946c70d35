// SPDX-License-Identifier: Apache-2.0
// A skin table that knows other subcutis than its own.
#include <cmath>
#include <mutex>

#include "firmware-host/simulated/skin/skin_table.h"
#include "firmware-host/simulated/skin/subcutis_table.h"
#include "shared/base/check.h"
#include "shared/base/parallel.h"
#include "shared/units/angle.h"

namespace stratalux::rig {

struct SkinTable::Subcutis {
  explicit Subcutis(SubcutisTable other) : table(std::move(other)) {}
  SubcutisTable table;
  mutable std::once_flag albedos_made;
  // Logarithm over that of the table's own subcutis.
  mutable std::array<NodeAlbedos, SubcutisGrid::kKinds> log_albedos{};
};

SkinTable SkinTable::With(SubcutisTable subcutis) const {
  SkinTable table = *this;
  table.subcutis_ = std::make_shared<const Subcutis>(std::move(subcutis));
  return table;
}

const SubcutisTable* SkinTable::subcutis() const { return subcutis_ ? &subcutis_->table : nullptr; }

float SkinTable::SubcutisLogAlbedo(int channel, const SkinParameters& parameters) const {
  if (parameters.UsualSubcutis() || scatterings().empty()) return 0.0F;
  SLX_CHECK(subcutis_ != nullptr);
  std::call_once(subcutis_->albedos_made, [&] {
    const NodeAlbedos& usual = LogAlbedos();
    for (int kind = 0; kind < SubcutisGrid::kKinds; ++kind)
      for (int c = 0; c < kSkinChannels; ++c) {
        std::vector<float>& logarithms = subcutis_->log_albedos[kind][c];
        logarithms.resize(static_cast<size_t>(nodes()));
        ParallelFor(nodes(), 8, [&](int64_t begin, int64_t end) {
          for (int64_t n = begin; n < end; ++n) {
            const SkinParameters skin = SubcutisGrid::WithKind(kind, NodeParameters(static_cast<int>(n)));
            logarithms[n] = static_cast<float>(std::log(Albedo(c, skin, RadFromDeg(30)))) - usual[c][n];
          }
        });
      }
  });
  const auto kinds = SubcutisGrid::KindsAround(parameters);
  float sum = 0.0F;
  for (const SkinNodeWeight& n : NodesAround(parameters))
    for (int kind = 0; kind < SubcutisGrid::kKinds; ++kind)
      sum += n.weight * kinds[kind] * subcutis_->log_albedos[kind][channel][n.node];
  return sum;
}

}  // namespace stratalux::rig
