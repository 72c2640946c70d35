// SPDX-License-Identifier: Apache-2.0
// The tabulated light transport of the simulated skin: spatial kernels by Monte Carlo over incidence and exit angle,
// melanin, blood, epidermal thickness and, where a table has the axis, scattering, at R, G, B. Made by
// `stratalux-skin-table generate`; its file: packed_table.h.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "firmware-host/simulated/skin/skin_optics.h"
#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// The grid. Angles are bins of theta, the same for incidence and exit, so that the table can be made exactly
// reciprocal.
struct SkinGrid {
  static constexpr int kThetas = 5;
  static constexpr std::array<double, kThetas + 1> kThetaEdgesDeg = {0.0, 20.0, 35.0, 50.0, 65.0, 85.0};
  static constexpr int kAzimuths = 5;  // 0, 45, 90, 135, 180 degrees between the tangential parts; bins of 45 degrees
  static constexpr int kRadii = 26;    // first bin [0, kFirstRadiusMm], then logarithmic up to kMaxRadiusMm
  static constexpr int kPolar = 16;    // bins of psi, the exit point's direction from the entry point
  static constexpr double kFirstRadiusMm = 0.03;
  static constexpr double kMaxRadiusMm = 30.0;
  static constexpr std::array<double, 6> kMelanin = {0.005, 0.012, 0.03, 0.07, 0.15, 0.30};
  static constexpr std::array<double, 4> kBlood = {0.0005, 0.003, 0.015, 0.06};
  static constexpr std::array<double, 3> kEpidermisMm = {0.05, 0.08, 0.15};
  // Of one scattering: absorption and thickness.
  static constexpr int kNodes = static_cast<int>(kMelanin.size() * kBlood.size() * kEpidermisMm.size());
  static constexpr int kMostScatterings = 5;
  static constexpr int kCells = kRadii * kPolar;
  static constexpr size_t kDirections = size_t{kSkinChannels} * kThetas * kThetas * kAzimuths;
  static double RadiusEdgeMm(int edge);  // 0 .. kRadii
  static double Sin2Edge(int edge);      // sin^2(theta), 0 .. kThetas
  static int NodeIndex(int melanin, int blood, int epidermis);
  static size_t DirectionIndex(int channel, int in, int out, int azimuth);
  // Helmholtz: S(i -> o; r, psi) = S(o -> i; r, azimuth - pi - psi), as a bin.
  static int ReciprocalPsi(int azimuth, int psi) { return ((2 * azimuth - 8 - psi - 1) % kPolar + kPolar) % kPolar; }
  // Where a theta bin counts as a node: its mean sin(theta), weighted with the Fresnel transmittance.
  static double NodeThetaRad(int bin);
  // The skin of a node of one scattering.
  static SkinParameters NodeParameters(int node);
};

// Nodes around a skin and their weights, which add up to 1; a weight may be 0. Clamped outside the grid. Light that
// went a path L through a fraction m is exp(-m L): its logarithm is interpolated, which is exact for one L; over many
// paths the short ones win as m rises, so that log S falls like m^0.75, blood^0.67 and thickness^0.6 (measured; a
// linear interpolation of S over log m is 60 % off in blue between 8 and 30 % melanin).
struct SkinNodeWeight {
  int node = 0;
  float weight = 0.0F;
};
[[nodiscard]] std::array<SkinNodeWeight, 8> SkinNodesAround(const SkinParameters& parameters);

// Nodes of a table, and their weights: of each of two scatterings, eight. Between scatterings log S is a straight line
// of the square root of the scattering.
class SkinNodes {
 public:
  void Add(SkinNodeWeight node) { nodes_[static_cast<size_t>(count_++)] = node; }
  [[nodiscard]] const SkinNodeWeight* begin() const { return nodes_.data(); }
  [[nodiscard]] const SkinNodeWeight* end() const { return nodes_.data() + count_; }

 private:
  std::array<SkinNodeWeight, 16> nodes_{};
  int count_ = 0;
};
// Of a table with these nodes of scattering, rising, at least one. Clamped outside the nodes.
[[nodiscard]] SkinNodes SkinNodesAround(const std::vector<double>& scatterings, const SkinParameters& parameters);

