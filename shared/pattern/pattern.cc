// SPDX-License-Identifier: Apache-2.0
#include "shared/pattern/pattern.h"

#include <array>
#include <charconv>
#include <cmath>
#include <numbers>
#include <sstream>
#include <string_view>

#include "shared/pattern/micro_phase.h"

namespace stratalux {
namespace {

constexpr std::array<std::string_view, 8> kNames = {"black",    "white", "gray",  "checkerboard",
                                                    "sinusoid", "comb",  "spots", "grey"};

float GrayIntensity(const Pattern& p, int position) {
  if (!IsOfStripes(p.code)) {
    const double wave = std::cos(MicroPhaseWave(p.bit, p.bits, p.period).Angle(position));
    return static_cast<float>(0.5 + (p.inverse ? -0.5 : 0.5) * wave);
  }
  const unsigned word = WordOf(p.code, static_cast<unsigned>(position), p.bits);
  const bool lit = ((word >> (p.bits - 1 - p.bit)) & 1U) != 0;
  return lit != p.inverse ? 1.0F : 0.0F;
}

float SinusoidIntensity(const Pattern& p, int position) {
  const double turns = (position + 0.5) / p.period - static_cast<double>(p.shift) / p.shifts;
  return static_cast<float>(0.5 + 0.5 * std::cos(2.0 * std::numbers::pi * turns));
}

int Modulo(int a, int b) { return ((a % b) + b) % b; }

float CheckerIntensity(const Pattern& p, int column, int row) {
  const int half = p.period / 2;
  const int dx = (p.shift % p.shifts) * p.period / p.shifts;
  const int dy = (p.shift / p.shifts) * p.period / p.shifts;
  const bool x = Modulo(column - dx, p.period) < half;
  const bool y = Modulo(row - dy, p.period) < half;
  return x == y ? 1.0F : 0.0F;
}

float SpotIntensity(const Pattern& p, int column, int row) {
  const int dx = Modulo(column, p.period) - p.period / 2;
  const int dy = Modulo(row, p.period) - p.period / 2;
  return dx * dx + dy * dy <= p.width * p.width ? 1.0F : 0.0F;
}

Status ParseField(std::string_view key, std::string_view value, Pattern& p) {
  auto number = [&](std::string_view text, int& out) {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), out);
    return error == std::errc() && end == text.data() + text.size();
  };
  const size_t slash = value.find('/');
  const bool pair = slash != std::string_view::npos;
  const std::string_view first = value.substr(0, slash);
  const std::string_view second = pair ? value.substr(slash + 1) : std::string_view();
  bool good = false;
  if (key == "code" && p.kind == PatternKind::kGray) {
    SLX_ASSIGN_OR_RETURN(p.code, ParseColumnCode(std::string(value)));
    good = true;
  }
  if (key == "bit") good = pair && number(first, p.bit) && number(second, p.bits);
  if (key == "shift") good = number(first, p.shift) && (!pair || number(second, p.shifts));
  if (key == "level") good = p.kind == PatternKind::kGrey && pair && number(first, p.shift) && number(second, p.shifts);
  if (key == "period") good = !pair && number(first, p.period);
  if (key == "width" || key == "radius") good = !pair && number(first, p.width);
  // One level and nothing else: `gray` in its other spelling is no level.
  if (p.kind == PatternKind::kGrey) good = good && key == "level";
  if (good) return Status::Ok();
  return Status::Usage("pattern field '" + std::string(key) + "=" + std::string(value) + "' is not understood");
}

}  // namespace

float Pattern::Intensity(int column, int row) const {
  const int position = axis == PatternAxis::kColumns ? column : row;
  switch (kind) {
    case PatternKind::kBlack:
      return 0.0F;
    case PatternKind::kWhite:
      return 1.0F;
    case PatternKind::kGray:
      return GrayIntensity(*this, position);
    case PatternKind::kCheckerboard:
      return CheckerIntensity(*this, column, row);
    case PatternKind::kSinusoid:
      return SinusoidIntensity(*this, position);
    case PatternKind::kComb:
      return Modulo(position - shift, period) < width ? 1.0F : 0.0F;
    case PatternKind::kSpots:
      return SpotIntensity(*this, column, row);
    case PatternKind::kGrey:
      return static_cast<float>(shift) / static_cast<float>(shifts);
  }
  return 0.0F;
}

std::vector<float> Pattern::Profile(int count) const {
  SLX_CHECK(IsOneDimensional());
  std::vector<float> profile(static_cast<size_t>(count));
  for (int i = 0; i < count; ++i) profile[i] = axis == PatternAxis::kColumns ? Intensity(i, 0) : Intensity(0, i);
  return profile;
}

Image<float> Pattern::Render(int width_px, int height_px) const {
  Image<float> image(width_px, height_px);
  for (int y = 0; y < height_px; ++y)
    for (int x = 0; x < width_px; ++x) image(x, y) = Intensity(x, y);
  return image;
}

