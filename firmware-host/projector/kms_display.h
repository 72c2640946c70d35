// SPDX-License-Identifier: Apache-2.0
// Displays driven through the kernel's mode setting (DRM/KMS): XRGB8888 buffers in plain memory, page flips with
// vertical blank events. No desktop, no graphics library, no scaling: a projector pixel is a pixel of the pattern.
#pragma once

#include <memory>
#include <vector>

#include "firmware-host/projector/display.h"
#include "firmware-host/projector/projector_wiring.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// Opens the displays, in order, black. Several may hang on one graphics card. kNotFound: no such card or connector, or
// nothing is plugged in; kUsage: no such mode (the message lists those there are); kBusy: another program, such as a
// desktop, holds the card. Flips are stamped by the kernel with CLOCK_MONOTONIC, in microseconds.
// Displays of one card share a lock; each function may be called from any thread. When a display goes, it is black.
[[nodiscard]] Result<std::vector<std::unique_ptr<Display>>> OpenKmsDisplays(const std::vector<DisplayWiring>& wirings);

// Takes the picture from a display that nobody drives (a program that ended took its own along). kBusy: another program
// is the card's master; the message names those that have it open, as far as this account may see them.
[[nodiscard]] Status BlankDisplay(const DisplayWiring& wiring);

}  // namespace stratalux::rig
