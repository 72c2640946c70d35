// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/camera/raw_format.h"

#include <map>
#include <utility>

namespace stratalux::rig {

std::string FourccText(uint32_t fourcc) {
  std::string text;
  for (int i = 0; i < 4; ++i) text += static_cast<char>(fourcc >> (8 * i) & 0x7fU);
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return (fourcc >> 31) != 0 ? text + "-BE" : text;
}

std::optional<RawFormat> RawFormatOf(const std::string& fourcc_text) {
  using enum RawPacking;
  using enum Cfa;
  static const std::map<std::string, RawFormat> kFormats = {
      {"GREY", {8, kBytes, kMono}},   {"Y10", {10, kWords, kMono}},       {"Y12", {12, kWords, kMono}},
      {"Y16", {16, kWords, kMono}},   {"Y16-BE", {16, kWordsBig, kMono}}, {"Y10P", {10, kMipi10, kMono}},
      {"Y12P", {12, kMipi12, kMono}}, {"BA81", {8, kBytes, kBggr}},       {"GBRG", {8, kBytes, kGbrg}},
      {"GRBG", {8, kBytes, kGrbg}},   {"RGGB", {8, kBytes, kRggb}},       {"BG10", {10, kWords, kBggr}},
      {"GB10", {10, kWords, kGbrg}},  {"BA10", {10, kWords, kGrbg}},      {"RG10", {10, kWords, kRggb}},
      {"pBAA", {10, kMipi10, kBggr}}, {"pGAA", {10, kMipi10, kGbrg}},     {"pgAA", {10, kMipi10, kGrbg}},
      {"pRAA", {10, kMipi10, kRggb}}, {"BG12", {12, kWords, kBggr}},      {"GB12", {12, kWords, kGbrg}},
      {"BA12", {12, kWords, kGrbg}},  {"RG12", {12, kWords, kRggb}},      {"pBCC", {12, kMipi12, kBggr}},
      {"pGCC", {12, kMipi12, kGbrg}}, {"pgCC", {12, kMipi12, kGrbg}},     {"pRCC", {12, kMipi12, kRggb}},
      {"BYR2", {16, kWords, kBggr}},  {"GB16", {16, kWords, kGbrg}},      {"GR16", {16, kWords, kGrbg}},
      {"RG16", {16, kWords, kRggb}},
  };
  const auto found = kFormats.find(fourcc_text);
  return found == kFormats.end() ? std::nullopt : std::optional(found->second);
}

std::optional<StreamFormat> StreamFormatOf(const std::string& name) {
  using enum RawPacking;
  static const std::map<std::string, Cfa> kMosaics = {
      {"SBGGR", Cfa::kBggr}, {"SGBRG", Cfa::kGbrg}, {"SGRBG", Cfa::kGrbg}, {"SRGGB", Cfa::kRggb}, {"R", Cfa::kMono}};
  static const std::map<std::string, std::pair<int, RawPacking>> kDepths = {
      {"8", {8, kBytes}},   {"10", {10, kWords}},        {"12", {12, kWords}},
      {"16", {16, kWords}}, {"10_CSI2P", {10, kMipi10}}, {"12_CSI2P", {12, kMipi12}}};
  if (name == "BGR888") return StreamFormat{.raw = {8, kBytes, Cfa::kMono}, .green_of_bgr = true};
  const size_t digits = name.find_first_of("0123456789");
  if (digits == std::string::npos) return std::nullopt;
  const auto mosaic = kMosaics.find(name.substr(0, digits));
  const auto depth = kDepths.find(name.substr(digits));
  if (mosaic == kMosaics.end() || depth == kDepths.end()) return std::nullopt;
  return StreamFormat{.raw = {depth->second.first, depth->second.second, mosaic->second}};
}

}  // namespace stratalux::rig
