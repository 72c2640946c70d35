// SPDX-License-Identifier: Apache-2.0
#include "tests/shared/http/http_client.h"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstdint>

#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/time.h>

namespace stratalux::http {

Client::Client(int port, Family family, int limit_s)
    : socket_(socket(family == Family::kV4 ? AF_INET : AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
  const timeval limit{limit_s, 0};
  setsockopt(socket_.get(), SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
  setsockopt(socket_.get(), SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit);
  if (family == Family::kV4) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    connected_ = connect(socket_.get(), reinterpret_cast<sockaddr*>(&address), sizeof address) == 0;
    return;
  }
  sockaddr_in6 address{};
  address.sin6_family = AF_INET6;
  address.sin6_port = htons(static_cast<uint16_t>(port));
  address.sin6_addr = in6addr_loopback;
  connected_ = connect(socket_.get(), reinterpret_cast<sockaddr*>(&address), sizeof address) == 0;
}

bool Client::Send(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t sent = send(socket_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (sent <= 0) return false;
    bytes.remove_prefix(static_cast<size_t>(sent));
  }
  return true;
}

std::string Client::ReadUntil(std::string_view text) {
  std::string all;
  char buffer[4096];
  while (text.empty() || all.find(text) == std::string::npos) {
    const ssize_t got = recv(socket_.get(), buffer, sizeof buffer, 0);
    if (got <= 0) break;
    all.append(buffer, static_cast<size_t>(got));
  }
  return all;
}

std::string Client::ReadAll() { return ReadUntil(""); }

bool Client::SeesEnd() {
  char buffer[4096];
  ssize_t got = 1;
  while (got > 0) got = recv(socket_.get(), buffer, sizeof buffer, 0);
  return got == 0 || errno == ECONNRESET;
}

Answer ParseAnswer(const std::string& text) {
  Answer answer;
  const size_t end = text.find("\r\n\r\n");
  if (!text.starts_with("HTTP/1.1 ") || end == std::string::npos) return answer;
  answer.status = std::stoi(text.substr(9, 3));
  answer.body = text.substr(end + 4);
  for (size_t at = text.find("\r\n") + 2; at < end;) {
    const size_t stop = text.find("\r\n", at), colon = text.find(": ", at);
    std::string name = text.substr(at, colon - at);
    std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::tolower(c); });
    answer.headers[name] = text.substr(colon + 2, stop - colon - 2);
    at = stop + 2;
  }
  return answer;
}

Answer Ask(int port, const std::string& method, const std::string& target,
           const std::map<std::string, std::string>& headers, const std::string& body) {
  std::string text = method + " " + target + " HTTP/1.1\r\nConnection: close\r\n";
  if (headers.count("Host") == 0) text += "Host: 127.0.0.1:" + std::to_string(port) + "\r\n";
  for (const auto& [name, value] : headers) text += name + ": " + value + "\r\n";
  if (!body.empty()) text += "Content-Length: " + std::to_string(body.size()) + "\r\n";
  Client client(port);
  client.Send(text + "\r\n" + body);
  return ParseAnswer(client.ReadAll());
}

Answer Get(int port, const std::string& target, const std::map<std::string, std::string>& headers) {
  return Ask(port, "GET", target, headers);
}

}  // namespace stratalux::http
