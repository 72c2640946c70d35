// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/session_store.h"

#include <bit>
#include <csignal>
#include <functional>
#include <limits>

#include <gmock/gmock.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/base/sqlite.h"
#include "db/care/verify.h"
#include "db/catalogue/manifest.h"
#include "db/segment/truth_segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

void ExpectSameRecord(const FrameRecord& a, const FrameRecord& b) {
  EXPECT_EQ(a.step, b.step);
  EXPECT_EQ(a.projector, b.projector);
  EXPECT_EQ(a.phase, b.phase);
  EXPECT_EQ(a.pattern, b.pattern);
  EXPECT_EQ(a.bracket, b.bracket);
  EXPECT_EQ(a.pose, b.pose);
  EXPECT_EQ(a.retry, b.retry);
  EXPECT_EQ(a.trigger_number, b.trigger_number);
  EXPECT_EQ(a.trigger_time, b.trigger_time);
  EXPECT_EQ(a.sync_time, b.sync_time);
  EXPECT_EQ(a.driver_sequence, b.driver_sequence);
  EXPECT_EQ(a.frame_time, b.frame_time);
  EXPECT_EQ(a.frame_clock, b.frame_clock);
  EXPECT_EQ(a.exposure_ms, b.exposure_ms);
  EXPECT_EQ(a.gain, b.gain);
  EXPECT_EQ(a.level_check, b.level_check);
  EXPECT_EQ(a.mean_dn, b.mean_dn);
  EXPECT_EQ(a.format, b.format);
  EXPECT_EQ(a.cfa, b.cfa);
  EXPECT_EQ(a.width, b.width);
  EXPECT_EQ(a.height, b.height);
  EXPECT_EQ(a.channels, b.channels);
  EXPECT_EQ(a.crop_x, b.crop_x);
  EXPECT_EQ(a.crop_y, b.crop_y);
}

bool SamePixels(const Image<uint16_t>& a, const Image<uint16_t>& b) {
  return a.width() == b.width() && a.height() == b.height() && a.channels() == b.channels() &&
         std::equal(a.pixels().begin(), a.pixels().end(), b.pixels().begin());
}

using SessionStoreTest = StoreTest;

TEST_F(SessionStoreTest, GivesBackEveryFormatAndTheWholeProofOfAFrame) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit());
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  // Odd widths: the last pixel of a packed row stands alone. Three 12-bit channels are not packed.
  const std::vector<FrameRecord> records = {
      RecordFor(0, PixelFormat::kMono12, 7, 5), RecordFor(1, PixelFormat::kMono12, 8, 3),
      RecordFor(2, PixelFormat::kMono16, 5, 4), RecordFor(3, PixelFormat::kMono12, 3, 2, 3),
      RecordFor(4, PixelFormat::kMono8, 9, 2)};
  const std::vector<std::string> codecs = {"raw12", "raw12", "raw16", "raw16", "raw8"};
  const std::vector<int64_t> bytes = {5 * 11, 3 * 12, 5 * 4 * 2, 3 * 2 * 3 * 2, 9 * 2};
  for (const FrameRecord& r : records) {
    const auto pixels = PixelsFor(r);
    if (r.format != PixelFormat::kMono8) {
      ASSERT_TRUE(writer->Append(r, pixels.view()).ok());
      continue;
    }
    Image<uint8_t> narrow(r.width, r.height);
    for (size_t i = 0; i < narrow.size(); ++i) narrow.data()[i] = static_cast<uint8_t>(pixels.data()[i]);
    ASSERT_TRUE(writer->Append(r, ImageView<const uint8_t>(narrow.data(), r.width, r.height)).ok());
  }
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  const auto frames = store.ListFrames(writer->info().id);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  ASSERT_EQ(frames->size(), records.size());
  for (size_t i = 0; i < records.size(); ++i) {
    SCOPED_TRACE(i);
    const FrameRow& row = (*frames)[i];
    EXPECT_EQ(row.id, static_cast<int64_t>(i));
    EXPECT_EQ(row.codec, codecs[i]);
    EXPECT_EQ(row.stored_bytes, bytes[i]);
    ExpectSameRecord(row.record, records[i]);
    const auto image = store.ReadFrame(writer->info().id, row);
    ASSERT_TRUE(image.ok()) << image.status().message();
    EXPECT_TRUE(SamePixels(*image, PixelsFor(records[i])));
  }
}

