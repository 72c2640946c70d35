// SPDX-License-Identifier: Apache-2.0
// The session store: an SQLite index over append-only frame segments (docs/file-formats.md).
//
// Order of a write: segment bytes -> fdatasync -> row COMMIT -> acknowledge. A failed write or sync fails the session,
// for good, and leaves every other one readable. Names count as much as bytes: a folder is synced before anything is
// acknowledged that lies in it. No sqlite3 type appears here.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/capture/frame_record.h"
#include "shared/capture/session.h"
#include "shared/capture/store_codec.h"
#include "shared/image/image.h"

namespace stratalux::db {

inline constexpr int kSchemaVersion = 9;

// A session without what only its own work needs: a list of a hundred thousand carries no plan, no calibration and no
// findings.
struct SessionSummary {
  SessionInfo info;  // plan_json, calibration_json and found empty
  int64_t frames = 0;
  int64_t bytes = 0;   // payload bytes on disk
  std::string key_id;  // 32 hex digits; empty: not encrypted
};

// The whole of one session.
struct SessionRow : SessionSummary {};

struct FrameRow {
  int64_t id = 0;  // position of the frame in the session, 0-based
  FrameRecord record;
  std::string codec;    // "raw8" | "raw12" | "raw16" | "f32" | "delta"
  std::string segment;  // file name within the session folder
  int64_t offset = 0;   // of the frame record in the segment
  int64_t stored_bytes = 0;
  std::string hash;        // XXH3-128 of the stored payload, 32 hex digits
  std::string pixel_hash;  // of the samples, whatever the codec (db/segment/pixel_hash.h); empty: not recorded
};

struct FitRow {
  std::string id;  // content hash of inputs + options + program version
  std::string session;
  std::string options_json;
  std::string metrics_json;  // what the index keeps of metrics.json, may be empty
  WallNs created_wall;
  std::string calibration_json =
      {};  // record of its folder's calibration.json, if it has one (db/catalogue/calibration_store.h)
  // Of fit.json alone: the artifact of each stage that the fit was made of (db/catalogue/artifact_record.h).
  std::map<std::string, std::string> artifacts = {};
};

struct RegisterOptions {
  // Token of the lease under which it was fitted: the row is entered only while that lease stands
  // (db/catalogue/job_store.h).
  std::optional<int64_t> job_token = {};
  // How long to ask again while other programs write the index.
  std::chrono::milliseconds patience{60'000};
};

enum class AccessMode { kReadOnly, kReadWrite };

// kPerSession: each session has a key of its own in keys.sqlite (db/segment/frame_cipher.h).
enum class Encryption { kNone, kPerSession };

// kRigKey: a finished session is signed with the rig's key (db/catalogue/signature.h).
enum class Signing { kNone, kRigKey };

struct WriterOptions {
  StoreCodec codec = StoreCodec::kDelta;  // smaller and fast enough for any camera here (docs/benchmarks.md)
  // Frames are acknowledged together once there are so many, or once the first of them has waited so long: looked at
  // with each frame, and by FlushIfDue().
  int group_frames = 16;
  std::chrono::milliseconds group_window{250};
  int64_t max_segment_bytes = int64_t{1} << 30;
  Encryption encryption = Encryption::kNone;
  Signing signing = Signing::kNone;
  std::function<std::chrono::steady_clock::time_point()> now = std::chrono::steady_clock::now;

  [[nodiscard]] Status Validate() const;
};

class SessionStore;

// Appends the frames of one session. Thread-bound. Dropped without Finish(): the session stays `recording` and the next
// read-write open ends it (db/catalogue/recovery.h). After a failure every call repeats it, and the session is
// `failed`, or stays `recording` for the next open where not even that can be written.
class SessionWriter {
 public:
  ~SessionWriter();
  SessionWriter(SessionWriter&&) noexcept;
  SessionWriter& operator=(SessionWriter&&) noexcept;