std::string Pattern::ToString() const {
  std::ostringstream text;
  text << kNames[static_cast<size_t>(kind)];
  const char* axis_name = axis == PatternAxis::kColumns ? " columns" : " rows";
  switch (kind) {
    case PatternKind::kBlack:
    case PatternKind::kWhite:
      break;
    case PatternKind::kGray:
      text << axis_name << " bit=" << bit << '/' << bits << (inverse ? " inverse" : "");
      if (code != ColumnCode::kGray) text << " code=" << stratalux::ToString(code);
      if (!IsOfStripes(code)) text << " period=" << period;
      break;
    case PatternKind::kCheckerboard:
      text << " period=" << period << " shift=" << shift << '/' << shifts;
      break;
    case PatternKind::kSinusoid:
      text << axis_name << " period=" << period << " shift=" << shift << '/' << shifts;
      break;
    case PatternKind::kComb:
      text << axis_name << " period=" << period << " width=" << width << " shift=" << shift;
      break;
    case PatternKind::kSpots:
      text << " period=" << period << " radius=" << width;
      break;
    case PatternKind::kGrey:
      text << " level=" << shift << '/' << shifts;
      break;
  }
  return text.str();
}

Result<Pattern> Pattern::Parse(const std::string& text) {
  std::istringstream words(text);
  std::string word;
  words >> word;
  Pattern pattern;
  size_t kind = 0;
  while (kind < kNames.size() && kNames[kind] != word) ++kind;
  if (kind == kNames.size()) return Status::Usage("unknown pattern '" + text + "'");
  pattern.kind = static_cast<PatternKind>(kind);
  while (words >> word) {
    if (word == "columns") {
      pattern.axis = PatternAxis::kColumns;
    } else if (word == "rows") {
      pattern.axis = PatternAxis::kRows;
    } else if (word == "inverse") {
      pattern.inverse = true;
    } else {
      const size_t equals = word.find('=');
      if (equals == std::string::npos) return Status::Usage("pattern '" + text + "': unexpected word '" + word + "'");
      const Status status =
          ParseField(std::string_view(word).substr(0, equals), std::string_view(word).substr(equals + 1), pattern);
      if (!status.ok()) return status.WithContext("pattern '" + text + "'");
    }
  }
  if (pattern.kind == PatternKind::kGray && IsOfStripes(pattern.code) && pattern.period != 0)
    return Status::Usage("pattern '" + text + "': stripes of code '" + stratalux::ToString(pattern.code) +
                         "' have no period");
  if (pattern.kind == PatternKind::kGrey && text.find(" level=") == std::string::npos)
    return Status::Usage("pattern '" + text + "' names no level (grey level=5/32)");
  return pattern;
}

Status Pattern::Validate(int projector_width, int projector_height) const {
  const int extent = axis == PatternAxis::kColumns ? projector_width : projector_height;
  auto refuse = [&](const std::string& why) { return Status::Usage("pattern '" + ToString() + "': " + why); };
  switch (kind) {
    case PatternKind::kBlack:
    case PatternKind::kWhite:
      return Status::Ok();
    case PatternKind::kGray:
      if (bits < 1 || bits > kMaxCodeBits || bit < 0 || bit >= bits)
        return refuse("bit must lie in 0 .. bits-1, bits in 1 .. 16");
      if (bits > GrayBits(extent))
        return refuse("a projector of " + std::to_string(extent) + " px needs at most " +
                      std::to_string(GrayBits(extent)) + " bits");
      if (!IsOfStripes(code) && (period < 3 || period > extent))
        return refuse("period must lie in 3 .. " + std::to_string(extent) + " px");
      return Status::Ok();
    case PatternKind::kCheckerboard:
      if (period < 2 || period % 2 != 0) return refuse("period must be even and at least 2 px");
      if (shifts < 1 || period % shifts != 0 || shift < 0 || shift >= shifts * shifts)
        return refuse("shifts must divide the period, shift lie in 0 .. shifts^2-1");
      return Status::Ok();
    case PatternKind::kSinusoid:
      if (period < 3 || period > extent) return refuse("period must lie in 3 .. " + std::to_string(extent) + " px");
      if (shifts < 3 || shift < 0 || shift >= shifts) return refuse("needs at least 3 shifts, shift in 0 .. shifts-1");
      return Status::Ok();
    case PatternKind::kComb:
      if (width < 1 || period <= width) return refuse("width must be at least 1 px and less than the period");
      if (period > extent) return refuse("period exceeds the projector's " + std::to_string(extent) + " px");
      if (shift < 0 || shift >= period) return refuse("shift must lie in 0 .. period-1");
      return Status::Ok();
    case PatternKind::kSpots:
      if (width < 1 || period <= 2 * width) return refuse("radius must be at least 1 px, pitch more than its double");
      if (period > projector_width || period > projector_height) return refuse("pitch exceeds the projector");
      return Status::Ok();
    case PatternKind::kGrey:
      if (shifts < 1 || shift < 0 || shift > shifts) return refuse("level must lie in 0 .. its number of levels");
      return Status::Ok();
  }
  return refuse("unknown kind");
}

}  // namespace stratalux
