// SPDX-License-Identifier: Apache-2.0
// Folders for a store and for what power cuts leave of it; recorded nights.
#pragma once

#include <cstdlib>
#include <filesystem>

#include <gtest/gtest.h>
#include <unistd.h>

#include "tests/db/crash/disk_recorder.h"
#include "tests/db/crash/store_workload.h"

namespace stratalux::db::crash {

class CrashTest : public ::testing::Test {
 protected:
  void SetUp() override {
    // Thousands of stores: in memory where there is a place for it.
    namespace fs = std::filesystem;
    const fs::path place = access("/dev/shm", W_OK) == 0 ? fs::path("/dev/shm") : fs::temp_directory_path();
    std::string name = (place / "stratalux-crash-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = fs::canonical(name);
    fs::create_directory(Store());
    SkipSyncs();
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  [[nodiscard]] std::filesystem::path Store() const { return folder_ / "store"; }
  [[nodiscard]] std::filesystem::path Remains() const { return folder_ / "remains"; }

  // A night without faults.
  WorkloadReport Record(DiskLog& log, Encryption encryption = Encryption::kNone) {
    StartRecording(Store());
    WorkloadReport report = RunWorkload(Store(), encryption);
    log = StopRecording();
    for (const Status& failure : report.failures) ADD_FAILURE() << failure.message();
    return report;
  }

  std::filesystem::path folder_;
};

}  // namespace stratalux::db::crash
