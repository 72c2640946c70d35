// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/apps/devices_command.h"

#include <algorithm>
#include <iterator>
#include <sstream>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "firmware-host/camera/raw_format.h"
#include "shared/base/formatted.h"
#include "shared/base/printable.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t kColumns = 100;

const char* Mosaic(Cfa cfa) {
  switch (cfa) {
    case Cfa::kMono:
      return "mono";
    case Cfa::kRggb:
      return "RGGB";
    case Cfa::kGrbg:
      return "GRBG";
    case Cfa::kGbrg:
      return "GBRG";
    case Cfa::kBggr:
      return "BGGR";
  }
  return "";
}

// `first`, then the words, broken before kColumns and indented like what stands behind `first`.
std::string Wrapped(const std::string& first, const std::vector<std::string>& words) {
  std::string text, line = first;
  for (const std::string& word : words) {
    if (line.size() > first.size() && line.size() + 1 + word.size() > kColumns) {
      text += line + "\n";
      line = std::string(first.size(), ' ');
    }
    line += (line.size() > first.size() ? " " : "") + word;
  }
  return text + line + "\n";
}

// A comma behind each item but the last.
std::string Listed(const std::string& first, std::vector<std::string> items) {
  for (size_t i = 0; i + 1 < items.size(); ++i) items[i] += ",";
  return Wrapped(first, items);
}

std::string Sentence(const std::string& first, const std::string& sentence) {
  std::istringstream stream(sentence);
  return Wrapped(first, {std::istream_iterator<std::string>(stream), {}});
}

std::string WiredText(const DeviceList& list, const std::string& device, const std::string& indent) {
  std::string text;
  for (const WiredDevice& wired : list.wired) {
    if (wired.device != device) continue;
    text += Sentence(indent + "-> ",
                     wired.key + ": " + (wired.usable.ok() ? "usable" : "NOT usable: " + wired.usable.message()));
  }
  return text;
}

std::string SizeText(const V4l2FrameSize& size) {
  std::string text = Formatted("%dx%d", size.max_width, size.max_height);
  if (size.min_width != size.max_width || size.min_height != size.max_height)
    text = Formatted("%dx%d to ", size.min_width, size.min_height) + text;
  if (size.intervals_ms.empty()) return text;
  const auto [least, most] = std::minmax_element(size.intervals_ms.begin(), size.intervals_ms.end());
  return text + (*least == *most ? Formatted(" %.4g ms", *least) : Formatted(" %.4g..%.4g ms", *least, *most));
}

std::string V4l2Text(const DeviceList& list, const V4l2Camera& camera) {
  std::string text = "  " + camera.node.path + "\n    driver = \"" + camera.node.driver + "\", card = \"" +
                     camera.node.card + "\", bus = \"" + camera.node.bus + "\"\n";
  std::vector<std::string> others;
  for (const V4l2PixelFormat& format : camera.formats) {
    const std::optional<RawFormat> raw = RawFormatOf(format.name);
    if (!raw) {
      others.push_back(format.name);
      continue;
    }
    std::vector<std::string> sizes;
    for (const V4l2FrameSize& size : format.sizes) sizes.push_back(SizeText(size));
    if (sizes.empty()) sizes = {"sizes not listed by the driver"};
    text += Listed(Formatted("    %-6s %2d bits %-4s  ", format.name.c_str(), raw->bits, Mosaic(raw->cfa)), sizes);
  }
  if (others.size() == camera.formats.size()) text += "    no raw format: this camera cannot measure light\n";
  if (!others.empty()) text += Listed("    not raw: ", others);
  for (const V4l2Control& control : camera.controls)
    text += Formatted("    %s = \"%s\": %d .. %d, now %d (%s)\n", control.key.c_str(), control.value.c_str(),
                      control.minimum, control.maximum, control.current, control.name.c_str());
  return text + WiredText(list, camera.node.path, "    ");
}

std::optional<RawFormat> RawOf(const LibcameraFormat& format) {
  const std::optional<StreamFormat> known = StreamFormatOf(format.name);
  return known && !known->green_of_bgr ? std::optional(known->raw) : std::nullopt;
}

std::string LibcameraText(const DeviceList& list, const LibcameraDevice& camera) {
  std::string text = "  " + camera.id + (camera.model.empty() ? "" : " (" + camera.model + ")") + "\n";
  for (const LibcameraFormat& format : camera.formats) {
    std::vector<std::string> sizes;
    for (const auto& [width, height] : format.sizes) sizes.push_back(Formatted("%dx%d", width, height));
    const std::optional<RawFormat> raw = RawOf(format);
    const std::string kind = raw ? Formatted("%2d bits %s", raw->bits, Mosaic(raw->cfa)) : "not raw";
    text += Listed(Formatted("    %-14s %-12s  ", format.name.c_str(), kind.c_str()), sizes);
  }
  return text + WiredText(list, camera.id, "    ");
}

