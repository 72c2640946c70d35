// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/page_front.h"

#include <cerrno>
#include <cstring>
#include <utility>

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include "db/privacy/ticket.h"

namespace stratalux::rig {
namespace {

// Presses that the loop has not heard: more than people can make while it turns.
constexpr size_t kMostWaiting = 64;

void Drain(const UniqueFd& fd) {
  uint64_t count = 0;
  [[maybe_unused]] const ssize_t taken = read(fd.get(), &count, sizeof count);
}

}  // namespace

Status PageFront::Open() {
  pressed_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  second_ = UniqueFd(timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK));
  either_ = UniqueFd(epoll_create1(EPOLL_CLOEXEC));
  const itimerspec each_second{{1, 0}, {1, 0}};
  epoll_event readable{};
  readable.events = EPOLLIN;
  const bool open = pressed_.ok() && second_.ok() && either_.ok() &&
                    timerfd_settime(second_.get(), 0, &each_second, nullptr) == 0 &&
                    epoll_ctl(either_.get(), EPOLL_CTL_ADD, pressed_.get(), &readable) == 0 &&
                    epoll_ctl(either_.get(), EPOLL_CTL_ADD, second_.get(), &readable) == 0;
  return open ? Status::Ok() : Status::Failed(std::string("the kiosk's page: ") + std::strerror(errno));
}

Result<std::unique_ptr<PageFront>> PageFront::Start(const KioskPageOptions& options, Logger& logger) {
  std::unique_ptr<PageFront> front(new PageFront);
  SLX_RETURN_IF_ERROR(front->Open());
  KioskPageInput input;
  input.event = [self = front.get()](const VisitEvent& event) { self->Press(event); };
  input.withdraw = [self = front.get()](const std::string& ticket) { return self->Withdraw(ticket); };
  SLX_ASSIGN_OR_RETURN(front->page_, KioskPage::Start(options, std::move(input), logger));
  return front;
}

void PageFront::Press(const VisitEvent& event) {
  {
    const std::lock_guard lock(mutex_);
    if (waiting_.size() < kMostWaiting) waiting_.push_back(event);
  }
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(pressed_.get(), &one, sizeof one);
}

void PageFront::ServeWithdrawals(Withdrawal withdraw) {
  const std::lock_guard lock(withdraw_mutex_);
  withdraw_ = std::move(withdraw);
}

Status PageFront::Withdraw(const std::string& ticket) {
  SLX_ASSIGN_OR_RETURN(const std::string visitor, db::VisitorOfTicket(ticket));
  const std::lock_guard lock(withdraw_mutex_);
  if (!withdraw_) return Status(StatusCode::kBusy, "the kiosk starts or ends; try again when it is idle");
  return withdraw_(visitor);
}

std::vector<VisitEvent> PageFront::Take() {
  Drain(pressed_);
  Drain(second_);
  page_->Beat();
  const std::lock_guard lock(mutex_);
  return std::exchange(waiting_, {});
}

}  // namespace stratalux::rig
