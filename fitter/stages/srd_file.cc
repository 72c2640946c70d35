// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/srd_file.h"

#include <algorithm>
#include <array>
#include <utility>

#include "fitter/export/npy_file.h"
#include "fitter/stages/stage_json.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Member = std::vector<float> SrdBatch::*;

// A row a profile: K samples (kSamples), or one value.
constexpr const char* kSamples = "y";
constexpr std::array<std::pair<const char*, Member>, 19> kValues = {
    {{"noise_floor", &SrdBatch::noise_floor},
     {"noise_slope", &SrdBatch::noise_slope},
     {"white", &SrdBatch::white},
     {"white_variance", &SrdBatch::white_variance},
     {"first_u_mm", &SrdBatch::first_u_mm},
     {"step_mm", &SrdBatch::step_mm},
     {"line_width_mm", &SrdBatch::line_width_mm},
     {"blur_mm", &SrdBatch::blur_mm},
     {"quad_x_mm", &SrdBatch::quad_x_mm},
     {"quad_y_mm", &SrdBatch::quad_y_mm},
     {"pair_mm", &SrdBatch::pair_mm},
     {"box_x_mm", &SrdBatch::box_x_mm},
     {"box_y_mm", &SrdBatch::box_y_mm},
     {"slope_in", &SrdBatch::slope_in},
     {"slope_out", &SrdBatch::slope_out},
     {"cos_in", &SrdBatch::cos_in},
     {"cos_out", &SrdBatch::cos_out},
     {"slope_in_across", &SrdBatch::slope_in_across},
     {"slope_out_across", &SrdBatch::slope_out_across}}};

nlohmann::ordered_json JsonOf(const SweepFigure& f) {
  return {{"projector", f.projector},
          {"axis", f.axis},
          {"profiles_by_reason", f.profiles_by_reason},
          {"missing_frames", f.missing_frames},
          {"energy_profiles", f.energy_profiles},
          {"energy_median", f.energy_median},
          {"energy_p95_error", f.energy_p95_error}};
}

SweepFigure FigureOf(const nlohmann::json& json) {
  SweepFigure f;
  json.at("projector").get_to(f.projector);
  json.at("axis").get_to(f.axis);
  json.at("profiles_by_reason").get_to(f.profiles_by_reason);
  json.at("missing_frames").get_to(f.missing_frames);
  json.at("energy_profiles").get_to(f.energy_profiles);
  json.at("energy_median").get_to(f.energy_median);
  json.at("energy_p95_error").get_to(f.energy_p95_error);
  return f;
}

fs::path ArrayOf(const fs::path& folder, const char* name) { return folder / (std::string(name) + ".npy"); }

// White frames were not captured, quads not pooled; all others must be there.
constexpr std::array<const char*, 4> kOptional = {"white", "white_variance", "quad_x_mm", "quad_y_mm"};

Result<bool> IsThere(const fs::path& folder, const char* name) {
  std::error_code error;
  if (fs::exists(ArrayOf(folder, name), error)) return true;
  for (const char* optional : kOptional)
    if (std::string(optional) == name) return false;
  return Status::Integrity(ArrayOf(folder, name).string() + " is missing");
}

// Rows of the valid profiles, `columns` values each.
std::vector<float> Pick(const std::vector<float>& values, std::span<const int32_t> which, int64_t columns) {
  std::vector<float> rows;
  rows.reserve(which.size() * static_cast<size_t>(columns));
  for (const int32_t i : which)
    rows.insert(rows.end(), values.begin() + i * columns, values.begin() + (i + 1) * columns);
  return rows;
}