std::string ChipText(const DeviceList& list, const GpioChip& chip) {
  std::string text = Formatted("  \"%s\" (%s), %zu lines\n", chip.label.c_str(), chip.path.c_str(), chip.lines.size());
  size_t left_out = 0, width = 0;
  for (unsigned offset = 0; offset < chip.lines.size(); ++offset)
    width = std::max(width, LineInToml(list.chips, chip, offset).size());
  for (unsigned offset = 0; offset < chip.lines.size(); ++offset) {
    const GpioLine& line = chip.lines[offset];
    const std::string wired = WiredText(list, LineName(chip.path, offset), "         ");
    if (line.name.empty() && !line.in_use && wired.empty()) {
      ++left_out;
      continue;
    }
    const std::string use = !line.in_use ? "free" : "used by " + (line.consumer.empty() ? "a driver" : line.consumer);
    const std::string hint = LineInToml(list.chips, chip, offset);
    const bool by_offset = !line.name.empty() && hint.find(line.name) == std::string::npos;
    text += Formatted("    %4u %-*s %-6s %s", offset, static_cast<int>(width), hint.c_str(),
                      line.direction == LineDirection::kOutput ? "output" : "input", use.c_str());
    text += (by_offset ? ", one of several " + line.name : "") + "\n" + wired;
  }
  if (left_out > 0) text += Formatted("    and %zu free lines without a name, by their offset\n", left_out);
  return text;
}

std::string CardText(const DeviceList& list, const KmsCard& card) {
  std::string text = "  " + card.path + " (" + card.driver + ")";
  if (!card.plain_buffers) text += ", shows no plain pictures";
  text += "\n" +
          Sentence("    ", card.mastered ? "its screens are held by " + card.master : "no program holds its screens");
  if (card.connectors.empty()) text += "    no connectors\n";
  for (const KmsConnector& connector : card.connectors) {
    std::vector<std::string> modes;
    for (const DisplayMode& mode : connector.modes)
      modes.push_back(Formatted("%dx%d@%.4g", mode.width, mode.height, mode.refresh_hz));
    if (!connector.connected) modes = {"nothing connected"};
    text += Listed(Formatted("    connector = \"%s\"  ", connector.name.c_str()), modes);
    text += WiredText(list, DisplayName(card, connector), "      ");
  }
  return text;
}

std::string RefusedText(const DeviceList& list) {
  std::string text = list.refused.empty() ? "" : "Could not be examined\n";
  for (const RefusedDevice& refused : list.refused)
    text += Sentence("  " + refused.path + "  ", refused.reason + ": " + refused.remedy);
  return text;
}

// What the configuration names and nothing here is.
std::string MissingText(const DeviceList& list) {
  std::string text;
  for (const WiredDevice& wired : list.wired)
    if (wired.device.empty()) text += Sentence("  " + wired.key + "  ", wired.wanted + ": " + wired.usable.message());
  if (list.configuration.empty()) return "";
  if (!list.unreadable.empty())
    return "Not compared with " + list.configuration + ", which cannot be read\n" + Sentence("  ", list.unreadable);
  if (text.empty()) return "Everything that " + list.configuration + " names is here\n";
  return "Named in " + list.configuration + " but not here\n" + text;
}

Json V4l2Json(const V4l2Camera& camera) {
  Json formats = Json::array(), controls = Json::array();
  for (const V4l2PixelFormat& format : camera.formats) {
    const std::optional<RawFormat> raw = RawFormatOf(format.name);
    Json one = {{"name", format.name}, {"description", format.description}, {"raw", raw.has_value()}};
    if (raw) {
      one["bits"] = raw->bits;
      one["mosaic"] = Mosaic(raw->cfa);
      one["sizes"] = Json::array();
    }
    for (const V4l2FrameSize& size : format.sizes)
      one["sizes"].push_back({{"min_width", size.min_width},
                              {"min_height", size.min_height},
                              {"max_width", size.max_width},
                              {"max_height", size.max_height},
                              {"step_width", size.step_width},
                              {"step_height", size.step_height},
                              {"intervals_ms", size.intervals_ms},
                              {"intervals_are_a_range", size.intervals_are_a_range}});
    formats.push_back(std::move(one));
  }
  for (const V4l2Control& control : camera.controls)
    controls.push_back({{"key", control.key},
                        {"value", control.value},
                        {"name", control.name},
                        {"minimum", control.minimum},
                        {"maximum", control.maximum},
                        {"step", control.step},
                        {"default", control.preset},
                        {"current", control.current}});
  return {{"path", camera.node.path}, {"driver", camera.node.driver}, {"card", camera.node.card},
          {"bus", camera.node.bus},   {"formats", formats},           {"controls", controls}};
}

Json LibcameraJson(const LibcameraDevice& camera) {
  Json formats = Json::array();
  for (const LibcameraFormat& format : camera.formats) {
    Json sizes = Json::array();
    for (const auto& [width, height] : format.sizes) sizes.push_back({{"width", width}, {"height", height}});
    const std::optional<RawFormat> raw = RawOf(format);
    Json one = {{"name", format.name}, {"raw", raw.has_value()}, {"sizes", sizes}};
    if (raw) one["bits"] = raw->bits;
    if (raw) one["mosaic"] = Mosaic(raw->cfa);
    formats.push_back(std::move(one));
  }
  return {{"id", camera.id}, {"model", camera.model}, {"formats", formats}};
}

