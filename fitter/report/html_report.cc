// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/html_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

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
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums;font-size:.88rem}
th,td{padding:.22rem .7rem;text-align:right;border-bottom:1px solid var(--line)}th:first-child,td:first-child{text-align:left}
th{color:var(--soft);font-weight:600}caption{text-align:left;color:var(--soft);padding:.3rem 0}
)";
constexpr std::array<const char*, 8> kColours = {"#3b6fd4", "#d1602c", "#2b9a66", "#8a55c9",
                                                 "#c23b6b", "#7a7f2a", "#1f9db3", "#8c8c8c"};

std::string Escape(const std::string& text) {
  std::string out;
  for (char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  }
  return out;
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

std::string Number(double v) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", v);
  return text;
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

std::string Ticks(const Axis& x, const Axis& y) {
  std::string svg;
  for (int k = 0; k <= 4; ++k) {
    const double vx = x.low + (x.high - x.low) * k / 4, vy = y.low + (y.high - y.low) * k / 4;
    svg += "<text x='" + Number(x.At(vx)) + "' y='244' text-anchor='middle'>" + Number(vx) + "</text>";
    svg += "<text x='50' y='" + Number(y.At(vy) + 4) + "' text-anchor='end'>" + Number(vy) + "</text>";
    svg += "<line x1='56' x2='520' y1='" + Number(y.At(vy)) + "' y2='" + Number(y.At(vy)) + "' stroke='var(--line)'/>";
  }
  return svg;
}

std::string PlotSvg(const ReportPlot& plot) {
  const Axis x = FitAxis(plot, true, 60, 516), y = FitAxis(plot, false, 226, 14);
  std::string svg = "<svg width='540' height='282' viewBox='0 0 540 282' role='img'>" + Ticks(x, y);
  double legend = 62;
  for (size_t k = 0; k < plot.series.size(); ++k) {
    const ReportSeries& s = plot.series[k];
    const std::string colour = kColours[k % kColours.size()];
    std::string points;
    for (size_t i = 0; i < s.x.size(); ++i) {
      if (!std::isfinite(s.x[i]) || !std::isfinite(s.y[i])) continue;
      if (s.dots) {
        svg += "<circle cx='" + Number(x.At(s.x[i])) + "' cy='" + Number(y.At(s.y[i])) + "' r='2.2' fill='" + colour +
               "'/>";
      } else {
        points += Number(x.At(s.x[i])) + "," + Number(y.At(s.y[i])) + " ";
      }
    }
    if (!points.empty())
      svg += "<polyline fill='none' stroke='" + colour + "' stroke-width='1.5' points='" + points + "'/>";
    if (s.name.empty()) continue;
    svg += "<rect x='" + Number(legend) + "' y='268' width='10' height='4' fill='" + colour + "'/><text x='" +
           Number(legend + 14) + "' y='274'>" + Escape(s.name) + "</text>";
    legend += 28 + 6.2 * static_cast<double>(s.name.size());
  }
  return svg + "<text x='288' y='260' text-anchor='middle'>" + Escape(plot.x_label) + "</text><text x='60' y='10'>" +
         Escape(plot.y_label) + "</text></svg>";
}

std::string TableHtml(const ReportTable& table) {
  std::string html = "<table><caption>" + Escape(table.caption) + "</caption><thead><tr>";
  for (const std::string& cell : table.header) html += "<th>" + Escape(cell) + "</th>";
  html += "</tr></thead><tbody>";
  for (const auto& row : table.rows) {
    html += "<tr>";
    for (const std::string& cell : row) html += "<td>" + Escape(cell) + "</td>";
    html += "</tr>";
  }
  return html + "</tbody></table>\n";
}

}  // namespace

Result<std::string> RenderHtml(const Report& report) {
  std::string html =
      "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'><meta name='viewport' content='width=device-width'>"
      "<title>" +
      Escape(report.title) + "</title><style>" + kStyle + "</style></head><body><main>\n<h1>" + Escape(report.title) +
      "</h1><p>" + Escape(report.subtitle) + "</p>\n";
  for (const ReportSection& section : report.sections) {
    html += "<h2>" + Escape(section.title) + "</h2>\n";
    if (!section.text.empty()) html += "<p>" + Escape(section.text) + "</p>\n";
    html += "<div class='row'>";
    for (const ReportImage& image : section.images) {
      SLX_ASSIGN_OR_RETURN(const auto png, EncodePng8(image.pixels));
      html += "<figure><img alt=\"" + Escape(image.caption) + "\" src='data:image/png;base64," + Base64(png) +
              "'><figcaption>" + Escape(image.caption) + "</figcaption></figure>\n";
    }
    for (const ReportPlot& plot : section.plots)
      html +=
          "<figure class='plot'>" + PlotSvg(plot) + "<figcaption>" + Escape(plot.caption) + "</figcaption></figure>\n";
    html += "</div>\n";
    for (const ReportTable& table : section.tables) html += TableHtml(table);
  }
  return html + "</main></body></html>\n";
}

}  // namespace stratalux::fit
