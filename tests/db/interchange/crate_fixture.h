// SPDX-License-Identifier: Apache-2.0
// A store with sessions worth a crate, and another store to read it back into.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "db/interchange/crate_export.h"
#include "db/interchange/crate_import.h"
#include "shared/capture/rig_calibration.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {

inline constexpr const char* kVisitor = "v-77ab3f";

class CrateTest : public StoreTest {
 protected:
  void SetUp() override;
  void TearDown() override;

  // A visitor's session of real life with plan, calibration, a fit whose report names the visitor; consent to fit and
  // research.
  std::string Visit();
  // A degraded session of kind flat with reasons and frames of 8, 12 and 16 bits in raw codecs, over two segments.
  std::string Flats();
  // A simulated session with truth.
  std::string Simulated();

  Result<CrateReport> Export(const std::vector<std::string>& ids, CrateOptions options = {});
  Result<CrateImportReport> Import();
  // Writes manifest-sha256.txt, and the description's checksums, anew after a file was changed.
  void Reseal();
  // All rows of a store that speak of a session, without the numbers that a store gives.
  [[nodiscard]] static std::string RowsOf(const std::filesystem::path& store, const std::string& id);
  [[nodiscard]] Outcome Db(const std::string& arguments) const;

  std::filesystem::path base_, crate_, other_;
  Logger logger_{LogLevel::kError};
};

[[nodiscard]] RigCalibration SomeCalibration();
[[nodiscard]] std::string TextOfFile(const std::filesystem::path& file);

}  // namespace stratalux::db