struct SkinDirections {
  float theta_in_rad = 0.0F;
  float theta_out_rad = 0.0F;
  float azimuth_rad = 0.0F;  // 0 .. pi, between the tangential parts of omega_in and omega_out (both FROM the surface)
};

// S(x, y): radiance leaving towards omega_out per unit flux falling on a point, 1 / (mm^2 sr), (x, y) = exit minus
// entry point in the tangent plane. +x: the tangential part of omega_in (towards the lamp); +y: the side on which
// omega_out lies.
class SkinKernel {
 public:
  [[nodiscard]] float operator()(float x_mm, float y_mm) const;
  // Integral over the plane: radiance under unit irradiance, 1 / sr.
  [[nodiscard]] double Integral() const;
  // Of share(r) S alone; the weights are made once.
  using RadialWeights = std::array<double, SkinGrid::kRadii>;
  [[nodiscard]] static RadialWeights WeightsOf(const std::function<double(double r_mm)>& share);
  [[nodiscard]] double Integral(const RadialWeights& weights) const;

 private:
  friend class SkinTable;
  // `means`: of S over the table's cells, times the 1.5th power of the ring's centre.
  void SetRingMeans(const std::array<float, SkinGrid::kCells>& means);

  // S r^1.5 at bin centres (flat enough to interpolate linearly), [radius][psi], with the first psi repeated at the
  // end.
  std::array<float, SkinGrid::kRadii*(SkinGrid::kPolar + 1)> flat_{};
};

class SubcutisTable;  // subcutis_table.h

struct SkinTableRun {
  int64_t photons = 1000000;  // for each channel, incidence bin and scattering
  uint64_t seed = 1;
  int threads = 0;  // 0: all cores
};

// Copies share what was read.
class SkinTable {
 public:
  // As ReadPackedTable. The table read last is kept: as long as the file is the
  // same, it is not read again.
  static Result<SkinTable> Load(const std::string& path);
  // The shipped tables' files.
  static constexpr const char* kSkinFile = "skin_table.bin";
  static constexpr const char* kWaxFile = "wax_table.bin";
  // Where a shipped table may lie: where STRATALUX_SKIN_TABLE says (others: beside it), else in share/stratalux beside
  // the program's folder, then in the data folder that the build was to be installed in.
  static std::vector<std::string> DefaultPlaces(const std::string& file);
  // The first of them that is there; where none is, the first.
  static std::string DefaultPath() { return DefaultPathOf(kSkinFile); }
  static std::string DefaultWaxPath() { return DefaultPathOf(kWaxFile); }
  // The same table, which knows other subcutis than its own.
  [[nodiscard]] SkinTable With(SubcutisTable subcutis) const;
  // Null where it does not.
  [[nodiscard]] const SubcutisTable* subcutis() const;
  // `level`: zstd's; a table that is shipped is packed as small as it goes.
  Status Save(const std::string& path, int level = 19) const;

