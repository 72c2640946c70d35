// SPDX-License-Identifier: Apache-2.0
// Boards of other rigs, imported: a chessboard that a projector lights, column for column and row for row, as a camera
// sees it straight on.
#include "fitter/calibration/board_stage.h"

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <string>

#include <gmock/gmock.h>

#include "db/interchange/import.h"
#include "shared/image/png.h"
#include "tests/db/store_fixture.h"

namespace stratalux::fit {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int kWidth = 480, kHeight = 400, kBits = 8;
constexpr int kColumns = 240, kRows = 200;  // of the projector, whose codes could number 256
constexpr double kPixelsPerSquare = 42.0, kFirstPx = 60.0;

// Of the board's squares; off it the table is grey.
double Albedo(double x, double y) {
  const int c = static_cast<int>(std::floor((x - kFirstPx) / kPixelsPerSquare));
  const int r = static_cast<int>(std::floor((y - kFirstPx) / kPixelsPerSquare));
  const bool inside = c >= 0 && r >= 0 && c < 8 && r < 7;
  return inside && (c + r) % 2 == 0 ? 0.05 : 0.9;
}

class BoardStage : public db::StoreTest {
 protected:
  // A session of white, black and the codes of which `wanted` says so; the frames are crops, three pixels in.
  Result<std::string> Import(const std::function<bool(const Pattern&)>& wanted) {
    const std::filesystem::path files = folder_ / "files";
    std::filesystem::create_directories(files);
    std::string manifest =
        "[import]\nrig = \"elsewhere\"\ncamera_width = 500\ncamera_height = 420\nbit_depth = 8\n"
        "projector_width = 240\nprojector_height = 200\n"
        "[[pose]]\nindex = 2\ncrop_x = 3\ncrop_y = 5\n";
    int number = 0;
    const auto add = [&](const Pattern& pattern) {
      const std::string name = "f" + std::to_string(number++) + ".png";
      manifest += "[[file]]\nfile = \"" + name + "\"\npattern = \"" + pattern.ToString() + "\"\n";
      EXPECT_TRUE(WritePng8(files / name, Seen(pattern).view()).ok());
    };
    add({.kind = PatternKind::kWhite});
    add({.kind = PatternKind::kBlack});
    for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows})
      for (int bit = 0; bit < kBits; ++bit)
        for (const bool inverse : {false, true}) {
          const Pattern code{.kind = PatternKind::kGray, .axis = axis, .bit = bit, .bits = kBits, .inverse = inverse};
          if (wanted(code)) add(code);
        }
    db::WriteText(files / "m.toml", manifest);
    db::SessionStore store = OpenStore();
    SLX_ASSIGN_OR_RETURN(const auto report, db::ImportSession(store, {files / "m.toml", {}, {}}, logger_));
    return report.session;
  }
  Result<BoardPoses> Observe(const std::string& session, const BoardStageOptions& options) {
    return ObserveBoards(folder_.string(), {session}, options, logger_);
  }
  Result<BoardPoses> Observe(const std::function<bool(const Pattern&)>& wanted, const BoardStageOptions& options) {
    SLX_ASSIGN_OR_RETURN(const std::string session, Import(wanted));
    return Observe(session, options);
  }
  // What the programs said on the way.
  std::string Said() {
    logger_.Flush();
    std::rewind(log_);
    std::string text;
    for (int c = std::fgetc(log_); c != EOF; c = std::fgetc(log_)) text += static_cast<char>(c);
    return text;
  }
  [[nodiscard]] static BoardStageOptions Chessboard() {
    BoardStageOptions options;
    options.board = {BoardKind::kChess, 8, 7, 10.0, 0.0};
    return options;
  }

 private:
  // Half a projector pixel a camera pixel.
  static Image<uint8_t> Seen(const Pattern& pattern) {
    const Image<float> shown = pattern.Render(kColumns, kRows);
    Image<uint8_t> seen(kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        seen(x, y) = static_cast<uint8_t>(std::lround(8.0 + 200.0 * Albedo(x + 0.5, y + 0.5) * shown(x / 2, y / 2)));
    return seen;
  }
  std::FILE* log_ = std::tmpfile();
  Logger logger_{LogLevel::kWarning, log_};
};

