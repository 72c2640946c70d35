// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/calibration/board_watch.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

namespace stratalux::rig {
namespace {

// Coarse bits of a code: enough to tell 8 x 6 cells, and wide enough for any blur.
constexpr int kCoarseBits = 5;
constexpr double kLitShare = 0.15;          // of the brightest light that comes back
constexpr double kLeastSignal = 0.01;       // of the range
constexpr double kLeastBitContrast = 0.15;  // of white less black
constexpr double kPairTolerance = 0.25;     // of white less black
constexpr double kCellShare = 0.25;         // of a camera cell's probes that must be lit
constexpr double kCellProbes = 0.001;       // of all probes that must fall into a projector's cell

std::string Percent(double share) {
  char text[16];
  std::snprintf(text, sizeof text, "%.0f %%", 100.0 * share);
  return text;
}

std::string Milliseconds(double ms) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", ms);
  return text;
}

Pattern GrayBit(PatternAxis axis, int extent, int bit, bool inverse) {
  return {.kind = PatternKind::kGray, .axis = axis, .bit = bit, .bits = GrayBits(extent), .inverse = inverse};
}

}  // namespace

struct BoardWatch::Lit {
  const Probes* white = nullptr;
  const Probes* black = nullptr;
  std::vector<size_t> probes;  // that the projector's light comes back from
  double saturated = 0.0;      // share of them

  [[nodiscard]] double Signal(size_t i) const { return double((*white)[i]) - (*black)[i]; }
};

void BoardWatch::OnFrame(const FrameRecord& record, const Image<uint16_t>& pixels) {
  if (record.projector < 0 || record.bracket != 0 || record.level_check == LevelCheck::kFailed) return;
  if (lattice_.size() == 0) lattice_ = ProbeLattice(pixels.width(), pixels.height());
  frames_[{record.projector, record.pattern.ToString()}] = lattice_.Sample(pixels);
}

const Probes* BoardWatch::Find(int projector, const Pattern& pattern) const {
  const auto found = frames_.find({projector, pattern.ToString()});
  return found == frames_.end() ? nullptr : &found->second;
}

std::optional<BoardWatch::Lit> BoardWatch::LitBy(int projector) const {
  Lit lit;
  lit.white = Find(projector, {.kind = PatternKind::kWhite});
  lit.black = Find(projector, {.kind = PatternKind::kBlack});
  if (lit.white == nullptr || lit.black == nullptr) return std::nullopt;
  std::vector<double> signal(lattice_.size());
  for (size_t i = 0; i < signal.size(); ++i) signal[i] = lit.Signal(i);
  std::vector<double> sorted = signal;
  const auto bright = sorted.begin() + static_cast<int64_t>(0.99 * static_cast<double>(sorted.size() - 1));
  std::nth_element(sorted.begin(), bright, sorted.end());
  const double least = std::max(kLitShare * *bright, kLeastSignal * options_.saturation_dn);
  double saturated = 0.0;
  for (size_t i = 0; i < signal.size(); ++i) {
    if (signal[i] < least) continue;
    lit.probes.push_back(i);
    saturated += (*lit.white)[i] >= 0.975 * options_.saturation_dn ? 1.0 : 0.0;
  }
  lit.saturated = lit.probes.empty() ? 0.0 : saturated / static_cast<double>(lit.probes.size());
  return lit;
}

double BoardWatch::MovedShare(int projector, const Lit& lit) const {
  double worst = 0.0;
  for (const auto& [axis, extent] : {std::pair(PatternAxis::kColumns, options_.projector_width),
                                     std::pair(PatternAxis::kRows, options_.projector_height)})
    for (int bit = 0; bit < GrayBits(extent); ++bit) {
      const Probes* code = Find(projector, GrayBit(axis, extent, bit, false));
      const Probes* inverse = Find(projector, GrayBit(axis, extent, bit, true));
      if (code == nullptr || inverse == nullptr) continue;
      double off = 0.0;
      for (const size_t i : lit.probes) {
        const double sum = double((*code)[i]) + (*inverse)[i], white = double((*lit.white)[i]) + (*lit.black)[i];
        off += std::abs(sum - white) > kPairTolerance * lit.Signal(i) ? 1.0 : 0.0;
      }
      worst = std::max(worst, off / static_cast<double>(lit.probes.size()));
    }
  return worst;
}

