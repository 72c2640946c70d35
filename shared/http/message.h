// SPDX-License-Identifier: Apache-2.0
// What a browser asks and what it is given.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "shared/base/unique_fd.h"

namespace stratalux::http {

class EventStream;

enum class Method { kGet, kHead, kPost, kPut, kDelete };
[[nodiscard]] const char* ToString(Method method);

struct Request {
  Method method = Method::kGet;
  std::string path;                              // decoded, "/sessions/s000001"
  std::map<std::string, std::string> query;      // decoded; of a name given twice the first counts
  std::map<std::string, std::string> headers;    // names in lower case; of a header given twice the values, with commas
  std::map<std::string, std::string> wildcards;  // of the route: "{id}" -> "id"
  std::string body;
  std::string peer;  // address of the other end, "127.0.0.1"

  // Empty where it was not given.
  [[nodiscard]] std::string Header(const std::string& lower_case_name) const;
  [[nodiscard]] std::string Query(const std::string& name) const;
  [[nodiscard]] std::string Wildcard(const std::string& name) const;
};

// Fills the buffer and says how much it gave; 0 ends the answer. Called from a thread of the server.
using Generator = std::function<size_t(std::span<char> buffer)>;

// A file from its beginning to `bytes`.
struct FileBody {
  UniqueFd fd;
  uint64_t bytes = 0;
};

struct Response;
// Makes an answer that takes long, on a thread beside the server's own (server.h); what it throws is answered by 500.
using SlowAnswer = std::function<Response()>;

struct Response {
  int status = 200;
  // Beside those that every answer carries (server.h); one of the same name replaces that.
  std::vector<std::pair<std::string, std::string>> headers;
  std::variant<std::string, FileBody, Generator, std::shared_ptr<EventStream>, SlowAnswer> body;

  [[nodiscard]] static Response Of(std::string content_type, std::string bytes, int status = 200);
  // Plain text for a person: the reason of a refusal.
  [[nodiscard]] static Response Text(int status, const std::string& text);
  // 303: look there, with GET. `place` is a path of this server.
  [[nodiscard]] static Response SeeOther(const std::string& place);
  [[nodiscard]] static Response Events(std::shared_ptr<EventStream> stream);
  // Of this response nothing else counts; `answer` is not slow itself.
  [[nodiscard]] static Response Later(SlowAnswer answer);
  Response& With(std::string name, std::string value);
};

using Handler = std::function<Response(const Request&)>;

}  // namespace stratalux::http
