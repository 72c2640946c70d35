// SPDX-License-Identifier: Apache-2.0
// `stratalux-db export --crate` and `import --crate`.
#pragma once

#include <string>
#include <vector>

#include "db/apps/command.h"

namespace stratalux::db {

struct CrateFlags {
  std::string crate;  // folder; empty: not asked for
  std::string frames = "tiff16", scope, title, licence;
  bool keep_pseudonym = false;
};

// 0; 2: nothing was written; 3: some sessions were refused, the others are in the crate.
int RunCrateExport(const CommonFlags& common, const std::vector<std::string>& sessions, const CrateFlags& flags);
// 0; 2: all sessions were forgotten here; 3: some of them.
int RunCrateImport(const CommonFlags& common, const std::string& crate);

}  // namespace stratalux::db
