// SPDX-License-Identifier: Apache-2.0
#include "fitter/stages/maps.h"

#include "fitter/stages/fit_summary.h"
#include "fitter/stages/layer_maps.h"
#include "fitter/stages/stage_json.h"

namespace stratalux::fit {
namespace {

constexpr int kMapsSchema = 2;  // of maps.json

}  // namespace

Result<AllLayers> FitMaps(const SrdSet& srds, int heldout, const FitOptions& options, const SharedLight& shared,
                          Logger& logger, const std::string& label) {
  SLX_ASSIGN_OR_RETURN(const auto all, TrainingLightsOf(srds, kNoneHeldOut));
  AllLayers made;
  SLX_ASSIGN_OR_RETURN(made.layers.map, FitLayers(srds, kNoneHeldOut, options, shared, logger, label));
  const MixtureMap& map = made.layers.map;
  made.layers.pool = srds.pool;
  made.layers.signal_to_noise = SignalToNoise(map, all.batches);
  MapsFigures& figures = made.figures;
  figures.provenance = ProvenanceOf(map, static_cast<int>(srds.batches.size()));
  figures.projectors = DistinctProjectors(map);
  figures.heldout = heldout;
  for (int64_t i = 0; i < map.profiles(); ++i) figures.fitted += map.Fitted(i) ? 1 : 0;
  figures.masked_by_reason = MaskedByReason(map);
  figures.divergence = MedianDivergence(map);
  return made;
}

Status SaveMaps(const std::filesystem::path& folder, const AllLayers& made) {
  const std::filesystem::path maps = folder / kMapsFolder;
  std::error_code error;
  std::filesystem::create_directory(maps, error);
  if (error) return Status::Failed("cannot create " + maps.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SaveLayers(maps, made.layers));
  SLX_RETURN_IF_ERROR(WriteLayerMaps(maps, SummariseLayers(made.layers.map)));
  const MapsFigures& f = made.figures;
  return WriteJson(maps / "maps.json", {{"schema", kMapsSchema},
                                        {"provenance", f.provenance},
                                        {"projectors", f.projectors},
                                        {"heldout_of_fit", f.heldout},
                                        {"profiles", {{"fitted", f.fitted}, {"masked_by_reason", f.masked_by_reason}}},
                                        {"divergence", f.divergence}});
}

Result<FittedLayers> LoadMaps(const std::filesystem::path& folder) { return LoadLayers(folder / kMapsFolder); }

Result<MapsFigures> LoadMapsFigures(const std::filesystem::path& folder) {
  MapsFigures f;
  int schema = 0;
  const std::filesystem::path file = folder / kMapsFolder / "maps.json";
  SLX_RETURN_IF_ERROR(ReadJson(file, [&](const nlohmann::json& json) {
    if (json.at("schema").get_to(schema) != kMapsSchema) return;
    json.at("provenance").get_to(f.provenance);
    json.at("projectors").get_to(f.projectors);
    json.at("heldout_of_fit").get_to(f.heldout);
    const auto& profiles = json.at("profiles");
    profiles.at("fitted").get_to(f.fitted);
    profiles.at("masked_by_reason").get_to(f.masked_by_reason);
    json.at("divergence").get_to(f.divergence);
  }));
  if (schema < kMapsSchema)
    return Status::Integrity(file.string() + ": schema " + std::to_string(schema) +
                             " of an older program; `stratalux-fit run` makes it again");
  if (schema > kMapsSchema)
    return Status(StatusCode::kNewerSchema, file.string() + ": schema " + std::to_string(schema) +
                                                ", this program reads " + std::to_string(kMapsSchema));
  return f;
}

}  // namespace stratalux::fit
