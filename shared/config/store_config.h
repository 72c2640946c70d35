// SPDX-License-Identifier: Apache-2.0
// What the rig's configuration file (docs/examples/rig.toml) says of its store: read by the controller, which fills it,
// and by stratalux-db, which keeps it in order.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "shared/base/result.h"
#include "shared/capture/session.h"
#include "shared/capture/store_codec.h"

namespace stratalux {

class TomlTable;

struct StoreConfig {
  std::string rig = "rig";      // the rig's name, kept with each session
  std::string folder;           // empty: not set here
  std::optional<bool> encrypt;  // frames; unset: a kiosk does, a capture by hand does not
  bool sign = false;            // sessions, with STORE/rig.key (`stratalux-db key sign-init`)
  RetentionDays retention;      // of `stratalux-db purge`
  StoreCodec codec = StoreCodec::kDelta;
};

// Reads [rig], [store] and [retention] of `root`. The caller reads or skips the other tables and calls Finish.
[[nodiscard]] Result<StoreConfig> ReadStoreConfig(TomlTable& root);

// The whole file for a program that is not the controller: its device and plan tables are left unread. kUsage with
// file:line for unreadable files, unknown tables and keys, wrong types and values out of range.
[[nodiscard]] Result<StoreConfig> LoadStoreConfig(const std::filesystem::path& file);

}  // namespace stratalux