// What an index that is built again would refuse, or tell otherwise, is refused before it is written.
TEST_F(SessionStoreTest, TakesNoSessionThatARebuildWouldRefuse) {
  SessionStore store = OpenStore();
  const auto begin = [&](const std::function<void(SessionInfo&)>& change) {
    SessionInfo info = SimulatedVisit();
    change(info);
    return store.BeginSession(info).status();
  };
  const std::string zero("a\0b", 3);
  for (const Status& refused :
       {begin([&](SessionInfo& i) { i.rig = zero; }), begin([&](SessionInfo& i) { i.program_version = zero; }),
        begin([](SessionInfo& i) { i.started_wall.ns = -1; }), begin([](SessionInfo& i) { i.plan_json = "no plan"; }),
        begin([](SessionInfo& i) { i.calibration_json = "[1]"; })}) {
    EXPECT_EQ(refused.code(), StatusCode::kUsage) << refused.message();
    EXPECT_FALSE(refused.message().empty());
  }
  EXPECT_THAT(*store.ListSessions(), IsEmpty()) << "nothing is left of what did not begin";

  auto writer = store.BeginSession(SimulatedVisit());
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  const auto append = [&](const std::function<void(FrameRecord&)>& change) {
    FrameRecord record = RecordFor(0, PixelFormat::kMono12, 4, 2);
    change(record);
    return writer->Append(record, Image<uint16_t>(4, 2).view());
  };
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  for (const Status& refused :
       {append([&](FrameRecord& r) { r.exposure_ms = nan; }), append([&](FrameRecord& r) { r.gain = infinity; }),
        append([&](FrameRecord& r) { r.mean_dn = -infinity; }), append([](FrameRecord& r) { r.exposure_ms = -1.0; }),
        append([](FrameRecord& r) { r.step = -1; }), append([](FrameRecord& r) { r.projector = -2; }),
        append([](FrameRecord& r) { r.phase = static_cast<CapturePhase>(10); }),
        append([](FrameRecord& r) { r.frame_clock = static_cast<ClockSource>(7); }),
        append([&](FrameRecord& r) { r.retake_cause = zero; })}) {
    EXPECT_EQ(refused.code(), StatusCode::kUsage) << refused.message();
    EXPECT_THAT(refused.message(), HasSubstr("step"));
  }
  EXPECT_EQ(writer->AppendTruth(zero, Image<float>(2, 2).view()).code(), StatusCode::kUsage);
  ASSERT_TRUE(AppendTo(*writer, 0).ok()) << "the session goes on";
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  const auto report = VerifySession(store, *store.FindSession(writer->info().id));
  EXPECT_THAT(report->problems, IsEmpty());
}

TEST_F(SessionStoreTest, GivesBackTruthMapsBitForBitIncludingNaN) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit());
  ASSERT_TRUE(writer.ok());
  Image<float> map(3, 2, 3, 0.25F);
  map(1, 1, 2) = std::numeric_limits<float>::quiet_NaN();
  map(2, 0, 0) = -1e-30F;
  const Image<float>& depth = map;
  ASSERT_TRUE(writer->AppendTruth("depth", depth.view()).ok());
  EXPECT_EQ(writer->AppendTruth("", depth.view()).code(), StatusCode::kUsage);
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  const auto truth = TruthSegment::Open(store.SessionFolder(writer->info().id) / "truth.seg");
  ASSERT_TRUE(truth.ok()) << truth.status().message();
  EXPECT_THAT(truth->names(), ::testing::ElementsAre("depth"));
  const auto read = truth->Read("depth");
  ASSERT_TRUE(read.ok()) << read.status().message();
  for (size_t i = 0; i < map.size(); ++i)
    EXPECT_EQ(std::bit_cast<uint32_t>(read->data()[i]), std::bit_cast<uint32_t>(map.data()[i]));
  EXPECT_EQ(truth->Read("normal").status().code(), StatusCode::kNotFound);
}

