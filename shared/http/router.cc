// SPDX-License-Identifier: Apache-2.0
#include "shared/http/router.h"

#include <algorithm>
#include <optional>
#include <utility>

namespace stratalux::http {
namespace {

using Wildcards = std::map<std::string, std::string>;

bool IsWildcard(const std::string& part) { return part.size() > 2 && part.front() == '{' && part.back() == '}'; }

std::optional<Wildcards> Fit(const std::vector<std::string>& pattern, const std::vector<std::string>& segments) {
  Wildcards wildcards;
  for (size_t i = 0; i < pattern.size(); ++i) {
    if (i >= segments.size()) return std::nullopt;
    if (!IsWildcard(pattern[i])) {
      if (pattern[i] != segments[i]) return std::nullopt;
      continue;
    }
    const std::string name = pattern[i].substr(1, pattern[i].size() - 2);
    if (!name.ends_with("...")) {
      wildcards[name] = segments[i];
      continue;
    }
    std::string rest;
    for (size_t s = i; s < segments.size(); ++s) rest += (rest.empty() ? "" : "/") + segments[s];
    wildcards[name.substr(0, name.size() - 3)] = rest;
    return wildcards;
  }
  return pattern.size() == segments.size() ? std::optional(wildcards) : std::nullopt;
}

}  // namespace

const char* ToString(Method method) {
  switch (method) {
    case Method::kGet:
      return "GET";
    case Method::kHead:
      return "HEAD";
    case Method::kPost:
      return "POST";
    case Method::kPut:
      return "PUT";
    case Method::kDelete:
      break;
  }
  return "DELETE";
}

std::string Request::Header(const std::string& name) const {
  const auto found = headers.find(name);
  return found == headers.end() ? "" : found->second;
}
std::string Request::Query(const std::string& name) const {
  const auto found = query.find(name);
  return found == query.end() ? "" : found->second;
}
std::string Request::Wildcard(const std::string& name) const {
  const auto found = wildcards.find(name);
  return found == wildcards.end() ? "" : found->second;
}

Response Response::Of(std::string content_type, std::string bytes, int status) {
  Response response;
  response.status = status;
  response.body = std::move(bytes);
  return std::move(response.With("Content-Type", std::move(content_type)));
}
Response Response::Text(int status, const std::string& text) {
  return Of("text/plain; charset=utf-8", text + "\n", status);
}
Response Response::SeeOther(const std::string& place) {
  Response response = Text(303, "look at " + place);
  return std::move(response.With("Location", place));
}
Response Response::Events(std::shared_ptr<EventStream> stream) {
  Response response;
  response.body = std::move(stream);
  return std::move(response.With("Content-Type", "text/event-stream"));
}

Response Response::Later(SlowAnswer answer) {
  Response response;
  response.body = std::move(answer);
  return response;
}
Response& Response::With(std::string name, std::string value) {
  headers.emplace_back(std::move(name), std::move(value));
  return *this;
}

void Router::Add(Method method, const std::string& pattern, Handler handler, Audience audience) {
  std::vector<std::string> parts;
  for (size_t at = 1; at < pattern.size();) {
    const size_t end = std::min(pattern.find('/', at), pattern.size());
    parts.push_back(pattern.substr(at, end - at));
    at = end + 1;
  }
  routes_.push_back({method, std::move(parts), std::move(handler), audience});
}

Router::Match Router::Find(Method method, const Target& target) const {
  Match match;
  const auto allow = [&match](Method allowed) {
    if (std::find(match.allowed.begin(), match.allowed.end(), allowed) == match.allowed.end())
      match.allowed.push_back(allowed);
  };
  for (const Route& route : routes_) {
    auto wildcards = Fit(route.pattern, target.segments);
    if (!wildcards) continue;
    allow(route.method);
    if (route.method == Method::kGet) allow(Method::kHead);
    const bool answers = route.method == method || (method == Method::kHead && route.method == Method::kGet);
    if (!answers || match.handler != nullptr) continue;
    match.handler = &route.handler;
    match.audience = route.audience;
    match.wildcards = std::move(*wildcards);
  }
  return match;
}

}  // namespace stratalux::http
