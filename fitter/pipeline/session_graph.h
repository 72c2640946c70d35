// SPDX-License-Identifier: Apache-2.0
// The stages of one session: which reads what. Each method adds a node, and what it reads, and gives its key.
//
//   frames -> decode -> shape --------+-> srd -> offset -> fit -> predict -> compare
//         \-> separate -> normals      |     \       |         \-> maps, which nothing reads that judges a fit
//                     \-> skin (+ shape), which offset and fit pool what all pixels share over, and by which
//                         comparisons judge where no truth of a simulation tells what is skin
//                                      |      \      \-> placed_shape, which predictions and comparisons stand on
//                                      |       \-> diffuse_normals, of maps (or fit), normals and placed_shape
//                                      \-> (truth_shape, of the truth of a simulation, in its place: without offset)
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "fitter/evaluation/heldout_view.h"
#include "fitter/evaluation/predict.h"
#include "fitter/evaluation/truth.h"
#include "fitter/pipeline/kept.h"
#include "fitter/pipeline/run_options.h"
#include "fitter/pipeline/stage_graph.h"
#include "fitter/separation/separation_map.h"
#include "fitter/session/session_frames.h"
#include "fitter/stages/decode.h"
#include "fitter/stages/layers_file.h"
#include "fitter/stages/offset.h"
#include "fitter/stages/skin.h"
#include "fitter/stages/srd_file.h"

namespace stratalux::fit {

// What a fit is made of data for: itself, a baseline, an ablation.
enum class FitKind { kJudged, kDirectionBlind, kDirectionBlindPlaced, kProjectorsPermuted, kCombFramesShuffled };
[[nodiscard]] const char* ToString(FitKind kind);  // none for the judged fit itself
// Whether it is fitted to spoilt data, and the seed by which combs are shuffled.
[[nodiscard]] bool IsSpoilt(FitKind kind);
inline constexpr uint64_t kShuffleSeed = 1;

class SessionGraph {
 public:
  // Hashes the session's frames. kIntegrity, kNotFound; kUsage: frames that are too few for the geometry asked for.
  static Result<std::unique_ptr<SessionGraph>> Open(const RunOptions& options, const SessionFrames& frames,
                                                    Logger& logger);

  std::string Decode();
  std::string Shape(GeometrySource source);
  std::string Separate();
  // Of all frames, however few a fit may read: the direct light by which predictions are judged.
  std::string SeparateAll();
  std::string Normals();
  // Of the surface of SkinSource().
  std::string Skin();
  std::string Srd(GeometrySource source);
  // Of the surface, by the lights that a fit with that projector held out is fitted to; empty where the surface is
  // taken as it is. All fits share the judged one's, but for kDirectionBlindPlaced, which has its own.
  std::string Offset(GeometrySource source, int heldout, FitKind kind = FitKind::kJudged);
  // The surface put right by that; Shape where there is none.
  std::string PlacedShape(GeometrySource source, int heldout, FitKind kind = FitKind::kJudged);
  std::string Fit(GeometrySource source, int heldout, FitKind kind);
  // Layers by all projectors, the judged fit's beside.
  std::string Maps();
  std::string StandardErrors();
  // Of the placed surface, by the layers that are shown: of all projectors where they are made, else the judged fit's.
  std::string DiffuseNormals();
  // Of the layers that are shown, as the artifact has it: W x H x C, a value for a profile of `srd.pool` quads a side.
  Result<Image<float>> ShownWidths();
  // Of a model by name (evaluation/metrics.h): a fit, or a baseline that is derived from the judged one.
  std::string Predict(const std::string& model, GeometrySource source, int heldout);
  std::string Compare(const std::vector<std::string>& models, GeometrySource source, int heldout);

  [[nodiscard]] StageGraph& stages() { return stages_; }
  [[nodiscard]] std::string JudgedModel() const {
    return options_.fit.em.scattering.mode == FitMode::kTied ? "tied" : "free";
  }
  // The frames that stages of a fit read; none: all.
  [[nodiscard]] const std::optional<ThinPlan>& thin() const { return thin_; }
  // The surface that skin is told on: the reconstructed one, whichever the fits stand on, and nothing of the truth
  // enters; of a thinned visit on the true surface, which may have no codes, the true one.
  [[nodiscard]] GeometrySource SkinSource() const { return thin_ ? options_.geometry : GeometrySource::kReconstructed; }
  [[nodiscard]] int projectors() const { return static_cast<int>(record_.projectors.size()); }
  [[nodiscard]] bool has_truth() const { return !truth_hash_.empty(); }
  // What stages and the report read of artifacts, by key. The last of each kind stays in memory for whoever asks next,
  // until a fit needs the room: pointers are valid until another key of that kind is asked for, or a stage is made.
  Result<const FaceShape*> Face(const std::string& shape);
  Result<const std::vector<SeparationMap>*> Separation(const std::string& separate);
  Result<const FittedLayers*> Layers(const std::string& fit);

