// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/control_pipe.h"

#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <map>
#include <utility>

#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

namespace stratalux::rig {
namespace {

constexpr size_t kLongestLine = 200;

const std::map<std::string, Occurrence>& Words() {
  using enum RigSignal;
  using enum SignalLevel;
  static const std::map<std::string, Occurrence> kWords = {{"start", {kStart, kActive}},
                                                           {"door open", {kDoor, kActive}},
                                                           {"door closed", {kDoor, kRest}},
                                                           {"estop press", {kEmergencyStop, kActive}},
                                                           {"estop release", {kEmergencyStop, kRest}},
                                                           {"unplug camera", {kCamera, kActive}},
                                                           {"plug camera", {kCamera, kRest}},
                                                           {"unplug lines", {kLines, kActive}},
                                                           {"plug lines", {kLines, kRest}}};
  return kWords;
}

std::string Why() { return std::strerror(errno); }

}  // namespace

Result<Occurrence> ParseOccurrence(const std::string& line) {
  if (const auto found = Words().find(line); found != Words().end()) return found->second;
  std::string known;
  for (const auto& [word, occurrence] : Words()) known += (known.empty() ? "" : ", ") + word;
  return Status::Usage("'" + line + "' is not an event of a rig; there are: " + known);
}

Status ControlPipe::Take() {
  if (mkfifo(path_.c_str(), 0600) == 0)
    made_ = true;
  else if (errno != EEXIST)
    return Status::Failed(path_.string() + ": cannot create a FIFO: " + Why());
  struct stat found {};
  // Before it is opened: some devices act on that.
  if (lstat(path_.c_str(), &found) != 0) return Status::Failed(path_.string() + ": " + Why());
  if (!S_ISFIFO(found.st_mode))
    return Status::Usage(path_.string() + ": it exists and is not a FIFO; name a path where one can be created");
  held_ = UniqueFd(open(path_.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC | O_NOFOLLOW));
  struct stat opened {};
  if (!held_.ok() || fstat(held_.get(), &opened) != 0) return Status::Failed(path_.string() + ": " + Why());
  if (!S_ISFIFO(opened.st_mode)) return Status::Usage(path_.string() + ": no longer a FIFO");
  if (opened.st_uid != geteuid() || (opened.st_mode & 077U) != 0)
    return Status::Usage(path_.string() + ": a FIFO that others own or may use; remove it, or name another path");
  if (flock(held_.get(), LOCK_EX | LOCK_NB) == 0) return Status::Ok();
  made_ = false;  // it is the other's to remove, which was faster
  return Status::Busy(path_.string() + ": another program reads it, a second stratalux-rig perhaps");
}

Status ControlPipe::OpenForReading() {
  // The FIFO that was taken, whatever stands at its path now.
  const std::string same = "/proc/self/fd/" + std::to_string(held_.get());
  UniqueFd reading(open(same.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC));
  if (!reading.ok()) return Status::Failed(path_.string() + ": " + Why());
  reading_ = std::move(reading);
  return Status::Ok();
}

Result<std::unique_ptr<ControlPipe>> ControlPipe::Open(const std::filesystem::path& path, SimulatedRig& rig,
                                                       Logger& logger) {
  std::unique_ptr<ControlPipe> pipe(new ControlPipe(path, rig, logger));
  SLX_RETURN_IF_ERROR(pipe->Take());
  SLX_RETURN_IF_ERROR(pipe->OpenForReading());
  pipe->ending_ = UniqueFd(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!pipe->ending_.ok()) return Status::Failed("eventfd: " + Why());
  pipe->thread_ = std::thread([raw = pipe.get()] { raw->Listen(); });
  return pipe;
}

ControlPipe::~ControlPipe() {
  if (thread_.joinable()) {
    const uint64_t one = 1;
    // Cannot fail: nobody else writes there.
    static_cast<void>(!write(ending_.get(), &one, sizeof one));
    thread_.join();
  }
  struct stat ours {
  }, there{};
  const bool same = held_.ok() && fstat(held_.get(), &ours) == 0 && lstat(path_.c_str(), &there) == 0 &&
                    ours.st_dev == there.st_dev && ours.st_ino == there.st_ino;
  if (made_ && same) unlink(path_.c_str());
}

void ControlPipe::Listen() {
  // Handlers run on other threads.
  sigset_t all;
  sigfillset(&all);
  for (const int fatal : {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT}) sigdelset(&all, fatal);
  pthread_sigmask(SIG_BLOCK, &all, nullptr);
  while (true) {
    std::array<pollfd, 2> fds = {pollfd{ending_.get(), POLLIN, 0}, pollfd{reading_.get(), POLLIN, 0}};
    poll(fds.data(), fds.size(), -1);
    if (fds[0].revents != 0) return;
    if (fds[1].revents == 0) continue;
    if (!ReadAll()) return logger_.Error(path_.string() + ": cannot be read any more: " + Why());
  }
}

bool ControlPipe::ReadAll() {
  std::array<char, 1024> bytes;
  while (true) {
    const ssize_t count = read(reading_.get(), bytes.data(), bytes.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return errno == EAGAIN;
    if (count == 0) break;
    Hear({bytes.data(), static_cast<size_t>(count)});
  }
  // The last writer went: a hang-up that would be told for ever, and half a line that nobody ends.
  if (!line_.empty() || too_long_) logger_.Warning(path_.string() + ": a line without an end was dropped");
  line_.clear();
  too_long_ = false;
  return OpenForReading().ok();
}

void ControlPipe::Hear(const std::string& bytes) {
  for (const char c : bytes) {
    if (c != '\n') {
      if (line_.size() < kLongestLine)
        line_ += c;
      else
        too_long_ = true;
      continue;
    }
    if (too_long_)
      logger_.Warning(path_.string() + ": a line of more than " + std::to_string(kLongestLine) + " bytes was dropped");
    else
      Obey(line_);
    line_.clear();
    too_long_ = false;
  }
}

void ControlPipe::Obey(const std::string& line) {
  const size_t first = line.find_first_not_of(" \t\r"), last = line.find_last_not_of(" \t\r");
  if (first == std::string::npos) return;
  const std::string word = line.substr(first, last - first + 1);
  const Result<Occurrence> occurrence = ParseOccurrence(word);
  if (!occurrence.ok()) return logger_.Warning(path_.string() + ": " + occurrence.status().message());
  logger_.Info("from outside: " + word);
  rig_.Happen(occurrence->signal, occurrence->level);
}

}  // namespace stratalux::rig
