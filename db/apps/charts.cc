// SPDX-License-Identifier: Apache-2.0
#include "db/apps/charts.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include "db/apps/display_text.h"

namespace stratalux::db {
namespace {

std::string ValueText(double value, Series::Unit unit) {
  if (unit == Series::Unit::kBytes) return SizeText(static_cast<int64_t>(value));
  char text[40];
  std::snprintf(text, sizeof text, unit == Series::Unit::kCount ? "%.0f" : "%.4g", value);
  return text;
}

double Largest(const Series& series) {
  double largest = 0.0;
  for (const SeriesPoint& point : series.points) largest = std::max(largest, point.value.value_or(0.0));
  return largest;
}

bool Empty(const Series& series) {
  return std::none_of(series.points.begin(), series.points.end(), [](const auto& p) { return p.value.has_value(); });
}

// Steps of a bar out of `whole`; at least one for anything above nothing.
int Steps(std::optional<double> value, double largest, int whole) {
  if (!value || *value <= 0.0 || largest <= 0.0) return 0;
  return std::clamp(static_cast<int>(std::lround(*value / largest * whole)), 1, whole);
}

// A cell of a column that is `filled` eighths full.
std::string Block(int filled, Glyphs glyphs) {
  constexpr std::array<const char*, 9> kBlocks = {" ",      "\u2581", "\u2582", "\u2583", "\u2584",
                                                  "\u2585", "\u2586", "\u2587", "\u2588"};
  const int eighths = std::clamp(filled, 0, 8);
  if (glyphs == Glyphs::kBlocks) return kBlocks[static_cast<size_t>(eighths)];
  return eighths == 0 ? " " : eighths <= 4 ? ":" : "#";
}

std::string PaddedTo(std::string text, int width) {
  text.append(static_cast<size_t>(std::max(0, width - DisplayWidth(text))), ' ');
  return text;
}

std::string Escaped(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '&') {
      out += "&amp;";
    } else if (c == '<') {
      out += "&lt;";
    } else if (c == '>') {
      out += "&gt;";
    } else if (c == '"') {
      out += "&quot;";
    } else {
      out += c;
    }
  }
  return out;
}

std::string Number(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.2f", value);
  return text;
}

std::string ColumnSvg(const Series& series) {
  constexpr double kWidth = 600.0, kHeight = 120.0, kTop = 16.0, kBottom = 18.0;
  const double largest = Largest(series);
  const double pitch = kWidth / static_cast<double>(std::max<size_t>(series.points.size(), 1));
  std::string svg = "<svg viewBox=\"0 0 600 " + Number(kTop + kHeight + kBottom) + "\" role=\"img\" aria-label=\"" +
                    Escaped(series.title) + "\">";
  for (size_t i = 0; i < series.points.size(); ++i) {
    const SeriesPoint& point = series.points[i];
    if (!point.value) continue;
    const double height =
        largest > 0.0 ? std::max(*point.value / largest * kHeight, *point.value > 0.0 ? 1.0 : 0.0) : 0.0;
    svg += "<rect x=\"" + Number(pitch * static_cast<double>(i) + pitch * 0.1) + "\" y=\"" +
           Number(kTop + kHeight - height) + "\" width=\"" + Number(std::min(pitch * 0.8, 24.0)) + "\" height=\"" +
           Number(height) + "\"><title>" + Escaped(point.label + ": " + ValueText(*point.value, series.unit)) +
           "</title></rect>";
  }
  svg += "<line x1=\"0\" x2=\"600\" y1=\"" + Number(kTop + kHeight) + "\" y2=\"" + Number(kTop + kHeight) + "\"/>";
  svg += "<text x=\"0\" y=\"11\">" + Escaped(ValueText(largest, series.unit)) + "</text>";
  if (!series.points.empty()) {
    const std::string y = Number(kTop + kHeight + 14.0);
    svg += "<text x=\"0\" y=\"" + y + "\">" + series.points.front().label + "</text><text x=\"600\" y=\"" + y +
           "\" text-anchor=\"end\">" + series.points.back().label + "</text>";
  }
  return svg + "</svg>";
}

std::string BarRows(const Series& series) {
  std::string html = "<table>";
  const double largest = Largest(series);
  for (const SeriesPoint& point : series.points)
    html += "<tr><td>" + Escaped(point.label) + "</td><td class=\"n\">" + ValueText(*point.value, series.unit) +
            "</td><td class=\"bar\"><svg viewBox=\"0 0 100 8\" preserveAspectRatio=\"none\" aria-hidden=\"true\"><rect "
            "width=\"" +
            Number(*point.value / largest * 100.0) + "\" height=\"8\"/></svg></td></tr>";
  return html + "</table>";
}

