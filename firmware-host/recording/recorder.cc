// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/recording/recorder.h"

#include <algorithm>
#include <utility>

namespace stratalux::rig {

namespace {

constexpr std::chrono::milliseconds kPause{250};  // as long as the store keeps a group of frames open

}  // namespace

Recorder::Recorder(FrameArchive& archive, int queue_frames)
    : archive_(archive), queue_(static_cast<size_t>(std::max(1, queue_frames))), thread_([this] { WriteFrames(); }) {}

Recorder::~Recorder() {
  queue_.Close();
  if (thread_.joinable()) thread_.join();
}

Status Recorder::Put(FrameRecord record, Image<uint16_t> pixels) {
  if (queue_.Push({std::move(record), std::move(pixels)})) return Status::Ok();
  const Status status = error();
  return status.ok() ? Status::Failed("the recorder is closed") : status;
}

Status Recorder::Close() {
  queue_.Close();
  if (thread_.joinable()) thread_.join();
  return error();
}

void Recorder::WriteFrames() {
  Status status;
  bool flushed = true;
  while (status.ok()) {
    const std::optional<Item> item = flushed ? queue_.Pop() : queue_.PopWithin(kPause);
    if (item) {
      status = archive_.Append(item->record, item->pixels);
      flushed = false;
    } else if (queue_.finished()) {
      break;
    } else {
      status = archive_.Flush();  // the visitor moves, a retake waits: what came is safe meanwhile
      flushed = true;
    }
  }
  if (status.ok()) status = archive_.Flush();
  if (status.ok()) return;
  // The error stands before the queue closes, so that a producer woken by Close finds the reason.
  SetError(status);
  queue_.Close();
}

Status Recorder::error() const {
  const std::lock_guard lock(error_mutex_);
  return error_;
}

void Recorder::SetError(Status status) {
  const std::lock_guard lock(error_mutex_);
  error_ = std::move(status);
}

}  // namespace stratalux::rig
