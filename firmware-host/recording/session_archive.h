// SPDX-License-Identifier: Apache-2.0
// SessionArchive: a session of the store as the recorder's archive.
#pragma once

#include "db/session_store.h"
#include "firmware-host/recording/recorder.h"

namespace stratalux::rig {

class SessionArchive : public FrameArchive {
 public:
  explicit SessionArchive(db::SessionWriter writer) : writer_(std::move(writer)) {}

  Status Append(const FrameRecord& record, const Image<uint16_t>& pixels) override {
    return writer_.Append(record, pixels.view());
  }
  Status Flush() override { return writer_.Flush(); }
  Status FlushIfDue() override { return writer_.FlushIfDue(); }
  // For what follows the frames (truth maps, Finish), once the recorder is closed.
  [[nodiscard]] db::SessionWriter& writer() { return writer_; }

 private:
  db::SessionWriter writer_;
};

}  // namespace stratalux::rig