Json ChipJson(const DeviceList& list, const GpioChip& chip) {
  Json lines = Json::array();
  for (unsigned offset = 0; offset < chip.lines.size(); ++offset) {
    const GpioLine& line = chip.lines[offset];
    lines.push_back({{"device", LineName(chip.path, offset)},
                     {"offset", offset},
                     {"name", line.name},
                     {"direction", line.direction == LineDirection::kOutput ? "output" : "input"},
                     {"in_use", line.in_use},
                     {"consumer", line.consumer},
                     {"rig_toml", LineInToml(list.chips, chip, offset)}});
  }
  return {{"path", chip.path}, {"label", chip.label}, {"lines", lines}};
}

Json CardJson(const KmsCard& card) {
  Json connectors = Json::array();
  for (const KmsConnector& connector : card.connectors) {
    Json modes = Json::array();
    for (const DisplayMode& mode : connector.modes)
      modes.push_back({{"width", mode.width}, {"height", mode.height}, {"refresh_hz", mode.refresh_hz}});
    connectors.push_back({{"device", DisplayName(card, connector)},
                          {"name", connector.name},
                          {"connected", connector.connected},
                          {"modes", modes}});
  }
  return {{"path", card.path},
          {"driver", card.driver},
          {"mastered", card.mastered},
          {"master", card.master},
          {"plain_buffers", card.plain_buffers},
          {"connectors", connectors}};
}

}  // namespace

Result<DeviceList> DevicesBeside(const std::string& config_file, ConfigurationFrom from) {
  if (config_file.empty()) return ListDevices();
  const Result<RigConfig> config = LoadRigConfig(config_file);
  if (!config.ok() && from == ConfigurationFrom::kAsked) return config.status();
  DeviceList list = ListDevices();
  if (config.ok()) {
    AddWired(*config, config_file, list);
  } else {
    list.configuration = config_file;
    list.unreadable = config.status().message();
  }
  return list;
}

std::string DevicesAsText(const DeviceList& list) {
  std::string text = "Cameras (V4L2; [camera] backend = \"v4l2\")\n";
  for (const V4l2Camera& camera : list.v4l2) text += V4l2Text(list, camera);
  if (list.v4l2.empty()) text += "  none: check cable and power, and what dmesg says about its driver\n";
  text += "Cameras (libcamera; [camera] backend = \"libcamera\", device = the id)\n";
  for (const LibcameraDevice& camera : list.libcamera) text += LibcameraText(list, camera);
  if (!list.libcamera_asked.ok())
    text += Sentence("  ", "unknown: " + list.libcamera_asked.message());
  else if (list.libcamera.empty())
    text += "  none: check the ribbon cable, and the overlay of the sensor (/boot/firmware/config.txt)\n";
  text += "GPIO chips and their lines\n";
  for (const GpioChip& chip : list.chips) text += ChipText(list, chip);
  if (list.chips.empty()) text += "  none: check that the chip's driver is loaded (dmesg); a PC needs an adapter\n";
  text += "Displays\n";
  for (const KmsCard& card : list.cards) text += CardText(list, card);
  if (list.cards.empty()) text += "  none: check that the graphics card's driver is loaded (ls /dev/dri, dmesg)\n";
  return PrintableLines(text + RefusedText(list) + MissingText(list));
}

std::string DevicesAsJson(const DeviceList& list) {
  Json json = {{"v4l2", Json::array()},    {"libcamera", Json::array()}, {"libcamera_asked", list.libcamera_asked.ok()},
               {"chips", Json::array()},   {"cards", Json::array()},     {"refused", Json::array()},
               {"configuration", nullptr}, {"wired", Json::array()}};
  for (const V4l2Camera& camera : list.v4l2) json["v4l2"].push_back(V4l2Json(camera));
  for (const LibcameraDevice& camera : list.libcamera) json["libcamera"].push_back(LibcameraJson(camera));
  if (!list.libcamera_asked.ok()) json["libcamera_reason"] = list.libcamera_asked.message();
  for (const GpioChip& chip : list.chips) json["chips"].push_back(ChipJson(list, chip));
  for (const KmsCard& card : list.cards) json["cards"].push_back(CardJson(card));
  for (const RefusedDevice& one : list.refused)
    json["refused"].push_back({{"path", one.path}, {"reason", one.reason}, {"remedy", one.remedy}});
  if (!list.configuration.empty()) json["configuration"] = list.configuration;
  if (!list.unreadable.empty()) json["configuration_unreadable"] = list.unreadable;
  for (const WiredDevice& one : list.wired)
    json["wired"].push_back({{"key", one.key},
                             {"wanted", one.wanted},
                             {"device", one.device},
                             {"usable", one.usable.ok()},
                             {"reason", one.usable.message()}});
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace stratalux::rig
