// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/board.h"

#include <sstream>

namespace stratalux::fit {
namespace {
constexpr int kDictionaryMarkers = 50;
}

const char* ToString(BoardKind kind) { return kind == BoardKind::kChess ? "chess" : "charuco"; }

Result<BoardKind> ParseBoardKind(const std::string& text) {
  for (const BoardKind kind : {BoardKind::kChess, BoardKind::kCharuco})
    if (text == ToString(kind)) return kind;
  return Status::Usage("board '" + text + "' is unknown; allowed: chess, charuco");
}

Status BoardDescription::Validate() const {
  std::ostringstream what;
  what << "board of " << columns << "x" << rows << " squares of " << square_mm << " mm: ";
  if (columns < 3 || rows < 3 || columns > 100 || rows > 100)
    return Status::Usage(what.str() + "needs 3 to 100 squares each way");
  if (corners() < kLeastCorners)
    return Status::Usage(what.str() + "has " + std::to_string(corners()) + " inner corners, of which a pose needs " +
                         std::to_string(kLeastCorners));
  if (!(square_mm > 0.0)) return Status::Usage(what.str() + "the square's side must be positive");
  if (kind == BoardKind::kChess) return Status::Ok();
  if (!(marker_mm > 0.0 && marker_mm < square_mm))
    return Status::Usage(what.str() + "markers of " + std::to_string(marker_mm) + " mm do not fit its squares");
  if (columns * rows / 2 > kDictionaryMarkers)
    return Status::Usage(what.str() + "needs " + std::to_string(columns * rows / 2) + " markers, the dictionary has " +
                         std::to_string(kDictionaryMarkers));
  return Status::Ok();
}

}  // namespace stratalux::fit
