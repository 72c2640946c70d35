// SPDX-License-Identifier: Apache-2.0
#include "db/care/complementary_pairs.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <tuple>

namespace stratalux::db {
namespace {

constexpr int kBlock = 8;
constexpr double kFloorDn = 8.0, kRelative = 0.06, kAllowedShare = 0.03;

struct Pair {
  const FrameRow* pattern = nullptr;
  const FrameRow* inverse = nullptr;
};
struct Projector {
  const FrameRow* white = nullptr;
  const FrameRow* black = nullptr;
  std::map<std::tuple<PatternAxis, int>, Pair> pairs;  // axis, bit
};

std::map<int, Projector> Group(const std::vector<FrameRow>& frames) {
  std::map<int, Projector> projectors;
  for (const FrameRow& f : frames) {
    const FrameRecord& r = f.record;
    if (r.projector < 0 || r.bracket != 0 || r.level_check == LevelCheck::kFailed) continue;
    Projector& p = projectors[r.projector];
    if (r.phase == CapturePhase::kReference && r.pattern.kind == PatternKind::kWhite) p.white = &f;
    if (r.phase == CapturePhase::kReference && r.pattern.kind == PatternKind::kBlack) p.black = &f;
    if (r.pattern.kind != PatternKind::kGray || r.pattern.bit + 4 >= r.pattern.bits) continue;
    Pair& pair = p.pairs[{r.pattern.axis, r.pattern.bit}];
    (r.pattern.inverse ? pair.inverse : pair.pattern) = &f;
  }
  return projectors;
}

struct Blocks {
  std::vector<float> mean;
  std::vector<uint8_t> saturated;
};

Blocks BlocksOf(const Image<uint16_t>& image, PixelFormat format) {
  const int columns = image.width() / kBlock, rows = image.height() / kBlock;
  const int top = (1 << BitDepth(format)) - 1;
  Blocks blocks{std::vector<float>(static_cast<size_t>(columns) * rows), {}};
  blocks.saturated.resize(blocks.mean.size());
  for (int by = 0; by < rows; ++by)
    for (int bx = 0; bx < columns; ++bx) {
      uint32_t sum = 0;
      uint16_t highest = 0;
      for (int y = by * kBlock; y < (by + 1) * kBlock; ++y)
        for (int x = bx * kBlock; x < (bx + 1) * kBlock; ++x) {
          sum += image(x, y);
          highest = std::max(highest, image(x, y));
        }
      const size_t at = static_cast<size_t>(by) * columns + bx;
      blocks.mean[at] = static_cast<float>(sum) / (kBlock * kBlock);
      blocks.saturated[at] = highest >= top ? 1 : 0;
    }
  return blocks;
}

// Share of blocks that do not add up; nullopt where the frames cannot be compared.
std::optional<double> ShareOff(const Blocks& pattern, const Blocks& inverse, const Blocks& white, const Blocks& black) {
  const size_t count = white.mean.size();
  if (count == 0 || pattern.mean.size() != count || inverse.mean.size() != count || black.mean.size() != count)
    return std::nullopt;
  size_t compared = 0, off = 0;
  for (size_t i = 0; i < count; ++i) {
    if (pattern.saturated[i] || inverse.saturated[i] || white.saturated[i]) continue;
    ++compared;
    const double residual = pattern.mean[i] + inverse.mean[i] - white.mean[i] - black.mean[i];
    off += std::abs(residual) > kFloorDn + kRelative * std::abs(white.mean[i] - black.mean[i]);
  }
  if (compared == 0) return std::nullopt;
  return static_cast<double>(off) / static_cast<double>(compared);
}

// Of the complete pairs of an axis the one that `turn` picks: over the projectors every bit has its turn.
const Pair* Choose(const Projector& projector, PatternAxis axis, int turn) {
  std::vector<const Pair*> whole;
  for (const auto& [key, pair] : projector.pairs)
    if (std::get<0>(key) == axis && pair.pattern != nullptr && pair.inverse != nullptr) whole.push_back(&pair);
  return whole.empty() ? nullptr : whole[static_cast<size_t>(turn) % whole.size()];
}

}  // namespace

std::vector<std::string> CheckComplementaryPairs(const std::vector<FrameRow>& frames, const FrameLoader& load) {
  std::vector<std::string> complaints;
  int turn = 0;
  for (const auto& [number, projector] : Group(frames)) {
    if (projector.white == nullptr || projector.black == nullptr || turn >= 16) continue;
    // A frame that cannot be read is the hash check's business.
    auto blocks = [&load](const FrameRow& f) -> Blocks {
      const auto image = load(f);
      return image.ok() && image->channels() == 1 ? BlocksOf(*image, f.record.format) : Blocks{};
    };
    std::optional<Blocks> white, black;
    for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
      const Pair* pair = Choose(projector, axis, turn++);
      if (pair == nullptr) continue;
      if (!white) white = blocks(*projector.white), black = blocks(*projector.black);
      const auto share = ShareOff(blocks(*pair->pattern), blocks(*pair->inverse), *white, *black);
      if (!share || *share <= kAllowedShare) continue;
      char text[256];
      std::snprintf(text, sizeof text,
                    "projector %d: '%s' (frame %lld) and its inverse (frame %lld) do not add up to white in %.0f %% of "
                    "the picture",
                    number, pair->pattern->record.pattern.ToString().c_str(), static_cast<long long>(pair->pattern->id),
                    static_cast<long long>(pair->inverse->id), 100.0 * *share);
      complaints.emplace_back(text);
    }
  }
  return complaints;
}

}  // namespace stratalux::db
