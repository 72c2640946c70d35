// SPDX-License-Identifier: Apache-2.0
// What a capture found is kept as data, in manifest and index alike, and nobody reads into it what is not there.
#include <functional>
#include <limits>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "db/base/sqlite.h"
#include "db/care/reindex.h"
#include "db/care/verify.h"
#include "db/catalogue/manifest.h"
#include "db/keys/rig_key.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using Json = nlohmann::ordered_json;

class FindingsTest : public StoreTest {
 protected:
  std::string Capture(const WriterOptions& options = {}) const {
    SessionStore store = OpenStore();
    SessionInfo info = SimulatedVisit();
    info.visit = "evening";
    info.attempt = 2;
    auto writer = store.BeginSession(info, options);
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    EXPECT_TRUE(AppendTo(*writer, 0).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kDegraded, {"the visitor moved"}, SomeFindings()).ok());
    return writer->info().id;
  }
  [[nodiscard]] std::filesystem::path Folder(const std::string& id) const { return folder_ / "sessions" / id; }
  // With the hash that it then has.
  void ChangeManifest(const std::string& id, const std::function<void(Json&)>& change) const {
    Json json = Json::parse(ReadBytes(Folder(id) / "manifest.json"));
    change(json);
    json.erase("hash");
    WriteText(Folder(id) / "manifest.json", WithOwnHash(json.dump(1)));
  }
  void Execute(const std::string& sql) const {
    const Status status = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite)->Execute(sql);
    ASSERT_TRUE(status.ok()) << sql << ": " << status.message();
  }
  [[nodiscard]] std::vector<std::string> Texts(const std::string& sql) const {
    auto connection = *Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadOnly);
    auto select = connection.Prepare(sql);
    EXPECT_TRUE(select.ok()) << select.status().message();
    std::vector<std::string> texts;
    while (*select->Step()) texts.push_back(select->Text(0));
    return texts;
  }
  [[nodiscard]] std::vector<std::string> Problems(const std::string& id) const {
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    return VerifySession(store, *store.FindSession(id), {})->problems;
  }
  [[nodiscard]] SessionInfo InfoOf(const std::string& id) const {
    return OpenStore(AccessMode::kReadOnly).FindSession(id)->info;
  }

  Logger logger_{LogLevel::kError};
};

TEST_F(FindingsTest, TheVisitIsKnownFromTheStartAndTheFindingsFromTheEnd) {
  SessionStore store = OpenStore();
  SessionInfo info = SimulatedVisit();
  info.visit = "evening";
  info.attempt = 2;
  info.found = SomeFindings();  // of some capture before
  auto writer = store.BeginSession(info);
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  const std::string id = writer->info().id;
  const auto begun = ReadManifest(Folder(id));
  ASSERT_TRUE(begun.ok()) << begun.status().message();
  for (const SessionInfo& read : {*begun, InfoOf(id)}) {
    EXPECT_EQ(read.visit, "evening");
    EXPECT_EQ(read.attempt, 2);
    EXPECT_EQ(read.found, CaptureFindings());
  }
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems, IsEmpty());
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete, {}, SomeFindings()).ok());
  EXPECT_EQ(InfoOf(id).found, SomeFindings());
  EXPECT_THAT(Problems(id), IsEmpty());
}

TEST_F(FindingsTest, WhatNoManifestTakesIsRefusedAndCanBeMended) {
  SessionStore store = OpenStore();
  auto writer = store.BeginSession(SimulatedVisit());
  ASSERT_TRUE(writer.ok());
  ASSERT_TRUE(AppendTo(*writer, 0).ok());
  for (const CaptureFindings& wrong :
       {CaptureFindings{{{FindingKind::kLamp, 0, 3, std::numeric_limits<double>::quiet_NaN(), 0.1, ""}}, {}},
        CaptureFindings{{{FindingKind::kLamp, 0, 3, 0.5, std::numeric_limits<double>::infinity(), ""}}, {}},
        CaptureFindings{{{FindingKind::kLamp, 0, 2'000'000, 0.5, 0.1, ""}}, {}},
        CaptureFindings{{}, {{"lost frame", -1}}}}) {
    EXPECT_EQ(writer->Finish(SessionStatus::kComplete, {}, wrong).code(), StatusCode::kUsage);
    EXPECT_EQ(InfoOf(writer->info().id).status, SessionStatus::kRecording);
  }
  EXPECT_TRUE(writer->Finish(SessionStatus::kComplete, {}, SomeFindings()).ok());
}