double BoardWatch::CoverCells(int projector, const Lit& lit, CoverageMap& cells) const {
  std::array<std::vector<const Probes*>, 2> code, inverse;
  const std::array<std::pair<PatternAxis, int>, 2> axes = {std::pair(PatternAxis::kColumns, options_.projector_width),
                                                           std::pair(PatternAxis::kRows, options_.projector_height)};
  for (size_t a = 0; a < 2; ++a)
    for (int bit = 0; bit < std::min(kCoarseBits, GrayBits(axes[a].second)); ++bit) {
      code[a].push_back(Find(projector, GrayBit(axes[a].first, axes[a].second, bit, false)));
      inverse[a].push_back(Find(projector, GrayBit(axes[a].first, axes[a].second, bit, true)));
      if (code[a].back() == nullptr || inverse[a].back() == nullptr) return 1.0;
    }
  std::array<int, size_t{CoverageMap::kColumns} * CoverageMap::kRows> counts{};
  double unreadable = 0.0;
  for (const size_t i : lit.probes) {
    std::array<double, 2> place{};
    bool read = true;
    for (size_t a = 0; a < 2 && read; ++a) {
      unsigned gray = 0;
      for (size_t bit = 0; bit < code[a].size() && read; ++bit) {
        const double difference = double((*code[a][bit])[i]) - (*inverse[a][bit])[i];
        read = std::abs(difference) >= kLeastBitContrast * lit.Signal(i);
        gray = 2 * gray + (difference > 0.0 ? 1U : 0U);
      }
      const int fine = GrayBits(axes[a].second) - static_cast<int>(code[a].size());
      place[a] = (BinaryFromGray(gray) + 0.5) * (1 << fine) / axes[a].second;
    }
    if (read) ++counts[static_cast<size_t>(CoverageMap::CellAt(place[0], place[1]))];
    unreadable += read ? 0.0 : 1.0;
  }
  for (size_t cell = 0; cell < counts.size(); ++cell)
    if (counts[cell] > kCellProbes * static_cast<double>(lattice_.size())) cells.Cover(static_cast<int>(cell));
  return unreadable / static_cast<double>(lit.probes.size());
}

void BoardWatch::JudgeProjector(int projector, const Lit& lit, BoardSighting& sighting) const {
  const std::string name = "projector " + std::to_string(projector);
  if (lit.saturated > options_.max_saturated) {
    sighting.faults.push_back({Percent(lit.saturated) + " of what " + name + " lights is saturated",
                               "--exposure " + Milliseconds(0.5 * options_.exposure_ms) + " (now " +
                                   Milliseconds(options_.exposure_ms) + " ms), or a less glossy board",
                               false});
    return;  // saturated pairs do not add up
  }
  if (const double unreadable = CoverCells(projector, lit, sighting.projectors[static_cast<size_t>(projector)]);
      unreadable > options_.max_unreadable)
    sighting.faults.push_back({"the codes of " + name + " cannot be read on " + Percent(unreadable) + " of the board",
                               "focus that projector; keep the board still", true});
  if (const double moved = MovedShare(projector, lit); moved > options_.max_moved)
    sighting.faults.push_back({"the board moved while " + name + " was on (" + Percent(moved) + " of it changed)",
                               "fix the board, keep your hands off it", true});
}

BoardSighting BoardWatch::Judge() const {
  BoardSighting sighting;
  sighting.projectors.resize(static_cast<size_t>(options_.projectors));
  const double all = static_cast<double>(std::max<size_t>(1, lattice_.size()));
  const int columns = std::max(1, lattice_.columns());
  const double rows = all / columns;
  std::array<double, size_t{CoverageMap::kColumns} * CoverageMap::kRows> lit_probes{}, cell_probes{};
  const auto cell_of = [&](size_t i) {
    const auto x = static_cast<double>(i % static_cast<size_t>(columns));
    const auto y = static_cast<double>(i / static_cast<size_t>(columns));
    return static_cast<size_t>(CoverageMap::CellAt((x + 0.5) / columns, (y + 0.5) / rows));
  };
  std::vector<bool> lit_by_any(lattice_.size(), false);
  int seeing = 0;
  for (int p = 0; p < options_.projectors; ++p) {
    const auto lit = LitBy(p);
    if (!lit || static_cast<double>(lit->probes.size()) < options_.min_lit * all) {
      sighting.notes.push_back("projector " + std::to_string(p) +
                               " lights hardly anything: it will be left out of this pose");
      continue;
    }
    ++seeing;
    for (const size_t i : lit->probes) lit_by_any[i] = true;
    JudgeProjector(p, *lit, sighting);
  }
  if (seeing == 0) {
    sighting.notes.clear();
    sighting.faults.push_back({"nothing is lit: no projector's light comes back from a board",
                               "bring the board to where a face would be, take off the lens cap", false});
    return sighting;
  }
  for (size_t i = 0; i < lit_by_any.size(); ++i) {
    cell_probes[cell_of(i)] += 1.0;
    lit_probes[cell_of(i)] += lit_by_any[i] ? 1.0 : 0.0;
  }
  for (size_t cell = 0; cell < lit_probes.size(); ++cell)
    if (lit_probes[cell] > kCellShare * cell_probes[cell]) sighting.camera.Cover(static_cast<int>(cell));
  return sighting;
}

}  // namespace stratalux::rig
