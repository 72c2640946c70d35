// SPDX-License-Identifier: Apache-2.0
// Codes the frames of a finished session anew. Pixels and proofs stay bit for bit; the segments that hold them are new.
//
// Order: journal -> new segments, synced -> every frame read back from both and compared -> rows in one transaction
//        -> manifest -> old segments removed -> journal removed.
// Stopped anywhere, the session is readable with all its frames; the next read-write opening of the store clears what
// is left over. A frame's payload hash is of its stored bytes and changes with the codec; its pixel hash
// stays (a frame of before gets one), and with it the name by which fits know the session: none is made anew.
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "db/catalogue/session_store.h"
#include "shared/base/log.h"
#include "shared/base/result.h"
#include "shared/capture/store_codec.h"

namespace stratalux::db {

// What has just been done.
enum class TranscodeStep { kJournalWritten, kFrameWritten, kSegmentsSynced, kCompared, kCommitted, kSettled };

struct TranscodeOptions {
  StoreCodec codec = StoreCodec::kDelta;
  int64_t max_segment_bytes = WriterOptions{}.max_segment_bytes;
  std::function<void(TranscodeStep)> on_step = {};  // may be empty; tests stop the program here
};

struct TranscodeReport {
  int64_t frames = 0;
  int64_t changed = 0;                        // frames with another codec than before; 0: nothing was rewritten
  int64_t bytes_before = 0, bytes_after = 0;  // payloads
};

// kBusy: the session is being recorded, or the store written. kIntegrity: a damaged frame (nothing is changed then).
// kUsage: an encrypted session, whose payloads no codec may touch. Progress counts frames, each written and compared.
Result<TranscodeReport> TranscodeSession(const SessionStore& store, const SessionRow& session,
                                         const TranscodeOptions& options, Progress& progress);

}  // namespace stratalux::db