TEST_F(FindingsTest, AVisitThatNoManifestTakesDoesNotBegin) {
  SessionStore store = OpenStore();
  SessionInfo info = SimulatedVisit();
  info.attempt = -1;
  EXPECT_EQ(store.BeginSession(info).status().code(), StatusCode::kUsage);
  info.attempt = 1;
  info.visit = std::string("a\0b", 3);
  EXPECT_EQ(store.BeginSession(info).status().code(), StatusCode::kUsage);
}

TEST_F(FindingsTest, OfALaterVersionKeepTheSessionOutOfTheIndexAndNoOther) {
  const std::string id = Capture(), other = Capture();
  ChangeManifest(id, [](Json& json) { json["findings"][0]["kind"] = "sneezed"; });
  EXPECT_EQ(ReadManifest(Folder(id)).status().exit_code(), 7);
  EXPECT_THAT(ReadManifest(Folder(id)).status().message(), HasSubstr("sneezed"));
  const auto report = Reindex(folder_, logger_);
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_TRUE(report->newer);
  EXPECT_THAT(Texts("SELECT id FROM sessions"), ElementsAre(other));
}

TEST_F(FindingsTest, OfAnotherShapeAreDamageWhateverTheHashSays) {
  const std::string id = Capture();
  const auto before = ReadBytes(Folder(id) / "manifest.json");
  const std::function<void(Json&)> changes[] = {
      [](Json& json) { json["findings"] = Json::object(); },
      [](Json& json) { json["findings"] = nullptr; },
      [](Json& json) { json["findings"][0] = 7; },
      [](Json& json) { json["findings"][0]["value"] = "much"; },
      [](Json& json) { json["findings"][0].erase("limit"); },
      [](Json& json) { json["findings"][0]["step"] = -1; },
      [](Json& json) { json["findings"][0]["projector"] = 1.5; },
      [](Json& json) { json["findings"][1]["detail"] = 3; },
      [](Json& json) { json["faults"] = Json::array(); },
      [](Json& json) { json["faults"]["lost frame"] = -1; },
      [](Json& json) { json["faults"]["lost frame"] = std::numeric_limits<uint64_t>::max(); },
      [](Json& json) { json["faults"]["lost frame"] = 1.5; },
      [](Json& json) { json["visit"] = 7; },
      [](Json& json) { json["attempt"] = -1; },
      [](Json& json) { json["attempt"] = 1'000'001; },
      [](Json& json) { json["attempt"] = "first"; }};
  for (const auto& change : changes) {
    ChangeManifest(id, change);
    const auto read = ReadManifest(Folder(id));
    EXPECT_EQ(read.status().code(), StatusCode::kIntegrity) << read.status().message();
    WriteBytes(Folder(id) / "manifest.json", before);
  }
  EXPECT_TRUE(ReadManifest(Folder(id)).ok());
}

// A number that no double holds: JSON has no word for it, and the reader none of its own.
TEST_F(FindingsTest, AFigureBeyondAllDoublesIsDamage) {
  const std::string id = Capture();
  const auto bytes = ReadBytes(Folder(id) / "manifest.json");
  std::string text(bytes.begin(), bytes.end());
  const size_t at = text.find("0.0625");
  ASSERT_NE(at, std::string::npos);
  text.replace(at, 6, "1e9999");
  text.erase(text.rfind(",\n \"hash\""));
  WriteText(Folder(id) / "manifest.json", WithOwnHash(text + "\n}"));
  EXPECT_EQ(ReadManifest(Folder(id)).status().code(), StatusCode::kIntegrity);
}

TEST_F(FindingsTest, ManifestsOfBeforeMeanThatNothingWasFound) {
  const std::string id = Capture();
  ChangeManifest(id, [](Json& json) {
    json["schema"] = 3;
    for (const char* key : {"visit", "attempt", "findings", "faults"}) json.erase(key);
  });
  const auto read = ReadManifest(Folder(id));
  ASSERT_TRUE(read.ok()) << read.status().message();
  EXPECT_EQ(read->visit, "");
  EXPECT_EQ(read->attempt, 0);
  EXPECT_EQ(read->found, CaptureFindings());
  EXPECT_THAT(read->reasons, ElementsAre("the visitor moved"));
}