  // Every artifact that is there of the nodes added so far, in their order.
  [[nodiscard]] std::vector<std::pair<std::string, db::ArtifactRecord>> Records() const;

 private:
  SessionGraph(const RunOptions& options, const SessionFrames& frames, ArtifactStore artifacts, Logger& logger);
  std::string Add(StageNode node);
  std::string PredictLocalAlbedo(GeometrySource source, int heldout);
  // What the judged fit's options are to a fit of that kind.
  [[nodiscard]] FitOptions FitOptionsOf(FitKind kind) const;
  // The fit that a model is, or is derived from.
  [[nodiscard]] static FitKind KindOf(const std::string& model);
  std::string ShownFit();
  std::string FitOf(const std::string& model, GeometrySource source, int heldout);
  // The session's frames as `record` reads them, and the dark frames that stages have asked of them: those that a fit
  // may read; all, for what judges it.
  Result<const SessionFrames*> Frames(const RigCalibration& record);
  Result<const SessionFrames*> AllFrames(const RigCalibration& record);
  std::string SeparateBy(const std::string& frames_hash, bool of_all);
  // What a fit of that kind is made of: SRDs, by an offset (empty: none), what they share by skin alone.
  struct SrdKeys {
    std::string srd, offset, skin;
    [[nodiscard]] std::map<std::string, std::string> Inputs() const;
    [[nodiscard]] std::vector<std::string> Upstream() const;
  };
  SrdKeys SrdsOf(GeometrySource source, int heldout, FitKind kind = FitKind::kJudged) {
    return {Srd(source), Offset(source, heldout, kind), Skin()};
  }
  Result<const SrdSet*> Srds(const SrdKeys& keys, FitKind kind, int heldout);
  // Of the training lights of these SRDs, found once.
  Result<SharedLight> Shared(const SrdKeys& keys, const SrdSet& srds, int heldout);
  // Of a shape; SRDs make room for it.
  Result<const HeldOutView*> View(const std::string& shape, int heldout);
  Status KeepPrediction(const std::string& predict, const std::filesystem::path& folder, Prediction prediction);
  // The one kept, or read; it is kept no longer.
  Result<Prediction> TakePrediction(const std::string& predict);
  Kept<FittedLayers>& KeptLayers(const std::string& fit) { return fit == judged_fit_ ? judged_layers_ : layers_; }
  Result<const SkinMask*> Mask(const std::string& skin) {
    return mask_.Of(skin, [&] { return stages_.Load(skin, LoadSkin); });
  }
  // Of the profiles of those layers (SrdBatch::apart).
  Result<std::vector<uint8_t>> Apart(const std::string& skin, const FittedLayers& layers);
  Result<MixtureMap> DipoleBaseline(const MixtureMap& fit, const SrdKeys& srds, int heldout);
  void MakeRoomForAFit();
  std::string AddFit(const SrdKeys& from, int heldout, const FitOptions& fit, FitKind kind, const std::string& label);
  [[nodiscard]] std::string LabelOf(const std::string& what, GeometrySource source, int heldout) const;

  const RunOptions options_;
  const std::string session_;
  const RigCalibration record_;
  const PlanOptions plan_;
  Logger& logger_;
  std::optional<ThinPlan> thin_;
  std::string frames_hash_, all_frames_hash_, record_hash_, truth_hash_, isa_;
  StageGraph stages_;
  std::vector<std::string> order_;
  // What one stage leaves for the next.
  Kept<SessionFrames> frames_, all_frames_;
  Kept<DecodedFace> decoded_;
  Kept<FaceShape> face_;
  Kept<std::vector<SeparationMap>> separation_;
  Kept<SkinMask> mask_;
  Kept<PlacedSrds> srds_;
  Kept<HeldOutView> view_;
  std::string judged_fit_;  // the fit that the session's report shows
  Kept<FittedLayers> judged_layers_, layers_;
  std::map<std::string, SharedLight> shared_;
  std::map<std::string, Prediction> predictions_;  // until they are compared
};

}  // namespace stratalux::fit
