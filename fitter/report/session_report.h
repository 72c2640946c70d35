// SPDX-License-Identifier: Apache-2.0
// The report of a session: the pictures of the paper in its order, then the figures.
#pragma once

#include <filesystem>
#include <vector>

#include "fitter/evaluation/compare.h"
#include "fitter/evaluation/metrics.h"
#include "fitter/report/html_report.h"
#include "fitter/report/layer_pictures.h"
#include "fitter/separation/separation_map.h"
#include "fitter/session/session_frames.h"
#include "fitter/stages/layers_file.h"
#include "fitter/stages/normals.h"
#include "fitter/stages/shape.h"
#include "fitter/stages/skin.h"

namespace stratalux::fit {

struct ReportInput {
  const SessionFrames& frames;
  const FaceShape& shape;
  const std::vector<SeparationMap>& separation;
  const FaceNormals& normals;
  const Image<float>& diffuse_normals;  // W x H x 3C
  const SkinMask& skin;
  const FittedLayers& layers;         // of the fit: what SRDs are held against
  ShownLayers shown;                  // what the maps show: of all projectors, where they were made
  int64_t chosen_profile = -1;        // whose SRDs are shown; -1: none
  std::vector<SrdBatch> chosen_srds;  // of that profile alone, by projector
  std::vector<LightComparison> comparisons;
  int heldout = 0;
};

// The fitted profile nearest to the cheek; -1: none is fitted.
[[nodiscard]] int64_t ProfileToShow(const MixtureMap& map);

// Writes report/index.html and its pictures into `folder`, where report/ is.
Status WriteReport(const std::filesystem::path& folder, const ReportInput& input, const Metrics& metrics,
                   KnownPictures& pictures);

}  // namespace stratalux::fit