// The hash of a manifest finds accidents; forged findings are for the signature.
TEST_F(FindingsTest, AreSigned) {
  ASSERT_TRUE(RigKey::Create(folder_).ok());
  const std::string id = Capture({.signing = Signing::kRigKey});
  EXPECT_THAT(Problems(id), IsEmpty());
  ChangeManifest(id, [](Json& json) { json["findings"] = Json::array(); });
  Execute("UPDATE sessions SET findings_json = '[]'");
  EXPECT_THAT(Problems(id), Contains(HasSubstr("signature")));
}

TEST_F(FindingsTest, ChangedInTheIndexAreFoundAndHideNoFrame) {
  const std::string id = Capture();
  for (const char* text : {"[]", "no json", "[1]", R"([{"kind":"sneezed","value":1,"limit":0}])", "{}"}) {
    Execute(std::string("UPDATE sessions SET findings_json = '") + text + "'");
    EXPECT_THAT(Problems(id), ElementsAre(HasSubstr("sessions.findings_json of"))) << text;
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    EXPECT_THAT(store.FindSession(id)->info.found.findings, IsEmpty());
    EXPECT_TRUE(store.ReadFrame(id, store.ListFrames(id)->front()).ok());
    EXPECT_EQ(store.FindSession(id)->info.found.faults, SomeFindings().faults);
  }
  ASSERT_TRUE(Reindex(folder_, logger_).ok());
  EXPECT_THAT(Problems(id), IsEmpty());
  EXPECT_EQ(InfoOf(id).found, SomeFindings());
}

// The manifest is written last: where it is whole, the session is, and its findings are.
TEST_F(FindingsTest, AWriterThatDiedBehindItsManifestLosesNone) {
  const std::string id = Capture();
  Execute(
      "UPDATE sessions SET status = 'recording', reasons_json = '[]', finished_wall_ns = NULL,"
      " findings_json = '[]', faults_json = '{}'");
  EXPECT_THAT(Problems(id), IsEmpty());
  EXPECT_FALSE(OpenStore().notes().empty());
  EXPECT_EQ(InfoOf(id).found, SomeFindings());
  EXPECT_EQ(InfoOf(id).status, SessionStatus::kDegraded);
  EXPECT_THAT(Problems(id), IsEmpty());
}

TEST_F(FindingsTest, OneThatIsRecordedHasNone) {
  const std::string id = Capture();
  Execute("UPDATE sessions SET status = 'recording', reasons_json = '[]', finished_wall_ns = NULL");
  EXPECT_THAT(VerifyStore(OpenStore(AccessMode::kReadOnly), {})->problems,
              Contains(HasSubstr("while it is being recorded")));
}

TEST_F(FindingsTest, ViewsHaveARowEachAndBearAnyText) {
  const std::string id = Capture();
  EXPECT_THAT(Texts("SELECT id || '|' || visit || '|' || attempt || '|' || finding || '|' || kind || '|' ||"
                    " coalesce(projector, 'none') || '|' || coalesce(step, 'none') || '|' || value || '|' || \"limit\""
                    " || '|' || coalesce(detail, 'none') FROM session_findings ORDER BY finding"),
              ElementsAre(id + "|evening|2|0|moved|2|117|0.0625|0.03|none",
                          id + "|evening|2|1|device|none|none|0.0|0.0|/dev/video0: \"gone\""));
  EXPECT_THAT(Texts("SELECT id || '|' || fault || '|' || shots FROM session_faults ORDER BY fault"),
              ElementsAre(id + "|lost frame|2", id + "|wrong level|14"));
  EXPECT_THAT(Texts("SELECT visit || '|' || attempt || '|' || findings FROM session_overview"),
              ElementsAre("evening|2|2"));
  for (const char* text : {"", "no json", "[", "7", "\"moved\"", "null", "[7, \"x\", null, [1]]", "{\"a\": \"b\"}"}) {
    Execute(std::string("UPDATE sessions SET findings_json = '") + text + "', faults_json = '" + text + "'");
    EXPECT_THAT(Texts("SELECT kind FROM session_findings WHERE kind = 'moved' OR value > 1 OR detail <> ''"), IsEmpty())
        << text;
    EXPECT_THAT(Texts("SELECT fault FROM session_faults WHERE fault = 'lost frame' OR shots > 7"), IsEmpty()) << text;
    EXPECT_EQ(Texts("SELECT id FROM session_overview").size(), 1U) << text;
  }
}

