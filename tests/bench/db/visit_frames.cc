// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/db/visit_frames.h"

#include <cstdlib>

#include "db/catalogue/session_store.h"

namespace stratalux::bench {

Result<std::vector<VisitFrame>> LoadVisit(size_t most) {
  const char* folder = std::getenv("STRATALUX_BENCH_STORE");
  if (folder == nullptr)
    return Status::Usage(
        "set STRATALUX_BENCH_STORE to a store with a visit (`stratalux-rig capture --simulate --store DIR`)");
  SLX_ASSIGN_OR_RETURN(const auto store, db::SessionStore::Open(folder, db::AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(const auto session, store.FindSession("latest"));
  SLX_ASSIGN_OR_RETURN(const auto rows, store.ListFrames(session.info.id));
  const size_t stride = (rows.size() + most - 1) / most;
  std::vector<VisitFrame> frames;
  for (size_t i = 0; i < rows.size(); i += stride) {
    SLX_ASSIGN_OR_RETURN(auto pixels, store.ReadFrame(session.info.id, rows[i]));
    frames.push_back({rows[i].record, std::move(pixels)});
  }
  if (frames.empty()) return Status::NotFound(std::string(folder) + ": the latest session has no frames");
  return frames;
}

}  // namespace stratalux::bench
