// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_files.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <vector>

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include "shared/base/unique_fd.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kManifestLimit = int64_t{1} << 30;
constexpr size_t kPiece = size_t{1} << 20;

// Open on an ordinary file; its size.
Result<std::pair<UniqueFd, int64_t>> OpenOrdinary(const fs::path& file) {
  // O_NONBLOCK: a pipe must not hold us up.
  UniqueFd fd(open(file.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC));
  struct stat info {};
  if (fd.get() < 0) {
    if (errno == ENOENT) return Status::NotFound("cannot open " + file.string() + ": " + std::strerror(errno));
    if (errno == ELOOP) return Status::Integrity(file.string() + " is a symbolic link; a crate holds ordinary files");
    return Status::Failed("cannot open " + file.string() + ": " + std::strerror(errno));
  }
  if (fstat(fd.get(), &info) != 0) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
  if (!S_ISREG(info.st_mode)) return Status::Integrity(file.string() + " is not an ordinary file");
  return std::pair(std::move(fd), int64_t{info.st_size});
}

bool IsHash(std::string_view text) {
  return text.size() == 64 && std::all_of(text.begin(), text.end(), [](unsigned char c) {
           return std::isdigit(c) != 0 || (c >= 'a' && c <= 'f');
         });
}

bool IsUnreserved(unsigned char c) { return std::isalnum(c) != 0 || c == '-' || c == '.' || c == '_' || c == '~'; }

int HexDigit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

bool IsOurMark(const std::string& name) { return name.starts_with(".stratalux-export-") && name.ends_with(".json"); }

}  // namespace

bool IsCratePath(std::string_view path) {
  if (path.empty() || path.size() > 1024) return false;
  for (const unsigned char c : path)
    if (c < 0x20 || c == 0x7f || c == '\\') return false;
  for (size_t from = 0; from <= path.size();) {
    const size_t end = std::min(path.find('/', from), path.size());
    const std::string_view part = path.substr(from, end - from);
    if (part.empty() || part == "." || part == "..") return false;
    from = end + 1;
  }
  return true;
}

std::string UriOf(std::string_view path) {
  std::string uri;
  for (const char c : path) {
    const auto byte = static_cast<unsigned char>(c);
    if (IsUnreserved(byte) || c == '/') {
      uri += c;
    } else {
      char escaped[4];
      std::snprintf(escaped, sizeof escaped, "%%%02X", byte);
      uri += escaped;
    }
  }
  return uri;
}

std::string PathOfUri(std::string_view uri) {
  std::string path;
  for (size_t i = 0; i < uri.size(); ++i) {
    if (uri[i] != '%') {
      path += uri[i];
      continue;
    }
    const int high = i + 2 < uri.size() ? HexDigit(uri[i + 1]) : -1, low = high >= 0 ? HexDigit(uri[i + 2]) : -1;
    if (low < 0) return {};
    path += static_cast<char>(high * 16 + low);
    i += 2;
  }
  return path;
}

std::string HtmlOf(std::string_view text) {
  std::string html;
  for (const char c : text) {
    switch (c) {
      case '&':
        html += "&amp;";
        break;
      case '<':
        html += "&lt;";
        break;
      case '>':
        html += "&gt;";
        break;
      case '"':
        html += "&quot;";
        break;
      default:
        html += c;
    }
  }
  return html;
}

Result<CrateChecksum> ChecksumOf(const fs::path& file) {
  SLX_ASSIGN_OR_RETURN(const auto opened, OpenOrdinary(file));
  crypto_hash_sha256_state state;
  crypto_hash_sha256_init(&state);
  CrateChecksum sum;
  std::vector<uint8_t> piece(kPiece);
  while (true) {
    const ssize_t got = read(opened.first.get(), piece.data(), piece.size());
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
    if (got == 0) break;
    crypto_hash_sha256_update(&state, piece.data(), static_cast<unsigned long long>(got));
    sum.bytes += got;
  }
  std::array<uint8_t, crypto_hash_sha256_BYTES> hash;
  std::array<char, 2 * crypto_hash_sha256_BYTES + 1> text;
  crypto_hash_sha256_final(&state, hash.data());
  sodium_bin2hex(text.data(), text.size(), hash.data(), hash.size());
  sum.sha256 = text.data();
  return sum;
}

