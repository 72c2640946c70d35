// SPDX-License-Identifier: Apache-2.0
// A rebuild loses nothing that is there, hides nothing that is missing, and takes nothing that does not make sense.
#include <cmath>
#include <cstdlib>
#include <functional>
#include <limits>
#include <map>
#include <random>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>

#include "db/base/sqlite.h"
#include "db/care/reindex.h"
#include "db/care/session_rebuild.h"
#include "db/catalogue/manifest.h"
#include "tests/db/forged_segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;

constexpr size_t kFrame = 320 + 36;

class RebuildTest : public StoreTest {
 protected:
  // A capture that was killed: every frame acknowledged, no footer, no final manifest, `recording` in the index.
  std::string Killed(int frames) {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(SimulatedVisit(), Groups(1));
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < frames; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    return writer->info().id;
  }
  ReindexReport Rebuild() {
    auto report = Reindex(folder_, logger_);
    EXPECT_TRUE(report.ok()) << report.status().message();
    return report.ok() ? *report : ReindexReport{};
  }
  [[nodiscard]] int Command(const std::string& arguments) const {
    const int status = std::system(("timeout 60 " STRATALUX_BIN_DIR "/stratalux-db " + arguments + " --store " +
                                    folder_.string() + " > " + (folder_ / "said.toml").string() + " 2>&1")
                                       .c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  [[nodiscard]] std::string Said() const {
    const auto bytes = ReadBytes(folder_ / "said.toml");
    return {bytes.begin(), bytes.end()};
  }
  [[nodiscard]] std::map<std::string, std::vector<uint8_t>> Segments() const {
    std::map<std::string, std::vector<uint8_t>> all;
    for (const auto& entry : fs::recursive_directory_iterator(folder_ / "sessions"))
      if (entry.path().extension() == ".seg" && entry.is_regular_file())
        all[entry.path().string()] = ReadBytes(entry.path());
    return all;
  }
  void LoseIndex() const {
    for (const char* suffix : {"", "-wal", "-shm"}) fs::remove(folder_ / ("index.sqlite" + std::string(suffix)));
  }
  [[nodiscard]] SessionInfo InfoOf(const std::string& id) const {
    return OpenStore(AccessMode::kReadOnly).FindSession(id)->info;
  }
  void ExpectReadable(const std::string& id, size_t frames) const {
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    const auto rows = store.ListFrames(id);
    ASSERT_TRUE(rows.ok()) << rows.status().message();
    EXPECT_EQ(rows->size(), frames);
    for (const FrameRow& row : *rows) EXPECT_TRUE(store.ReadFrame(id, row).ok());
  }

  Logger logger_{LogLevel::kError};
};

// The first case: a bit in the header of frame 5 of a killed session cost the 139 frames behind it.
TEST_F(RebuildTest, ABitInOneHeaderOfAKilledSessionCostsThatFrameAndIsSaid) {
  const std::string id = Killed(145);
  const auto whole = ReadBytes(Segment(id));
  FlipBits(Segment(id), 64 + 5 * kFrame + 17, 0x04);
  const auto before = Segments();
  EXPECT_EQ(Command("reindex"), 6);
  EXPECT_THAT(Said(), HasSubstr("144 frames"));
  EXPECT_THAT(Said(), HasSubstr("1 of 145 frames are missing: 5 (steps 5)"));
  EXPECT_EQ(Segments(), before) << "not a byte was changed";
  EXPECT_EQ(ReadBytes(Segment(id)).size(), whole.size());
  ExpectReadable(id, 144);
  EXPECT_THAT(InfoOf(id).reasons, Contains(HasSubstr("1 of 145 frames are missing: 5")));
  FlipBits(Segment(id), 64 + 5 * kFrame + 17, 0x04);  // the copy comes back
  EXPECT_EQ(Command("reindex"), 0) << Said();
  ExpectReadable(id, 145);
}

TEST_F(RebuildTest, AcknowledgedFramesAtTheEndThatAreGoneAreMissed) {
  const std::string id = Killed(8);
  fs::resize_file(Segment(id), 64 + 5 * kFrame + 100);
  EXPECT_EQ(Command("reindex"), 6);
  EXPECT_THAT(Said(), HasSubstr("3 of 8 frames are missing: 5 to 7 (steps 5 to 7)")) << "the old index knew them";
  ExpectReadable(id, 5);
}

// Its second: a session that was cut short stayed complete.
TEST_F(RebuildTest, ACompleteSessionThatLacksFramesIsCompleteNoLonger) {
  const std::string id = StoreSession(20);
  const auto whole = ReadBytes(Segment(id));
  fs::resize_file(Segment(id), 64 + 14 * kFrame);
  for (int round = 0; round < 2; ++round) {  // with the old index and without one
    EXPECT_EQ(Command("reindex"), 6);
    EXPECT_THAT(Said(), HasSubstr("6 of 20 frames are missing: 14 to 19"));
    const SessionInfo info = InfoOf(id);
    EXPECT_EQ(info.status, SessionStatus::kDegraded);
    EXPECT_THAT(info.reasons, Contains(HasSubstr("6 of 20 frames are missing: 14 to 19")));
    ExpectReadable(id, 14);
    EXPECT_EQ(Command("query failures"), 0);
    EXPECT_THAT(Said(), HasSubstr("frames are missing"));
    LoseIndex();
  }
  WriteBytes(Segment(id), whole);
  EXPECT_EQ(Command("reindex"), 0) << Said();
  EXPECT_EQ(InfoOf(id).status, SessionStatus::kComplete) << "the manifest was not rewritten";
}

TEST_F(RebuildTest, ACompleteSessionWithoutItsOnlySegmentIsCompleteNoLonger) {
  const std::string id = StoreSession(3);
  fs::remove(Segment(id));
  LoseIndex();
  EXPECT_EQ(Command("reindex"), 6);
  const SessionInfo info = InfoOf(id);
  EXPECT_EQ(info.status, SessionStatus::kDegraded);
  EXPECT_THAT(info.reasons, Contains("segment frames-0001.seg is missing"));
  EXPECT_THAT(info.reasons, Contains(HasSubstr("3 of 3 frames are missing: 0 to 2")));
}

TEST_F(RebuildTest, APlannedStepWithoutAFrameIsMissed) {
  PlanOptions options;
  options.projectors = 1;
  SessionStore store = OpenStore();
  SessionInfo info = SimulatedVisit();
  info.plan_json = PlanOptionsToJson(options);
  auto writer = store.BeginSession(info);
  ASSERT_TRUE(writer.ok());
  const Image<uint16_t> pixels(4, 2);
  const auto plan = BuildPlan(options);
  for (const PlanStep& step : plan->steps)
    if (step.index != 5 && step.index != 6) {
      ASSERT_TRUE(writer->Append(RecordFor(step.index, PixelFormat::kMono12, 4, 2), pixels.view()).ok());
    }
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  const auto session = RebuildSession(store.SessionFolder(writer->info().id));
  ASSERT_TRUE(session.ok()) << session.status().message();
  EXPECT_EQ(session->info.status, SessionStatus::kDegraded);
  EXPECT_THAT(session->loss, UnorderedElementsAre("planned steps without a good frame: 5 to 6"));
}

// The fourth mutant of its third, and the fifth: right hashes, wrong values.
TEST_F(RebuildTest, ASessionOfTheNextVersionIsNotListedAndTheOthersAre) {
  const std::string first = StoreSession(3), newer = StoreSession(3), last = StoreSession(3);
  ForgeHeaders(Segment(newer), [](FrameHeader& h) { h.phase = h.frame == 1 ? 10 : h.phase; });
  const auto before = Segments();
  EXPECT_EQ(Command("reindex"), 7);
  EXPECT_THAT(Said(), AllOf(HasSubstr("2 sessions"), HasSubstr(newer), HasSubstr("phase 10"), HasSubstr("newer")));
  ExpectReadable(first, 3);
  ExpectReadable(last, 3);
  EXPECT_EQ(OpenStore(AccessMode::kReadOnly).FindSession(newer).status().code(), StatusCode::kNotFound);
  EXPECT_EQ(Segments(), before);
  EXPECT_THAT(StoreSession(1), HasSubstr("s000004-")) << "numbers go on";
}

TEST_F(RebuildTest, AnExposureThatIsNoNumberKeepsOutItsSessionAlone) {
  const std::string first = StoreSession(3), bad = StoreSession(3), last = StoreSession(3);
  ForgeHeaders(Segment(bad), [](FrameHeader& h) { h.exposure_ms = std::numeric_limits<double>::quiet_NaN(); });
  EXPECT_EQ(Command("reindex"), 6);
  EXPECT_THAT(Said(), AllOf(HasSubstr("2 sessions"), HasSubstr(bad), HasSubstr("exposure")));
  ExpectReadable(first, 3);
  ExpectReadable(last, 3);
}

// The eighth: a length near 2^64 made every walk endless.
TEST_F(RebuildTest, APayloadLengthNearTheEndOfNumbersEndsNothing) {
  const std::string id = StoreSession(4), other = StoreSession(2);
  const std::string killed = Killed(4);
  for (const std::string& session : {id, killed})
    ForgeHeaders(Segment(session),
                 [](FrameHeader& h) { h.payload_bytes = h.frame == 2 ? ~uint64_t{0} - 319 : h.payload_bytes; });
  EXPECT_EQ(Command("verify " + id), 6);
  EXPECT_EQ(Command("verify " + id + " --deep"), 6);
  EXPECT_EQ(Command("reindex"), 6) << Said();
  ExpectReadable(killed, 3);
  ExpectReadable(other, 2);
}

TEST_F(RebuildTest, AManifestWithAnyMistypedFieldIsDamageAndNoAbort) {
  const std::string id = StoreSession(2), other = StoreSession(1);
  const fs::path file = folder_ / "sessions" / id / "manifest.json";
  const auto bytes = ReadBytes(file);
  // Of schema 2, which has no hash of its own: every value reaches the reader.
  auto json = nlohmann::ordered_json::parse(bytes);
  json.erase("hash");
  json.erase("files");
  json["schema"] = 2;
  for (const auto& item : json.items()) {
    for (const char* wrong : {"null", "true", "-1", "1e300", "18446744073709551615", "\"word\"", "[1]", "{\"a\": 1}"}) {
      SCOPED_TRACE(item.key() + " = " + wrong);
      auto mutant = json;
      mutant[item.key()] = nlohmann::ordered_json::parse(wrong);
      if (mutant[item.key()] == item.value()) continue;
      WriteText(file, mutant.dump());
      const auto session = RebuildSession(folder_ / "sessions" / id);
      const auto code = session.status().code();
      EXPECT_TRUE(session.ok() || code == StatusCode::kIntegrity || code == StatusCode::kNewerSchema)
          << session.status().message();
      (void)ReadManifestContents(folder_ / "sessions" / id).ok();
    }
  }
  auto mutant = json;
  mutant["retention"] = "for ever";
  WriteText(file, mutant.dump());
  EXPECT_EQ(RebuildSession(folder_ / "sessions" / id).status().code(), StatusCode::kNewerSchema);
  EXPECT_EQ(Command("reindex"), 7);
  ExpectReadable(other, 1);
}

TEST_F(RebuildTest, WhatALostManifestSaidIsTakenFromTheOldIndex) {
  const std::string id = StoreSession(3);
  const fs::path manifest = folder_ / "sessions" / id / "manifest.json";
  const SessionInfo before = InfoOf(id);
  ASSERT_FALSE(before.visitor.empty());
  WriteText(manifest, "{\"schema\": 3, \"visi");
  EXPECT_EQ(Command("reindex"), 6);
  EXPECT_THAT(Said(), HasSubstr("taken from the old index"));
  EXPECT_EQ(ReadBytes(manifest.parent_path() / "manifest.damaged.json").size(), 19U) << "kept";
  fs::remove(manifest);
  EXPECT_EQ(Command("reindex"), 6) << "deleted, too";
  LoseIndex();
  EXPECT_EQ(Command("reindex"), 0) << "the manifest was written anew: " << Said();
  const SessionInfo after = InfoOf(id);
  EXPECT_EQ(after.status, SessionStatus::kDegraded);
  EXPECT_THAT(after.reasons, Contains(HasSubstr("manifest was lost")));
  EXPECT_EQ(after.visitor, before.visitor);
  EXPECT_EQ(after.consent.text_version, before.consent.text_version);
  EXPECT_EQ(after.consent.given_wall.ns, before.consent.given_wall.ns);
  EXPECT_EQ(after.started_wall.ns, before.started_wall.ns);
  ExpectReadable(id, 3);
  EXPECT_EQ(Command("verify --deep"), 0) << Said();
}

TEST_F(RebuildTest, AManifestThatIsLostWithTheIndexLeavesAFailedSessionWithAllItsFrames) {
  const std::string id = StoreSession(3);
  for (const char* text : {"", "{", "[]", "{\"schema\": 2}", "null"}) {
    SCOPED_TRACE(text);
    LoseIndex();
    WriteText(folder_ / "sessions" / id / "manifest.json", text);
    EXPECT_EQ(Command("reindex"), 6);
    EXPECT_EQ(InfoOf(id).status, SessionStatus::kFailed);
    ExpectReadable(id, 3);
  }
}

TEST_F(RebuildTest, APlaceThatNoStoreGivesIsNotTaken) {
  const std::string id = StoreSession(1);
  for (const char* number : {"9223372036854775807", "18446744073709551615", "-4", "0", "1.5", "\"7\""}) {
    WriteText(folder_ / "sessions" / id / "place.json", "{\"schema\": 1, \"number\": " + std::string(number) + "}");
    EXPECT_EQ(PlaceOf(folder_ / "sessions" / id), std::optional<int64_t>(1)) << number;
  }
  EXPECT_EQ(NumberOfId("s9223372036854775807-0badcafe"), std::nullopt);
}

TEST_F(RebuildTest, ADamagedFileHeaderCostsNoFrameOfASegmentThatTheManifestHashes) {
  const std::string id = StoreSession(3);
  for (const size_t at : {0U, 5U, 20U, 60U}) {
    FlipBits(Segment(id), at, 1);
    LoseIndex();
    EXPECT_EQ(Command("reindex"), 6) << at;
    EXPECT_THAT(Said(), HasSubstr("3 frames are known by the manifest's hash of its footer and stay listed"));
    EXPECT_EQ(InfoOf(id).status, SessionStatus::kComplete);
    ExpectReadable(id, 3);
    EXPECT_EQ(Command("verify --deep"), 6) << "the damage is there, and said, for as long as it is there";
    FlipBits(Segment(id), at, 1);
  }
  EXPECT_EQ(Command("reindex"), 0);
}

TEST_F(RebuildTest, ADamagedFileHeaderOfAKilledSessionLeavesInTheFileWhatTheOldIndexDidNotKnow) {
  const std::string id = Killed(3), other = StoreSession(2);
  FlipBits(Segment(id), 20, 1);
  EXPECT_EQ(Command("reindex"), 6);
  EXPECT_THAT(Said(), AllOf(HasSubstr("file header is damaged (offset 0)"),
                            HasSubstr("3 frames are known by the old index and stay listed")));
  ExpectReadable(id, 3);
  LoseIndex();
  EXPECT_EQ(Command("reindex"), 6);
  EXPECT_THAT(Said(), HasSubstr("3 frames stay in the file and are not listed"));
  ExpectReadable(other, 2);
  FlipBits(Segment(id), 20, 1);
  EXPECT_EQ(Command("reindex"), 0) << Said();
  ExpectReadable(id, 3);
}

TEST_F(RebuildTest, ADamagedFrameHeaderOfASealedSegmentIsReadByItsCopyInTheFooter) {
  const std::string id = StoreSession(3);
  FlipBits(Segment(id), 64 + kFrame + 17, 0x04);
  ExpectReadable(id, 3);
  for (int round = 0; round < 2; ++round) {  // with the old index and without one
    EXPECT_EQ(Command("reindex"), 6);
    EXPECT_THAT(Said(), HasSubstr("the header of frame 1 is damaged (offset " + std::to_string(64 + kFrame) +
                                  "); its copy in the footer was used"));
    EXPECT_EQ(InfoOf(id).status, SessionStatus::kComplete) << "no frame is lost";
    ExpectReadable(id, 3);
    LoseIndex();
  }
  EXPECT_EQ(Command("reindex"), 6);
  EXPECT_EQ(Command("verify"), 6) << "the damage is there, and said";
}

TEST_F(RebuildTest, ACopyOfASegmentUnderTheNextNumberAddsNothing) {
  const std::string id = StoreSession(3);
  fs::copy_file(Segment(id), Segment(id, 2));
  const auto session = RebuildSession(folder_ / "sessions" / id);
  ASSERT_TRUE(session.ok()) << session.status().message();
  EXPECT_EQ(session->frames.size(), 3U);
  EXPECT_EQ(session->frames[0].first, 1);
  EXPECT_THAT(session->notes, Contains(HasSubstr("3 frames lie in segments that the manifest does not name")));
  EXPECT_EQ(session->info.status, SessionStatus::kComplete);
}

// Any single damage, anywhere: every other frame is listed and reads, what is lost is said, no segment is written.
TEST_F(RebuildTest, AfterAnySingleDamageNoSegmentIsWrittenAndNoOtherFrameLost) {
  const std::string sealed = StoreSession(6, [] {
    WriterOptions options = Groups(2);
    options.max_segment_bytes = 900;
    return options;
  }());
  const std::string killed = Killed(6);
  EXPECT_EQ(Rebuild().frames, 12);  // from here on the killed one is `failed`, and its manifest says six frames
  const auto whole = Segments();
  std::mt19937 random(20261122);
  for (int round = 0; round < 120; ++round) {
    auto victim = whole.begin();
    std::advance(victim, random() % whole.size());
    auto bytes = victim->second;
    const size_t at = random() % bytes.size(), length = 1 + random() % 40;
    const int kind = static_cast<int>(random() % 5);
    if (kind == 0) bytes[at] ^= static_cast<uint8_t>(1U << (random() % 8));
    if (kind == 1) std::fill_n(bytes.begin() + static_cast<std::ptrdiff_t>(at), std::min(length, bytes.size() - at), 0);
    if (kind == 2) bytes.resize(at);
    if (kind == 3) bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(at), length, 0x5a);
    if (kind == 4) bytes.insert(bytes.end(), length, 0x5a);
    SCOPED_TRACE(victim->first + ", kind " + std::to_string(kind) + " at " + std::to_string(at) + " of " +
                 std::to_string(victim->second.size()) + ", " + std::to_string(length));
    WriteBytes(victim->first, bytes);
    const auto damaged = Segments();
    if (round % 2 == 0) LoseIndex();
    const auto report = Reindex(folder_, logger_);
    ASSERT_TRUE(report.ok()) << report.status().message();
    EXPECT_EQ(Segments(), damaged);
    // A segment holds two frames, or the killed session's six; a cut costs those behind it, the rest two at most.
    const bool cut = kind == 2, file_header = at < 64 && kind < 4;
    const int64_t most_lost = cut || file_header ? (victim->first.find(killed) != std::string::npos ? 6 : 3) : 2;
    EXPECT_GE(report->frames, 12 - most_lost);
    if (report->frames < 12) {
      EXPECT_FALSE(report->problems.empty());
      EXPECT_NE(InfoOf(victim->first.find(killed) != std::string::npos ? killed : sealed).status,
                SessionStatus::kComplete);
    }
    WriteBytes(victim->first, victim->second);
    LoseIndex();
    EXPECT_EQ(Rebuild().frames, 12);
  }
}

}  // namespace
}  // namespace stratalux::db
