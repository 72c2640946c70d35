// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/service_notice.h"

#include <algorithm>
#include <charconv>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

namespace stratalux::rig {
namespace {

std::string Variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

// 0: none.
uint64_t NumberIn(const char* name) {
  const std::string text = Variable(name);
  uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  return error == std::errc() && end == text.data() + text.size() ? number : 0;
}

}  // namespace

ServiceNotice::ServiceNotice() : address_(Variable("NOTIFY_SOCKET")) {
  const bool known = (address_.starts_with('/') || address_.starts_with('@')) && address_.size() > 1 &&
                     address_.size() < sizeof(sockaddr_un::sun_path);
  if (!known) address_.clear();
  if (!address_.empty()) socket_ = UniqueFd(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const uint64_t whose = NumberIn("WATCHDOG_PID");
  if (whose == 0 || whose == static_cast<uint64_t>(getpid()))
    pause_ = std::chrono::microseconds(NumberIn("WATCHDOG_USEC") / 2);
}

bool ServiceNotice::Send(const std::string& text) const {
  if (!socket_.ok()) return true;
  sockaddr_un to{};
  to.sun_family = AF_UNIX;
  std::memcpy(to.sun_path, address_.data(), address_.size());
  if (to.sun_path[0] == '@') to.sun_path[0] = '\0';  // unix(7), "abstract"
  const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + address_.size());
  return sendto(socket_.get(), text.data(), text.size(), MSG_NOSIGNAL | MSG_DONTWAIT,
                reinterpret_cast<const sockaddr*>(&to), size) >= 0;
}

void ServiceNotice::SendWaiting() {
  for (std::string* waiting : {&waiting_once_, &waiting_state_})
    if (!waiting->empty() && Send(*waiting)) waiting->clear();
}

void ServiceNotice::Ready() {
  waiting_once_ = "READY=1";
  SendWaiting();
}

void ServiceNotice::Stopping() {
  waiting_once_ = "STOPPING=1";
  SendWaiting();
}

void ServiceNotice::State(const std::string& text) {
  if (text == state_) return;
  state_ = text;
  waiting_state_ = "STATUS=" + text;
  SendWaiting();
}

void ServiceNotice::Alive() {
  SendWaiting();
  const auto now = std::chrono::steady_clock::now();
  if (pause_.count() == 0 || now < next_) return;
  if (Send("WATCHDOG=1")) next_ = now + pause_;
}

}  // namespace stratalux::rig
