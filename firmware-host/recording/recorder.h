// SPDX-License-Identifier: Apache-2.0
// Recorder: a FrameSink that writes on a thread of its own, through a bounded queue.
#pragma once

#include <memory>
#include <mutex>
#include <thread>

#include "firmware-host/recording/bounded_queue.h"
#include "firmware-host/safety/stop_token.h"
#include "firmware-host/sequence/frame_sink.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// What the recorder writes to: a session of the store (session_archive.h) or, in tests, anything that can fail.
// Used by one thread at a time.
class FrameArchive {
 public:
  virtual ~FrameArchive() = default;
  virtual Status Append(const FrameRecord& record, const Image<uint16_t>& pixels) = 0;
  // Returns once all appended frames are safe.
  virtual Status Flush() = 0;
  // Called every few milliseconds while no frame comes: appended frames that have waited long enough become safe.
  virtual Status FlushIfDue() { return Status::Ok(); }
};

class Recorder : public FrameSink {
 public:
  // Flushes when no frame came for 250 ms. The archive is used by the writer thread alone until Close() returns.
  // `queue_frames` >= 1 bounds the memory. Once stopped, nobody waits for space any more; what is queued is written.
  Recorder(FrameArchive& archive, int queue_frames, const StopToken& stop);
  ~Recorder() override;
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  // Waits while the queue is full. The archive's error, from the first frame it could not write onwards.
  Status Put(FrameRecord record, Image<uint16_t> pixels) override;
  // Writes what is queued, flushes, ends the thread. The archive's first error; safe to call again.
  Status Close();

 private:
  struct Item {
    FrameRecord record;
    Image<uint16_t> pixels;
  };
  void WriteFrames();
  [[nodiscard]] Status WhyClosed() const;
  [[nodiscard]] Status error() const;
  void SetError(Status status);

  FrameArchive& archive_;
  const StopToken& stop_;
  BoundedQueue<Item> queue_;
  mutable std::mutex error_mutex_;
  Status error_;
  std::thread thread_;
};

}  // namespace stratalux::rig
