// SPDX-License-Identifier: Apache-2.0
// What another subcutis than the skin table's does to its light: one that absorbs more, or begins less deep. A
// correction of low rank: the logarithm of the kernel over the skin table's depends on the distance from the entry and,
// linearly, on how steeply light comes and goes, but not on the direction in the plane. Made by
// `stratalux-skin-table generate --subcutis`; its error is in docs/simulated-rig.md.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {

// The kinds of subcutis: every pair of a depth and an absorption but the first of both, which is the skin table's own.
struct SubcutisGrid {
  // The two ends are wanted; what happens between them is no straight line, so there is a node in the middle.
  static constexpr std::array<double, 3> kSkinMm = {rig::kSkinMm, 1.48, 0.98};
  static constexpr std::array<double, 2> kAbsorption = {1.0, 4.0};  // as SkinParameters::subcutis_absorption
  static constexpr int kKinds = static_cast<int>(kSkinMm.size() * kAbsorption.size()) - 1;
  static constexpr int kTerms = 2;  // at kMeanCosines, and for each 1 of cosine more
  static constexpr int kKindCodes = kTerms * SkinGrid::kRadii;
  // Of both ways together, inside the tissue, where light comes and leaves diffusely: 2 times the mean over
  // sin^2(theta) of sqrt(1 - sin^2(theta) / kSkinIndex^2), which is (2 / 3) n^2 (1 - (1 - n^-2)^1.5).
  static constexpr double kMeanCosines = 1.7175;
  // Of a photon or a look-up: cosines inside the tissue less kMeanCosines, of the sines (squared) outside.
  static double CosinesOf(double sin2_theta_in, double sin2_theta_out);
  // `skin` with that subcutis; 0 <= kind < kKinds.
  static SkinParameters WithKind(int kind, SkinParameters skin);
  // Weights of the kinds; the skin table's own has what they lack to 1. A weight may lie below 0: over the depth it is
  // a parabola. Over the absorption it is a straight line of its power of 0.15, by which the logarithm of the far
  // rings' light falls (measured; between 0.1 and 0.3). Clamped outside the nodes.
  static std::array<float, kKinds> KindsAround(const SkinParameters& skin);
};

// Copies share what was read.
class SubcutisTable {
 public:
  static constexpr const char* kFile = "subcutis_table.bin";
  // As ReadPackedTable (packed_table.h).
  static Result<SubcutisTable> Load(const std::string& path);
  Status Save(const std::string& path) const;
  // As SkinTable::DefaultPath().
  static std::string DefaultPath();

  // kUsage where the skin's subcutis or scattering lies outside the nodes, saying what it knows.
  [[nodiscard]] Status Check(const SkinParameters& skin) const;
  // Logarithm of S over that of the same skin with the skin table's subcutis, by ring of the skin table.
  using Rings = std::array<float, SkinGrid::kRadii>;
  [[nodiscard]] Rings LogRatio(int channel, const SkinParameters& skin, const SkinDirections& directions) const;

  [[nodiscard]] const std::vector<double>& scatterings() const { return contents_->scatterings; }
  // All that it says, as it is kept in memory.
  [[nodiscard]] std::span<const int16_t> codes() const { return contents_->codes; }
  // How it was made, JSON.
  [[nodiscard]] const std::string& manifest() const { return contents_->manifest; }
  // Of the run that it was made by; none where its manifest does not tell.
  [[nodiscard]] std::optional<uint64_t> seed() const;

 private:
  struct Contents {
    std::vector<double> scatterings;
    // [channel][node][kind][term][ring], kCodesPerUnit to one of the natural logarithm; nodes as those of a skin table.
    std::vector<int16_t> codes;
    std::string manifest;
  };
  static constexpr float kCodesPerUnit = 1024.0F;  // 0.1 % a step; the photons' own errors are larger
  explicit SubcutisTable(std::shared_ptr<const Contents> contents) : contents_(std::move(contents)) {}
  friend Result<SubcutisTable> GenerateSubcutisTable(const SkinTableRun&, std::vector<double>, Logger&);

  std::shared_ptr<const Contents> contents_;
};

// Monte Carlo of every kind; `run.photons` for each channel, scattering and depth. Deterministic by seed. kUsage as of
// GenerateSkinTable.
Result<SubcutisTable> GenerateSubcutisTable(const SkinTableRun& run, std::vector<double> scatterings, Logger& logger);

}  // namespace stratalux::rig
