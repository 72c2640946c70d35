// SPDX-License-Identifier: Apache-2.0
// Captures of other rigs, imported and decoded: a camera that looks through the projector, pixel for pixel.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>

#include "db/interchange/import.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/decode.h"
#include "shared/image/png.h"
#include "tests/db/store_fixture.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr int kWidth = 64, kHeight = 48, kBits = 6;

class DecodeStage : public db::StoreTest {
 protected:
  // What `wanted` says of the code's frames, beside white, black and sinusoids_.
  Result<SessionFrames> Import(const std::function<bool(const Pattern&)>& wanted) {
    const std::filesystem::path files = folder_ / "files";
    std::filesystem::create_directories(files);
    manifest_ = "[import]\nrig = \"elsewhere\"\ncamera_width = 64\ncamera_height = 48\n" + of_devices_;
    SLX_RETURN_IF_ERROR(Add(files, {.kind = PatternKind::kWhite}));
    SLX_RETURN_IF_ERROR(Add(files, {.kind = PatternKind::kBlack}));
    for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
      for (int bit = 0; bit < kBits; ++bit)
        for (const bool inverse : {false, true}) {
          const Pattern pattern{.kind = PatternKind::kGray,
                                .axis = axis,
                                .bit = bit,
                                .bits = kBits,
                                .inverse = inverse,
                                .code = axis == PatternAxis::kRows ? rows_code_.value_or(code_) : code_,
                                .period = IsOfStripes(code_) ? 0 : 8};
          if (wanted(pattern)) SLX_RETURN_IF_ERROR(Add(files, pattern));
        }
      for (const Pattern& sinusoid : sinusoids_) {
        Pattern along = sinusoid;
        along.axis = axis;
        SLX_RETURN_IF_ERROR(Add(files, along));
      }
    }
    db::WriteText(files / "m.toml", manifest_);
    {
      db::SessionStore store = OpenStore();
      SLX_RETURN_IF_ERROR(db::ImportSession(store, {files / "m.toml", {}, {}}, logger_).status());
    }
    return SessionFrames::Open(folder_.string(), "latest");
  }
  Result<DecodeReport> DecodeImported(const std::function<bool(const Pattern&)>& wanted,
                                      CodeReading reading = CodeReading::kWithSinusoids) {
    SLX_ASSIGN_OR_RETURN(const auto frames, Import(wanted));
    return DecodeProjector(frames, 0, -1, kWidth, kHeight, NoiseOf(frames), reading);
  }

  std::string of_devices_ = "bit_depth = 8\nprojector_width = 64\nprojector_height = 48\n";
  double black_dn_ = 10.0, white_dn_ = 210.0, clip_dn_ = 65535.0;
  ColumnCode code_ = ColumnCode::kGray;
  std::optional<ColumnCode> rows_code_;  // unset: the columns'
  std::vector<Pattern> sinusoids_;       // of either axis

 private:
  Status Add(const std::filesystem::path& files, const Pattern& pattern) {
    const Image<float> shown = pattern.Render(kWidth, kHeight);
    const std::string name = "f" + std::to_string(number_++) + ".png";
    manifest_ += "[[file]]\nfile = \"" + name + "\"\npattern = \"" + pattern.ToString() + "\"\n";
    return of_devices_.starts_with("bit_depth = 8") ? WritePng8(files / name, Seen<uint8_t>(shown).view())
                                                    : WritePng16(files / name, Seen<uint16_t>(shown).view());
  }
  template <typename T>
  [[nodiscard]] Image<T> Seen(const Image<float>& shown) const {
    Image<T> seen(kWidth, kHeight);
    for (size_t i = 0; i < seen.size(); ++i)
      seen.data()[i] =
          static_cast<T>(std::lround(std::min(black_dn_ + (white_dn_ - black_dn_) * shown.data()[i], clip_dn_)));
    return seen;
  }
  std::string manifest_;
  int number_ = 0;
  Logger logger_{LogLevel::kError};
};

bool All(const Pattern&) { return true; }