std::string Section(const Series& series, const std::string& body) {
  return "<section><h2>" + Escaped(series.title) + "</h2>" + (Empty(series) ? "<p>nothing to show</p>" : body) +
         "</section>\n";
}

std::string Summary(const Statistics& s) {
  return ToIso8601(s.since).substr(0, 10) + " to " + ToIso8601(s.until).substr(0, 10) + ": " +
         std::to_string(s.sessions) + " sessions, " + std::to_string(s.complete) + " complete; " +
         std::to_string(s.frames) + " frames, " + SizeText(s.bytes);
}

constexpr const char* kStyle = R"(
:root { color-scheme: light dark; --ink: #1d2328; --paper: #fff; --faint: #66727d; --bar: #2a78b8; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6eaee; --paper: #14181c; --faint: #95a1ac; --bar: #62aee6; } }
body { margin: 2rem auto; max-width: 84rem; padding: 0 1rem; font: 16px/1.5 system-ui, sans-serif; color: var(--ink);
  background: var(--paper); }
h1 { font-size: 1.5rem; margin-bottom: 0; } h2 { font-size: 1rem; margin: 0 0 .5rem; } p { color: var(--faint); }
main { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)); gap: 2rem; }
section:last-child { grid-column: 1 / -1; }
svg { width: 100%; height: auto; } rect { fill: var(--bar); } line { stroke: var(--faint); }
text { font-size: 12px; fill: var(--faint); }
table { width: 100%; border-collapse: collapse; } td { padding: .2rem .75rem .2rem 0; }
.n { text-align: right; font-variant-numeric: tabular-nums; } .bar { width: 40%; } .bar svg { height: .6rem; display: block; }
)";

}  // namespace

std::string ColumnChart(const Series& series, Glyphs glyphs, int rows) {
  std::string text = series.title + "\n";
  if (Empty(series)) return text + "  (nothing to show)\n";
  const double largest = Largest(series);
  const std::string top = ValueText(largest, series.unit);
  const int margin = std::max(DisplayWidth(top), 1);
  for (int row = rows - 1; row >= 0; --row) {
    const std::string scale = row == rows - 1 ? top : row == 0 ? "0" : "";
    std::string line = "  " + std::string(static_cast<size_t>(margin - DisplayWidth(scale)), ' ') + scale + " ";
    for (const SeriesPoint& point : series.points)
      line += Block(Steps(point.value, largest, rows * 8) - row * 8, glyphs);
    line.erase(line.find_last_not_of(' ') + 1);
    text += line + "\n";
  }
  const std::string indent(static_cast<size_t>(margin) + 3, ' ');
  const std::string &first = series.points.front().label, &last = series.points.back().label;
  const auto gap = static_cast<int>(series.points.size()) - static_cast<int>(first.size() + last.size());
  if (series.points.size() == 1) return text + indent + first + "\n";
  return text + indent + first + (gap > 0 ? std::string(static_cast<size_t>(gap), ' ') : " ... ") + last + "\n";
}

std::string BarChart(const Series& series, Glyphs glyphs, int width) {
  std::string text = series.title + "\n";
  if (Empty(series)) return text + "  (nothing to show)\n";
  const double largest = Largest(series);
  int labels = 0;
  for (const SeriesPoint& point : series.points) labels = std::max(labels, DisplayWidth(point.label));
  for (const SeriesPoint& point : series.points) {
    std::string bar;
    for (int i = Steps(point.value, largest, width); i > 0; --i) bar += glyphs == Glyphs::kBlocks ? "\u2588" : "#";
    text += "  " + PaddedTo(point.label, labels) + "  " + bar + " " +
            ValueText(point.value.value_or(0.0), series.unit) + "\n";
  }
  return text;
}

std::string StatisticsAsText(const Statistics& s, Glyphs glyphs) {
  std::string text = Summary(s) + "\n";
  for (const Series* series : {&s.sessions_per_bin, &s.not_complete_per_bin, &s.disk, &s.nrmse})
    text += "\n" + ColumnChart(*series, glyphs);
  return text + "\n" + BarChart(s.failures, glyphs);
}

std::string StatisticsAsHtml(const Statistics& s, const std::string& store) {
  std::string html =
      "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" "
      "content=\"width=device-width\">"
      "<title>Stratalux: store statistics</title><style>" +
      std::string(kStyle) + "</style></head><body>\n<h1>Store " + Escaped(Printable(store)) + "</h1><p>" +
      Escaped(Summary(s)) + "</p>\n<main>\n";
  for (const Series* series : {&s.sessions_per_bin, &s.not_complete_per_bin, &s.disk, &s.nrmse})
    html += Section(*series, ColumnSvg(*series));
  return html + Section(s.failures, BarRows(s.failures)) + "</main></body></html>\n";
}

}  // namespace stratalux::db
