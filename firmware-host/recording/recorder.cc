// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/recording/recorder.h"

#include <algorithm>
#include <exception>
#include <string>
#include <utility>

namespace stratalux::rig {

namespace {
constexpr std::chrono::milliseconds kLook{20};  // between looks at the stop
constexpr std::chrono::milliseconds kIdle{50};  // well below the 250 ms that a frame may wait to be acknowledged
}  // namespace

Recorder::Recorder(FrameArchive& archive, int queue_frames, const StopToken& stop)
    : archive_(archive),
      stop_(stop),
      queue_(static_cast<size_t>(std::max(1, queue_frames))),
      thread_([this] { WriteFrames(); }) {}

Recorder::~Recorder() {
  queue_.Close();
  if (thread_.joinable()) thread_.join();
}

Status Recorder::Put(FrameRecord record, Image<uint16_t> pixels) {
  Item item{std::move(record), std::move(pixels)};
  while (!queue_.PushFor(kLook, item)) {
    if (queue_.closed()) return WhyClosed();
    SLX_RETURN_IF_ERROR(stop_.Check());
  }
  return Status::Ok();
}

Status Recorder::WhyClosed() const {
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
  // Of a library, or for memory: on this thread it would take the program with it.
  try {
    while (status.ok() && !queue_.exhausted()) {
      const std::optional<Item> item = queue_.PopFor(kIdle);
      status = item ? archive_.Append(item->record, item->pixels) : archive_.FlushIfDue();
    }
    if (status.ok()) status = archive_.Flush();
  } catch (const std::exception& error) {
    status = Status::Failed(std::string("the frames' writer: ") + error.what());
  }
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
