// SPDX-License-Identifier: Apache-2.0
// Sessions leave as a crate and come back the same, only where consent allows, and whole or not at all.
#include <chrono>
#include <random>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/catalogue/consent.h"
#include "db/interchange/crate_files.h"
#include "db/interchange/crate_staging.h"
#include "db/interchange/image_file.h"
#include "db/ledger/ledger.h"
#include "db/privacy/access_log.h"
#include "db/segment/truth_segment.h"
#include "tests/db/interchange/crate_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

CrateOptions ForResearch() {
  CrateOptions options;
  options.scope = CrateScope::kResearch;
  return options;
}

class Crates : public CrateTest {
 protected:
  void ExpectSameSession(const std::string& id) {
    EXPECT_EQ(RowsOf(other_, id), RowsOf(folder_, id));
    const SessionStore here = OpenStore(AccessMode::kReadOnly);
    const auto there = SessionStore::Open(other_, AccessMode::kReadOnly);
    ASSERT_TRUE(there.ok());
    const auto frames = here.ListFrames(id), copies = there->ListFrames(id);
    ASSERT_TRUE(frames.ok() && copies.ok()) << copies.status().message();
    ASSERT_EQ(frames->size(), copies->size());
    for (size_t i = 0; i < frames->size(); ++i) {
      EXPECT_EQ((*frames)[i].codec, (*copies)[i].codec);
      EXPECT_EQ((*frames)[i].record.mean_dn, (*copies)[i].record.mean_dn);
      EXPECT_EQ((*frames)[i].record.frame_time, (*copies)[i].record.frame_time);
      EXPECT_EQ((*frames)[i].record.retake_cause, (*copies)[i].record.retake_cause);
      const auto a = here.ReadFrame(id, (*frames)[i]), b = there->ReadFrame(id, (*copies)[i]);
      ASSERT_TRUE(a.ok() && b.ok()) << b.status().message();
      EXPECT_THAT(b->pixels(), ::testing::ElementsAreArray(a->pixels()));
    }
  }
};

class BothFormats : public Crates, public ::testing::WithParamInterface<ExportFormat> {};

TEST_P(BothFormats, GiveTheSamePixelsAndRowsBack) {
  const std::string visit = Visit(), flats = Flats(), simulated = Simulated();
  CrateOptions options = ForResearch();
  options.frames = GetParam();
  options.pseudonyms = CratePseudonyms::kKept;
  const auto exported = Export({simulated, visit, flats}, options);
  ASSERT_TRUE(exported.ok()) << exported.status().message();
  EXPECT_THAT(exported->sessions, ElementsAre(visit, flats, simulated)) << "in the order of capture";
  EXPECT_THAT(exported->notes, IsEmpty());
  const auto imported = Import();
  ASSERT_TRUE(imported.ok()) << imported.status().message();
  EXPECT_EQ(imported->frames, 4 + 6 + 1);
  for (const std::string& id : {visit, flats, simulated}) {
    SCOPED_TRACE(id);
    ExpectSameSession(id);
  }
  const SessionDevices devices = SessionStore::Open(other_, AccessMode::kReadOnly)->DevicesOf(visit);
  EXPECT_EQ(devices, (SessionDevices{50, 40, 1280, 800, 4092.0}));
  for (const char* file : {"frames-0001.seg", "frames-0002.seg"})
    EXPECT_EQ(ReadBytes(other_ / "sessions" / flats / file), ReadBytes(folder_ / "sessions" / flats / file)) << file;
  for (const char* map : {"depth", "subsurface stripe 2"})
    EXPECT_THAT(TruthSegment::Open(other_ / "sessions" / simulated / "truth.seg")->Read(map)->pixels(),
                ::testing::ElementsAreArray(
                    TruthSegment::Open(folder_ / "sessions" / simulated / "truth.seg")->Read(map)->pixels()));
  EXPECT_EQ(TextOfFile(other_ / "sessions" / visit / "fits/0badcafe/normal.exr"),
            TextOfFile(folder_ / "sessions" / visit / "fits/0badcafe/normal.exr"));
  EXPECT_EQ(Shell(std::string(STRATALUX_BIN_DIR) + "/stratalux-db verify --deep --store " + other_.string()).code, 0);
}
INSTANTIATE_TEST_SUITE_P(Crates, BothFormats, ::testing::Values(ExportFormat::kTiff, ExportFormat::kPng));

