// SPDX-License-Identifier: Apache-2.0
// `stratalux-rig selftest`: the rig's devices, the disk of its store and the codec for it.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "firmware-host/config/rig_config.h"
#include "firmware-host/safety/stop_token.h"
#include "firmware-host/sequence/rig_check.h"
#include "firmware-host/simulated/simulated_rig.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/store_codec.h"

namespace stratalux::rig {

struct SelftestOptions {
  RigCheckOptions rig;
  std::filesystem::path store;            // folder, of which the disk is measured; empty: left out
  StoreCodec codec = StoreCodec::kDelta;  // as configured
  // Keeps the delays of a healthy rig (KeepDelays) and says where; empty: nothing is kept. A refusal fails nothing.
  std::function<Result<std::string>(const RigDelays&)> keep_delays;
};

struct CodecSpeed {
  StoreCodec codec = StoreCodec::kRaw12;
  double frames_per_s = 0.0;  // of one thread, for this rig's frames
  double bytes_per_frame = 0.0;
};

struct SelftestReport {
  RigCheckReport rig;             // its items are the whole table
  double disk_bytes_per_s = 0.0;  // written and synced; 0: not measured
  std::vector<CodecSpeed> codecs;
  StoreCodec recommended = StoreCodec::kDelta;

  [[nodiscard]] bool passed() const;
};

// Fails only where the devices cannot be started or are interrupted; all else is an item of the report.
[[nodiscard]] Result<SelftestReport> RunSelftest(const RigDevices& devices, const SelftestOptions& options);

// A table with the remedies, and histograms of the latencies; one JSON object.
[[nodiscard]] std::string SelftestAsText(const SelftestReport& report);
[[nodiscard]] std::string SelftestAsJson(const SelftestReport& report);
// Of latencies, ms: up to ten rows of equal width from the least to the most, "0.400 ..  0.500 ms | ####  12".
[[nodiscard]] std::string Histogram(const std::vector<double>& values_ms);

// Of the rig that `config` wires, or of the simulated one in its place; what was learnt is kept in StateFolder().
[[nodiscard]] Result<SelftestReport> SelftestOf(const RigConfig& config, std::optional<SimulatedRigOptions> simulated,
                                                StopToken& stop, Logger& logger);

}  // namespace stratalux::rig
