// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/display_line_bank.h"

#include <algorithm>
#include <string>
#include <thread>
#include <utility>

namespace stratalux::rig {
namespace {

using std::chrono::steady_clock;

// How long one source of edges is waited for while another may have one.
constexpr auto kPollSlice = std::chrono::milliseconds(1);

}  // namespace

DisplayLineBank::DisplayLineBank(LineBank* lines, std::vector<DisplayOfProjector> displays) : lines_(lines) {
  for (const DisplayOfProjector& wiring : displays) channels_.push_back({.wiring = wiring});
}

Status DisplayLineBank::Flip(Channel& channel) {
  SLX_RETURN_IF_ERROR(channel.wiring.display->Flip());
  channel.pending = true;
  return Status::Ok();
}

Result<TriggerReceipt> DisplayLineBank::TriggerProjector(int projector) {
  SLX_CHECK(projector >= -1 && projector < static_cast<int>(channels_.size()));
  TriggerReceipt receipt{.number = triggers_, .time = MonotonicNow()};
  bool real_line = false;
  for (int p = 0; p < static_cast<int>(channels_.size()); ++p) {
    if (projector >= 0 && p != projector) continue;
    if (channels_[p].wiring.display == nullptr) {
      real_line = true;
      continue;
    }
    SLX_RETURN_IF_ERROR(Flip(channels_[p]).WithContext("display of projector " + std::to_string(p)));
  }
  if (real_line) {
    if (lines_ == nullptr)
      return Status::Failed("the rig has no lines to trigger projector " + std::to_string(projector));
    SLX_ASSIGN_OR_RETURN(const TriggerReceipt pulse, lines_->TriggerProjector(projector));
    receipt.time = std::min(receipt.time, pulse.time);
  }
  ++triggers_;
  return receipt;
}

Result<TriggerReceipt> DisplayLineBank::TriggerCamera() {
  if (lines_ == nullptr) {
    return Status::Failed("the rig has no line to trigger its camera; plan with sync_mode = \"free_running\"");
  }
  SLX_ASSIGN_OR_RETURN(TriggerReceipt pulse, lines_->TriggerCamera());
  pulse.number = triggers_++;
  return pulse;
}

bool DisplayLineBank::AnyPending() const {
  return std::any_of(channels_.begin(), channels_.end(), [](const Channel& c) { return c.pending; });
}

Result<std::optional<SyncEdge>> DisplayLineBank::WaitSync(std::chrono::nanoseconds timeout) {
  const auto deadline = steady_clock::now() + timeout;
  while (true) {
    const bool displays = AnyPending() || !edges_.empty();
    if (displays) {
      const auto until = lines_ != nullptr ? std::min(deadline, steady_clock::now() + kPollSlice) : deadline;
      SLX_ASSIGN_OR_RETURN(std::optional<SyncEdge> edge, WaitEdge(until));
      if (edge) return edge;
    }
    const auto left = std::max<std::chrono::nanoseconds>(deadline - steady_clock::now(), {});
    if (lines_ != nullptr) {
      const auto wait = displays ? std::min<std::chrono::nanoseconds>(left, kPollSlice) : left;
      SLX_ASSIGN_OR_RETURN(std::optional<SyncEdge> edge, lines_->WaitSync(wait));
      if (edge) return edge;
    } else if (!displays) {
      std::this_thread::sleep_for(left);
    }
    if (steady_clock::now() >= deadline) return std::optional<SyncEdge>();
  }
}

Result<std::optional<SyncEdge>> DisplayLineBank::WaitEdge(steady_clock::time_point deadline) {
  do {
    for (int p = 0; p < static_cast<int>(channels_.size()); ++p) {
      Channel& channel = channels_[p];
      if (!channel.pending) continue;
      const auto left = std::max<std::chrono::nanoseconds>(deadline - steady_clock::now(), {});
      SLX_ASSIGN_OR_RETURN(const std::optional<MonotonicNs> flip,
                           channel.wiring.display->WaitFlip(std::min<std::chrono::nanoseconds>(left, kPollSlice)));
      if (!flip) continue;
      channel.pending = false;
      const SyncEdge edge{.projector = p, .sequence = channel.edges++, .time = *flip + channel.wiring.latency};
      edges_.insert(std::upper_bound(edges_.begin(), edges_.end(), edge,
                                     [](const SyncEdge& a, const SyncEdge& b) { return a.time < b.time; }),
                    edge);
    }
    if (edges_.empty()) continue;
    // The edge says the pattern IS on: it is told no earlier.
    const auto dark = edges_.front().time - MonotonicNow();
    const auto left = std::max<std::chrono::nanoseconds>(deadline - steady_clock::now(), {});
    std::this_thread::sleep_for(std::min<std::chrono::nanoseconds>(dark, left));
    if (dark > left) continue;
    const SyncEdge edge = edges_.front();
    edges_.pop_front();
    return std::optional<SyncEdge>(edge);
  } while (steady_clock::now() < deadline);
  return std::optional<SyncEdge>();
}

std::optional<MonotonicNs> DisplayLineBank::LastStrobe() {
  return lines_ != nullptr ? lines_->LastStrobe() : std::nullopt;
}

}  // namespace stratalux::rig
