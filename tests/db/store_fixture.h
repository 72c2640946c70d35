// SPDX-License-Identifier: Apache-2.0
// A store in a folder of its own, and frames whose pixels tell their number.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "db/catalogue/session_store.h"

namespace stratalux::db {

// In memory where there is such a folder: hundreds of stores would wait for the disk's syncs. $TMPDIR overrides.
[[nodiscard]] std::filesystem::path TemporaryFolder();

class StoreTest : public ::testing::Test {
 protected:
  void SetUp() override;
  void TearDown() override;

  [[nodiscard]] SessionStore OpenStore(AccessMode mode = AccessMode::kReadWrite) const;
  // A finished session of `frames` 12-bit frames.
  std::string StoreSession(int frames, const WriterOptions& options = {}) const;
  [[nodiscard]] std::filesystem::path Segment(const std::string& session, int number = 1) const;

  std::filesystem::path folder_;
};

// Groups that no slow machine closes early.
[[nodiscard]] inline WriterOptions Groups(int frames) {
  return {.group_frames = frames, .group_window = std::chrono::hours(1)};
}

// A simulated visitor's session, whose consent records itself.
[[nodiscard]] SessionInfo SimulatedVisit();
// A finding with all that one can have, one with words alone, and two faults.
[[nodiscard]] CaptureFindings SomeFindings();
[[nodiscard]] FrameRecord RecordFor(int step, PixelFormat format, int width, int height, int channels = 1);
// Samples over the format's whole range, different in each frame.
[[nodiscard]] Image<uint16_t> PixelsFor(const FrameRecord& record);
[[nodiscard]] Status AppendTo(SessionWriter& writer, int step);

[[nodiscard]] std::vector<uint8_t> ReadBytes(const std::filesystem::path& file);
void WriteBytes(const std::filesystem::path& file, const std::vector<uint8_t>& bytes);
// In place: rewriting whole files by the thousand waits for the disk.
void FlipBits(const std::filesystem::path& file, size_t at, uint8_t mask);
void WriteText(const std::filesystem::path& file, const std::string& text);

}  // namespace stratalux::db