Status SaveBatch(const fs::path& folder, const SrdBatch& batch) {
  std::error_code error;
  fs::create_directory(folder, error);
  if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());
  std::vector<int32_t> which;
  for (size_t i = 0; i < batch.valid.size(); ++i)
    if (batch.valid[i] != 0) which.push_back(static_cast<int32_t>(i));
  SLX_RETURN_IF_ERROR(WriteNpy(folder / "profile.npy", which));
  std::vector<int32_t> rows = which;
  for (int32_t& row : rows)
    if (!batch.row.empty()) row = batch.row[static_cast<size_t>(row)];
  SLX_RETURN_IF_ERROR(WriteNpy(ArrayOf(folder, kSamples), Pick(batch.y, rows, batch.samples), batch.samples));
  for (const auto& [name, member] : kValues)
    if (!(batch.*member).empty()) SLX_RETURN_IF_ERROR(WriteNpy(ArrayOf(folder, name), Pick(batch.*member, which, 1)));
  return WriteJson(folder / "sweep.json", {{"profiles", batch.profiles()},
                                           {"samples", batch.samples},
                                           {"wrapped", batch.wrapped},
                                           {"sample_box", batch.sample_box},
                                           {"pool", batch.pool}});
}

Status Spread(const fs::path& file, std::span<const int32_t> which, int64_t profiles, std::vector<float>& values) {
  SLX_ASSIGN_OR_RETURN(const auto rows, ReadNpyFloats(file));
  if (rows.size() != which.size()) return Status::Integrity(file.string() + " does not belong to its profiles");
  values.assign(static_cast<size_t>(profiles), 0.0F);
  for (size_t k = 0; k < which.size(); ++k) values[static_cast<size_t>(which[k])] = rows[k];
  return Status::Ok();
}

// What a sweep's folder says of itself: a batch without samples and values.
struct SavedSweep {
  SrdBatch batch;
  int64_t profiles = 0;
  std::vector<int32_t> which;  // the valid ones
};

Result<SavedSweep> OpenSweep(const fs::path& folder) {
  SavedSweep sweep;
  SrdBatch& batch = sweep.batch;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "sweep.json", [&](const nlohmann::json& json) {
    json.at("profiles").get_to(sweep.profiles);
    json.at("samples").get_to(batch.samples);
    json.at("wrapped").get_to(batch.wrapped);
    json.at("sample_box").get_to(batch.sample_box);
    json.at("pool").get_to(batch.pool);
  }));
  SLX_ASSIGN_OR_RETURN(sweep.which, ReadNpyIntegers(folder / "profile.npy"));
  int32_t before = -1;
  for (const int32_t i : sweep.which) {
    if (i <= before || i >= sweep.profiles)
      return Status::Integrity((folder / "profile.npy").string() + ": no such profile");
    before = i;
  }
  return sweep;
}

Result<SrdBatch> LoadBatch(const fs::path& folder) {
  SLX_ASSIGN_OR_RETURN(SavedSweep sweep, OpenSweep(folder));
  SrdBatch& batch = sweep.batch;
  batch.valid.assign(static_cast<size_t>(sweep.profiles), 0);
  batch.row.assign(static_cast<size_t>(sweep.profiles), -1);
  for (int32_t rows = 0; const int32_t i : sweep.which) {
    batch.valid[static_cast<size_t>(i)] = 1;
    batch.row[static_cast<size_t>(i)] = rows++;
  }
  const fs::path samples = ArrayOf(folder, kSamples);
  SLX_ASSIGN_OR_RETURN(batch.y, ReadNpyFloats(samples));
  if (batch.y.size() != sweep.which.size() * static_cast<size_t>(batch.samples))
    return Status::Integrity(samples.string() + " does not belong to its profiles");
  for (const auto& [name, member] : kValues) {
    SLX_ASSIGN_OR_RETURN(const bool there, IsThere(folder, name));
    if (there) SLX_RETURN_IF_ERROR(Spread(ArrayOf(folder, name), sweep.which, sweep.profiles, batch.*member));
  }
  return std::move(batch);
}

Result<SrdBatch> LoadProfile(const fs::path& folder, int64_t profile) {
  SLX_ASSIGN_OR_RETURN(SavedSweep sweep, OpenSweep(folder));
  SrdBatch& batch = sweep.batch;
  const auto found = std::ranges::lower_bound(sweep.which, profile);
  const bool valid = found != sweep.which.end() && *found == profile;
  const int64_t at = found - sweep.which.begin();
  batch.valid = {static_cast<uint8_t>(valid ? 1 : 0)};
  batch.place = {profile};
  batch.AllotRows(batch.valid, 0.0F);
  if (valid) {
    SLX_ASSIGN_OR_RETURN(batch.y, ReadNpyFloats(ArrayOf(folder, kSamples), at * batch.samples, batch.samples));
  }
  for (const auto& [name, member] : kValues) {
    SLX_ASSIGN_OR_RETURN(const bool there, IsThere(folder, name));
    if (!there) continue;
    batch.*member = {0.0F};
    if (valid) {
      SLX_ASSIGN_OR_RETURN(batch.*member, ReadNpyFloats(ArrayOf(folder, name), at, 1));
    }
  }
  return std::move(batch);
}