  [[nodiscard]] const SessionInfo& info() const;
  // `pixels`: height x width x channels samples. uint16_t for kMono12 / kMono16, uint8_t for kMono8, float for kF32.
  // Values above the bit depth are refused (kUsage). Acknowledged only once a later Flush() or group commit succeeded.
  Status Append(const FrameRecord& record, ImageView<const uint16_t> pixels);
  Status Append(const FrameRecord& record, ImageView<const uint8_t> pixels);
  // Maps of truth.seg (simulation only); `name` such as "depth", "normal", "subsurface stripe 2". Not indexed.
  Status AppendTruth(const std::string& name, ImageView<const float> pixels);
  // truth_calibration.json (simulation only): the exact record, where the session names another calibration.
  Status KeepTruthCalibration(const std::string& record_json);
  Status Flush();
  // Flush() if the first unacknowledged frame has waited for group_window: for writers to whom no frame comes.
  Status FlushIfDue();
  [[nodiscard]] int64_t acknowledged_frames() const;
  // Seals the segment, writes manifest.json, then the final status. A power cut after the manifest: the next open finds
  // the session finished. kUsage for findings that no manifest takes (CheckFound): nothing was done.
  Status Finish(SessionStatus status, std::vector<std::string> reasons = {}, CaptureFindings found = {});

 private:
  friend class SessionStore;
  struct Impl;
  explicit SessionWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Thread-bound; open one per thread.
class SessionStore {
 public:
  // Creates STORE/index.sqlite at the newest schema; an existing store is left as it is (kOk). kIntegrity where
  // sessions lie without their index.
  static Status Create(const std::filesystem::path& folder);
  // kNotFound: no store there; kNewerSchema; kIntegrity: a foreign or damaged file; kBusy: another writer.
  static Result<SessionStore> Open(const std::filesystem::path& folder, AccessMode mode);
  ~SessionStore();
  SessionStore(SessionStore&&) noexcept;
  SessionStore& operator=(SessionStore&&) noexcept;

  [[nodiscard]] const std::filesystem::path& folder() const;
  // What opening mended (read-write), or found to mend (read-only, or a disk that cannot be written): one line each,
  // for the program to show as a warning.
  [[nodiscard]] const std::vector<std::string>& notes() const;

  // Starts a session; info.id is given here (order never depends on a wall clock). Read-write mode only. A session of
  // kind visitor takes its consent from the store (db/catalogue/consent.h): kUsage with the remedy where none holds.
  Result<SessionWriter> BeginSession(SessionInfo info, const WriterOptions& options = {});

  // Newest first; FindSession(info.id) has the rest of one. The second: of one visitor.
  Result<std::vector<SessionSummary>> ListSessions() const;
  Result<std::vector<SessionSummary>> ListSessionsOf(const std::string& visitor) const;
  // `selector`: an id, a unique prefix of one, or "latest" (that has frames). kNotFound, or kUsage when ambiguous. As
  // fast in a store of a hundred thousand sessions as in one of ten.
  Result<SessionRow> FindSession(const std::string& selector) const;
  // As the session's manifest says; nothing is known where it has none that can be read.
  [[nodiscard]] SessionDevices DevicesOf(const std::string& session_id) const;
  Result<std::vector<FrameRow>> ListFrames(const std::string& session_id) const;
  // Decoded pixels; 8-bit frames are widened. Every read checks the hashes of payload and pixels: kIntegrity names
  // session, segment and offset.
  // kNotFound for an encrypted session whose key is not here.
  Result<Image<uint16_t>> ReadFrame(const std::string& session_id, const FrameRow& frame) const;
  [[nodiscard]] std::filesystem::path SessionFolder(const std::string& session_id) const;

  // Folder for a fit's outputs, registered once complete (which syncs it); replaces an equal id. A folder with
  // calibration.json becomes a calibration of the session's rig, too (db/catalogue/calibration_store.h).
  [[nodiscard]] std::filesystem::path FitFolder(const std::string& session_id, const std::string& fit_id) const;
  // db/catalogue/fit_store.h says when a fit is refused.
  Status RegisterFit(const FitRow& fit, const RegisterOptions& options = {});
  Result<std::vector<FitRow>> ListFits(const std::string& session_id) const;

 private:
  struct Impl;
  explicit SessionStore(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace stratalux::db
