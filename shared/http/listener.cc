// SPDX-License-Identifier: Apache-2.0
#include "shared/http/listener.h"

#include <cerrno>
#include <cstring>
#include <utility>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include "shared/http/server.h"

namespace stratalux::http {
namespace {

struct Address {
  sockaddr_storage bytes{};
  socklen_t size = 0;
  [[nodiscard]] sockaddr* get() { return reinterpret_cast<sockaddr*>(&bytes); }
};

bool Parse(const std::string& text, int port, Address& address) {
  auto* v4 = reinterpret_cast<sockaddr_in*>(&address.bytes);
  auto* v6 = reinterpret_cast<sockaddr_in6*>(&address.bytes);
  if (inet_pton(AF_INET, text.c_str(), &v4->sin_addr) == 1) {
    v4->sin_family = AF_INET;
    v4->sin_port = htons(static_cast<uint16_t>(port));
    address.size = sizeof *v4;
    return true;
  }
  if (inet_pton(AF_INET6, text.c_str(), &v6->sin6_addr) != 1) return false;
  v6->sin6_family = AF_INET6;
  v6->sin6_port = htons(static_cast<uint16_t>(port));
  address.size = sizeof *v6;
  return true;
}

Status CannotListen(const std::string& address, int port) {
  const std::string text = "cannot listen on " + address + ", port " + std::to_string(port) + ": ";
  if (errno == EADDRINUSE)
    return Status::Busy(text + "another program listens there; choose another port (0: any free one)");
  if (errno == EACCES) return Status::Failed(text + "ports below 1024 are reserved for the system; choose another");
  if (errno == EADDRNOTAVAIL) return Status::Failed(text + "this machine has no such address");
  return Status::Failed(text + std::strerror(errno));
}

}  // namespace

bool IsLoopback(const std::string& text) {
  in_addr v4{};
  in6_addr v6{};
  if (inet_pton(AF_INET, text.c_str(), &v4) == 1) return ntohl(v4.s_addr) >> 24 == 127;
  return inet_pton(AF_INET6, text.c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

Result<Listener> Listen(const std::string& text, int port) {
  Address address;
  if (!Parse(text, port, address))
    return Status::Usage("'" + text + "' is not an IPv4 or IPv6 address, such as 127.0.0.1 or ::1");
  UniqueFd fd(socket(address.bytes.ss_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!fd.ok()) return CannotListen(text, port);
  const int on = 1;
  // Connections of a server that just ended do not keep the next one waiting; one that listens does.
  (void)setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (address.bytes.ss_family == AF_INET6) (void)setsockopt(fd.get(), IPPROTO_IPV6, IPV6_V6ONLY, &on, sizeof on);
  if (bind(fd.get(), address.get(), address.size) != 0 || listen(fd.get(), 64) != 0) return CannotListen(text, port);
  Address bound;
  bound.size = sizeof bound.bytes;
  if (getsockname(fd.get(), bound.get(), &bound.size) != 0) return CannotListen(text, port);
  const in_port_t given = bound.bytes.ss_family == AF_INET6 ? reinterpret_cast<sockaddr_in6*>(&bound.bytes)->sin6_port
                                                            : reinterpret_cast<sockaddr_in*>(&bound.bytes)->sin_port;
  return Listener{std::move(fd), ntohs(given)};
}

}  // namespace stratalux::http
