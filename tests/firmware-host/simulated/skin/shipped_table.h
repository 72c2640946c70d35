// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "firmware-host/simulated/skin/skin_table.h"

namespace stratalux::rig {

// The skin table that is installed; read once.
inline const SkinTable& ShippedTable() {
  static const SkinTable table = *SkinTable::Load(SkinTable::DefaultPath());
  return table;
}

}  // namespace stratalux::rig