struct SavedSet {
  ExtractedSrds srds;  // without its batches
  size_t columns = 0, rows = 0;
};

Result<SavedSet> OpenSet(const fs::path& folder) {
  SavedSet saved;
  SrdSet& set = saved.srds.set;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "srds.json", [&](const nlohmann::json& json) {
    json.at("pool").get_to(set.pool);
    json.at("width").get_to(set.width);
    json.at("height").get_to(set.height);
    json.at("channels").get_to(set.channels);
    json.at("spacing_mm").get_to(set.spacing_mm);
    json.at("column_sweeps").get_to(saved.columns);
    json.at("row_sweeps").get_to(saved.rows);
    for (const auto& sweep : json.at("sweeps")) saved.srds.figures.push_back(FigureOf(sweep));
  }));
  return saved;
}

// Of the sweeps along columns, by projector, then of those along rows.
std::vector<fs::path> FoldersOf(const fs::path& folder, size_t columns, size_t rows) {
  std::vector<fs::path> folders;
  for (size_t p = 0; p < columns; ++p) folders.push_back(folder / ("columns_" + std::to_string(p)));
  for (size_t p = 0; p < rows; ++p) folders.push_back(folder / ("rows_" + std::to_string(p)));
  return folders;
}

}  // namespace

Status SaveSrds(const fs::path& folder, const ExtractedSrds& srds) {
  const SrdSet& set = srds.set;
  const std::vector<fs::path> folders = FoldersOf(folder, set.batches.size(), set.row_batches.size());
  SLX_RETURN_IF_ERROR(ParallelTry(folders.size(), [&](size_t k) {
    const size_t columns = set.batches.size();
    return SaveBatch(folders[k], k < columns ? set.batches[k] : set.row_batches[k - columns]);
  }));
  nlohmann::ordered_json sweeps = nlohmann::ordered_json::array();
  for (const SweepFigure& f : srds.figures) sweeps.push_back(JsonOf(f));
  return WriteJson(folder / "srds.json", {{"pool", set.pool},
                                          {"width", set.width},
                                          {"height", set.height},
                                          {"channels", set.channels},
                                          {"spacing_mm", set.spacing_mm},
                                          {"column_sweeps", set.batches.size()},
                                          {"row_sweeps", set.row_batches.size()},
                                          {"sweeps", sweeps}});
}

Result<ExtractedSrds> LoadSrds(const fs::path& folder) {
  SLX_ASSIGN_OR_RETURN(SavedSet saved, OpenSet(folder));
  const std::vector<fs::path> folders = FoldersOf(folder, saved.columns, saved.rows);
  std::vector<SrdBatch> batches(folders.size());
  SLX_RETURN_IF_ERROR(ParallelTry(folders.size(), [&](size_t k) -> Status {
    SLX_ASSIGN_OR_RETURN(batches[k], LoadBatch(folders[k]));
    return Status::Ok();
  }));
  for (size_t k = 0; k < batches.size(); ++k)
    (k < saved.columns ? saved.srds.set.batches : saved.srds.set.row_batches).push_back(std::move(batches[k]));
  return std::move(saved.srds);
}

Result<ProfileSrds> LoadProfileSrds(const fs::path& folder, int64_t profile) {
  SLX_ASSIGN_OR_RETURN(SavedSet saved, OpenSet(folder));
  ProfileSrds srds{std::move(saved.srds.figures), {}};
  if (profile < 0) return srds;
  for (const fs::path& sweep : FoldersOf(folder, saved.columns, 0)) {
    SLX_ASSIGN_OR_RETURN(srds.batches.emplace_back(), LoadProfile(sweep, profile));
  }
  return srds;
}

}  // namespace stratalux::fit