TEST_F(Crates, HoldTheExactDigitalNumbers) {
  const std::string id = Visit();
  ASSERT_TRUE(Export({id}, ForResearch()).ok());
  const SessionStore store = OpenStore(AccessMode::kReadOnly);
  const auto frames = store.ListFrames(id);
  const auto file = ReadImageFile(crate_ / "sessions" / id / "frames" / "000002-gray-rows-bit-3-10-inverse.tif");
  ASSERT_TRUE(file.ok()) << file.status().message();
  EXPECT_EQ(file->bits, 16);
  EXPECT_THAT(file->image.pixels(), ::testing::ElementsAreArray(store.ReadFrame(id, (*frames)[2])->pixels()));
}

TEST_F(Crates, OfEncryptedSessionsCarryThemReadable) {
  const std::string id = StoreSession(3, {.encryption = Encryption::kPerSession});
  ASSERT_TRUE(Export({id}, ForResearch()).ok());
  const auto imported = Import();
  ASSERT_TRUE(imported.ok()) << imported.status().message();
  const SessionStore here = OpenStore(AccessMode::kReadOnly);
  const auto there = SessionStore::Open(other_, AccessMode::kReadOnly);
  EXPECT_EQ(there->FindSession(id)->key_id, "");
  const auto frames = here.ListFrames(id), copies = there->ListFrames(id);
  for (size_t i = 0; i < frames->size(); ++i)
    EXPECT_THAT(there->ReadFrame(id, (*copies)[i])->pixels(),
                ::testing::ElementsAreArray(here.ReadFrame(id, (*frames)[i])->pixels()));
}

TEST_F(Crates, NameNobodyByTheStoresPseudonym) {
  const std::string first = Visit(), second = Visit();
  const auto report = Export({first, second}, ForResearch());
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_THAT(report->notes, ElementsAre(HasSubstr("named.bin is left out"), HasSubstr("named.bin is left out")));
  for (const auto& entry : fs::recursive_directory_iterator(crate_)) {
    if (!entry.is_regular_file()) continue;
    EXPECT_THAT(TextOfFile(entry.path()), Not(HasSubstr(kVisitor))) << entry.path();
  }
  const auto pseudonym = [&](const fs::path& crate, const std::string& id) {
    return nlohmann::json::parse(TextOfFile(crate / "sessions" / id / "session.json"))["visitor"].get<std::string>();
  };
  EXPECT_EQ(pseudonym(crate_, first), pseudonym(crate_, second)) << "one person, one name within a crate";
  CrateOptions again = ForResearch();
  again.out = base_ / "again";
  ASSERT_TRUE(Export({first}, again).ok());
  EXPECT_NE(pseudonym(crate_, first), pseudonym(again.out, first)) << "two crates cannot be joined";
  EXPECT_TRUE(Import().ok());
}

TEST_F(Crates, LeaveOnlyUnderAConsentThatHoldsAndCoversThePurpose) {
  const std::string id = Visit();
  const auto refused = [&](CrateScope scope) {
    CrateOptions options;
    options.scope = scope;
    const auto report = Export({id}, options);
    EXPECT_TRUE(report.ok()) << report.status().message();
    EXPECT_FALSE(fs::exists(crate_));
    EXPECT_FALSE(fs::exists(crate_.string() + ".partial"));
    return report->refused.empty() ? std::string() : report->refused[0].reason;
  };
  EXPECT_THAT(refused(CrateScope::kNotStated), HasSubstr(id + " shows a visitor: state the purpose"));
  EXPECT_THAT(refused(CrateScope::kPublication), HasSubstr("fit,research, not to publication"));
  ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"text-4", "de", true, false, false, {}}).ok());
  EXPECT_THAT(refused(CrateScope::kResearch), HasSubstr("consented to fit, not to research")) << "the newest counts";
  ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"text-4", "de", true, true, true, WallNow()}).ok());
  CrateOptions options;
  options.scope = CrateScope::kPublication;
  options.out = base_ / "published";
  EXPECT_THAT(Export({id}, options)->sessions, ElementsAre(id)) << "given later, it holds now";
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  EXPECT_THAT(refused(CrateScope::kResearch), HasSubstr("was withdrawn on"));
  ASSERT_TRUE(GiveConsent(folder_, kVisitor, {"text-5", "de", true, true, true, {}}).ok());
  EXPECT_THAT(refused(CrateScope::kResearch), HasSubstr("was withdrawn on")) << "what was withdrawn stays so";
}

