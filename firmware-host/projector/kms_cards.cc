// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/projector/kms_cards.h"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <optional>
#include <sstream>

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>
#include <xf86drm.h>
#include <xf86drmMode.h>

#include "firmware-host/projector/kms_freed.h"
#include "shared/base/unique_fd.h"

namespace stratalux::rig {
namespace {

using Version = std::unique_ptr<drmVersion, Freed<drmFreeVersion>>;
using Resources = std::unique_ptr<drmModeRes, Freed<drmModeFreeResources>>;
using Connector = std::unique_ptr<drmModeConnector, Freed<drmModeFreeConnector>>;

bool IsNumber(const std::string& text) {
  return !text.empty() && text.find_first_not_of("0123456789") == std::string::npos;
}

// Root alone may read the kernel's own list; others learn who it may be.
std::string MasterOf(int fd, const std::string& path) {
  struct stat node {};
  if (fstat(fd, &node) == 0) {
    std::ifstream list("/sys/kernel/debug/dri/" + std::to_string(minor(node.st_rdev)) + "/clients");
    const std::string clients{std::istreambuf_iterator<char>(list), std::istreambuf_iterator<char>()};
    if (const std::string master = MasterAmongClients(clients); !master.empty()) return master;
  }
  return UsersOfCard(path);
}

KmsConnector Describe(const drmModeConnector& connector) {
  KmsConnector described;
  described.name = KmsConnectorName(connector.connector_type, connector.connector_type_id);
  described.connected = connector.connection == DRM_MODE_CONNECTED;
  for (int i = 0; described.connected && i < connector.count_modes; ++i) {
    const drmModeModeInfo& mode = connector.modes[i];
    if ((mode.flags & DRM_MODE_FLAG_INTERLACE) != 0 || mode.htotal == 0 || mode.vtotal == 0) continue;
    described.modes.push_back({.width = mode.hdisplay,
                               .height = mode.vdisplay,
                               .refresh_hz = mode.clock * 1000.0 / (static_cast<double>(mode.htotal) * mode.vtotal)});
  }
  return described;
}

}  // namespace

std::vector<std::string> KmsPaths() {
  std::vector<std::string> paths;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/dev/dri", error))
    if (entry.path().filename().string().starts_with("card")) paths.push_back(entry.path().string());
  std::sort(paths.begin(), paths.end());
  return paths;
}

std::string KmsConnectorName(uint32_t type, uint32_t type_id) {
  const char* name = drmModeGetConnectorTypeName(type);
  return std::string(name != nullptr ? name : "Unknown") + "-" + std::to_string(type_id);
}

std::string UsersOfCard(const std::string& path) {
  std::string users;
  std::error_code error;
  for (const auto& process : std::filesystem::directory_iterator("/proc", error)) {
    const std::string pid = process.path().filename().string();
    if (!IsNumber(pid) || pid == std::to_string(getpid())) continue;
    for (const auto& open : std::filesystem::directory_iterator(process.path() / "fd", error)) {
      if (std::filesystem::read_symlink(open.path(), error) != path) continue;
      std::string name;
      std::getline(std::ifstream(process.path() / "comm"), name);
      users += (users.empty() ? "" : ", ") + name + " (" + pid + ")";
      break;
    }
  }
  return users.empty() ? "a program that this account cannot see" : users;
}

std::string MasterAmongClients(const std::string& clients) {
  // "  command  tgid dev master a  uid  magic", newer kernels append columns. A command may hold blanks: the flag is
  // the first "y" or "n" behind two numbers.
  std::istringstream lines(clients);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words_of_line(line);
    const std::vector<std::string> words{std::istream_iterator<std::string>(words_of_line), {}};
    for (size_t i = 3; i < words.size(); ++i) {
      if ((words[i] != "y" && words[i] != "n") || !IsNumber(words[i - 1]) || !IsNumber(words[i - 2])) continue;
      if (words[i] == "n") break;
      std::string command = words[0];
      for (size_t w = 1; w + 2 < i; ++w) command += " " + words[w];
      return command + " (" + words[i - 2] + ")";
    }
  }
  return "";
}

int DescribeKmsCard(const std::string& path, KmsCard& card) {
  const UniqueFd fd(open(path.c_str(), O_RDWR | O_CLOEXEC));
  if (!fd.ok()) return errno;
  card = {};
  card.path = path;
  const Version version(drmGetVersion(fd.get()));
  if (version && version->name != nullptr) card.driver.assign(version->name, static_cast<size_t>(version->name_len));
  uint64_t dumb = 0;
  card.plain_buffers = drmGetCap(fd.get(), DRM_CAP_DUMB_BUFFER, &dumb) == 0 && dumb != 0;
  // Who opens a card that has no master becomes it.
  card.mastered = drmIsMaster(fd.get()) == 0;
  if (card.mastered) card.master = MasterOf(fd.get(), path);
  const Resources resources(drmModeGetResources(fd.get()));
  for (int i = 0; resources && i < resources->count_connectors; ++i) {
    const Connector connector(drmModeGetConnector(fd.get(), resources->connectors[i]));
    if (connector) card.connectors.push_back(Describe(*connector));
  }
  return 0;
}

bool Names(const DisplayWiring& wiring, const KmsCard& card, const KmsConnector& connector) {
  std::error_code ignored;
  return wiring.connector == connector.name && (wiring.device.empty() || wiring.device == card.path ||
                                                std::filesystem::equivalent(wiring.device, card.path, ignored));
}

Status CanShow(const DisplayWiring& wiring, std::span<const KmsCard> cards) {
  for (const KmsCard& card : cards) {
    const auto connector = std::find_if(card.connectors.begin(), card.connectors.end(),
                                        [&](const KmsConnector& candidate) { return Names(wiring, card, candidate); });
    if (connector == card.connectors.end()) continue;
    const std::string name = card.path + " " + connector->name;
    if (!card.plain_buffers) return Status::NotFound(name + ": this card shows no plain pictures (no dumb buffers)");
    if (!connector->connected) return Status::NotFound(name + ": nothing is plugged in, or it is switched off");
    if (!PickMode(connector->modes, wiring.width, wiring.height, wiring.refresh_hz))
      return Status::Usage(name + " has no mode " + std::to_string(wiring.width) + "x" + std::to_string(wiring.height) +
                           " at the refresh_hz asked for; choose one of its modes");
    if (card.mastered)
      return Status::Busy(name + ": the screen is held by " + card.master + "; end that program before a capture");
    return Status::Ok();
  }
  return Status::NotFound("no connector " + wiring.connector + " on " +
                          (wiring.device.empty() ? "any graphics card that can be opened" : wiring.device));
}

}  // namespace stratalux::rig
