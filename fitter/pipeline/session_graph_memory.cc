// SPDX-License-Identifier: Apache-2.0
// What SessionGraph's stages leave in memory for each other: frames, surfaces, SRDs, what all pixels share, layers.
#include <set>
#include <utility>

#include "fitter/evaluation/ablations.h"
#include "fitter/pipeline/session_graph.h"
#include "fitter/stages/layers.h"
#include "fitter/stages/separate.h"
#include "shared/base/parallel_each.h"

namespace stratalux::fit {
namespace {

SrdSet Spoil(SrdSet srds, FitKind kind, int heldout) {
  if (kind == FitKind::kProjectorsPermuted) return WithPermutedProjectors(std::move(srds), heldout);
  if (kind == FitKind::kCombFramesShuffled) return WithShuffledCombFrames(std::move(srds), kShuffleSeed);
  return srds;
}

}  // namespace

Result<const SessionFrames*> SessionGraph::Frames(const RigCalibration& record) {
  return frames_.Of(record.ToJson(), [&]() -> Result<SessionFrames> {
    SLX_ASSIGN_OR_RETURN(auto frames, SessionFrames::Open(options_.store, session_));
    if (thin_) frames.KeepOnly(*thin_);
    frames.UseRecord(record);
    return frames;
  });
}

Result<const SessionFrames*> SessionGraph::AllFrames(const RigCalibration& record) {
  if (!thin_) return Frames(record);
  return all_frames_.Of(record.ToJson(), [&]() -> Result<SessionFrames> {
    SLX_ASSIGN_OR_RETURN(auto frames, SessionFrames::Open(options_.store, session_));
    frames.UseRecord(record);
    return frames;
  });
}

Result<const FaceShape*> SessionGraph::Face(const std::string& shape) {
  return face_.Of(shape, [&] { return stages_.Load(shape, LoadShape); });
}

Result<const std::vector<SeparationMap>*> SessionGraph::Separation(const std::string& separate) {
  return separation_.Of(separate, [&] { return stages_.Load(separate, LoadSeparation); });
}

Result<const SrdSet*> SessionGraph::Srds(const SrdKeys& keys, FitKind kind, int heldout) {
  std::optional<FaceOffset> offset;
  if (!keys.offset.empty()) {
    SLX_ASSIGN_OR_RETURN(offset, stages_.Load(keys.offset, LoadOffset));
  }
  const bool spoilt = IsSpoilt(kind);
  const std::string of =
      spoilt ? keys.srd + " " + keys.offset + " " + ToString(kind) + " " + std::to_string(heldout) : keys.srd;
  const auto load = [&]() -> Result<PlacedSrds> {
    SLX_ASSIGN_OR_RETURN(auto extracted, stages_.Load(keys.srd, LoadSrds));
    SLX_ASSIGN_OR_RETURN(const SkinMask* skin, Mask(keys.skin));
    SLX_RETURN_IF_ERROR(SetApart(extracted.set, *skin));
    PlacedSrds srds(std::move(extracted.set));
    if (!spoilt) return srds;
    srds.MoveTo(offset ? &*offset : nullptr);
    return PlacedSrds(Spoil(srds.Take(), kind, heldout));
  };
  SLX_RETURN_IF_ERROR(srds_.Of(of, load).status());
  if (!spoilt) srds_.Get()->MoveTo(offset ? &*offset : nullptr);
  return &srds_.Get()->set();
}

// All fits but those of spoilt data ask of the same lights. Where a surface is placed, all lights and all but the
// held-out one are asked of: side by side.
Result<SharedLight> SessionGraph::Shared(const SrdKeys& keys, const SrdSet& srds, int heldout) {
  const auto key_of = [&](int left_out) { return keys.srd + " " + keys.skin + " " + std::to_string(left_out); };
  if (const auto known = shared_.find(key_of(heldout)); known != shared_.end()) return known->second;
  std::set<int> asked = {heldout};
  if (keys.srd == Srd(options_.geometry) && !Offset(options_.geometry, kNoneHeldOut).empty())
    asked.insert({kNoneHeldOut, options_.heldout});
  std::vector<std::pair<std::string, TrainingLights>> missing;
  for (const int left_out : asked) {
    if (shared_.contains(key_of(left_out))) continue;
    SLX_ASSIGN_OR_RETURN(auto lights, TrainingLightsOf(srds, left_out));
    missing.emplace_back(key_of(left_out), std::move(lights));
  }
  std::vector<SharedLight> found(missing.size());
  ParallelEach(missing.size(),
               [&](size_t k) { found[k] = FindSharedLight(options_.fit, missing[k].second.batches, srds.Grid()); });
  for (size_t k = 0; k < missing.size(); ++k) shared_[missing[k].first] = found[k];
  return shared_.at(key_of(heldout));
}

Result<const HeldOutView*> SessionGraph::View(const std::string& shape, int heldout) {
  srds_.Drop();
  return view_.Of(shape + " " + std::to_string(heldout), [&]() -> Result<HeldOutView> {
    SLX_ASSIGN_OR_RETURN(const FaceShape* face, Face(shape));
    return ViewOf(*face, plan_, heldout, HeldOutLights(plan_));
  });
}

Result<const FittedLayers*> SessionGraph::Layers(const std::string& fit) {
  Kept<FittedLayers>& kept = KeptLayers(fit);
  return kept.Of(fit, [&] {
    // SRDs and two fits' layers at once would be most of the memory.
    if (!srds_.Empty()) (&kept == &layers_ ? judged_layers_ : layers_).Drop();
    return stages_.Load(fit, LoadLayers);
  });
}

// The samples of a visitor and the layers that come of them are most of a run's memory.
void SessionGraph::MakeRoomForAFit() {
  separation_.Drop();
  view_.Drop();
  judged_layers_.Drop();
  layers_.Drop();
  predictions_.clear();
}

}  // namespace stratalux::fit
