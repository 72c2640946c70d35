// SPDX-License-Identifier: Apache-2.0
// SessionArchive: a session of the store as the recorder's archive.
#pragma once

#include "db/catalogue/session_store.h"
#include "firmware-host/recording/recorder.h"

namespace stratalux::rig {

class SessionArchive : public FrameArchive {
 public:
  // `board_pose`: of a calibration session, kept with each frame; -1: none.
  explicit SessionArchive(db::SessionWriter writer, int board_pose = -1)
      : writer_(std::move(writer)), board_pose_(board_pose) {}

  Status Append(const FrameRecord& record, const Image<uint16_t>& pixels) override {
    FrameRecord posed = record;
    posed.pose = board_pose_;
    return writer_.Append(posed, pixels.view());
  }
  Status Flush() override { return writer_.Flush(); }
  Status FlushIfDue() override { return writer_.FlushIfDue(); }
  // For what follows the frames (truth maps, Finish), once the recorder is closed.
  [[nodiscard]] db::SessionWriter& writer() { return writer_; }

 private:
  db::SessionWriter writer_;
  int board_pose_;
};

}  // namespace stratalux::rig
