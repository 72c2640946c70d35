// SPDX-License-Identifier: Apache-2.0
// From frames to shape and light components: decode, triangulate, smooth, separate, four-source normals.
#pragma once

#include <vector>

#include "fitter/photometric/photometric_stereo.h"
#include "fitter/pipeline/session_frames.h"
#include "fitter/pipeline/stage_clock.h"
#include "fitter/reconstruction/triangulate.h"
#include "fitter/separation/separate.h"
#include "fitter/structured_light/gray_decoder.h"

namespace stratalux::fit {

// Everything later stages take from the correspondence and separation phases. Vectors are by projector.
struct FaceGeometry {
  std::vector<DecodedMap> decoded;
  std::array<int64_t, kDecodeReasons> decode_counts{};
  TriangulationCounts triangulation;
  SurfaceMap surface;  // smoothed
  std::vector<SeparationMap> separation;
  PhotometricMap photometric;
  Image<float> fused_normal;        // photometric detail on the surface's low frequencies
  std::vector<Image<uint8_t>> lit;  // on quads: this projector reaches the point
};

// Noise of a session's frames: from its own calibration, or what an import's bit depth implies.
[[nodiscard]] SensorNoise NoiseOf(const SessionFrames& frames);

struct CodeSize {
  int columns = 0, rows = 0;  // of the projectors: as the plan says, or the most that the stored code can number
};
[[nodiscard]] CodeSize CodeSizeOf(const SessionFrames& frames);

// Decodes projector p of a session whose frames have `width` x `height` code columns and rows; sinusoids where the plan
// has them.
[[nodiscard]] Result<DecodeReport> DecodeProjector(const SessionFrames& frames, int projector, int pose, int code_width,
                                                   int code_height, const SensorNoise& noise);

[[nodiscard]] Result<FaceGeometry> ReconstructFace(const SessionFrames& frames, StageClock& clock, Logger& logger);

// Quads that a projector lights: decoded where the surface says so, one quad away from any shadow's edge.
[[nodiscard]] Image<uint8_t> LitQuads(const DecodedMap& decoded, const SurfaceMap& surface, const RigCalibration& rig,
                                      int projector);

// Mean over each quad's sites of a colour of (raw - dark), digital numbers; NaN where a site is saturated.
[[nodiscard]] Image<float> QuadSignal(ImageView<const uint16_t> raw, ImageView<const float> dark,
                                      const CameraCalibration& camera);

// Variance of QuadSignal: shot noise of all light that arrived and read noise, digital numbers squared.
[[nodiscard]] Image<float> QuadVariance(ImageView<const uint16_t> raw, const CameraCalibration& camera);

}  // namespace stratalux::fit
