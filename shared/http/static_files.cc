// SPDX-License-Identifier: Apache-2.0
#include "shared/http/static_files.h"

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>

namespace stratalux::http {
namespace {

constexpr std::pair<const char*, const char*> kTypes[] = {{".html", "text/html; charset=utf-8"},
                                                          {".css", "text/css; charset=utf-8"},
                                                          {".js", "text/javascript; charset=utf-8"},
                                                          {".json", "application/json"},
                                                          {".txt", "text/plain; charset=utf-8"},
                                                          {".csv", "text/csv; charset=utf-8"},
                                                          {".svg", "image/svg+xml"},
                                                          {".png", "image/png"},
                                                          {".jpg", "image/jpeg"},
                                                          {".woff2", "font/woff2"}};

// What lies there and is not for us is as if it were not there; a disk that fails is something else.
Status NotThere(const std::string& relative) {
  constexpr int kAbsent[] = {ENOENT, ELOOP, ENOTDIR, ENAMETOOLONG, ENXIO};
  if (std::find(std::begin(kAbsent), std::end(kAbsent), errno) != std::end(kAbsent))
    return Status::NotFound("no file " + relative);
  return Status::Failed("cannot open " + relative + ": " + std::strerror(errno));
}

}  // namespace

Result<FileBody> OpenBelow(const std::filesystem::path& root, const std::string& relative) {
  UniqueFd at(open(root.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
  if (!at.ok()) return NotThere(relative);
  for (size_t begin = 0; begin <= relative.size();) {
    const size_t end = std::min(relative.find('/', begin), relative.size());
    const std::string name = relative.substr(begin, end - begin);
    if (name.empty() || name == "." || name == ".." || name.find('\0') != std::string::npos)
      return Status::NotFound("no file " + relative);
    const bool last = end == relative.size();
    // Not to wait for the other end of a pipe.
    const int flags = O_RDONLY | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK | (last ? 0 : O_DIRECTORY);
    UniqueFd next(openat(at.get(), name.c_str(), flags));
    if (!next.ok()) return NotThere(relative);
    at = std::move(next);
    begin = end + 1;
  }
  struct stat facts {};
  if (fstat(at.get(), &facts) != 0) return NotThere(relative);
  if (!S_ISREG(facts.st_mode)) return Status::NotFound("no file " + relative);
  return FileBody{std::move(at), static_cast<uint64_t>(facts.st_size)};
}

std::string ContentTypeOf(const std::string& name) {
  for (const auto& [ending, type] : kTypes)
    if (name.ends_with(ending)) return type;
  return "application/octet-stream";
}

Response FileOf(const std::filesystem::path& root, const std::string& relative) {
  auto file = OpenBelow(root, relative);
  if (!file.ok())
    return Response::Text(file.status().code() == StatusCode::kNotFound ? 404 : 500, file.status().message());
  Response response;
  response.body = std::move(*file);
  return std::move(response.With("Content-Type", ContentTypeOf(relative)));
}

}  // namespace stratalux::http
