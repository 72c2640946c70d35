// SPDX-License-Identifier: Apache-2.0
#include "tests/db/mutants/sample_stores.h"

#include <cstdio>
#include <cstdlib>

#include "db/care/transcode.h"
#include "db/catalogue/consent.h"
#include "db/privacy/forget.h"
#include "db/segment/segment.h"
#include "db/transfer/backup.h"
#include "shared/capture/plan.h"
#include "shared/capture/rig_calibration.h"
#include "tests/db/mutants/sealed_sample.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

void Must(const Status& status) {
  if (status.ok()) return;
  std::fprintf(stderr, "sample stores: %s\n", status.message().c_str());
  std::abort();
}
template <typename T>
T Must(Result<T> result) {
  Must(result.status());
  return std::move(result).value();
}

// 8 x 6, smooth enough for `delta` to shrink some.
Status Append(SessionWriter& writer, int step, int width = 8, int height = 6) {
  FrameRecord record = RecordFor(step, PixelFormat::kMono12, width, height);
  record.pattern = *Pattern::Parse(step % 2 == 0 ? "gray rows bit=3/10" : "gray rows bit=4/10 inverse");
  if (step == 2) record.retake_cause = "wrong level";
  Image<uint16_t> pixels(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) pixels.row(y)[x] = static_cast<uint16_t>(200 + 10 * step + x + y);
  return writer.Append(record, std::as_const(pixels).view());
}

SessionInfo Visit(const std::string& visitor, int64_t started) {
  SessionInfo info = SimulatedVisit();
  info.visitor = visitor;
  info.rig = "bench";
  info.seed = 7;
  info.started_wall = {started};
  return info;
}

std::string Capture(const fs::path& folder, SessionInfo info, int frames, const WriterOptions& options = {},
                    SessionStatus status = SessionStatus::kComplete, std::vector<std::string> reasons = {},
                    CaptureFindings found = {}) {
  SessionStore store = Must(SessionStore::Open(folder, AccessMode::kReadWrite));
  SessionWriter writer = Must(store.BeginSession(std::move(info), options));
  for (int i = 0; i < frames; ++i) Must(Append(writer, i));
  Must(writer.Finish(status, std::move(reasons), std::move(found)));
  return writer.info().id;
}

void Agree(const fs::path& folder, const std::string& visitor, int64_t given) {
  const Consent consent{"2026-03", "de", true, true, false, {given}};
  Must(GiveConsent(folder, visitor, consent));
}

SampleStore New(const fs::path& root, const std::string& name) {
  SampleStore sample;
  sample.name = name;
  sample.folder = root / name;
  Must(SessionStore::Create(sample.folder));
  return sample;
}