TEST_F(SessionStoreTest, RefusesSamplesAboveTheBitDepthAndPixelsOfAnotherSize) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit());
  ASSERT_TRUE(writer.ok());
  const FrameRecord record = RecordFor(0, PixelFormat::kMono12, 4, 4);
  Image<uint16_t> pixels(4, 4, 1, 4096);
  EXPECT_EQ(writer->Append(record, std::as_const(pixels).view()).code(), StatusCode::kUsage);
  const Image<uint16_t> narrow(3, 4);
  EXPECT_EQ(writer->Append(record, narrow.view()).code(), StatusCode::kUsage);
  EXPECT_TRUE(AppendTo(*writer, 0).ok()) << "a refused frame must not fail the session";
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  EXPECT_EQ(store.ListFrames(writer->info().id)->size(), 1U);
}

TEST_F(SessionStoreTest, AcknowledgesAGroupOnlyWhenOthersCanReadIt) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit(), Groups(4));
  ASSERT_TRUE(writer.ok());
  for (int i = 0; i < 9; ++i) {
    ASSERT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_EQ(writer->acknowledged_frames(), (i + 1) / 4 * 4);
    const SessionStore reader = OpenStore(AccessMode::kReadOnly);
    EXPECT_EQ(static_cast<int64_t>(reader.ListFrames(writer->info().id)->size()), writer->acknowledged_frames());
  }
  ASSERT_TRUE(writer->Flush().ok());
  EXPECT_EQ(writer->acknowledged_frames(), 9);
}

TEST_F(SessionStoreTest, AGroupDoesNotWaitLongerThanItsWindow) {
  SessionStore store = OpenStore();
  auto writer =
      store.BeginSession(SimulatedVisit(), {.group_frames = 1000, .group_window = std::chrono::milliseconds(0)});
  ASSERT_TRUE(writer.ok());
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_EQ(writer->acknowledged_frames(), i + 1);
  }
}

TEST_F(SessionStoreTest, RefusesImpossibleWriterOptions) {
  SessionStore store = OpenStore();
  for (const WriterOptions& options :
       {WriterOptions{.group_frames = 0}, WriterOptions{.group_window = std::chrono::milliseconds(-1)},
        WriterOptions{.max_segment_bytes = 0}})
    EXPECT_EQ(store.BeginSession(SimulatedVisit(), options).status().code(), StatusCode::kUsage);
  EXPECT_TRUE(store.ListSessions()->empty());
}

TEST_F(SessionStoreTest, SpreadsALongSessionOverSegments) {
  const std::string id = StoreSession(10, {.group_frames = 3, .max_segment_bytes = 1000});
  EXPECT_TRUE(std::filesystem::exists(Segment(id, 4)));
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const auto frames = store.ListFrames(id);
  ASSERT_TRUE(frames.ok()) << frames.status().message();
  ASSERT_EQ(frames->size(), 10U);
  for (const FrameRow& row : *frames)
    EXPECT_TRUE(SamePixels(*store.ReadFrame(id, row), PixelsFor(row.record))) << row.segment;
  EXPECT_THAT(VerifySession(store, *store.FindSession(id))->problems, IsEmpty());
}

