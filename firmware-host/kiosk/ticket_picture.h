// SPDX-License-Identifier: Apache-2.0
// The QR code (ISO/IEC 18004) of a ticket.
#pragma once

#include <string>

#include "shared/base/result.h"

namespace stratalux::rig {

// An SVG document: black modules on white with the four light modules around that readers ask for; error correction M
// (15 % may be covered). kUsage for an empty text or one that no symbol holds.
[[nodiscard]] Result<std::string> TicketPicture(const std::string& text);

}  // namespace stratalux::rig