// Largest difference of two maps.
double Largest(const Image<float>& found, const Image<float>& other) {
  double most = 0.0;
  for (size_t i = 0; i < found.size(); ++i)
    most = std::max(most, std::abs(double(found.pixels()[i]) - double(other.pixels()[i])));
  return most;
}

std::vector<Pattern> Sinusoids(int period, int shifts) {
  std::vector<Pattern> all;
  for (int shift = 0; shift < shifts; ++shift)
    all.push_back({.kind = PatternKind::kSinusoid, .period = period, .shift = shift, .shifts = shifts});
  return all;
}

enum class Axes { kBoth, kColumns };

void ExpectEveryPixelAtItsPlace(const DecodedMap& map, Axes axes) {
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_EQ(map.reason(x, y), 0) << x << ", " << y;
      ASSERT_NEAR(map.column(x, y), x, 0.3);
      if (axes == Axes::kBoth)
        ASSERT_NEAR(map.row(x, y), y, 0.3);
      else
        ASSERT_TRUE(std::isnan(map.row(x, y)));
    }
}

TEST_F(DecodeStage, ReadsTheCodeThatTheFramesAreOf) {
  for (const ColumnCode code :
       {ColumnCode::kXor2, ColumnCode::kXor4, ColumnCode::kMinStripe, ColumnCode::kMicroPhase}) {
    code_ = code;
    const auto report = DecodeImported(All);
    ASSERT_TRUE(report.ok()) << ToString(code) << ": " << report.status().message();
    ExpectEveryPixelAtItsPlace(report->map, Axes::kBoth);
  }
}

TEST_F(DecodeStage, RefusesTwoCodesInOneSession) {
  rows_code_ = ColumnCode::kXor4;
  const auto report = DecodeImported(All);
  EXPECT_EQ(report.status().code(), StatusCode::kUsage);
  EXPECT_THAT(report.status().message(),
              HasSubstr("frames of two codes, 'gray columns bit=5/6 inverse' and 'gray rows bit=0/6 code=xor-4'"));
}

TEST_F(DecodeStage, ReadsAWholeCode) {
  const auto report = DecodeImported(All);
  ASSERT_TRUE(report.ok()) << report.status().message();
  ExpectEveryPixelAtItsPlace(report->map, Axes::kBoth);
}

TEST_F(DecodeStage, NeedsNoInverses) {
  const auto report = DecodeImported([](const Pattern& pattern) { return !pattern.inverse; });
  ASSERT_TRUE(report.ok()) << report.status().message();
  ExpectEveryPixelAtItsPlace(report->map, Axes::kBoth);
}

TEST_F(DecodeStage, NeedsNoRows) {
  const auto report = DecodeImported([](const Pattern& pattern) { return pattern.axis == PatternAxis::kColumns; });
  ASSERT_TRUE(report.ok()) << report.status().message();
  ExpectEveryPixelAtItsPlace(report->map, Axes::kColumns);
}

// Of a pair one frame is enough; which one is missing is said.
TEST_F(DecodeStage, DoesWithoutEitherFrameOfAPair) {
  for (const bool inverse : {false, true}) {
    const auto frames = Import([&](const Pattern& pattern) {
      return pattern.axis != PatternAxis::kRows || pattern.bit != 4 || pattern.inverse != inverse;
    });
    ASSERT_TRUE(frames.ok()) << frames.status().message();
    const auto report = DecodeProjector(*frames, 0, -1, kWidth, kHeight, NoiseOf(*frames));
    ASSERT_TRUE(report.ok()) << report.status().message();
    ExpectEveryPixelAtItsPlace(report->map, Axes::kBoth);
    EXPECT_THAT(UnreadPatterns(*frames, 0, -1),
                HasSubstr(inverse ? "'gray rows bit=4/6 inverse' is missing" : "'gray rows bit=4/6' is missing"));
  }
}

