// SPDX-License-Identifier: Apache-2.0
#include "db/transfer/rsync.h"

#include <algorithm>
#include <cstdlib>

#include "shared/base/program.h"

namespace stratalux::db {
namespace {

// What rsync's exit codes (and ssh's 255) leave to do. The program's own words come before it.
std::string Remedy(int code, const std::string& source) {
  const std::string host = source.substr(0, source.find(':'));
  const std::string ssh = "ssh must connect without asking anything: run `ssh " + host +
                          " true` once by hand to accept its host key, `ssh-copy-id " + host + "` to log in with a key";
  const bool is_remote = host.size() < source.size() && host.find('/') == std::string::npos;
  switch (code) {
    case 11:
      return "check the free space and the permissions of the store";
    case 12:  // the other side ended: before it had said a word that may be ssh, whose 255 comes too late at times
      if (is_remote) return ssh + "; and is rsync installed on both sides? apt-get install rsync";
      [[fallthrough]];
    case 127:
      return "is rsync installed on both sides? apt-get install rsync";
    case 30:
    case 35:
      return "the other side did not answer in time; check the network and run pull again to continue";
    case 255:
      return ssh;
    default:
      return "run pull again to continue";
  }
}

std::string OneLine(const std::string& errors) {
  std::string reason = errors.substr(0, std::min(errors.find("\nrsync error"), size_t{1000}));
  std::replace_if(
      reason.begin(), reason.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; }, ' ');
  while (reason.ends_with(' ')) reason.pop_back();
  return reason;
}

// Told to end, rsync keeps what it has of a file for the next time.
std::optional<ProgramLimit> LimitOf(const RsyncLimits& limits) {
  constexpr std::chrono::seconds kGrace(2);
  if (!limits.deadline) return std::nullopt;
  const auto left = std::chrono::ceil<std::chrono::milliseconds>(*limits.deadline - std::chrono::steady_clock::now());
  return ProgramLimit{std::max(left, std::chrono::milliseconds(0)), kGrace};
}

}  // namespace

Result<std::string> Rsync(const RsyncOptions& options, const std::string& source, const std::filesystem::path& target) {
  const std::string seconds = std::to_string(options.limits.timeout.count());
  // -s: names reach the other side as they are. Deltas also between local folders, so that a cut copy is continued.
  // Times to the nanosecond: a file that changed within the second is another one.
  std::vector<std::string> arguments = {
      "rsync", "-rts", "--no-whole-file", "--modify-window=-1", "--partial", "--timeout=" + seconds};
  if (std::getenv("RSYNC_RSH") == nullptr)
    arguments.push_back("--rsh=ssh -o BatchMode=yes -o ConnectTimeout=" + seconds +
                        " -o ServerAliveInterval=15 -o ServerAliveCountMax=4");
  arguments.insert(arguments.end(), options.arguments.begin(), options.arguments.end());
  arguments.insert(arguments.end(), {"--", source, target.string() + "/"});
  auto outcome = RunProgram(arguments, LimitOf(options.limits));
  if (outcome.status().code() == StatusCode::kNotFound)
    return Status::NotFound("pull needs rsync, which is not installed here; apt-get install rsync");
  if (!outcome.ok()) return outcome.status();
  if (outcome->code == 0) return outcome->output;
  const std::string what = "rsync from " + source + " failed (" + std::to_string(outcome->code) +
                           "): " + OneLine(outcome->errors) + "; " + Remedy(outcome->code, source);
  // 23: some files were not transferred; 24: some vanished.
  return outcome->code == 23 || outcome->code == 24 ? Status::Integrity(what) : Status::Failed(what);
}

}  // namespace stratalux::db