TEST_F(SessionStoreTest, KeepsWhatASessionSaysOfItselfInIndexAndManifest) {
  SessionStore store = OpenStore();
  SessionInfo info;
  info.kind = SessionKind::kFlat;
  info.rig = "rig \"7\"";
  info.visitor = "v-12";
  info.consent = {"2026-01", "de", true, false, true, {1'600'000'000'000'000'000}};
  info.retention = Retention::kLong;
  info.simulated = true;
  info.seed = std::numeric_limits<uint64_t>::max();
  info.started_wall = {1'700'000'000'000'000'000};
  info.program_version = "9.9";
  info.plan_json = PlanOptionsToJson({});
  info.visit = "2026-03-07/12";
  info.attempt = 2;
  info.devices = {1392, 1042, 1280, 800, 4092.0};
  auto writer = store.BeginSession(info);
  ASSERT_TRUE(writer.ok());
  ASSERT_TRUE(writer->Finish(SessionStatus::kDegraded, {"step 3 has no frame"}, SomeFindings()).ok());
  const auto row = store.FindSession(writer->info().id);
  const auto manifest = ReadManifest(store.SessionFolder(writer->info().id));
  ASSERT_TRUE(row.ok() && manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->devices, info.devices);
  EXPECT_EQ(store.DevicesOf(row->info.id), info.devices);
  std::filesystem::remove(store.SessionFolder(row->info.id) / "manifest.json");
  EXPECT_EQ(store.DevicesOf(row->info.id), SessionDevices{}) << "nothing is known without a manifest";
  for (const SessionInfo* read : {&row->info, &*manifest}) {
    EXPECT_EQ(read->id, writer->info().id);
    EXPECT_EQ(read->kind, info.kind);
    EXPECT_EQ(read->rig, info.rig);
    EXPECT_EQ(read->visitor, info.visitor);
    EXPECT_EQ(read->consent, info.consent);
    EXPECT_EQ(read->retention, info.retention);
    EXPECT_GT(read->finished_wall.ns, info.started_wall.ns);
    EXPECT_TRUE(read->simulated);
    EXPECT_EQ(read->seed, info.seed);
    EXPECT_EQ(read->started_wall, info.started_wall);
    EXPECT_EQ(read->status, SessionStatus::kDegraded);
    EXPECT_THAT(read->reasons, ::testing::ElementsAre("step 3 has no frame"));
    EXPECT_EQ(read->visit, info.visit);
    EXPECT_EQ(read->attempt, 2);
    EXPECT_EQ(read->found, SomeFindings());
    EXPECT_EQ(read->program_version, info.program_version);
    EXPECT_TRUE(PlanOptionsFromJson(read->plan_json).ok());
  }
}

TEST(SessionDevices, AreReadBackAndNothingElseIs) {
  for (const SessionDevices& devices :
       {SessionDevices{}, SessionDevices{.projector_width = 1280, .projector_height = 800},
        SessionDevices{.saturation_dn = 65535.0}}) {
    const auto back = DevicesFromJson(DevicesToJson(devices));
    ASSERT_TRUE(back.ok()) << back.status().message();
    EXPECT_EQ(*back, devices);
  }
  EXPECT_EQ(DevicesToJson({}), "{}");
  for (const char* text : {"[]", "", R"({"camera_width":0})", R"({"camera_height":-3})", R"({"projector_width":3.5})",
                           R"({"projector_height":1e9})", R"({"projector_height":70000})", R"({"saturation_dn":0})",
                           R"({"saturation_dn":"4095"})", R"({"saturation_dn":65536})"})
    EXPECT_EQ(DevicesFromJson(text).status().code(), StatusCode::kIntegrity) << text;
}

TEST_F(SessionStoreTest, SelectsByIdUniquePrefixAndLatest) {
  const std::string first = StoreSession(1), second = StoreSession(2);
  const std::string empty = StoreSession(0);
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  EXPECT_EQ(store.FindSession(first)->info.id, first);
  EXPECT_EQ(store.FindSession("s000001")->info.id, first);
  EXPECT_EQ(store.FindSession("latest")->info.id, second) << "a session without frames is not worth a fit";
  EXPECT_EQ(store.FindSession("s00000").status().code(), StatusCode::kUsage);
  EXPECT_EQ(store.FindSession("").status().code(), StatusCode::kNotFound);
  EXPECT_EQ(store.FindSession("x").status().code(), StatusCode::kNotFound);
  const auto rows = store.ListSessions();
  ASSERT_EQ(rows->size(), 3U);
  EXPECT_EQ((*rows)[0].info.id, empty);
  EXPECT_EQ((*rows)[2].info.id, first);
}

TEST_F(SessionStoreTest, ReplacesAFitOfEqualId) {
  const std::string id = StoreSession(1);
  SessionStore store = OpenStore();
  ASSERT_TRUE(store.RegisterFit({"f1", id, "{}", R"({"a":1})", {5}}).ok());
  ASSERT_TRUE(store.RegisterFit({"f1", id, "{}", R"({"a":2})", {6}}).ok());
  const auto fits = store.ListFits(id);
  ASSERT_EQ(fits->size(), 1U);
  EXPECT_EQ((*fits)[0].metrics_json, R"({"a":2})");
}

