// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/html_report.h"

#include <filesystem>
#include <fstream>
#include <limits>
#include <regex>

#include <gtest/gtest.h>

#include "fitter/report/svg_drawing.h"
#include "shared/image/png.h"
#include "tests/fitter/report/html_checks.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::fit {
namespace {

const char* const kNasty = "a < b & \"c\" > d </main><script>alert(1)</script>";

Report Sample() {
  Image<uint8_t> picture(5, 3, 3);
  for (size_t i = 0; i < picture.size(); ++i) picture.pixels()[i] = static_cast<uint8_t>(7 * i);
  ReportSection section;
  section.title = "Direct and global light";
  section.text = kNasty;
  section.images = {{kNasty, picture}, {"gray", Image<uint8_t>(2, 2, 1, 128)}};
  const double nan = std::numeric_limits<double>::quiet_NaN();
  section.plots = {{"row 130", "mm", "radiance", {{"real", {0, 1, 2, 3}, {1, 4, nan, 2}, true}}},
                   {"one point", "x", "y", {{kNasty, {2}, {3}}}},
                   {"nothing", "x", "y", {}}};
  SvgDrawing drawing;
  drawing.Text({3, 4}, kNasty);
  drawing.Arrow({nan, 1}, {2, 2}, "red");
  section.drawings = {{kNasty, drawing.Svg(20, 10), 20}};
  section.tables = {{"figures", {"model", kNasty}, {{"tied", "0.03"}, {kNasty, "0.1"}}}};
  return {"Session 3f", kNasty, {section}, ReportBanner{Tone::kBad, kNasty}};
}

std::string Rendered(const Report& report) {
  auto html = RenderHtml(report);
  EXPECT_TRUE(html.ok()) << html.status().message();
  return html.ok() ? *html : "";
}

std::vector<uint8_t> FromBase64(const std::string& text) {
  const std::string digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::vector<uint8_t> bytes;
  unsigned value = 0;
  int bits = 0;
  for (char c : text) {
    if (c == '=') break;
    value = value << 6 | static_cast<unsigned>(digits.find(c));
    bits += 6;
    if (bits >= 8) {
      bits -= 8;
      bytes.push_back(static_cast<uint8_t>(value >> bits));
    }
  }
  return bytes;
}

TEST(RenderHtml, NestsItsElements) {
  EXPECT_EQ(FirstBadlyNested("<p>a<b>c</p></b>"), "p");  // the check itself can fail
  EXPECT_EQ(FirstBadlyNested("<p>a"), "p");
  EXPECT_EQ(FirstBadlyNested(Rendered(Sample())), "");
}

TEST(RenderHtml, FetchesNothingFromOutside) {
  const std::string html = Rendered(Sample());
  EXPECT_EQ(FetchedFromOutside(html), "");
  EXPECT_EQ(FetchedFromOutside("<link rel='stylesheet'>"), "<link");
  const std::regex source("src='([^']{0,21})");
  for (std::sregex_iterator it(html.begin(), html.end(), source), end; it != end; ++it)
    EXPECT_EQ((*it)[1], "data:image/png;base64");
}

TEST(RenderHtml, ShowsTextAsTextEverywhere) {
  const std::string html = Rendered(Sample());
  EXPECT_EQ(html.find(kNasty), std::string::npos);
  const std::string escaped = "a &lt; b &amp; &quot;c&quot; &gt; d";
  int shown = 0;
  for (size_t at = html.find(escaped); at != std::string::npos; at = html.find(escaped, at + 1)) ++shown;
  // Subtitle, banner, section text, picture (alt and caption), series name, drawing (text and caption), table header
  // and cell.
  EXPECT_EQ(shown, 10);
}

TEST(RenderHtml, CarriesPicturesBitForBit) {
  const Report report = Sample();
  const std::string html = Rendered(report);
  const std::string mark = "base64,";
  const ScratchFolder scratch;
  size_t at = 0;
  for (const ReportImage& image : report.sections[0].images) {
    at = html.find(mark, at);
    ASSERT_NE(at, std::string::npos);
    at += mark.size();
    const auto bytes = FromBase64(html.substr(at, html.find('\'', at) - at));
    const auto file = scratch / "picture.png";
    std::ofstream(file, std::ios::binary).write(reinterpret_cast<const char*>(bytes.data()), std::ssize(bytes));
    const auto read = ReadPng(file, nullptr);
    ASSERT_TRUE(read.ok()) << read.status().message();
    ASSERT_EQ(read->channels(), image.pixels.channels());
    ASSERT_EQ(read->size(), image.pixels.size());
    for (size_t i = 0; i < read->size(); ++i) EXPECT_EQ(read->pixels()[i], image.pixels.pixels()[i]);
  }
}

TEST(RenderHtml, PlotsOnlyFinitePointsInsideTheFrame) {
  const std::string html = Rendered(Sample());
  EXPECT_EQ(html.find("nan"), std::string::npos);
  EXPECT_EQ(html.find("inf"), std::string::npos);
  const std::regex circle("<circle cx='([^']*)' cy='([^']*)'");
  int circles = 0;
  for (std::sregex_iterator it(html.begin(), html.end(), circle), end; it != end; ++it, ++circles) {
    const double x = std::stod((*it)[1]), y = std::stod((*it)[2]);
    EXPECT_TRUE(x >= 60 && x <= 516 && y >= 14 && y <= 226) << x << " " << y;
  }
  EXPECT_EQ(circles, 3);  // four samples, one of them not a number
}

TEST(KnownPictures, AreThoseOfTheSamePixelsAlone) {
  KnownPictures known;
  Report report = Sample();
  const auto first = EncodePictures(report, known);
  ASSERT_TRUE(first.ok());
  report.sections[0].images[0].caption = "the same pixels";
  const auto again = EncodePictures(report, known);
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(*again, *first);
  EXPECT_EQ(known.size(), 2U);  // nothing was encoded again
  Image<uint8_t>& pixels = report.sections[0].images[0].pixels;
  const Image<uint8_t> before = pixels;
  pixels.pixels()[0] ^= 1;  // one bit of one pixel
  const auto changed = EncodePictures(report, known);
  ASSERT_TRUE(changed.ok());
  EXPECT_NE((*changed)[0], (*first)[0]);
  EXPECT_EQ(known.size(), 3U);
  // As many values in another shape.
  pixels = Image<uint8_t>(before.height(), before.width(), before.channels());
  std::ranges::copy(before.pixels(), pixels.pixels().begin());
  const auto turned = EncodePictures(report, known);
  ASSERT_TRUE(turned.ok());
  EXPECT_NE((*turned)[0], (*first)[0]);
}

TEST(RenderHtml, RefusesAPictureThatIsNoPicture) {
  Report report = Sample();
  report.sections[0].images[0].pixels = Image<uint8_t>(4, 4, 5);
  EXPECT_FALSE(RenderHtml(report).ok());
}

}  // namespace
}  // namespace stratalux::fit
