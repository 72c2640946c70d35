// SPDX-License-Identifier: Apache-2.0
// The decode stage: projector coordinates of every camera site, of each projector's codes.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "fitter/session/session_frames.h"
#include "fitter/structured_light/gray_decoder.h"
#include "fitter/structured_light/sensor_noise.h"
#include "shared/base/log.h"

namespace stratalux::fit {

inline constexpr int kDecodeVersion = 9;

struct CodeSize {
  // Of the projectors: as plan or import say, or the most that the stored code can number.
  int columns = 0, rows = 0;
};
[[nodiscard]] CodeSize CodeSizeOf(const SessionFrames& frames);

struct CodedAxes {
  bool columns = false, rows = false;
};
// Of which axes the projector's codes were captured, with and without inverses.
[[nodiscard]] CodedAxes CodedAxesOf(const SessionFrames& frames, int projector, int pose);

// A numbered pose's own reference black, else the mean of all of the projector's.
[[nodiscard]] Result<Image<float>> BlackOfPose(const SessionFrames& frames, int projector, int pose);

// kBitsAlone leaves out the sinusoids that were captured: what the codes say by themselves.
enum class CodeReading { kWithSinusoids, kBitsAlone };

// What DecodeProjector does without, and why: frames of codes that are missing, sinusoids of a set that lacks shifts,
// and all sets but the finest of several. Empty: nothing.
[[nodiscard]] std::string UnreadPatterns(const SessionFrames& frames, int projector, int pose);

// Decodes projector p of a session whose frames have `width` x `height` code columns and rows; of the sinusoids those
// that the plan has, without a plan an axis' whole set of one period and all its shifts. An axis without any Gray frame
// is left out; of an axis that has one any others may be missing: a pair's other frame is decided against white and
// black, a bit without both tells nothing. kNotFound: no white, no black or no code.
[[nodiscard]] Result<DecodeReport> DecodeProjector(const SessionFrames& frames, int projector, int pose, int code_width,
                                                   int code_height, const SensorNoise& noise,
                                                   CodeReading reading = CodeReading::kWithSinusoids);

struct DecodedFace {
  std::vector<DecodedMap> maps;  // by projector
  std::array<int64_t, kDecodeReasons> counts{};
};
// Of all projectors of a calibrated session. One without white, black or codes is warned of and decodes nowhere, unless
// all are.
[[nodiscard]] Result<DecodedFace> DecodeFace(const SessionFrames& frames, Logger& logger,
                                             CodeReading reading = CodeReading::kWithSinusoids);

// decoded_<p>.exr, decode.json.
Status SaveDecoded(const std::filesystem::path& folder, const DecodedFace& face);
[[nodiscard]] Result<DecodedFace> LoadDecoded(const std::filesystem::path& folder);

}  // namespace stratalux::fit