TEST_F(SessionStoreTest, ASecondWriterIsToldToWait) {
  SessionStore store = OpenStore();
  {
    auto writer = store.BeginSession(SimulatedVisit());
    ASSERT_TRUE(writer.ok());
    SessionStore other = OpenStore();
    EXPECT_EQ(other.BeginSession(SimulatedVisit()).status().code(), StatusCode::kBusy);
    EXPECT_EQ(other.FindSession(writer->info().id)->info.status, SessionStatus::kRecording)
        << "a live writer's session must not be recovered";
  }
  EXPECT_TRUE(store.BeginSession(SimulatedVisit()).ok());
}

TEST_F(SessionStoreTest, AnAbandonedSessionBecomesFailedAndKeepsWhatWasAcknowledged) {
  std::string id;
  {
    SessionStore store = OpenStore();
    SessionInfo info = SimulatedVisit();
    info.devices.saturation_dn = 4092.0;
    auto writer = store.BeginSession(info, Groups(2));
    ASSERT_TRUE(writer.ok());
    id = writer->info().id;
    for (int i = 0; i < 5; ++i) ASSERT_TRUE(AppendTo(*writer, i).ok());
  }
  EXPECT_EQ(OpenStore(AccessMode::kReadOnly).FindSession(id)->info.status, SessionStatus::kRecording);
  // Reading tells what is left to do and does nothing; writing does it and says so; then there is nothing to say.
  EXPECT_THAT(OpenStore(AccessMode::kReadOnly).notes(),
              ::testing::Contains(AllOf(HasSubstr(id), HasSubstr("356 bytes to be cut from frames-0001.seg"))));
  const SessionStore store = OpenStore(AccessMode::kReadWrite);
  EXPECT_THAT(store.notes(),
              ::testing::Contains(AllOf(HasSubstr(id), HasSubstr("356 bytes cut from frames-0001.seg"))));
  EXPECT_THAT(store.notes(), ::testing::Contains(HasSubstr("4 acknowledged frames kept")));
  EXPECT_THAT(OpenStore(AccessMode::kReadWrite).notes(), IsEmpty());
  const auto manifest = ReadManifest(store.SessionFolder(id));
  ASSERT_TRUE(manifest.ok()) << manifest.status().message();
  EXPECT_EQ(manifest->status, SessionStatus::kFailed);
  EXPECT_EQ(manifest->devices.saturation_dn, 4092.0);
  const auto row = store.FindSession(id);
  EXPECT_EQ(row->info.status, SessionStatus::kFailed);
  ASSERT_EQ(row->info.reasons.size(), 1U);
  EXPECT_THAT(row->info.reasons[0], HasSubstr("4 acknowledged frames"));
  const auto frames = store.ListFrames(id);
  ASSERT_EQ(frames->size(), 4U);
  for (const FrameRow& f : *frames) EXPECT_TRUE(SamePixels(*store.ReadFrame(id, f), PixelsFor(f.record)));
  EXPECT_THAT(VerifySession(store, *row)->problems, IsEmpty());
}

TEST_F(SessionStoreTest, AKilledProcessLosesNothingThatWasAcknowledged) {
  // `frames` of groups of 2, then half a record, then death without a destructor.
  for (const int frames : {0, 1, 5}) {
    SCOPED_TRACE(frames);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      auto store = SessionStore::Open(folder_, AccessMode::kReadWrite);
      if (!store.ok()) _exit(1);
      auto writer = store->BeginSession(SimulatedVisit(), Groups(2));
      if (!writer.ok()) _exit(2);
      for (int i = 0; i < frames; ++i)
        if (!AppendTo(*writer, i).ok()) _exit(3);
      if (frames > 0) {
        auto bytes = ReadBytes(Segment(writer->info().id));
        bytes.resize(bytes.size() + 100, 0x46);
        WriteBytes(Segment(writer->info().id), bytes);
      }
      _exit(0);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_EQ(status, 0);
    const SessionStore store = OpenStore(AccessMode::kReadWrite);
    const SessionRow row = *store.FindSession((*store.ListSessions())[0].info.id);
    EXPECT_EQ(row.info.status, SessionStatus::kFailed);
    EXPECT_EQ(row.frames, frames / 2 * 2);
    EXPECT_THAT(VerifySession(store, row)->problems, IsEmpty());
  }
}

