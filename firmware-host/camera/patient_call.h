// SPDX-License-Identifier: Apache-2.0
// A call that may wait for a device for ever, on a thread of its own.
#pragma once

#include <chrono>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <thread>
#include <utility>

namespace stratalux::rig {

// What the call returns; nullopt: nothing within `patience`. Then the call goes on, and must own all that it touches.
template <typename T>
std::optional<T> CallPatiently(std::chrono::nanoseconds patience, std::function<T()> call) {
  auto task = std::make_shared<std::packaged_task<T()>>(std::move(call));
  std::future<T> done = task->get_future();
  std::thread([task]() mutable {
    (*task)();
    task.reset();
  }).detach();
  if (done.wait_for(patience) != std::future_status::ready) return std::nullopt;
  return std::optional<T>(done.get());
}

}  // namespace stratalux::rig
