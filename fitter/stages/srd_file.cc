// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/srd_file.h"

#include <array>
#include <utility>

#include "fitter/export/npy_file.h"
#include "fitter/stages/stage_json.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using Member = std::vector<float> SrdBatch::*;

// A row a profile: of K samples each, or of one value.
constexpr std::array<std::pair<const char*, Member>, 2> kSamples = {
    {{"y", &SrdBatch::y}, {"variance", &SrdBatch::variance}}};
constexpr std::array<std::pair<const char*, Member>, 15> kValues = {
    {{"white", &SrdBatch::white},
     {"white_variance", &SrdBatch::white_variance},
     {"first_u_mm", &SrdBatch::first_u_mm},
     {"step_mm", &SrdBatch::step_mm},
     {"line_width_mm", &SrdBatch::line_width_mm},
     {"blur_mm", &SrdBatch::blur_mm},
     {"quad_x_mm", &SrdBatch::quad_x_mm},
     {"quad_y_mm", &SrdBatch::quad_y_mm},
     {"pair_mm", &SrdBatch::pair_mm},
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
  for (const auto& [name, member] : kSamples)
    SLX_RETURN_IF_ERROR(
        WriteNpy(folder / (std::string(name) + ".npy"), Pick(batch.*member, rows, batch.samples), batch.samples));
  for (const auto& [name, member] : kValues)
    if (!(batch.*member).empty())
      SLX_RETURN_IF_ERROR(WriteNpy(folder / (std::string(name) + ".npy"), Pick(batch.*member, which, 1)));
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

Result<SrdBatch> LoadBatch(const fs::path& folder) {
  SrdBatch batch;
  int64_t profiles = 0;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "sweep.json", [&](const nlohmann::json& json) {
    json.at("profiles").get_to(profiles);
    json.at("samples").get_to(batch.samples);
    json.at("wrapped").get_to(batch.wrapped);
    json.at("sample_box").get_to(batch.sample_box);
    json.at("pool").get_to(batch.pool);
  }));
  SLX_ASSIGN_OR_RETURN(const auto which, ReadNpyIntegers(folder / "profile.npy"));
  batch.valid.assign(static_cast<size_t>(profiles), 0);
  batch.row.assign(static_cast<size_t>(profiles), -1);
  int32_t before = -1, rows = 0;
  for (const int32_t i : which) {
    if (i <= before || i >= profiles) return Status::Integrity((folder / "profile.npy").string() + ": no such profile");
    batch.valid[static_cast<size_t>(i)] = 1;
    batch.row[static_cast<size_t>(i)] = rows++;
    before = i;
  }
  for (const auto& [name, member] : kSamples) {
    const fs::path file = folder / (std::string(name) + ".npy");
    SLX_ASSIGN_OR_RETURN(batch.*member, ReadNpyFloats(file));
    if ((batch.*member).size() != which.size() * static_cast<size_t>(batch.samples))
      return Status::Integrity(file.string() + " does not belong to its profiles");
  }
  for (const auto& [name, member] : kValues) {
    const fs::path file = folder / (std::string(name) + ".npy");
    if (std::error_code error; fs::exists(file, error))
      SLX_RETURN_IF_ERROR(Spread(file, which, profiles, batch.*member));
  }
  return batch;
}

}  // namespace

Status SaveSrds(const fs::path& folder, const ExtractedSrds& srds) {
  const SrdSet& set = srds.set;
  for (size_t p = 0; p < set.batches.size(); ++p)
    SLX_RETURN_IF_ERROR(SaveBatch(folder / ("columns_" + std::to_string(p)), set.batches[p]));
  for (size_t p = 0; p < set.row_batches.size(); ++p)
    SLX_RETURN_IF_ERROR(SaveBatch(folder / ("rows_" + std::to_string(p)), set.row_batches[p]));
  nlohmann::ordered_json sweeps = nlohmann::ordered_json::array();
  for (const SweepFigure& f : srds.figures) sweeps.push_back(JsonOf(f));
  return WriteJson(folder / "srds.json", {{"pool", set.pool},
                                          {"width", set.width},
                                          {"height", set.height},
                                          {"channels", set.channels},
                                          {"column_sweeps", set.batches.size()},
                                          {"row_sweeps", set.row_batches.size()},
                                          {"sweeps", sweeps}});
}

Result<ExtractedSrds> LoadSrds(const fs::path& folder) {
  ExtractedSrds srds;
  SrdSet& set = srds.set;
  size_t columns = 0, rows = 0;
  SLX_RETURN_IF_ERROR(ReadJson(folder / "srds.json", [&](const nlohmann::json& json) {
    json.at("pool").get_to(set.pool);
    json.at("width").get_to(set.width);
    json.at("height").get_to(set.height);
    json.at("channels").get_to(set.channels);
    json.at("column_sweeps").get_to(columns);
    json.at("row_sweeps").get_to(rows);
    for (const auto& sweep : json.at("sweeps")) srds.figures.push_back(FigureOf(sweep));
  }));
  for (size_t p = 0; p < columns; ++p) {
    SLX_ASSIGN_OR_RETURN(auto batch, LoadBatch(folder / ("columns_" + std::to_string(p))));
    set.batches.push_back(std::move(batch));
  }
  for (size_t p = 0; p < rows; ++p) {
    SLX_ASSIGN_OR_RETURN(auto batch, LoadBatch(folder / ("rows_" + std::to_string(p))));
    set.row_batches.push_back(std::move(batch));
  }
  return srds;
}

}  // namespace stratalux::fit