TEST_F(SessionStoreTest, AFailedWriteFailsItsSessionAndNoOther) {
  const std::string good = StoreSession(3);
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit(), {.codec = StoreCodec::kRaw12, .group_frames = 1});
  ASSERT_TRUE(writer.ok());
  const std::string id = writer->info().id;
  // The segment would grow beyond 1 MiB: the kernel answers EFBIG, as a full disk answers ENOSPC.
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit limit = before;
  limit.rlim_cur = 1 << 20;
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
  const FrameRecord record = RecordFor(0, PixelFormat::kMono16, 400, 400);
  const auto pixels = PixelsFor(record);
  Status status;
  for (int i = 0; i < 8 && status.ok(); ++i) status = writer->Append(record, pixels.view());
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, old_handler);
  EXPECT_EQ(status.code(), StatusCode::kFailed);
  EXPECT_THAT(status.message(), HasSubstr("frames-0001.seg"));
  EXPECT_EQ(writer->Append(record, pixels.view()).message(), status.message()) << "the first failure stands";
  EXPECT_FALSE(writer->Finish(SessionStatus::kComplete).ok());
  EXPECT_EQ(store.FindSession(id)->info.status, SessionStatus::kFailed);
  EXPECT_EQ(store.ListFrames(id)->size(), 3U) << "3 frames of 320 kB fit in 1 MiB";
  EXPECT_THAT(VerifySession(store, *store.FindSession(id))->problems, IsEmpty()) << "the torn tail is gone";
  EXPECT_THAT(VerifySession(store, *store.FindSession(good))->problems, IsEmpty());
}

TEST_F(SessionStoreTest, NamesTheFolderItCannotMake) {
  WriteText(folder_ / "file", "not a folder");
  const Status status = SessionStore::Create(folder_ / "file" / "store");
  EXPECT_EQ(status.code(), StatusCode::kFailed);
  EXPECT_THAT(status.message(), HasSubstr("file/store"));
}

TEST_F(SessionStoreTest, CreatingTwiceLeavesTheStoreAsItIs) {
  const std::string id = StoreSession(2);
  ASSERT_TRUE(SessionStore::Create(folder_).ok());
  EXPECT_EQ(OpenStore().ListFrames(id)->size(), 2U);
}

TEST_F(SessionStoreTest, RefusesStoresOfANewerProgram) {
  ASSERT_TRUE(Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)
                  ->Execute("PRAGMA user_version = 99")
                  .ok());
  for (const AccessMode mode : {AccessMode::kReadOnly, AccessMode::kReadWrite}) {
    const auto store = SessionStore::Open(folder_, mode);
    EXPECT_EQ(store.status().code(), StatusCode::kNewerSchema);
    EXPECT_THAT(store.status().message(), HasSubstr("99"));
  }
}

TEST_F(SessionStoreTest, RefusesForeignAndDamagedIndexes) {
  const auto other = folder_ / "other";
  EXPECT_EQ(SessionStore::Open(other, AccessMode::kReadOnly).status().code(), StatusCode::kNotFound);
  std::filesystem::create_directories(other);
  ASSERT_TRUE(Connection::Open(other / "index.sqlite", Connection::Mode::kCreate)
                  ->Execute("CREATE TABLE t (x); PRAGMA application_id = 7")
                  .ok());
  EXPECT_EQ(SessionStore::Open(other, AccessMode::kReadWrite).status().code(), StatusCode::kIntegrity);
  WriteText(other / "index.sqlite", std::string(5000, 'x'));
  const auto garbage = SessionStore::Open(other, AccessMode::kReadOnly);
  EXPECT_EQ(garbage.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(garbage.status().message(), HasSubstr("index.sqlite"));
}

}  // namespace
}  // namespace stratalux::db
