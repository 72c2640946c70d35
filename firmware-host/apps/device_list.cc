// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/device_list.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <optional>

#include <grp.h>
#include <sys/stat.h>

#include "firmware-host/gpio/gpio_adapter.h"

namespace stratalux::rig {
namespace {

std::string GroupOf(const std::string& path) {
  struct stat node {};
  if (stat(path.c_str(), &node) != 0) return "";
  const group* entry = getgrgid(node.st_gid);
  return entry != nullptr ? entry->gr_name : std::to_string(node.st_gid);
}

void ListV4l2(DeviceList& list) {
  for (const std::string& path : V4l2Paths()) {
    const UniqueFd fd = OpenV4l2(path);
    if (!fd.ok()) {
      list.refused.push_back(Refusal(path, errno));
      continue;
    }
    if (std::optional<V4l2Node> node = DescribeV4l2(fd.get(), path))
      list.v4l2.push_back(InquireV4l2(fd.get(), *std::move(node)));
  }
}

void ListLibcamera(DeviceList& list) {
  Result<std::vector<LibcameraDevice>> found = LibcameraFrameSource::List();
  list.libcamera_asked = found.status();
  if (found.ok()) list.libcamera = std::move(found).value();
}

template <typename Device>
void ListNodes(const std::vector<std::string>& paths, int (*describe)(const std::string&, Device&),
               std::vector<Device>& devices, std::vector<RefusedDevice>& refused) {
  for (const std::string& path : paths) {
    Device device;
    if (const int error = describe(path, device); error != 0)
      refused.push_back(Refusal(path, error));
    else
      devices.push_back(std::move(device));
  }
}

// The reason and remedy, where a configuration names a device that could not be opened.
std::optional<Status> RefusedAs(const DeviceList& list, const std::string& device) {
  for (const RefusedDevice& refused : list.refused) {
    std::error_code ignored;
    if (device == refused.path || std::filesystem::equivalent(device, refused.path, ignored))
      return Status::Failed(refused.path + ": " + refused.reason + "; " + refused.remedy);
  }
  return std::nullopt;
}

std::string Wanted(const CameraWiring& camera) {
  std::string text;
  for (const auto& [key, value] : {std::pair("device", camera.device), std::pair("driver", camera.driver),
                                   std::pair("card", camera.card), std::pair("bus", camera.bus)})
    if (!value.empty()) text += (text.empty() ? "" : ", ") + std::string(key) + " = \"" + value + "\"";
  return text.empty() ? "the only camera" : text;
}

void AddV4l2(const CameraWiring& wiring, DeviceList& list) {
  WiredDevice wired{"[camera]", Wanted(wiring), "", {}};
  for (const V4l2Camera& camera : list.v4l2) {
    if (!Names(wiring, camera.node)) continue;
    if (!wired.device.empty()) {
      wired.usable =
          Status::Usage(wired.device + " and " + camera.node.path + " both match; give `device` or `bus` as well");
      break;
    }
    wired.device = camera.node.path;
    wired.usable = CanBe(wiring, camera);
  }
  if (wired.device.empty())
    wired.usable =
        RefusedAs(list, wiring.device)
            .value_or(Status::NotFound("no V4L2 camera here matches; check its cable, or name one from the list"));
  list.wired.push_back(std::move(wired));
}

Status FormatOffered(const CameraWiring& wiring, const LibcameraDevice& camera) {
  const auto offers = [&](const LibcameraFormat& format) { return format.name == wiring.format; };
  if (wiring.format.empty() || std::any_of(camera.formats.begin(), camera.formats.end(), offers)) return Status::Ok();
  return Status::Usage(camera.id + " has no format " + wiring.format + "; name one of its formats");
}

void AddLibcamera(const CameraWiring& wiring, DeviceList& list) {
  WiredDevice wired{"[camera]", Wanted(wiring), "", list.libcamera_asked};
  if (wired.usable.ok() && wiring.device.empty() && list.libcamera.size() > 1)
    wired.usable = Status::Usage("libcamera has several cameras; name one as `device`");
  if (wired.usable.ok()) {
    const auto camera = std::find_if(list.libcamera.begin(), list.libcamera.end(), [&](const LibcameraDevice& one) {
      return wiring.device.empty() || one.id == wiring.device;
    });
    const bool there = camera != list.libcamera.end();
    if (there) wired.device = camera->id;
    wired.usable = there ? FormatOffered(wiring, *camera)
                         : Status::NotFound("libcamera has no such camera; check its cable, or name one from the list");
  }
  list.wired.push_back(std::move(wired));
}

void AddLine(const std::string& key, const LineAddress& at, DeviceList& list) {
  WiredDevice wired{key, at.ToString(), "", {}};
  const Result<FoundLine> found = FindLine(list.chips, at);
  wired.usable = found.status();
  if (found.ok()) {
    wired.device = LineName(found->chip_path, found->offset);
    for (const GpioChip& chip : list.chips) {
      if (chip.path != found->chip_path || !chip.lines[found->offset].in_use) continue;
      const std::string& consumer = chip.lines[found->offset].consumer;
      wired.usable = Status::Busy("in use by " + (consumer.empty() ? "a driver of the board" : consumer) +
                                  "; a running rig holds its lines, otherwise end that program or choose another line");
    }
  }
  list.wired.push_back(std::move(wired));
}

template <typename Wiring>
void AddLine(const std::string& key, const std::optional<Wiring>& wiring, DeviceList& list) {
  if (wiring) AddLine(key, wiring->at, list);
}

void AddLines(const GpioWiring& gpio, DeviceList& list) {
  for (size_t p = 0; p < gpio.projectors.size(); ++p) {
    const std::string projector = "[[projector]] " + std::to_string(p) + " ";
    AddLine(projector + "enable", gpio.projectors[p].enable, list);
    AddLine(projector + "trigger", gpio.projectors[p].trigger, list);
    AddLine(projector + "sync", gpio.projectors[p].sync, list);
    AddLine(projector + "reset", gpio.projectors[p].reset, list);
  }
  AddLine("[gpio] camera_trigger", gpio.camera_trigger, list);
  AddLine("[gpio] strobe", gpio.strobe, list);
  AddLine("[gpio] emergency_stop", gpio.emergency_stop, list);
  AddLine("[gpio] door", gpio.door, list);
  AddLine("[gpio] start", gpio.start, list);
}

void AddDisplays(const RigConfig& config, DeviceList& list) {
  for (size_t p = 0; p < config.projectors.size(); ++p) {
    if (config.projectors[p].kind != ProjectorKind::kDisplay) continue;
    DisplayWiring wiring = config.projectors[p].display;
    if (wiring.width == 0) wiring.width = config.plan.projector_width;
    if (wiring.height == 0) wiring.height = config.plan.projector_height;
    WiredDevice wired{"[[projector]] " + std::to_string(p) + " display",
                      wiring.connector + (wiring.device.empty() ? "" : " of " + wiring.device), "",
                      CanShow(wiring, list.cards)};
    for (const KmsCard& card : list.cards)
      for (const KmsConnector& connector : card.connectors)
        if (wired.device.empty() && Names(wiring, card, connector)) wired.device = DisplayName(card, connector);
    if (wired.device.empty()) wired.usable = RefusedAs(list, wiring.device).value_or(wired.usable);
    list.wired.push_back(std::move(wired));
  }
}

}  // namespace

RefusedDevice Refusal(const std::string& path, int error) {
  RefusedDevice refused{path, std::strerror(error), "check that its driver is loaded (dmesg), and plug it in again"};
  if (error == EACCES || error == EPERM)
    refused.remedy =
        "run this as the rig's account and give the device to the rig with a udev rule "
        "(systemd/README.md), or join the group " +
        GroupOf(path);
  if (error == EBUSY) refused.remedy = "another program has it for its exclusive use; end that program";
  return refused;
}

DeviceList ListDevices() {
  DeviceList list;
  ListV4l2(list);
  ListLibcamera(list);
  ListNodes(ChipPaths(), DescribeChip, list.chips, list.refused);
  ListNodes(KmsPaths(), DescribeKmsCard, list.cards, list.refused);
  return list;
}

void AddWired(const RigConfig& config, const std::string& file, DeviceList& list) {
  list.configuration = file;
  list.wired.clear();
  if (config.camera.backend == CameraBackend::kV4l2) AddV4l2(config.camera, list);
  if (config.camera.backend == CameraBackend::kLibcamera) AddLibcamera(config.camera, list);
  AddLines(config.gpio, list);
  AddDisplays(config, list);
}

std::string LineName(const std::string& chip_path, unsigned offset) { return chip_path + ":" + std::to_string(offset); }

std::string DisplayName(const KmsCard& card, const KmsConnector& connector) { return card.path + " " + connector.name; }

std::string LineInToml(const std::vector<GpioChip>& chips, const GpioChip& chip, unsigned offset) {
  const std::string& name = chip.lines[offset].name;
  size_t of_that_name = 0;
  for (const GpioChip& other : chips)
    of_that_name += static_cast<size_t>(
        std::count_if(other.lines.begin(), other.lines.end(), [&](const GpioLine& line) { return line.name == name; }));
  if (!name.empty() && of_that_name == 1) return "{ line = \"" + name + "\" }";
  return "{ chip = \"" + chip.label + "\", offset = " + std::to_string(offset) + " }";
}

}  // namespace stratalux::rig
