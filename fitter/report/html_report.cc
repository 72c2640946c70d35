// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/html_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include "db/base/own_hash.h"
#include "fitter/export/pictures.h"
#include "fitter/report/svg_drawing.h"
#include "shared/base/formatted.h"
#include "shared/base/parallel_each.h"
#include "shared/image/png.h"

namespace stratalux::fit {
namespace {

constexpr const char* kStyle = R"(
:root{--ink:#1d2330;--soft:#5d6678;--line:#d9dde5;--paper:#fff;--card:#f6f7f9;--accent:#b4532a}
@media (prefers-color-scheme:dark){:root{--ink:#e7e9ee;--soft:#9aa3b5;--line:#343b49;--paper:#14171d;--card:#1c2027;--accent:#e08a5b}}
body{margin:0;background:var(--paper);color:var(--ink);font:15px/1.5 system-ui,sans-serif}
main{max-width:1180px;margin:0 auto;padding:2rem 1.2rem 4rem}
h1{font-size:1.7rem;margin:0}h2{font-size:1.15rem;margin:2.4rem 0 .3rem;border-top:1px solid var(--line);padding-top:1.2rem}
p{margin:.2rem 0 .8rem;color:var(--soft);max-width:75ch}
.row{display:flex;flex-wrap:wrap;gap:.8rem}figure{margin:0;background:var(--card);border:1px solid var(--line);border-radius:6px;padding:.4rem}
figure img{display:block;width:270px;image-rendering:auto;border-radius:3px}figcaption{font-size:.82rem;color:var(--soft);padding:.3rem .2rem 0;max-width:270px}
figure.plot figcaption{max-width:540px}svg text{fill:var(--soft);font:11px system-ui,sans-serif}
.bar{display:flex;gap:.4rem;align-items:center;font-size:.78rem;color:var(--soft);padding:.3rem .2rem 0;width:266px}.bar i{flex:1;height:8px;border-radius:2px;background:linear-gradient(%SCALE%)}
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums;font-size:.88rem}
th,td{padding:.22rem .7rem;text-align:right;border-bottom:1px solid var(--line)}th:first-child,td:first-child{text-align:left}
th{color:var(--soft);font-weight:600}caption{text-align:left;color:var(--soft);padding:.3rem 0}
.banner{margin:1rem 0;padding:.7rem 1rem;border-radius:6px;border-left:6px solid;background:var(--card);font-weight:600}
.good{border-color:#2b9a66}.doubtful{border-color:#d99a1c}.bad{border-color:#c8352b}
)";
std::string Style() {
  const std::string mark = "%SCALE%";
  std::string style = kStyle;
  return style.replace(style.find(mark), mark.size(), ColourScaleCss());
}

std::string Base64(const std::vector<uint8_t>& bytes) {
  constexpr const char* kDigits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (size_t i = 0; i < bytes.size(); i += 3) {
    const unsigned b0 = bytes[i], b1 = i + 1 < bytes.size() ? bytes[i + 1] : 0U,
                   b2 = i + 2 < bytes.size() ? bytes[i + 2] : 0U;
    const unsigned v = b0 << 16 | b1 << 8 | b2;
    out += kDigits[v >> 18];
    out += kDigits[v >> 12 & 63U];
    out += i + 1 < bytes.size() ? kDigits[v >> 6 & 63U] : '=';
    out += i + 2 < bytes.size() ? kDigits[v & 63U] : '=';
  }
  return out;
}

struct Axis {
  double low = 0.0, high = 1.0, from = 0.0, to = 1.0;
  [[nodiscard]] double At(double v) const { return from + (v - low) / (high - low) * (to - from); }
};

Axis FitAxis(const ReportPlot& plot, bool horizontal, double from, double to) {
  Axis axis{1e300, -1e300, from, to};
  for (const ReportSeries& s : plot.series)
    for (double v : horizontal ? s.x : s.y)
      if (std::isfinite(v)) {
        axis.low = std::min(axis.low, v);
        axis.high = std::max(axis.high, v);
      }
  if (!(axis.low < axis.high))
    axis = {axis.low < 1e299 ? axis.low - 1 : 0, axis.low < 1e299 ? axis.low + 1 : 1, from, to};
  if (!horizontal && axis.low > 0.0) axis.low = 0.0;
  return axis;
}

// The round values within the axis.
std::vector<double> TickValues(const Axis& axis) {
  const double step = RoundStep(axis.high - axis.low);
  std::vector<double> values;
  const auto first = static_cast<int64_t>(std::ceil(axis.low / step - 1e-6));
  const auto last = static_cast<int64_t>(std::floor(axis.high / step + 1e-6));
  for (int64_t k = first; k <= last; ++k) values.push_back(static_cast<double>(k) * step);
  return values;
}

void DrawTicks(const Axis& x, const Axis& y, SvgDrawing& svg) {
  for (double v : TickValues(x)) svg.Text({x.At(v), 244}, ShortNumber(v), TextAnchor::kMiddle);
  for (double v : TickValues(y)) {
    svg.Text({54, y.At(v) + 4}, ShortNumber(v), TextAnchor::kEnd);
    svg.Line({58, y.At(v)}, {520, y.At(v)}, "var(--line)");
  }
}

// Names in rows; a name that would leave the picture starts the next row. Returns the height that is needed.
double DrawLegend(const ReportPlot& plot, SvgDrawing& svg) {
  double x = 62, y = 268;
  for (size_t k = 0; k < plot.series.size(); ++k) {
    const ReportSeries& s = plot.series[k];
    if (s.name.empty()) continue;
    const double width = 28 + 6.2 * static_cast<double>(s.name.size());
    if (x > 62 && x + width > 536) {
      x = 62;
      y += 16;
    }
    svg.Rectangle({x, y}, {10, 4}, CurveColour(k));
    svg.Text({x + 14, y + 6}, s.name);
    x += width;
  }
  return y + 14;
}

std::string PlotSvg(const ReportPlot& plot) {
  const Axis x = FitAxis(plot, true, 60, 516), y = FitAxis(plot, false, 226, 14);
  SvgDrawing svg;
  DrawTicks(x, y, svg);
  for (size_t k = 0; k < plot.series.size(); ++k) {
    const ReportSeries& s = plot.series[k];
    std::vector<SvgDrawing::Point> points;
    for (size_t i = 0; i < s.x.size(); ++i) points.emplace_back(x.At(s.x[i]), y.At(s.y[i]));
    if (!s.dots) svg.Polyline(points, CurveColour(k));
    for (size_t i = 0; s.dots && i < points.size(); ++i) svg.Circle(points[i], 2.2, CurveColour(k));
  }
  const double height = DrawLegend(plot, svg);
  svg.Text({288, 260}, plot.x_label, TextAnchor::kMiddle);
  svg.Text({60, 10}, plot.y_label);
  return svg.Svg(540, height);
}

std::string BannerHtml(const ReportBanner& banner) {
  constexpr std::array<const char*, 3> kClasses = {"good", "doubtful", "bad"};
  return std::string("<div class='banner ") + kClasses[static_cast<size_t>(banner.tone)] + "'>" +
         EscapeHtml(banner.text) + "</div>\n";
}

std::string ColourBar(const ReportImage& image) {
  if (image.bar_low.empty()) return "";
  return "<div class='bar'><span>" + EscapeHtml(image.bar_low) + "</span><i></i><span>" + EscapeHtml(image.bar_high) +
         "</span></div>";
}

std::string Linked(const std::string& html, const std::string& link) {
  return link.empty() ? html : "<a href=\"" + EscapeHtml(link) + "\">" + html + "</a>";
}

std::string TableHtml(const ReportTable& table) {
  std::string html = "<table><caption>" + EscapeHtml(table.caption) + "</caption><thead><tr>";
  for (const std::string& cell : table.header) html += "<th>" + EscapeHtml(cell) + "</th>";
  html += "</tr></thead><tbody>";
  for (size_t i = 0; i < table.rows.size(); ++i) {
    html += "<tr>";
    std::string link = i < table.links.size() ? table.links[i] : "";
    for (const std::string& cell : table.rows[i])
      html += "<td>" + Linked(EscapeHtml(cell), std::exchange(link, "")) + "</td>";
    html += "</tr>";
  }
  return html + "</tbody></table>\n";
}

}  // namespace

Result<std::vector<uint8_t>> KnownPictures::AsPng(const Image<uint8_t>& pixels) {
  const std::string key = Formatted("%dx%dx%d ", pixels.width(), pixels.height(), pixels.channels()) +
                          db::HashHex(std::as_const(pixels).pixels());
  {
    const std::lock_guard lock(mutex_);
    if (const auto found = by_pixels_.find(key); found != by_pixels_.end()) return found->second;
  }
  SLX_ASSIGN_OR_RETURN(auto png, EncodePng8(pixels, PngEffort::kFast));
  const std::lock_guard lock(mutex_);
  return by_pixels_[key] = std::move(png);
}

Result<ReportPictures> EncodePictures(const Report& report, KnownPictures& known) {
  std::vector<const ReportImage*> images;
  for (const ReportSection& section : report.sections)
    for (const ReportImage& image : section.images) images.push_back(&image);
  ReportPictures pictures(images.size());
  SLX_RETURN_IF_ERROR(ParallelTry(images.size(), [&](size_t i) -> Status {
    SLX_ASSIGN_OR_RETURN(pictures[i], known.AsPng(images[i]->pixels));
    return Status::Ok();
  }));
  return pictures;
}

Result<std::string> RenderHtml(const Report& report) {
  KnownPictures none;
  SLX_ASSIGN_OR_RETURN(const ReportPictures pictures, EncodePictures(report, none));
  return RenderHtml(report, pictures);
}

std::string RenderHtml(const Report& report, const ReportPictures& pictures) {
  auto png = pictures.begin();
  std::string html =
      "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'><meta name='viewport' content='width=device-width'>"
      "<title>" +
      EscapeHtml(report.title) + "</title><style>" + Style() + "</style></head><body><main>\n<h1>" +
      EscapeHtml(report.title) + "</h1><p>" + EscapeHtml(report.subtitle) + "</p>\n";
  if (report.banner) html += BannerHtml(*report.banner);
  for (const ReportSection& section : report.sections) {
    html += "<h2>" + EscapeHtml(section.title) + "</h2>\n";
    if (!section.text.empty()) html += "<p>" + EscapeHtml(section.text) + "</p>\n";
    html += "<div class='row'>";
    for (const ReportImage& image : section.images) {
      const std::string picture =
          "<img alt=\"" + EscapeHtml(image.caption) + "\" src='data:image/png;base64," + Base64(*png++) + "'>";
      html += "<figure>" + Linked(picture, image.link) + ColourBar(image) + "<figcaption>" + EscapeHtml(image.caption) +
              "</figcaption></figure>\n";
    }
    for (const ReportPlot& plot : section.plots)
      html += "<figure class='plot'>" + PlotSvg(plot) + "<figcaption>" + EscapeHtml(plot.caption) +
              "</figcaption></figure>\n";
    for (const ReportDrawing& drawing : section.drawings)
      html += "<figure class='plot'>" + drawing.svg + "<figcaption style='max-width:" + ShortNumber(drawing.width) +
              "px'>" + EscapeHtml(drawing.caption) + "</figcaption></figure>\n";
    html += "</div>\n";
    for (const ReportTable& table : section.tables) html += TableHtml(table);
  }
  return html + "</main></body></html>\n";
}

}  // namespace stratalux::fit