// Frames that passed when they were stored and whose steps the capture found to prove nothing in the end.
class WithdrawnFramesTest : public FindingsTest {
 protected:
  // Steps 0 to 3, of 1 two shots; no proof of 1, another pattern on 2, and a lamp on 3, which withdraws nothing.
  std::string CaptureWithdrawn() const {
    SessionStore store = OpenStore();
    auto writer = store.BeginSession(SimulatedVisit());
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (const int step : {0, 1, 1, 2, 3}) EXPECT_TRUE(AppendTo(*writer, step).ok());
    EXPECT_TRUE(writer
                    ->Finish(SessionStatus::kDegraded, {"a code was given up"},
                             {{{FindingKind::kNoProof, 1, 1},
                               {FindingKind::kWrongPattern, 2, 2},
                               {FindingKind::kLamp, 3, 3, 1.3, 0.1}},
                              {}})
                    .ok());
    return writer->info().id;
  }
  [[nodiscard]] std::vector<int> StepsThatCount(const std::string& id) const {
    std::vector<int> steps;
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    const auto frames = store.ListFrames(id);
    EXPECT_TRUE(frames.ok()) << frames.status().message();
    for (const FrameRow& frame : *frames)
      if (frame.record.level_check != LevelCheck::kFailed) steps.push_back(frame.record.step);
    return steps;
  }
};

TEST_F(WithdrawnFramesTest, CountForNoReader) {
  const std::string id = CaptureWithdrawn();
  EXPECT_THAT(StepsThatCount(id), ElementsAre(0, 3));
  EXPECT_THAT(Texts("SELECT step FROM frame_overview WHERE level_check = 'failed' ORDER BY frame"),
              ElementsAre("1", "1", "2"));
  EXPECT_THAT(Problems(id), IsEmpty());
}

TEST_F(WithdrawnFramesTest, StayWithdrawnInAnIndexMadeAnew) {
  const std::string id = CaptureWithdrawn();
  ASSERT_TRUE(Reindex(folder_, logger_).ok());
  EXPECT_THAT(StepsThatCount(id), ElementsAre(0, 3));
  // By what the old index knew, too.
  std::filesystem::remove(Folder(id) / "manifest.json");
  ASSERT_TRUE(Reindex(folder_, logger_).ok());
  EXPECT_THAT(StepsThatCount(id), ElementsAre(0, 3));
}

TEST_F(WithdrawnFramesTest, AreWithdrawnWhereTheWriterDiedBehindItsManifest) {
  const std::string id = CaptureWithdrawn();
  Execute(
      "UPDATE sessions SET status = 'recording', reasons_json = '[]', finished_wall_ns = NULL, findings_json = '[]';"
      " UPDATE frames SET level_check = 1");
  EXPECT_THAT(Problems(id), IsEmpty()) << "the ending is still to come";
  EXPECT_FALSE(OpenStore().notes().empty());
  EXPECT_THAT(StepsThatCount(id), ElementsAre(0, 3));
  EXPECT_THAT(Problems(id), IsEmpty());
}

TEST_F(WithdrawnFramesTest, OnesThatCountAgainAreFound) {
  const std::string id = CaptureWithdrawn();
  Execute("UPDATE frames SET level_check = 1 WHERE step = 2");
  EXPECT_THAT(Problems(id), ElementsAre(HasSubstr("frames.level_check")));
  // Where no manifest tells the findings, the index's own do.
  std::filesystem::remove(Folder(id) / "manifest.json");
  EXPECT_THAT(Problems(id), Contains(HasSubstr("frames.level_check")));
  Execute("UPDATE frames SET level_check = 2 WHERE step = 2");
  EXPECT_THAT(Problems(id), Not(Contains(HasSubstr("frames.level_check"))));
}

TEST_F(WithdrawnFramesTest, OfAStoreOfSchemaEightAreWithdrawnAsItIsOpened) {
  const std::string id = CaptureWithdrawn(), whole = StoreSession(3);
  Execute("UPDATE frames SET level_check = 1; PRAGMA user_version = 8");
  (void)OpenStore();
  EXPECT_THAT(StepsThatCount(id), ElementsAre(0, 3));
  EXPECT_THAT(StepsThatCount(whole), ElementsAre(0, 1, 2));
  EXPECT_THAT(Problems(id), IsEmpty());
}

}  // namespace
}  // namespace stratalux::db