TEST_F(Crates, RefusedSessionsDoNotHinderOthers) {
  const std::string visit = Visit(), flats = Flats();
  const Outcome some = Db("export " + visit + " " + flats + " --crate " + crate_.string());
  EXPECT_EQ(some.code, 3) << some.out;
  EXPECT_THAT(some.out, HasSubstr(visit + " shows a visitor"));
  EXPECT_FALSE(fs::exists(crate_ / "sessions" / visit));
  EXPECT_TRUE(fs::exists(crate_ / "sessions" / flats / "frames.csv"));
  EXPECT_THAT(TextOfFile(crate_ / kCrateMetadataFile), Not(HasSubstr(visit)));
  EXPECT_EQ(Db("export " + visit + " --crate " + (base_ / "none").string()).code, 2);
  EXPECT_EQ(Db("export s9 --crate " + (base_ / "none").string()).code, 4);
  EXPECT_EQ(Db("export --crate " + (base_ / "none").string()).code, 2);
  EXPECT_EQ(Db("export " + flats + " --out x --crate " + (base_ / "none").string()).code, 2);
  EXPECT_EQ(Db("export " + flats + " --scope research").code, 2);
  EXPECT_EQ(Db("export " + flats + " --licence 'my own' --crate " + (base_ / "none").string()).code, 2);
  EXPECT_EQ(Db("import").code, 2);
  EXPECT_EQ(Db("export " + flats + " --crate " + crate_.string()).code, 2) << "the folder is used";
  EXPECT_FALSE(fs::exists(base_ / "none"));
}

TEST_F(Crates, ForgetFindsThem) {
  const std::string visit = Visit(), flats = Flats();
  ASSERT_TRUE(Export({visit, flats}, ForResearch()).ok());
  const auto access = ListAccess(folder_, visit);
  ASSERT_TRUE(access.ok());
  EXPECT_THAT(access->front().detail, HasSubstr(crate_.string()));
  const Outcome forgotten = Db("forget " + visit + " --yes");
  ASSERT_EQ(forgotten.code, 0) << forgotten.out;
  EXPECT_FALSE(fs::exists(crate_ / "sessions" / visit));
  EXPECT_FALSE(fs::exists(crate_ / kCratePreviewFolder / (visit + ".png")));
  EXPECT_FALSE(fs::exists(crate_ / kCrateMetadataFile)) << "it speaks of the forgotten, too";
  EXPECT_TRUE(fs::exists(crate_ / "sessions" / flats / "frames.csv"));
}

TEST_F(Crates, TheForgottenDoNotComeBack) {
  const std::string visit = Visit(), flats = Flats();
  ASSERT_TRUE(Export({visit, flats}, ForResearch()).ok());
  fs::copy(crate_, base_ / "elsewhere", fs::copy_options::recursive);
  ASSERT_EQ(Db("forget " + visit + " --yes").code, 0);
  const Outcome imported = Db("import --crate " + (base_ / "elsewhere").string());
  EXPECT_EQ(imported.code, 3) << imported.out;
  EXPECT_THAT(imported.out, HasSubstr("was forgotten here and is not imported again"));
  EXPECT_FALSE(fs::exists(folder_ / "sessions" / visit));
  EXPECT_THAT(imported.out, HasSubstr("1 here already"));
}

// A crate from before the withdrawal, into a store that has the ledger from after it.
TEST_F(Crates, OfWhoHasWithdrawnBringNoConsentBack) {
  const std::string id = Visit();
  ASSERT_TRUE(Export({id}, ForResearch()).ok());
  ASSERT_TRUE(WithdrawConsent(folder_, kVisitor).ok());
  ASSERT_TRUE(MergeLedger(other_, folder_ / "ledger").ok());
  { ASSERT_TRUE(SessionStore::Open(other_, AccessMode::kReadWrite).ok()); }  // its index follows
  const auto imported = Import();
  ASSERT_TRUE(imported.ok()) << imported.status().message();
  ASSERT_EQ(imported->sessions.size(), 1U);
  const auto consents = ListConsents(other_, "");
  ASSERT_TRUE(consents.ok()) << consents.status().message();
  ASSERT_EQ(consents->size(), 1U);
  EXPECT_TRUE(consents->front().withdrawn);
}

TEST_F(Crates, AreImportedOnce) {
  const std::string id = Flats();
  ASSERT_TRUE(Export({id}).ok());
  EXPECT_THAT(Import()->sessions, ElementsAre(id));
  const std::string rows = RowsOf(other_, id);
  const auto again = Import();
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_THAT(again->present, ElementsAre(id));
  EXPECT_THAT(again->sessions, IsEmpty());
  EXPECT_EQ(RowsOf(other_, id), rows);
}

TEST_F(Crates, AreWrittenByOneAtATime) {
  const std::string id = Flats();
  const auto held = CrateStaging::Take(crate_);
  ASSERT_TRUE(held.ok()) << held.status().message();
  EXPECT_EQ(Export({id}).status().code(), StatusCode::kBusy);
}

