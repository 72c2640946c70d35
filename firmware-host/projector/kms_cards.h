// SPDX-License-Identifier: Apache-2.0
// The graphics cards of this machine, their connectors and who shows pictures on them: what kms_display.h chooses from,
// and `stratalux-rig devices` prints. All functions are reentrant.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "firmware-host/projector/display_picture.h"
#include "firmware-host/projector/projector_wiring.h"
#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

struct KmsConnector {
  std::string name;  // as the kernel's in /sys/class/drm: "HDMI-A-1"
  bool connected = false;
  std::vector<DisplayMode> modes;  // without interlaced ones; empty where nothing is connected
};

struct KmsCard {
  std::string path;  // /dev/dri/cardN
  std::string driver;
  bool plain_buffers = true;  // else it can show no pattern
  // The DRM master shows its pictures, nobody else can. `master` is "Xorg (812)", or the programs one of which it is.
  bool mastered = false;
  std::string master;
  std::vector<KmsConnector> connectors;
};

// Device nodes of the cards, sorted.
[[nodiscard]] std::vector<std::string> KmsPaths();
// "HDMI-A-1": the name of a connector of this type (the kernel's number) and count.
[[nodiscard]] std::string KmsConnectorName(uint32_t type, uint32_t type_id);
// "Xorg (812), stratalux-rig (1034)": other processes that have the card open.
[[nodiscard]] std::string UsersOfCard(const std::string& path);
// The master among the kernel's list of a card's clients (debugfs dri/N/clients), "Xorg (812)"; empty: none in it.
[[nodiscard]] std::string MasterAmongClients(const std::string& clients);

// An open card that keeps no program from becoming its master: where it had none, the mastership that came with the
// opening was given back. `mastered`: it has another master. Where `fd` is not ok, errno says why.
struct KmsGuest {
  UniqueFd fd;
  bool mastered = false;
};
[[nodiscard]] KmsGuest OpenAsGuest(const std::string& path);

// By a guest's descriptor, for a moment. What is plugged in is what the driver last found; a connector that nobody has
// asked yet is asked, as the card's master, if it has none. 0, or errno of a card that cannot be opened.
[[nodiscard]] int DescribeKmsCard(const std::string& path, KmsCard& card);

// Whether the card and connector are those that a [[projector]] names.
[[nodiscard]] bool Names(const DisplayWiring& wiring, const KmsCard& card, const KmsConnector& connector);
// kNotFound: no such connector, or nothing is plugged into it; kUsage: it lacks that mode (`wiring` has its size);
// kBusy: somebody else is the card's master.
[[nodiscard]] Status CanShow(const DisplayWiring& wiring, std::span<const KmsCard> cards);

}  // namespace stratalux::rig