// Without both frames the bit tells nothing: of a coarse one only the sites on its own edges have a place, and none a
// wrong one.
TEST_F(DecodeStage, SaysNothingWhereABitIsLostThatMatters) {
  const auto without = [&](int bit) {
    return DecodeImported(
        [bit](const Pattern& pattern) { return pattern.axis != PatternAxis::kColumns || pattern.bit != bit; });
  };
  const auto placed = [&](const DecodedMap& map) {
    int sites = 0;
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        if (map.reason(x, y) != 0) continue;
        ++sites;
        const float off = std::abs(map.column(x, y) - static_cast<float>(x));
        EXPECT_LT(off, 4.0F * map.column_sigma(x, y)) << x << ", " << y;
        EXPECT_LT(off, 2.5F) << x << ", " << y;
      }
    return sites;
  };
  const auto coarse = without(1), finest = without(kBits - 1);
  ASSERT_TRUE(coarse.ok() && finest.ok());
  EXPECT_LT(placed(coarse->map), kWidth * kHeight / 8);
  EXPECT_EQ(placed(finest->map), kWidth * kHeight);
}

TEST_F(DecodeStage, NamesACodeThatIsMissingAltogether) {
  const auto report = DecodeImported([](const Pattern&) { return false; });
  ASSERT_FALSE(report.ok());
  EXPECT_THAT(report.status().message(), HasSubstr("gray columns"));
}

// A code without its finest planes is not read as one of fewer columns.
TEST_F(DecodeStage, PlacesASiteAsWellAsItsPlanesDoWhereTheFinestAreMissing) {
  const auto frames = Import([](const Pattern& pattern) { return pattern.bit < kBits - 2; });
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  EXPECT_THAT(UnreadPatterns(*frames, 0, -1), HasSubstr("'gray columns bit=4/6' is missing"));
  const auto report = DecodeProjector(*frames, 0, -1, kWidth, kHeight, NoiseOf(*frames));
  ASSERT_TRUE(report.ok()) << report.status().message();
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_EQ(report->map.reason(x, y), 0) << x << ", " << y;
      ASSERT_LT(std::abs(report->map.column(x, y) - static_cast<float>(x)), 4.0 * report->map.column_sigma(x, y));
      ASSERT_LT(std::abs(report->map.column(x, y) - static_cast<float>(x)), 2.5);
    }
}

TEST_F(DecodeStage, TellsNoiseAndSaturationOfSixteenBits) {
  of_devices_ = "bit_depth = 16\nprojector_width = 64\nprojector_height = 48\n";
  black_dn_ = 1000.0;
  white_dn_ = 40000.0;
  const auto frames = Import(All);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  const SensorNoise noise = NoiseOf(*frames);
  EXPECT_EQ(noise.saturation_dn, 65535.0);
  // The electrons of a sensor of 12 bits, in 16 times as fine numbers.
  EXPECT_NEAR(noise.gain_e_per_dn, 4.0 / 16.0, 0.001);
  EXPECT_NEAR(noise.read_noise_dn, 3.0 * 16.0, 0.1);
  const auto report = DecodeProjector(*frames, 0, -1, kWidth, kHeight, noise);
  ASSERT_TRUE(report.ok()) << report.status().message();
  ExpectEveryPixelAtItsPlace(report->map, Axes::kBoth);
}

// 10, 12 or 14 bits in the low ones of 16: nothing in the pictures says where they end. Sinusoids whose crests are cut
// off there would be read wrongly.
TEST_F(DecodeStage, TakesTheSaturationThatTheManifestSays) {
  white_dn_ = 1400.0;
  clip_dn_ = 1023.0;
  sinusoids_ = Sinusoids(8, 4);
  const std::string rest = "projector_width = 64\nprojector_height = 48\n";
  for (const bool told : {false, true}) {
    of_devices_ = "bit_depth = 16\n" + rest + (told ? "saturation = 1023\n" : "");
    const auto frames = Import(All);
    ASSERT_TRUE(frames.ok()) << frames.status().message();
    const SensorNoise noise = NoiseOf(*frames);
    EXPECT_EQ(noise.saturation_dn, told ? 1023.0 : 65535.0);
    const auto read = DecodeProjector(*frames, 0, -1, kWidth, kHeight, noise),
               alone = DecodeProjector(*frames, 0, -1, kWidth, kHeight, noise, CodeReading::kBitsAlone);
    ASSERT_TRUE(read.ok() && alone.ok());
    EXPECT_EQ(Largest(read->map.column_sigma, alone->map.column_sigma) == 0.0, told);
    EXPECT_NEAR(noise.read_noise_dn, told ? 0.7495 : 48.011, 0.001);
  }
}