bool All(const Pattern&) { return true; }

// Where the manifest is silent a projector has the 256 x 256 that its codes can number, and a camera what its frames
// cover: both would be wrong here.
TEST_F(BoardStage, DevicesAreOfTheSizesThatTheManifestSays) {
  const auto boards = Observe(All, Chessboard());
  ASSERT_TRUE(boards.ok()) << boards.status().message();
  const CalibrationObservations& o = boards->observations;
  ASSERT_EQ(o.projectors.size(), 1U);
  EXPECT_EQ(o.projectors[0].width, kColumns);
  EXPECT_EQ(o.projectors[0].height, kRows);
  EXPECT_EQ(o.camera.width, 500);
  EXPECT_EQ(o.camera.height, 420);
  EXPECT_EQ(boards->saturation_dn, 255.0);
  EXPECT_THAT(Said(), IsEmpty());
  ASSERT_EQ(o.poses.size(), 1U);
  EXPECT_EQ(o.poses[0].corners.size(), 42U);
  for (const auto& corner : o.poses[0].corners) {
    ASSERT_TRUE(corner.projector_px[0].has_value());
    EXPECT_NEAR(corner.projector_px[0]->x(), (corner.camera_px.x() - 3.0) / 2.0 - 0.25, 0.3);
    EXPECT_NEAR(corner.projector_px[0]->y(), (corner.camera_px.y() - 5.0) / 2.0 - 0.25, 0.3);
  }
}

TEST_F(BoardStage, FlagsPrevailOverTheManifest) {
  BoardStageOptions options = Chessboard();
  options.camera_size = DeviceSize{640, 480};
  options.projector_size = DeviceSize{250, 210};
  const auto boards = Observe(All, options);
  ASSERT_TRUE(boards.ok()) << boards.status().message();
  EXPECT_EQ(boards->observations.camera.width, 640);
  EXPECT_EQ(boards->observations.projectors[0].width, 250);
}

// An import of before its manifest was kept.
TEST_F(BoardStage, AProjectorOfUnknownSizeIsWarnedOf) {
  const auto session = Import(All);
  ASSERT_TRUE(session.ok()) << session.status().message();
  std::filesystem::remove(folder_ / "sessions" / *session / "manifest.json");
  const auto boards = Observe(*session, Chessboard());
  ASSERT_TRUE(boards.ok()) << boards.status().message();
  EXPECT_EQ(boards->observations.projectors[0].width, 256);
  EXPECT_THAT(Said(),
              HasSubstr("taken as 256x256, the largest size that their codes can number; give --projector-size"));
}

TEST_F(BoardStage, NeedsNoInversesAndSaysWhatIsNotLookedAt) {
  const auto boards = Observe([](const Pattern& code) { return !code.inverse; }, Chessboard());
  ASSERT_TRUE(boards.ok()) << boards.status().message();
  EXPECT_EQ(boards->observations.poses[0].corners.size(), 42U);
  EXPECT_TRUE(boards->observations.poses[0].corners[0].projector_px[0].has_value());
  EXPECT_THAT(Said(), HasSubstr("projector 0's finest row code was captured without its inverse"));
}

TEST_F(BoardStage, NeedsBothAxes) {
  for (const PatternAxis axis : {PatternAxis::kColumns, PatternAxis::kRows}) {
    const auto boards = Observe([axis](const Pattern& code) { return code.axis == axis; }, Chessboard());
    ASSERT_FALSE(boards.ok());
    EXPECT_THAT(boards.status().message(),
                HasSubstr(axis == PatternAxis::kColumns ? "has codes of columns alone; boards need both axes"
                                                        : "has codes of rows alone; boards need both axes"));
  }
}

}  // namespace
}  // namespace stratalux::fit
