// SPDX-License-Identifier: Apache-2.0
// What `stratalux-rig devices` lists: the devices of this machine that a rig could be made of, and which of them a
// configuration names. Nothing is taken, switched or changed.
#pragma once

#include <string>
#include <vector>

#include "firmware-host/camera/libcamera_frame_source.h"
#include "firmware-host/camera/v4l2_devices.h"
#include "firmware-host/config/rig_config.h"
#include "firmware-host/gpio/line_search.h"
#include "firmware-host/projector/kms_cards.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// A device that could not be looked at.
struct RefusedDevice {
  std::string path, reason, remedy;
};

// What a configuration names, and what that is here.
struct WiredDevice {
  std::string key;     // where it names it: "[[projector]] 0 enable"
  std::string wanted;  // what it names, in its own words
  std::string device;  // what that is here, a node, an id, LineName or DisplayName; empty: nothing
  Status usable;       // not ok: why it could not be used now, and what to do
};

struct DeviceList {
  std::vector<V4l2Camera> v4l2;
  std::vector<LibcameraDevice> libcamera;
  Status libcamera_asked;  // not ok: why nobody knows
  std::vector<GpioChip> chips;
  std::vector<KmsCard> cards;
  std::vector<RefusedDevice> refused;
  std::string configuration;  // its file; empty: none was looked at
  std::string unreadable;     // why that file tells nothing; empty: it was read
  std::vector<WiredDevice> wired;
};

// All devices that this user may open; those that may not be opened are `refused`.
[[nodiscard]] DeviceList ListDevices();
// Of a device that could not be opened: `error` is open(2)'s errno.
[[nodiscard]] RefusedDevice Refusal(const std::string& path, int error);

// Fills in `wired`, by `list` alone; `file` is where `config` was read.
void AddWired(const RigConfig& config, const std::string& file, DeviceList& list);

// A device's name in `wired`.
[[nodiscard]] std::string LineName(const std::string& chip_path, unsigned offset);
[[nodiscard]] std::string DisplayName(const KmsCard& card, const KmsConnector& connector);
// How rig.toml names a line: { line = "GPIO17" }, or by the chip's label and the offset where the name is not the only
// one of its kind.
[[nodiscard]] std::string LineInToml(const std::vector<GpioChip>& chips, const GpioChip& chip, unsigned offset);

}  // namespace stratalux::rig