TEST_F(Crates, TakeNoFolderThatHoldsOtherThings) {
  const std::string id = Flats();
  fs::create_directories(crate_.string() + ".partial");
  WriteText(crate_.string() + ".partial/thesis.txt", "mine");
  const auto report = Export({id});
  EXPECT_EQ(report.status().code(), StatusCode::kUsage);
  EXPECT_EQ(TextOfFile(crate_.string() + ".partial/thesis.txt"), "mine");
  fs::create_directories(crate_);
  WriteText(crate_ / "thesis.txt", "mine");
  EXPECT_EQ(Export({id}).status().code(), StatusCode::kUsage);
}

// A file that cannot grow stands for a full disk.
TEST_F(Crates, AFullDiskLeavesNoHalfCrate) {
  SessionStore store = OpenStore();
  SessionInfo info;
  info.kind = SessionKind::kFlat;
  auto writer = store.BeginSession(info);
  const FrameRecord record = RecordFor(1, PixelFormat::kMono16, 1200, 1000);
  Image<uint16_t> image(record.width, record.height);  // noise, which no file makes smaller
  std::mt19937 random(1);
  for (uint16_t& v : image.pixels()) v = static_cast<uint16_t>(random());
  ASSERT_TRUE(writer->Append(record, std::as_const(image).view()).ok());
  ASSERT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  for (const char* format : {"tiff16", "png16"}) {
    const Outcome full =
        Shell("trap '' XFSZ; ulimit -f 2000; STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR +
              "/stratalux-db export latest --crate " + crate_.string() + " --frames " + format + " 2>&1");
    EXPECT_EQ(full.code, 1) << full.out;
    EXPECT_THAT(full.out, HasSubstr(crate_.string()));
    EXPECT_FALSE(fs::exists(crate_));
    EXPECT_FALSE(fs::exists(crate_.string() + ".partial"));
  }
}

TEST_F(Crates, KilledExportsAndImportsLeaveNothingHalf) {
  const std::string id = StoreSession(60);
  const std::string program = std::string(STRATALUX_BIN_DIR) + "/stratalux-db ";
  const std::string exporting = program + "export latest --scope research --store " + folder_.string() + " --crate ";
  const std::string importing = program + "import --crate " + crate_.string() + " --store " + other_.string();
  const auto begun = std::chrono::steady_clock::now();
  ASSERT_EQ(Shell(exporting + (base_ / "first").string() + " 2>/dev/null").code, 0);
  const std::chrono::duration<double> whole = std::chrono::steady_clock::now() - begun;
  const auto broken_off = [&](const char* signal, int part) {
    return std::string("timeout -s ") + signal + " " + std::to_string(whole.count() * part / 12) + " ";
  };
  int broken = 0;
  for (int i = 1; i <= 12; ++i) {
    (void)Shell(broken_off(i % 2 == 0 ? "KILL" : "INT", i) + exporting + crate_.string() + " 2>/dev/null");
    broken += fs::exists(crate_.string() + ".partial") ? 1 : 0;
    if (fs::exists(crate_)) {
      ASSERT_TRUE(fs::exists(crate_ / kCrateManifestFile));
      fs::remove_all(crate_);
    }
  }
  EXPECT_GT(broken, 0) << "no kill hit";
  const auto report = Export({id}, ForResearch());
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_FALSE(fs::exists(crate_.string() + ".partial")) << "the remains are gone";
  for (int i = 1; i <= 12; ++i) {
    (void)Shell(broken_off("KILL", i) + importing + " 2>/dev/null");
    const auto store = SessionStore::Open(other_, AccessMode::kReadWrite);
    ASSERT_TRUE(store.ok()) << store.status().message();
    const auto rows = store->ListSessions();
    ASSERT_TRUE(rows.ok());
    for (const auto& row : *rows) EXPECT_EQ(row.frames, 60) << "listed means whole";
  }
  ASSERT_TRUE(Import().ok());
  EXPECT_EQ(RowsOf(other_, id), RowsOf(folder_, id));
}

TEST_F(Crates, BrokenOffOnesAreFoundByForget) {
  const std::string id = Flats();
  ASSERT_TRUE(Export({id}).ok());
  fs::rename(crate_, crate_.string() + ".partial");  // as a kill before the last rename leaves it
  ASSERT_EQ(Db("forget " + id + " --yes").code, 0);
  EXPECT_FALSE(fs::exists(crate_.string() + ".partial"));
}

}  // namespace
}  // namespace stratalux::db
