// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/svg_drawing.h"

#include <array>
#include <cmath>

#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

using Point = SvgDrawing::Point;

constexpr std::array<const char*, 8> kColours = {"#3b6fd4", "#d1602c", "#2b9a66", "#8a55c9",
                                                 "#c23b6b", "#7a7f2a", "#1f9db3", "#8c8c8c"};

std::string PointList(const std::vector<Point>& points) {
  std::string list;
  for (const Point& p : points)
    if (p.allFinite()) list += ShortNumber(p.x()) + "," + ShortNumber(p.y()) + " ";
  return list;
}

}  // namespace

std::string EscapeHtml(const std::string& text) {
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

std::string ShortNumber(double value) { return Formatted("%.4g", value); }

std::string CurveColour(size_t k) { return kColours[k % kColours.size()]; }

std::string HueColour(size_t k, size_t count) {
  return "hsl(" + ShortNumber(std::floor(360.0 * static_cast<double>(k) / static_cast<double>(count))) + ",62%,50%)";
}

double RoundStep(double span) {
  const double power = std::pow(10.0, std::floor(std::log10(span / 4.0)));
  const double parts = span / 4.0 / power;  // 1 .. 10
  return power * (parts >= 5.0 ? 5.0 : parts >= 2.0 ? 2.0 : 1.0);
}

void SvgDrawing::Line(const Point& from, const Point& to, const std::string& stroke, double width) {
  if (!from.allFinite() || !to.allFinite()) return;
  shapes_ += "<line x1='" + ShortNumber(from.x()) + "' y1='" + ShortNumber(from.y()) + "' x2='" + ShortNumber(to.x()) +
             "' y2='" + ShortNumber(to.y()) + "' stroke='" + stroke + "' stroke-width='" + ShortNumber(width) + "'/>";
}

void SvgDrawing::Arrow(const Point& from, const Point& to, const std::string& stroke) {
  Line(from, to, stroke, 1.2);
  const Point along = to - from;
  const double length = along.norm();
  if (!(length > 2.0) || !std::isfinite(length)) return;  // too short for a head
  const Point unit = along / length, across(-unit.y(), unit.x());
  const double head = std::min(4.0, 0.5 * length);
  Line(to, to - head * unit + 0.5 * head * across, stroke, 1.2);
  Line(to, to - head * unit - 0.5 * head * across, stroke, 1.2);
}

void SvgDrawing::Circle(const Point& centre, double radius, const std::string& fill) {
  if (!centre.allFinite()) return;
  shapes_ += "<circle cx='" + ShortNumber(centre.x()) + "' cy='" + ShortNumber(centre.y()) + "' r='" +
             ShortNumber(radius) + "' fill='" + fill + "'/>";
}

void SvgDrawing::Ring(const Point& centre, double radius, const std::string& stroke) {
  if (!centre.allFinite()) return;
  shapes_ += "<circle cx='" + ShortNumber(centre.x()) + "' cy='" + ShortNumber(centre.y()) + "' r='" +
             ShortNumber(radius) + "' fill='none' stroke='" + stroke + "'/>";
}

void SvgDrawing::Rectangle(const Point& corner, const Point& size, const std::string& fill, const std::string& stroke) {
  if (!corner.allFinite() || !size.allFinite()) return;
  shapes_ += "<rect x='" + ShortNumber(corner.x()) + "' y='" + ShortNumber(corner.y()) + "' width='" +
             ShortNumber(size.x()) + "' height='" + ShortNumber(size.y()) + "' fill='" + fill + "' stroke='" + stroke +
             "'/>";
}

void SvgDrawing::Polyline(const std::vector<Point>& points, const std::string& stroke, double width) {
  const std::string list = PointList(points);
  if (list.empty()) return;
  shapes_ +=
      "<polyline fill='none' stroke='" + stroke + "' stroke-width='" + ShortNumber(width) + "' points='" + list + "'/>";
}

void SvgDrawing::Polygon(const std::vector<Point>& points, const std::string& stroke, const std::string& fill) {
  shapes_ += "<polygon fill='" + fill + "' stroke='" + stroke + "' points='" + PointList(points) + "'/>";
}

void SvgDrawing::Text(const Point& at, const std::string& text, TextAnchor anchor, const std::string& fill) {
  if (!at.allFinite()) return;
  constexpr std::array<const char*, 3> kAnchors = {"start", "middle", "end"};
  shapes_ += "<text x='" + ShortNumber(at.x()) + "' y='" + ShortNumber(at.y()) + "' text-anchor='" +
             kAnchors[static_cast<size_t>(anchor)] + "'" + (fill.empty() ? "" : " style='fill:" + fill + "'") + ">" +
             EscapeHtml(text) + "</text>";
}

std::string SvgDrawing::Svg(double width, double height) const {
  const std::string w = ShortNumber(width), h = ShortNumber(height);
  return "<svg width='" + w + "' height='" + h + "' viewBox='0 0 " + w + " " + h + "' role='img'>" + shapes_ + "</svg>";
}

}  // namespace stratalux::fit