TEST_F(DecodeStage, KnowsTheProjectorsSizeThatTheManifestSays) {
  of_devices_ = "bit_depth = 8\nprojector_width = 50\nprojector_height = 40\n";
  const auto frames = Import(All);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  EXPECT_EQ(CodeSizeOf(*frames).columns, 50);
  EXPECT_EQ(CodeSizeOf(*frames).rows, 40);
}

TEST_F(DecodeStage, RefinesAnImportsCodesByItsSinusoids) {
  sinusoids_ = Sinusoids(8, 4);
  const auto frames = Import(All);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  EXPECT_EQ(UnreadPatterns(*frames, 0, -1), "");
  const auto refined = DecodeProjector(*frames, 0, -1, kWidth, kHeight, NoiseOf(*frames)),
             alone = DecodeProjector(*frames, 0, -1, kWidth, kHeight, NoiseOf(*frames), CodeReading::kBitsAlone);
  ASSERT_TRUE(refined.ok() && alone.ok());
  ExpectEveryPixelAtItsPlace(refined->map, Axes::kBoth);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_NEAR(refined->map.column(x, y), x, 0.05);
      ASSERT_LT(refined->map.column_sigma(x, y), alone->map.column_sigma(x, y));
      ASSERT_LT(refined->map.row_sigma(x, y), alone->map.row_sigma(x, y));
    }
}

// Their phases are those of equal steps.
TEST_F(DecodeStage, NamesAnImportsSinusoidsThatLackAShift) {
  sinusoids_ = Sinusoids(8, 4);
  sinusoids_.erase(sinusoids_.begin() + 2);
  const auto frames = Import(All);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  const std::string note = UnreadPatterns(*frames, 0, -1);
  EXPECT_THAT(note, HasSubstr("columns, sinusoids of period 8 px: 3 of 4 shifts"));
  EXPECT_THAT(note, HasSubstr("rows, sinusoids of period 8 px: 3 of 4 shifts"));
  const auto read = DecodeProjector(*frames, 0, -1, kWidth, kHeight, NoiseOf(*frames)),
             alone = DecodeProjector(*frames, 0, -1, kWidth, kHeight, NoiseOf(*frames), CodeReading::kBitsAlone);
  ASSERT_TRUE(read.ok() && alone.ok());
  EXPECT_EQ(Largest(read->map.column_sigma, alone->map.column_sigma), 0.0);
}

TEST_F(DecodeStage, ReadsTheFinestOfSeveralWholeSets) {
  for (const auto& [period, shifts] : {std::pair{6, 4}, {8, 3}, {16, 4}}) {
    const auto set = Sinusoids(period, shifts);
    sinusoids_.insert(sinusoids_.end(), set.begin(), set.end());
  }
  sinusoids_.erase(sinusoids_.begin());  // of the finest
  const auto frames = Import(All);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  const std::string note = UnreadPatterns(*frames, 0, -1);
  EXPECT_THAT(note, HasSubstr("columns, sinusoids of period 6 px: 3 of 4 shifts"));
  EXPECT_THAT(note, HasSubstr("columns, sinusoids of period 16 px: period 8 px is read"));
  EXPECT_THAT(note, Not(HasSubstr("sinusoids of period 8 px:")));
  const auto read = DecodeProjector(*frames, 0, -1, kWidth, kHeight, NoiseOf(*frames));
  ASSERT_TRUE(read.ok()) << read.status().message();
  for (int x = 0; x < kWidth; ++x) ASSERT_NEAR(read->map.column(x, 20), x, 0.05);
}

}  // namespace
}  // namespace stratalux::fit
