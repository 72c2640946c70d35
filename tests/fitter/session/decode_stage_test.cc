// SPDX-License-Identifier: Apache-2.0
// Captures of other rigs, imported and decoded: a camera that looks through the projector, pixel for pixel.
#include <cmath>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <utility>

#include <gmock/gmock.h>

#include "db/interchange/import.h"
#include "fitter/stages/decode.h"
#include "shared/image/png.h"
#include "tests/db/store_fixture.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;

constexpr int kWidth = 64, kHeight = 48, kBits = 6;

class DecodeStage : public db::StoreTest {
 protected:
  // What `wanted` says of the code's frames, beside white and black.
  Result<DecodeReport> DecodeImported(const std::function<bool(const Pattern&)>& wanted) {
    const std::filesystem::path files = folder_ / "files";
    std::filesystem::create_directories(files);
    manifest_ =
        "[import]\nrig = \"elsewhere\"\ncamera_width = 64\ncamera_height = 48\nbit_depth = 8\nprojector_width = 64\n"
        "projector_height = 48\n";
    SLX_RETURN_IF_ERROR(Add(files, {.kind = PatternKind::kWhite}));
    SLX_RETURN_IF_ERROR(Add(files, {.kind = PatternKind::kBlack}));
    for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows})
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
    db::WriteText(files / "m.toml", manifest_);
    {
      db::SessionStore store = OpenStore();
      SLX_RETURN_IF_ERROR(db::ImportSession(store, {files / "m.toml", {}, {}}, logger_).status());
    }
    SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(folder_.string(), "latest"));
    const SensorNoise noise{.saturation_dn = 255.0, .gain_e_per_dn = 20.0, .read_noise_dn = 1.0};
    return DecodeProjector(frames, 0, -1, kWidth, kHeight, noise);
  }

  ColumnCode code_ = ColumnCode::kGray;
  std::optional<ColumnCode> rows_code_;  // unset: the columns'

 private:
  Status Add(const std::filesystem::path& files, const Pattern& pattern) {
    const Image<float> shown = pattern.Render(kWidth, kHeight);
    Image<uint8_t> seen(kWidth, kHeight);
    for (size_t i = 0; i < seen.size(); ++i) seen.data()[i] = static_cast<uint8_t>(10.0F + 200.0F * shown.data()[i]);
    const std::string name = "f" + std::to_string(number_++) + ".png";
    manifest_ += "[[file]]\nfile = \"" + name + "\"\npattern = \"" + pattern.ToString() + "\"\n";
    return WritePng8(files / name, seen);
  }
  std::string manifest_;
  int number_ = 0;
  Logger logger_{LogLevel::kError};
};

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
    const auto report = DecodeImported([](const Pattern&) { return true; });
    ASSERT_TRUE(report.ok()) << ToString(code) << ": " << report.status().message();
    ExpectEveryPixelAtItsPlace(report->map, Axes::kBoth);
  }
}

TEST_F(DecodeStage, RefusesTwoCodesInOneSession) {
  rows_code_ = ColumnCode::kXor4;
  const auto report = DecodeImported([](const Pattern&) { return true; });
  EXPECT_EQ(report.status().code(), StatusCode::kUsage);
  EXPECT_THAT(report.status().message(),
              HasSubstr("frames of two codes, 'gray columns bit=5/6 inverse' and 'gray rows bit=0/6 code=xor-4'"));
}

TEST_F(DecodeStage, ReadsAWholeCode) {
  const auto report = DecodeImported([](const Pattern&) { return true; });
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

TEST_F(DecodeStage, NamesTheOneFrameThatIsMissing) {
  const auto report = DecodeImported([](const Pattern& pattern) {
    return pattern.axis != PatternAxis::kRows || pattern.bit != 4 || !pattern.inverse;
  });
  ASSERT_FALSE(report.ok());
  EXPECT_THAT(report.status().message(), HasSubstr("gray rows bit=4/6 inverse"));
}

TEST_F(DecodeStage, NamesACodeThatIsMissingAltogether) {
  const auto report = DecodeImported([](const Pattern&) { return false; });
  ASSERT_FALSE(report.ok());
  EXPECT_THAT(report.status().message(), HasSubstr("gray columns"));
}

}  // namespace
}  // namespace stratalux::fit
