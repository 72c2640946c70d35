// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/html_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
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
.bar{display:flex;gap:.4rem;align-items:center;font-size:.78rem;color:var(--soft);padding:.3rem .2rem 0;width:266px}.bar i{flex:1;height:8px;border-radius:2px;background:linear-gradient(%SCALE%)}
table{border-collapse:collapse;margin:.6rem 0;font-variant-numeric:tabular-nums;font-size:.88rem}
th,td{padding:.22rem .7rem;text-align:right;border-bottom:1px solid var(--line)}th:first-child,td:first-child{text-align:left}
th{color:var(--soft);font-weight:600}caption{text-align:left;color:var(--soft);padding:.3rem 0}
)";
constexpr std::array<const char*, 8> kColours = {"#3b6fd4", "#d1602c", "#2b9a66", "#8a55c9",
                                                 "#c23b6b", "#7a7f2a", "#1f9db3", "#8c8c8c"};

std::string Style() {
  const std::string mark = "%SCALE%";
  std::string style = kStyle;
  return style.replace(style.find(mark), mark.size(), ColourScaleCss());
}

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

// The round step (1, 2 or 5 times a power of ten) that cuts `span` into four to ten parts.
double RoundStep(double span) {
  const double power = std::pow(10.0, std::floor(std::log10(span / 4.0)));
  const double parts = span / 4.0 / power;  // 1 .. 10
  return power * (parts >= 5.0 ? 5.0 : parts >= 2.0 ? 2.0 : 1.0);
}

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

std::string Ticks(const Axis& x, const Axis& y) {
  std::string svg;
  for (double v : TickValues(x))
    svg += "<text x='" + Number(x.At(v)) + "' y='244' text-anchor='middle'>" + Number(v) + "</text>";
  for (double v : TickValues(y)) {
    svg += "<text x='54' y='" + Number(y.At(v) + 4) + "' text-anchor='end'>" + Number(v) + "</text>";
    svg += "<line x1='58' x2='520' y1='" + Number(y.At(v)) + "' y2='" + Number(y.At(v)) + "' stroke='var(--line)'/>";
  }
  return svg;
}

struct Legend {
  std::string svg;
  double height = 0.0;
};

// Names in rows; a name that would leave the picture starts the next row.
Legend LegendSvg(const ReportPlot& plot) {
  Legend legend;
  double x = 62, y = 268;
  for (size_t k = 0; k < plot.series.size(); ++k) {
    const ReportSeries& s = plot.series[k];
    if (s.name.empty()) continue;
    const double width = 28 + 6.2 * static_cast<double>(s.name.size());
    if (x > 62 && x + width > 536) {
      x = 62;
      y += 16;
    }
    legend.svg += "<rect x='" + Number(x) + "' y='" + Number(y) + "' width='10' height='4' fill='" +
                  kColours[k % kColours.size()] + "'/><text x='" + Number(x + 14) + "' y='" + Number(y + 6) + "'>" +
                  Escape(s.name) + "</text>";
    x += width;
  }
  legend.height = y + 14;
  return legend;
}

std::string PlotSvg(const ReportPlot& plot) {
  const Axis x = FitAxis(plot, true, 60, 516), y = FitAxis(plot, false, 226, 14);
  const Legend legend = LegendSvg(plot);
  std::string svg = "<svg width='540' height='" + Number(legend.height) + "' viewBox='0 0 540 " +
                    Number(legend.height) + "' role='img'>" + Ticks(x, y);
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
  }
  return svg + legend.svg + "<text x='288' y='260' text-anchor='middle'>" + Escape(plot.x_label) +
         "</text><text x='60' y='10'>" + Escape(plot.y_label) + "</text></svg>";
}

std::string ColourBar(const ReportImage& image) {
  if (image.bar_low.empty()) return "";
  return "<div class='bar'><span>" + Escape(image.bar_low) + "</span><i></i><span>" + Escape(image.bar_high) +
         "</span></div>";
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
      Escape(report.title) + "</title><style>" + Style() + "</style></head><body><main>\n<h1>" + Escape(report.title) +
      "</h1><p>" + Escape(report.subtitle) + "</p>\n";
  for (const ReportSection& section : report.sections) {
    html += "<h2>" + Escape(section.title) + "</h2>\n";
    if (!section.text.empty()) html += "<p>" + Escape(section.text) + "</p>\n";
    html += "<div class='row'>";
    for (const ReportImage& image : section.images) {
      SLX_ASSIGN_OR_RETURN(const auto png, EncodePng8(image.pixels));
      html += "<figure><img alt=\"" + Escape(image.caption) + "\" src='data:image/png;base64," + Base64(png) + "'>" +
              ColourBar(image) + "<figcaption>" + Escape(image.caption) + "</figcaption></figure>\n";
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