SampleStore Plain(const fs::path& root) {
  SampleStore sample = New(root, "plain");
  Agree(sample.folder, "v-5f3a91a1", 4'000);
  Capture(sample.folder, Visit("v-5f3a91a1", 5'000), 4, {.max_segment_bytes = 900});
  SessionInfo planned = Visit("v-5f3a91a1", 6'000);
  planned.plan_json = PlanOptionsToJson({});
  planned.visit = "evening";
  planned.attempt = 2;
  Capture(sample.folder, planned, 3, {}, SessionStatus::kDegraded, {"no proven frame for step 7"}, SomeFindings());
  return sample;
}

SampleStore Killed(const fs::path& root) {
  SampleStore sample = New(root, "killed");
  Agree(sample.folder, "v-5f3a91b2", 6'500);
  {
    SessionStore store = Must(SessionStore::Open(sample.folder, AccessMode::kReadWrite));
    SessionWriter writer = Must(store.BeginSession(Visit("v-5f3a91b2", 7'000), {.group_frames = 2}));
    for (int i = 0; i < 5; ++i) Must(Append(writer, i));
  }
  Must(SessionStore::Open(sample.folder, AccessMode::kReadWrite).status());
  SessionStore store = Must(SessionStore::Open(sample.folder, AccessMode::kReadWrite));
  SessionWriter writer = Must(store.BeginSession(Visit("v-5f3a91b2", 8'000)));
  Must(Append(writer, 0));
  const Image<float> map(4, 3, 1, 2.0F);
  Must(writer.AppendTruth("depth", map.view()));
  Must(writer.KeepTruthCalibration("{\"schema\":1}"));
  Must(writer.Finish(SessionStatus::kComplete));
  return sample;
}

SampleStore Encrypted(const fs::path& root) {
  SampleStore sample = New(root, "encrypted");
  sample.encrypted = true;
  Agree(sample.folder, "v-5f3a91c3", 8'500);
  const WriterOptions options{.encryption = Encryption::kPerSession};
  for (const int64_t started : {9'000, 10'000}) {
    const std::string id = Capture(sample.folder, Visit("v-5f3a91c3", started), 3, options);
    SessionStore store = Must(SessionStore::Open(sample.folder, AccessMode::kReadWrite));
    if (started == 9'000) Must(FitSealed(store, id));
  }
  return sample;
}

SampleStore Signed(const fs::path& root) {
  SampleStore sample = New(root, "signed");
  sample.signed_by = Must(RigKey::Create(sample.folder)).public_key();
  Agree(sample.folder, "v-5f3a91d4", 10'500);
  Capture(sample.folder, Visit("v-5f3a91d4", 11'000), 4, {.max_segment_bytes = 900, .signing = Signing::kRigKey});
  const std::string id = Capture(sample.folder, Visit("v-5f3a91d4", 12'000), 3, {.signing = Signing::kRigKey},
                                 SessionStatus::kComplete, {}, SomeFindings());
  const SessionStore store = Must(SessionStore::Open(sample.folder, AccessMode::kReadWrite));
  Logger logger(LogLevel::kError);
  Progress progress(logger, "transcode", 6);
  Must(TranscodeSession(store, Must(store.FindSession(id)), {.codec = StoreCodec::kRaw12}, progress).status());
  return sample;
}

RigCalibration CalibrationRecord() {
  RigCalibration record;
  record.source = "calibration session";
  record.camera.model = {64, 48, 100, 100, 31.5, 23.5, {}};
  record.projectors.emplace_back();
  record.projectors[0].name = "projector 0";
  record.projectors[0].model = {32, 24, 90, 90, 15.5, 11.5, {}};
  record.projectors[0].white_dn_mm2_per_ms = {1, 1, 1};
  record.made_wall.ns = 13'000;
  record.valid_until_wall.ns = 99'000;
  return record;
}

SampleStore Fitted(const fs::path& root) {
  SampleStore sample = New(root, "fitted");
  Agree(sample.folder, "v-5f3a91e5", 12'500);
  Agree(sample.folder, "v-5f3a91f6", 12'600);
  SessionInfo board = Visit("", 13'000);
  board.kind = SessionKind::kCalibration;
  const std::string calibration = Capture(sample.folder, board, 2);
  SessionInfo visit = Visit("v-5f3a91e5", 14'000);
  visit.calibration_json = CalibrationRecord().ToJson();
  const std::string fitted = Capture(sample.folder, visit, 3, {.max_segment_bytes = 700});
  const std::string gone = Capture(sample.folder, Visit("v-5f3a91f6", 15'000), 2);
  SessionStore store = Must(SessionStore::Open(sample.folder, AccessMode::kReadWrite));
  fs::create_directories(store.FitFolder(calibration, "c1"));
  WriteText(store.FitFolder(calibration, "c1") / "calibration.json", CalibrationRecord().ToJson() + "\n");
  Must(store.RegisterFit({"c1", calibration, R"({"stage":"calibrate"})", "{}", {16'000}, ""}));
  fs::create_directories(store.FitFolder(fitted, "f1"));
  WriteText(store.FitFolder(fitted, "f1") / "mesh.ply", "ply\n");
  Must(store.RegisterFit({"f1", fitted, R"({"eta":1.4})", R"({"fit": {"divergence": 0.5, "pixels": 9}})", {17'000}}));
  Logger logger(LogLevel::kError);
  Progress progress(logger, "transcode", 6);
  Must(TranscodeSession(store, Must(store.FindSession(fitted)), {.codec = StoreCodec::kRaw12}, progress).status());
  ForgetRequest request;
  request.sessions = {gone};
  request.visitors = {"v-5f3a91f6"};
  { SessionStore closed = std::move(store); }
  Must(Forget(sample.folder, request, logger).status());
  return sample;
}

// As the disk has it while the writer lives: copied in between two frames.
SampleStore Recording(const fs::path& root) {
  SampleStore alive = New(root, "alive");
  SampleStore sample;
  sample.name = "recording";
  sample.folder = root / sample.name;
  Agree(alive.folder, "v-5f3a91f7", 17'500);
  Capture(alive.folder, Visit("v-5f3a91f7", 18'000), 2);
  SessionInfo info = Visit("v-5f3a91f7", 19'000);
  info.plan_json = PlanOptionsToJson({});
  info.visit = "night";
  info.attempt = 1;
  SessionStore store = Must(SessionStore::Open(alive.folder, AccessMode::kReadWrite));
  SessionWriter writer = Must(store.BeginSession(info, {.group_frames = 1, .max_segment_bytes = 900}));
  for (int i = 0; i < 4; ++i) Must(Append(writer, i));
  fs::copy(alive.folder, sample.folder, fs::copy_options::recursive);
  for (const auto& entry : fs::directory_iterator(sample.folder / "sessions" / writer.info().id)) {
    if (entry.path().extension() != ".seg") continue;
    const SegmentReader reader = Must(SegmentReader::Open(entry.path()));
    bool sealed = false;
    const auto frames = Must(reader.Walk(false, &sealed));
    if (frames.empty()) continue;
    const SegmentFrame& last = frames.back();
    sample.acknowledged[entry.path().lexically_relative(sample.folder)] =
        static_cast<size_t>(last.offset) + sizeof(FrameHeader) + last.header.payload_bytes;
  }
  Must(writer.Finish(SessionStatus::kDegraded, {"the sample is taken"}));
  return sample;
}

SampleStore BackupOf(const SampleStore& store, const fs::path& root) {
  SampleStore sample;
  sample.name = "backup";
  sample.folder = root / sample.name;
  sample.road = Road::kRestore;
  sample.other = store.folder;
  Logger logger(LogLevel::kError);
  Must(Backup(store.folder, {sample.folder, {}, ScrubShare::kInTurn}, logger).status());
  return sample;
}

SampleStore SourceOf(const SampleStore& store, const fs::path& root) {
  SampleStore sample = store;
  sample.name = "source";
  sample.folder = root / sample.name;
  sample.road = Road::kPull;
  sample.other = New(root, "receiver").folder;
  fs::copy(store.folder, sample.folder, fs::copy_options::recursive);
  return sample;
}

}  // namespace

std::vector<SampleStore> MakeSampleStores(const fs::path& folder) {
  std::vector<SampleStore> samples = {Plain(folder),  Killed(folder), Encrypted(folder),
                                      Signed(folder), Fitted(folder), Recording(folder)};
  samples.push_back(BackupOf(samples[4], folder));
  samples.push_back(SourceOf(samples[4], folder));
  return samples;
}

}  // namespace stratalux::db
