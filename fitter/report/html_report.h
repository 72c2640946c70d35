// SPDX-License-Identifier: Apache-2.0
// Self-contained HTML pages, of a session or a calibration: pictures as data URIs, plots as inline SVG, no script,
// nothing from outside.
#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::fit {

struct ReportImage {
  std::string caption;
  Image<uint8_t> pixels;  // 1 or 3 channels
  // Values at the ends of a bar of ToColourScale's colours; empty: no bar.
  std::string bar_low = {}, bar_high = {};
  std::string link = {};  // where it leads, relative to the page; empty: nowhere
};

struct ReportSeries {
  std::string name;
  std::vector<double> x, y;
  bool dots = false;  // marks instead of a line
};

struct ReportPlot {
  std::string caption, x_label, y_label;
  std::vector<ReportSeries> series;
};

// A picture that is neither photograph nor curve (SvgDrawing).
struct ReportDrawing {
  std::string caption;
  std::string svg;     // one <svg> element, shown as it is
  double width = 540;  // of that element, px; the caption keeps to it
};

struct ReportTable {
  std::string caption;
  std::vector<std::string> header;
  std::vector<std::vector<std::string>> rows;
  // Where each row's first cell leads, relative to the page; empty: nowhere. Empty as a whole: none does.
  std::vector<std::string> links{};
};

struct ReportSection {
  std::string title, text;
  std::vector<ReportImage> images;
  std::vector<ReportPlot> plots;
  std::vector<ReportTable> tables;
  std::vector<ReportDrawing> drawings{};
};

// What a page says before anything else.
enum class Tone { kGood, kDoubtful, kBad };
struct ReportBanner {
  Tone tone = Tone::kGood;
  std::string text;
};

struct Report {
  std::string title, subtitle;
  std::vector<ReportSection> sections;
  std::optional<ReportBanner> banner{};
};

// Pictures that were encoded before: a report that is written again shows most of them again. Thread-safe.
class KnownPictures {
 public:
  [[nodiscard]] Result<std::vector<uint8_t>> AsPng(const Image<uint8_t>& pixels);
  [[nodiscard]] size_t size() const { return by_pixels_.size(); }  // nobody else asking meanwhile

 private:
  std::mutex mutex_;
  std::map<std::string, std::vector<uint8_t>> by_pixels_;  // by size and XXH3-128
};

// The images of all sections, in their order, as PNG files.
using ReportPictures = std::vector<std::vector<uint8_t>>;
[[nodiscard]] Result<ReportPictures> EncodePictures(const Report& report, KnownPictures& known);

[[nodiscard]] Result<std::string> RenderHtml(const Report& report);
// With its pictures, encoded before.
[[nodiscard]] std::string RenderHtml(const Report& report, const ReportPictures& pictures);

}  // namespace stratalux::fit