Result<std::string> ReadCrateFile(const fs::path& file, int64_t limit) {
  SLX_ASSIGN_OR_RETURN(const auto opened, OpenOrdinary(file));
  if (opened.second > limit)
    return Status::Integrity(file.string() + " has " + std::to_string(opened.second) + " bytes; at most " +
                             std::to_string(limit) + " are allowed");
  std::string text(static_cast<size_t>(opened.second), '\0');
  size_t at = 0;
  while (at < text.size()) {
    const ssize_t got = read(opened.first.get(), text.data() + at, text.size() - at);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return Status::Failed("cannot read " + file.string() + ": " + std::strerror(errno));
    if (got == 0) return Status::Integrity(file.string() + " became shorter while it was read");
    at += static_cast<size_t>(got);
  }
  return text;
}

std::string CrateManifestText(const CrateFiles& files) {
  std::string text;
  for (const auto& [path, sum] : files) text += sum.sha256 + "  " + path + "\n";
  return text;
}

Result<CrateFiles> ListCrateFiles(const fs::path& crate) {
  CrateFiles files;
  std::error_code error;
  if (!fs::is_directory(fs::symlink_status(crate, error)) && !fs::is_directory(crate, error))
    return Status::NotFound(crate.string() + " is not a folder");
  auto entry = fs::recursive_directory_iterator(crate, error);
  for (; !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
    const fs::file_status status = entry->symlink_status(error);
    const std::string name = entry->path().lexically_relative(crate).string();
    if (fs::is_symlink(status))
      return Status::Integrity(entry->path().string() + " is a symbolic link; a crate holds ordinary files");
    if (!IsCratePath(name))
      return Status::Integrity(crate.string() + ": '" + name + "' is not a valid name for a file of a crate");
    if (entry.depth() > 32) return Status::Integrity(entry->path().string() + " is nested too deeply");
    if (fs::is_directory(status)) continue;
    if (!fs::is_regular_file(status)) return Status::Integrity(entry->path().string() + " is not an ordinary file");
    if (name == kCrateManifestFile || IsOurMark(name)) continue;
    files[name].bytes = static_cast<int64_t>(entry->file_size(error));
  }
  if (error) return Status::Failed("cannot list " + crate.string() + ": " + error.message());
  return files;
}

Result<CrateFiles> ReadCrateManifest(const fs::path& crate, const CrateFiles& present) {
  const std::string file = (crate / kCrateManifestFile).string();
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadCrateFile(file, kManifestLimit));
  CrateFiles listed;
  int64_t line_number = 0;
  for (size_t from = 0; from < text.size();) {
    const size_t end = std::min(text.find('\n', from), text.size());
    const std::string_view line = std::string_view(text).substr(from, end - from);
    from = end + 1;
    const std::string where = file + ":" + std::to_string(++line_number);
    if (line.size() < 67 || !IsHash(line.substr(0, 64)) || line.substr(64, 2) != "  " || !IsCratePath(line.substr(66)))
      return Status::Integrity(where + ": not '<sha256>  <path inside the crate>'");
    const std::string path(line.substr(66));
    const auto there = present.find(path);
    if (there == present.end()) return Status::Integrity(where + ": " + path + " is missing from the crate");
    if (!listed.emplace(path, CrateChecksum{there->second.bytes, std::string(line.substr(0, 64))}).second)
      return Status::Integrity(where + ": " + path + " is listed twice");
  }
  for (const auto& [path, sum] : present)
    if (!listed.contains(path)) return Status::Integrity((crate / path).string() + " is not in " + kCrateManifestFile);
  return listed;
}

}  // namespace stratalux::db
