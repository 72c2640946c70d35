// SPDX-License-Identifier: Apache-2.0
// A client that sends what it is told, however wrong, to a server on this machine. Nothing waits for longer than the
// socket's time limit.
#pragma once

#include <map>
#include <string>
#include <string_view>

#include "shared/base/unique_fd.h"

namespace stratalux::http {

struct Answer {
  int status = 0;                              // 0: none came
  std::map<std::string, std::string> headers;  // names in lower case
  std::string body;
};

class Client {
 public:
  // 127.0.0.1, or ::1 with `v6`.
  enum class Family { kV4, kV6 };
  explicit Client(int port, Family family = Family::kV4, int limit_s = 5);
  [[nodiscard]] bool connected() const { return connected_; }
  bool Send(std::string_view bytes);
  // What has come until `text` was among it, the other end closed or the time was over.
  std::string ReadUntil(std::string_view text);
  // Until the other end closes.
  std::string ReadAll();
  // True when the other end has closed within the time limit.
  bool SeesEnd();

 private:
  UniqueFd socket_;
  bool connected_ = false;
};

// A whole request on a connection of its own; "Host" and "Connection: close" are added where `headers` has no Host.
[[nodiscard]] Answer Ask(int port, const std::string& method, const std::string& target,
                         const std::map<std::string, std::string>& headers = {}, const std::string& body = "");
[[nodiscard]] Answer Get(int port, const std::string& target, const std::map<std::string, std::string>& headers = {});
[[nodiscard]] Answer ParseAnswer(const std::string& text);

}  // namespace stratalux::http
