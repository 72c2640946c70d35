// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/session/state_file.h"

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <string>
#include <system_error>
#include <thread>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/durable_file.h"
#include "shared/base/json_number.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr size_t kMostBytes = 64 * 1024;
constexpr int kTries = 100;
constexpr auto kPause = std::chrono::milliseconds(10);

// The bytes of a file that nobody else could have written.
Result<std::string> ReadOwn(const fs::path& file) {
  const UniqueFd fd(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
  if (!fd.ok()) {
    const std::string why = file.string() + ": " + std::strerror(errno);
    return errno == ENOENT ? Status::NotFound(why) : Status::Failed(why);
  }
  struct stat info {};
  if (fstat(fd.get(), &info) != 0) return Status::Failed(file.string() + ": " + std::strerror(errno));
  if (!S_ISREG(info.st_mode)) return Status::Failed(file.string() + " is not a regular file; remove it");
  if (info.st_uid != geteuid() && info.st_uid != 0)
    return Status::Failed(file.string() + " belongs to account " + std::to_string(info.st_uid) + ", this is " +
                          std::to_string(geteuid()) + "; run `stratalux-rig` as the service's account");
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0)
    return Status::Failed(file.string() +
                          " can be written by others than its owner; chmod 600 it once its content is known to be "
                          "right, or remove it");
  std::string text(kMostBytes, '\0');
  const ssize_t bytes = read(fd.get(), text.data(), text.size());
  if (bytes < 0) return Status::Failed(file.string() + ": " + std::strerror(errno));
  text.resize(static_cast<size_t>(bytes));
  return text;
}

// What was read: kNewerSchema, or kIntegrity where it is not what we write.
Status Parse(const fs::path& file, const std::string& text, int schema,
             const std::function<void(const std::string& json)>& take) {
  try {
    const Json json = Json::parse(text);
    if (WholeAt<int64_t>(json, "schema") != schema)
      return Status(StatusCode::kNewerSchema, file.string() + ": schema " + json.at("schema").dump() +
                                                  ", this program knows " + std::to_string(schema));
    take(text);
    return Status::Ok();
  } catch (const Json::exception& error) {
    return Status::Integrity(file.string() + " is not what `stratalux-rig` writes: " + error.what());
  }
}

// Two programs write one after the other. Who holds on to it (anybody who may read the folder can) stops nobody for
// long.
Result<UniqueFd> LockFolder(const fs::path& folder) {
  UniqueFd fd(open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd.ok()) return Status::Failed("cannot write in " + folder.string() + ": " + std::strerror(errno));
  for (int tries = 0; flock(fd.get(), LOCK_EX | LOCK_NB) != 0; ++tries) {
    if (errno != EWOULDBLOCK && errno != EINTR)
      return Status::Failed("cannot lock " + folder.string() + ": " + std::strerror(errno));
    if (tries == kTries) return Status(StatusCode::kBusy, folder.string() + " is locked by another program");
    std::this_thread::sleep_for(kPause);
  }
  return fd;
}

// What ReplaceFile writes into: for its owner alone, whatever the process's umask, which is that of all its threads.
Status MakePrivate(const fs::path& file) {
  const UniqueFd fd(open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0600));
  return fd.ok() ? Status::Ok() : Status::Failed("cannot create " + file.string() + ": " + std::strerror(errno));
}

}  // namespace

fs::path StateFolder() {
  const char* folder = std::getenv("STATE_DIRECTORY");
  const std::string all = folder != nullptr && *folder != '\0' ? folder : "/var/lib/stratalux";
  return all.substr(0, all.find(':'));
}

Status KeepState(const fs::path& file, const std::string& json) {
  SLX_ASSIGN_OR_RETURN(const UniqueFd lock, LockFolder(file.parent_path()));
  // What a killed run left beside it may be another account's.
  std::error_code ignored;
  fs::remove(file.string() + ".new", ignored);
  SLX_RETURN_IF_ERROR(MakePrivate(file.string() + ".new"));
  return db::ReplaceFile(file, json);
}

Status ReadState(const fs::path& file, int schema, const std::function<void(const std::string& json)>& take) {
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadOwn(file));
  const Status taken = Parse(file, text, schema, take);
  return taken.code() == StatusCode::kIntegrity ? Status::Failed(taken.message()) : taken;
}

Status TakeState(const fs::path& file, int schema, const std::function<void(const std::string& json)>& take) {
  const Result<std::string> text = ReadOwn(file);
  if (text.status().code() == StatusCode::kNotFound) return text.status();
  if (!text.ok())
    return Status::Failed(text.status().message() + "; it stays as it is, and this program saves nothing in its place");
  const Status taken = Parse(file, *text, schema, take);
  if (taken.ok()) return taken;
  const std::string aside = file.string() + (taken.code() == StatusCode::kNewerSchema ? ".newer" : ".damaged");
  fs::path to = aside;
  std::error_code error;
  for (int n = 2; fs::exists(fs::symlink_status(to, error)); ++n) to = aside + "-" + std::to_string(n);
  fs::rename(file, to, error);
  if (error)
    return Status::Failed(taken.message() + "; it could not be set aside: " + error.message() +
                          "; this program saves nothing in its place");
  return {taken.code(), taken.message() + "; set aside as " + to.string()};
}

}  // namespace stratalux::rig
