// SPDX-License-Identifier: Apache-2.0
// The real programs run on copies of one tiny store, for tests of what must not go well.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux {

// What a file holds, by its path below `folder`. Without what may come and go at any opening: SQLite's -wal and -shm,
// and the unfinished fits, which no program shows.
std::map<std::string, std::string> Contents(const std::filesystem::path& folder);

// Each case gets a fresh folder with a copy of a store that holds the sessions s000001 (a visitor) and s000002 (a
// calibration, hence without sweeps), captured once by the simulated rig at the smallest size that a fit accepts.
class TinyStore : public ::testing::Test {
 protected:
  static void SetUpTestSuite();
  void SetUp() override;
  void TearDown() override;

  // Runs `program arguments` with STRATALUX_STORE set to the store; `before` are shell commands in front.
  Outcome Run(const std::string& program_and_arguments, const std::string& before = "") const;
  // The program must exit with `code`, say one thing on stderr that names all of `parts`, print nothing on stdout and
  // leave the store as it was.
  void ExpectRefused(const std::string& program_and_arguments, int code, const std::vector<std::string>& parts) const;
  // The sessions that nobody touched can still be listed and verified.
  void ExpectUnharmed() const;

  [[nodiscard]] std::filesystem::path Session(const std::string& prefix) const;
  // Writes `text` to FOLDER/name and returns its path.
  [[nodiscard]] std::string File(const std::string& name, const std::string& text) const;

  std::filesystem::path folder_, store_;
};

extern const std::string kTinyConfig;  // rig.toml of those captures

}  // namespace stratalux
