// SPDX-License-Identifier: Apache-2.0
// Line drawings of a report: shapes in, one <svg> element out. Pixels, origin at the top left, +y down.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace stratalux::fit {

// Text as HTML shows it, whatever is in it.
[[nodiscard]] std::string EscapeHtml(const std::string& text);
// Four digits, as SVG and people read them.
[[nodiscard]] std::string ShortNumber(double value);
// Of the k-th curve of a plot; they repeat after eight.
[[nodiscard]] std::string CurveColour(size_t k);
// Of the k-th of `count` things that must be told apart: around the circle of hues.
[[nodiscard]] std::string HueColour(size_t k, size_t count);
// The round step (1, 2 or 5 times a power of ten) that cuts `span` into four to ten parts.
[[nodiscard]] double RoundStep(double span);

enum class TextAnchor { kStart, kMiddle, kEnd };

// Colours are CSS. Shapes with a coordinate that is not finite are left out.
class SvgDrawing {
 public:
  using Point = Eigen::Vector2d;

  void Line(const Point& from, const Point& to, const std::string& stroke, double width = 1.0);
  // A line with a head at `to`.
  void Arrow(const Point& from, const Point& to, const std::string& stroke);
  void Circle(const Point& centre, double radius, const std::string& fill);
  void Ring(const Point& centre, double radius, const std::string& stroke);
  void Rectangle(const Point& corner, const Point& size, const std::string& fill, const std::string& stroke = "none");
  // Points that are not finite are passed over.
  void Polyline(const std::vector<Point>& points, const std::string& stroke, double width = 1.5);
  void Polygon(const std::vector<Point>& points, const std::string& stroke, const std::string& fill = "none");
  void Text(const Point& at, const std::string& text, TextAnchor anchor = TextAnchor::kStart,
            const std::string& fill = "");

  [[nodiscard]] std::string Svg(double width, double height) const;

 private:
  std::string shapes_;
};

}  // namespace stratalux::fit