  // S over the Fresnel transmittances of its two directions is linear in sin(theta) (through the normal: a theta below
  // the first node lies between it and its mirror image) and in azimuth; its logarithm over NodesAround. Precondition
  // (as of all that follows from it): subcutis() is there, or parameters.UsualSubcutis().
  void Interpolate(int channel, const SkinParameters& parameters, const SkinDirections& directions,
                   SkinKernel& out) const;
  // Hemispherical diffuse reflectance for light at theta_in.
  [[nodiscard]] double Albedo(int channel, const SkinParameters& parameters, double theta_in_rad) const;
  // How far light spreads that comes and leaves along the normal: the standard deviation of one coordinate of where it
  // leaves, sqrt(<r^2> / 2), within the table's radii.
  [[nodiscard]] double EffectiveWidthMm(int channel, const SkinParameters& parameters) const;
  // Kernels a direction: one each node of skin, scattering by scattering, or one where the tissue has no parameters
  // (wax).
  [[nodiscard]] int nodes() const { return contents_->nodes; }
  // The nodes of SkinParameters::scattering, rising; none of wax.
  [[nodiscard]] const std::vector<double>& scatterings() const { return contents_->scatterings; }
  // kUsage where the scattering lies outside the table's nodes, saying what it knows.
  [[nodiscard]] Status CheckScattering(double scattering) const;
  [[nodiscard]] size_t KernelIndex(int channel, int in, int out, int azimuth, int node) const {
    return SkinGrid::DirectionIndex(channel, in, out, azimuth) * nodes() + node;
  }
  // The skin of a node; of a table of wax, any.
  [[nodiscard]] SkinParameters NodeParameters(int node) const;
  // As SkinNodesAround.
  [[nodiscard]] SkinNodes NodesAround(const SkinParameters& parameters) const;
  // S of one cell (bin averages), 1 / (mm^2 sr).
  [[nodiscard]] double Cell(size_t kernel, int radius, int psi) const;
  // All that the table says, as it is kept in memory.
  [[nodiscard]] std::span<const uint16_t> codes() const { return contents_->codes; }
  // How it was made, JSON.
  [[nodiscard]] const std::string& manifest() const { return contents_->manifest; }
  // Whether it was made with these photons and this seed.
  [[nodiscard]] bool IsOf(const SkinTableRun& run) const;
  // Of the run that it was made by; none where its manifest does not tell.
  [[nodiscard]] std::optional<uint64_t> seed() const;
  // Logarithm of the diffuse albedo for light at 30 degrees, [channel][node]; computed once.
  using NodeAlbedos = std::array<std::vector<float>, kSkinChannels>;
  [[nodiscard]] const NodeAlbedos& LogAlbedos() const;
  // What the skin's subcutis adds to it, by the kinds of subcutis around; 0 for the table's own. Also computed once.
  [[nodiscard]] float SubcutisLogAlbedo(int channel, const SkinParameters& parameters) const;

 private:
  struct Contents {
    int nodes = 1;
    std::vector<double> scatterings;
    std::vector<uint16_t> codes;  // [direction][node][radius][psi], of log2(S r^1.5): skin_table_code.h
    std::string manifest;
    mutable std::once_flag albedos_made;
    mutable NodeAlbedos log_albedos{};
  };
  explicit SkinTable(std::shared_ptr<const Contents> contents) : contents_(std::move(contents)) {}
  // `codes` as in Contents; without scatterings, of wax.
  SkinTable(const SkinTableRun& run, std::vector<double> scatterings, std::vector<uint16_t> codes);
  static Result<std::shared_ptr<const Contents>> Read(const std::string& path);
  static std::string DefaultPathOf(const std::string& file);
  friend Result<SkinTable> GenerateSkinTable(const SkinTableRun&, std::vector<double>, std::span<const SkinTable>,
                                             Logger&);
  friend Result<SkinTable> GenerateWaxTable(const SkinTableRun&, Logger&);
  // S r^1.5 of one direction: `first_kernel` is that of its node 0.
  void DecodeCells(size_t first_kernel, const SkinNodes& nodes, float* cells) const;

  struct Subcutis;  // other kinds, and their albedos

  std::shared_ptr<const Contents> contents_;
  std::shared_ptr<const Subcutis> subcutis_;
};

// Monte Carlo of every kernel. Deterministic by seed, so that what a table of `made` holds of the same run is taken
// from it. kUsage for scatterings that do not rise, or lie outside 0.1 .. 3.
Result<SkinTable> GenerateSkinTable(const SkinTableRun& run, std::vector<double> scatterings,
                                    std::span<const SkinTable> made, Logger& logger);
Result<SkinTable> GenerateWaxTable(const SkinTableRun& run, Logger& logger);
// Of a table's axis: between one and kMostScatterings, rising, within 0.1 .. 3.
[[nodiscard]] Status CheckScatterings(const std::vector<double>& scatterings);

// One (channel, incidence, exit, azimuth) column of the table without reciprocity or smoothing, for checks: radiance
// under unit irradiance and its standard error for each node of the optics at scatterings()[scattering].
struct SkinCellCheck {
  double table = 0.0;
  double mean = 0.0;
  double standard_error = 0.0;
};
struct SkinColumn {
  int channel = 0, in = 0, out = 0, azimuth = 0, scattering = 0;
};
std::vector<SkinCellCheck> RegenerateSkinCell(const SkinTable& table, const SkinColumn& column, int64_t photons,
                                              uint64_t seed);

}  // namespace stratalux::rig
