// SPDX-License-Identifier: Apache-2.0
#include "shared/http/target.h"

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <cstdio>

#include "shared/base/printable.h"

namespace stratalux::http {
namespace {

int HexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

bool NamesAPlace(const std::string& segment) {
  if (segment == "." || segment == ".." || !IsUtf8(segment)) return false;
  return std::none_of(segment.begin(), segment.end(), [](char c) {
    return c == '/' || c == '\\' || static_cast<unsigned char>(c) < 0x20 || c == 0x7f;
  });
}

Result<std::string> DecodeQueryText(std::string_view text) {
  std::string spaced(text);
  std::replace(spaced.begin(), spaced.end(), '+', ' ');
  return PercentDecode(spaced);
}

Status ParseQuery(std::string_view text, std::map<std::string, std::string>& query) {
  while (!text.empty()) {
    const size_t end = std::min(text.find('&'), text.size());
    const std::string_view pair = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    if (pair.empty()) continue;
    const size_t equals = std::min(pair.find('='), pair.size());
    SLX_ASSIGN_OR_RETURN(auto name, DecodeQueryText(pair.substr(0, equals)));
    SLX_ASSIGN_OR_RETURN(auto value, DecodeQueryText(pair.substr(std::min(equals + 1, pair.size()))));
    query.emplace(std::move(name), std::move(value));
  }
  return Status::Ok();
}

}  // namespace

Result<std::string> PercentDecode(std::string_view text) {
  std::string decoded;
  for (size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '%') {
      decoded += text[i];
      continue;
    }
    const int high = i + 1 < text.size() ? HexDigit(text[i + 1]) : -1;
    const int low = i + 2 < text.size() ? HexDigit(text[i + 2]) : -1;
    if (high < 0 || low < 0) return Status::Usage("a percent sign must be followed by two hex digits");
    decoded += static_cast<char>(high * 16 + low);
    i += 2;
  }
  return decoded;
}

std::string PercentEncode(std::string_view text) {
  std::string encoded;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte < 0x80 && (std::isalnum(byte) != 0 || c == '-' || c == '.' || c == '_' || c == '~')) {
      encoded += c;
      continue;
    }
    char escape[4];
    std::snprintf(escape, sizeof escape, "%%%02X", byte);
    encoded += escape;
  }
  return encoded;
}

std::string Target::path() const {
  std::string path;
  for (const std::string& segment : segments) path += "/" + segment;
  return path.empty() ? "/" : path;
}

Result<Target> ParseTarget(std::string_view text) {
  if (text.empty() || text.front() != '/') return Status::Usage("the target of a request must be an absolute path");
  Target target;
  const size_t question = std::min(text.find('?'), text.size());
  std::string_view path = text.substr(1, std::max<size_t>(question, 1) - 1);
  while (!path.empty()) {
    const size_t end = std::min(path.find('/'), path.size());
    SLX_ASSIGN_OR_RETURN(auto segment, PercentDecode(path.substr(0, end)));
    if (segment.empty() || !NamesAPlace(segment)) return Status::Usage("the path is not in its normal form");
    target.segments.push_back(std::move(segment));
    path.remove_prefix(std::min(end + 1, path.size()));
  }
  SLX_RETURN_IF_ERROR(ParseQuery(text.substr(std::min(question + 1, text.size())), target.query));
  return target;
}

}  // namespace stratalux::http
