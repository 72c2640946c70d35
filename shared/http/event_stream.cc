// SPDX-License-Identifier: Apache-2.0
#include "shared/http/event_stream.h"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <utility>

namespace stratalux::http {
namespace {

// A line break of any kind would begin another field.
std::string OneLine(std::string text) {
  std::replace_if(
      text.begin(), text.end(), [](char c) { return c == '\r' || c == '\n' || c == '\0'; }, ' ');
  return text;
}

std::string EventText(int64_t id, const std::string& name, const std::string& data) {
  std::string text = "id: " + std::to_string(id) + "\nevent: " + OneLine(name) + "\n";
  for (size_t at = 0; at <= data.size();) {
    const size_t end = std::min(data.find('\n', at), data.size());
    text += "data: " + OneLine(data.substr(at, end - at)) + "\n";
    at = end + 1;
  }
  return text + "\n";
}

}  // namespace

void EventStream::Wake(Viewer& viewer) {
  if (std::exchange(viewer.asleep, false)) viewer.wake();
}

void EventStream::Give(Viewer& viewer, const std::string& text) {
  // An event that is larger than all that may wait reaches who has nothing waiting.
  if (!viewer.waiting.empty() && viewer.waiting.size() + text.size() > options_.viewer_bytes) viewer.dropped = true;
  if (!viewer.dropped) viewer.waiting += text;
  Wake(viewer);
}

void EventStream::Publish(const std::string& name, const std::string& data) {
  const std::lock_guard lock(mutex_);
  if (closed_) return;
  const std::string text = EventText(next_event_, name, data);
  kept_.emplace_back(next_event_++, text);
  kept_bytes_ += text.size();
  // The last one stays, however large.
  while (kept_.size() > 1 && kept_bytes_ > options_.kept_bytes) {
    kept_bytes_ -= kept_.front().second.size();
    kept_.pop_front();
  }
  for (auto& [id, viewer] : viewers_) Give(viewer, text);
}

void EventStream::KeepAlive() {
  const std::lock_guard lock(mutex_);
  // Who has something waiting will be found out by that.
  for (auto& [id, viewer] : viewers_)
    if (viewer.waiting.empty()) Give(viewer, ": keep-alive\n\n");
}

void EventStream::Close() {
  const std::lock_guard lock(mutex_);
  closed_ = true;
  for (auto& [id, viewer] : viewers_) Wake(viewer);
}

size_t EventStream::viewers() const {
  const std::lock_guard lock(mutex_);
  return viewers_.size();
}

int64_t EventStream::Add(const std::string& last_event_id, std::function<void()> wake) {
  const std::lock_guard lock(mutex_);
  int64_t seen = -1;
  std::from_chars(last_event_id.data(), last_event_id.data() + last_event_id.size(), seen);
  Viewer viewer{std::move(wake), "retry: 2000\n\n"};
  // A number that is not yet given is from another run of the program: then the last event alone, as for somebody new.
  const int64_t last = next_event_ - 1;
  const bool known = seen >= 0 && seen <= last;
  for (const auto& [id, text] : kept_)
    if (id == last || (known && id > seen)) viewer.waiting += text;
  viewers_.emplace(next_viewer_, std::move(viewer));
  return next_viewer_++;
}

void EventStream::Remove(int64_t viewer) {
  const std::lock_guard lock(mutex_);
  viewers_.erase(viewer);
}

EventStream::Taken EventStream::Take(int64_t id, std::span<char> buffer, const std::function<void()>& before_wait) {
  const std::lock_guard lock(mutex_);
  const auto found = viewers_.find(id);
  if (found == viewers_.end() || found->second.dropped) return {Taken::State::kEnd};
  Viewer& viewer = found->second;
  if (viewer.waiting.empty() && closed_) return {Taken::State::kEnd};
  if (viewer.waiting.empty()) {
    viewer.asleep = true;
    before_wait();
    return {Taken::State::kWait};
  }
  const size_t bytes = std::min(buffer.size(), viewer.waiting.size());
  std::memcpy(buffer.data(), viewer.waiting.data(), bytes);
  viewer.waiting.erase(0, bytes);
  return {Taken::State::kBytes, bytes};
}

}  // namespace stratalux::http
