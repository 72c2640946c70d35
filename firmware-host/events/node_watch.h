// SPDX-License-Identifier: Apache-2.0
// NodeWatch: tells that a device went or came back, by the nodes of a folder such as /dev (inotify).
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "firmware-host/events/rig_events.h"
#include "shared/base/result.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {

struct WatchedDevice {
  RigSignal signal = RigSignal::kCamera;
  std::string prefix;  // of its nodes' names, such as "video": others are not worth a look
  // Whether it is there, asked on the watch's thread.
  std::function<bool()> is_there;
};

class NodeWatch {
 public:
  // Begins by asking whether it is there. `events` outlives the watch. kFailed where the folder cannot be watched.
  static Result<std::unique_ptr<NodeWatch>> Start(const std::string& folder, WatchedDevice device, RigEvents& events);
  ~NodeWatch();
  NodeWatch(const NodeWatch&) = delete;
  NodeWatch& operator=(const NodeWatch&) = delete;

 private:
  NodeWatch(WatchedDevice device, RigEvents& events, UniqueFd changes, UniqueFd ending);
  void Watch();
  // True: something that may be the device's changed.
  bool ReadChanges();

  const WatchedDevice device_;
  RigEvents& events_;
  UniqueFd changes_, ending_;
  bool blind_ = false;  // the folder itself went: only asking is left
  std::thread thread_;
};

}  // namespace stratalux::rig
