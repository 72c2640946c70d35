// SPDX-License-Identifier: Apache-2.0
// An export is found again, and deleted without harm to what else lies in its folder.
#include "db/privacy/export_marker.h"

#include <gmock/gmock.h>

#include "db/base/durable_file.h"
#include "db/catalogue/consent.h"
#include "db/ledger/ledger.h"
#include "db/privacy/access_log.h"
#include "db/privacy/forget.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

class ExportMarkerTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    out_ = folder_ / "out";
    ASSERT_TRUE(WriteExportMarker(out_, "s000001-0badcafe", {"a.png", "deep/er/b.png"}).ok());
    fs::create_directories(out_ / "deep" / "er");
    for (const char* name : {"a.png", "deep/er/b.png"}) WriteText(out_ / name, "pixels");
  }
  fs::path out_;
};

TEST_F(ExportMarkerTest, DeletesItsFilesAndTheFolderTheyMade) {
  EXPECT_EQ(*RemoveExport(ExportPlace(out_), "s000001-0badcafe"), ExportState::kDeleted);
  EXPECT_FALSE(fs::exists(out_));
  // Nor is it known to be gone: the folder may lie on a disk that is not mounted.
  EXPECT_EQ(*RemoveExport(ExportPlace(out_), "s000001-0badcafe"), ExportState::kNoFolder);
  EXPECT_EQ(PlanExport(ExportPlace(out_), "s000001-0badcafe").state, ExportState::kNoFolder);
  EXPECT_STREQ(ToString(ExportState::kNoFolder), "its folder is not there (a disk that is not mounted?)");
  fs::create_directory(out_);
  EXPECT_EQ(*RemoveExport(ExportPlace(out_), "s000001-0badcafe"), ExportState::kNotThere);
  EXPECT_EQ(PlanExport(ExportPlace(out_), "s000001-0badcafe").state, ExportState::kNotThere);
}

// The folder is named before it is made, and by whoever stands elsewhere later.
TEST_F(ExportMarkerTest, ANameThatIsNotThereYetLeadsToTheFolderAllTheSame) {
  const fs::path before = fs::current_path();
  fs::current_path(folder_);
  const std::string not_yet = ExportPlace("seen"), there = ExportPlace("out");
  fs::current_path(before);
  EXPECT_EQ(LocalFolder(not_yet), fs::canonical(folder_) / "seen");
  EXPECT_EQ(*RemoveExport(there, "s000001-0badcafe"), ExportState::kDeleted);
  EXPECT_FALSE(fs::exists(out_));
}

TEST_F(ExportMarkerTest, TouchesNothingElse) {
  ASSERT_TRUE(WriteExportMarker(out_, "s000002-0badcafe", {"c.png"}).ok());
  WriteText(out_ / "c.png", "pixels");
  WriteText(out_ / "deep" / "thesis.txt", "mine");
  EXPECT_THAT(ExportsIn(out_), ElementsAre("s000001-0badcafe", "s000002-0badcafe"));
  EXPECT_EQ(*RemoveExport(ExportPlace(out_), "s000001-0badcafe"), ExportState::kDeleted);
  EXPECT_FALSE(fs::exists(out_ / "a.png"));
  EXPECT_FALSE(fs::exists(out_ / "deep" / "er"));
  EXPECT_TRUE(fs::exists(out_ / "deep" / "thesis.txt"));
  EXPECT_TRUE(fs::exists(out_ / "c.png"));
  EXPECT_THAT(ExportsIn(out_), ElementsAre("s000002-0badcafe"));
}

TEST_F(ExportMarkerTest, ASecondExportToTheSameFolderKeepsTheFirstOnesFiles) {
  ASSERT_TRUE(WriteExportMarker(out_, "s000001-0badcafe", {"c.png"}).ok());
  WriteText(out_ / "c.png", "pixels");
  EXPECT_EQ(*RemoveExport(ExportPlace(out_), "s000001-0badcafe"), ExportState::kDeleted);
  EXPECT_FALSE(fs::exists(out_));
}

TEST_F(ExportMarkerTest, NoMarkerCanNameAFileOutsideItsFolder) {
  WriteText(folder_ / "victim", "mine");
  for (const char* name : {"../victim", "deep/../../victim", "/etc/hostname", ""})
    EXPECT_EQ(WriteExportMarker(out_, "s000001-0badcafe", {name}).code(), StatusCode::kUsage) << name;
  WriteText(ExportMarker(out_, "s000001-0badcafe"),
            R"({"session": "s000001-0badcafe", "files": ["../victim", "a.png"]})");  // made by somebody else
  EXPECT_EQ(*RemoveExport(ExportPlace(out_), "s000001-0badcafe"), ExportState::kDeleted);
  EXPECT_TRUE(fs::exists(folder_ / "victim"));
}

TEST_F(ExportMarkerTest, AnotherMachinesPlaceIsNotLookedFor) {
  EXPECT_EQ(*RemoveExport("elsewhere.example:" + out_.string(), "s000001-0badcafe"), ExportState::kElsewhere);
  EXPECT_TRUE(fs::exists(out_ / "a.png"));
  EXPECT_EQ(LocalFolder(ExportPlace(out_)), fs::weakly_canonical(out_));
}

TEST_F(ExportMarkerTest, ADamagedMarkerIsAnErrorAndDeletesNothing) {
  WriteText(ExportMarker(out_, "s000001-0badcafe"), "{");
  EXPECT_EQ(RemoveExport(ExportPlace(out_), "s000001-0badcafe").status().code(), StatusCode::kIntegrity);
  EXPECT_TRUE(fs::exists(out_ / "a.png"));
}

// Killed while a file was written: it has no name of the marker's yet.
TEST_F(ExportMarkerTest, DeletesWhatAKilledExportHasHalfWritten) {
  fs::remove(out_ / "a.png");
  for (const char* name : {"a.png.part", "a.png.new", "deep/er/b.png.part.new"}) WriteText(out_ / name, "half a face");
  EXPECT_EQ(*RemoveExport(ExportPlace(out_), "s000001-0badcafe"), ExportState::kDeleted);
  EXPECT_FALSE(fs::exists(out_));
}

TEST_F(ExportMarkerTest, AFileThatCannotBeWrittenLeavesTheEarlierOne) {
  const auto file = folder_ / "cloud.ply";
  WriteText(file, "earlier");
  const Status failed = WriteExportedFile(file, [](const std::filesystem::path& beside) {
    WriteText(beside, "half");
    return Status::Failed("no space left");
  });
  EXPECT_EQ(failed.code(), StatusCode::kFailed);
  EXPECT_EQ(ReadText(file), "earlier");
  EXPECT_FALSE(std::filesystem::exists(file.string() + ".new"));
  EXPECT_TRUE(WriteExportedFile(file, [](const std::filesystem::path& beside) {
                WriteText(beside, "whole");
                return Status::Ok();
              }).ok());
  EXPECT_EQ(ReadText(file), "whole");
}

// Killed in the midst of it: what stands beside goes with a forgetting, as all else does.
TEST_F(ExportMarkerTest, WhatAKilledWriterLeftBesideIsForgottenToo) {
  const std::string session = StoreSession(1);
  const auto out = folder_ / "clouds";
  ASSERT_TRUE(BeginExport(folder_, "cloud", session, out, {"cloud.ply"}).ok());
  WriteText(out / "cloud.ply.new", "half a face");
  const auto removed = RemoveExport(ExportPlace(out), session);
  ASSERT_TRUE(removed.ok()) << removed.status().message();
  EXPECT_FALSE(std::filesystem::exists(out / "cloud.ply.new"));
}

TEST_F(ExportMarkerTest, AFolderThatCannotBeLookedIntoIsNotTakenForGone) {
  const fs::path endless = folder_ / std::string(300, 'x');  // no file system takes such a name
  EXPECT_EQ(RemoveExport(ExportPlace(endless), "s000001-0badcafe").status().code(), StatusCode::kFailed);
}

// As systemd shows a unit its mounts.
TEST_F(ExportMarkerTest, SaysWhichPlacesAUnitOfSystemdDoesNotSee) {
  const std::string
      unit =
          "22 1 8:1 / / ro,relatime shared:1 - ext4 /dev/sda1 ro\n"
          "51 22 8:1 /tmp/systemd-private-0badcafe-stratalux-purge.service-x/tmp /tmp rw - ext4 /dev/sda1 rw\n"
          "52 22 0:24 /systemd/inaccessible/dir /home ro - tmpfs tmpfs rw\n",
      shell = "22 1 8:1 / / rw,relatime shared:1 - ext4 /dev/sda1 rw\n23 22 0:30 / /tmp rw - tmpfs tmpfs rw\n";
  EXPECT_EQ(HiddenBy(unit, "/tmp/pictures"), "/tmp");
  EXPECT_EQ(HiddenBy(unit, "/tmp"), "/tmp");
  EXPECT_EQ(HiddenBy(unit, "/home/alice/x"), "/home");
  EXPECT_EQ(HiddenBy(unit, "/srv/exports"), "");
  EXPECT_EQ(HiddenBy(unit, "/tmpfiles"), "");
  EXPECT_EQ(HiddenBy(shell, "/tmp/pictures"), "");
  const std::string bound = unit + "53 51 8:1 /exports /tmp/exports rw - ext4 /dev/sda1 rw\n";
  EXPECT_EQ(HiddenBy(bound, "/tmp/exports/x"), "") << "BindPaths";
  EXPECT_EQ(HiddenBy(bound, "/tmp/pictures"), "/tmp");
}

// Else the first session's forgetting would delete the second one's files.
TEST_F(ExportMarkerTest, AFileOfAnotherSessionsExportIsNotWrittenOver) {
  const std::string first = StoreSession(1), second = StoreSession(1);
  const fs::path face = folder_ / "face";
  ASSERT_TRUE(BeginExport(folder_, "export", first, face, {"mesh.glb", "export.json"}).ok());
  WriteText(face / "export.json", "of the first");
  const Status refused = BeginExport(folder_, "export", second, face, {"cloud.ply", "export.json"});
  EXPECT_EQ(refused.exit_code(), 2);
  for (const std::string& part : {face.string(), std::string("export.json"), first, std::string("another folder")})
    EXPECT_THAT(refused.message(), HasSubstr(part));
  EXPECT_THAT(ExportsIn(face), ElementsAre(first));
  EXPECT_TRUE(ListAccess(folder_, second)->empty());
  // Other names, and its own ones again.
  EXPECT_TRUE(BeginExport(folder_, "cloud", second, face, {"cloud.ply"}).ok());
  EXPECT_TRUE(BeginExport(folder_, "cloud", second, face, {"cloud.ply"}).ok());
  EXPECT_TRUE(BeginExport(folder_, "export", first, face, {"export.json"}).ok());
  WriteText(face / "cloud.ply", "of the second");
  EXPECT_EQ(*RemoveExport(ExportPlace(face), first), ExportState::kDeleted);
  EXPECT_EQ(ReadText(face / "cloud.ply"), "of the second");
  EXPECT_TRUE(BeginExport(folder_, "export", second, face, {"export.json"}).ok()) << "the first is forgotten";
  // What one export holds of several sessions goes with whichever is forgotten first.
  EXPECT_TRUE(BeginExport(folder_, "export", first, face, {"export.json"}, {first, second}).ok());
}

// It goes with the next purge: by the index, and by the ledger alone. What was being written meanwhile goes at once.
TEST_F(ExportMarkerTest, OfWhoHasWithdrawnNothingIsHandedOut) {
  const std::string first = StoreSession(1), second = StoreSession(1);
  const auto refused = [this](const std::string& session) {
    const Status begun = BeginExport(folder_, "export", session, folder_ / session, {"mesh.glb"});
    EXPECT_EQ(begun.code(), StatusCode::kUsage);
    EXPECT_THAT(begun.message(), HasSubstr(session + ": the consent that it was made under was withdrawn on 2"));
    EXPECT_FALSE(fs::exists(folder_ / session));
  };
  const auto writing = [&] {
    WriteText(folder_ / first / "mesh.glb", "a face");
    return AppendToLedger(folder_, {LedgerKind::kWithdrawal, WallNow(), {first}, "", ""});
  };
  EXPECT_EQ(WriteExport(folder_, "export", first, folder_ / first, {"mesh.glb"}, writing).code(), StatusCode::kUsage);
  refused(first);
  EXPECT_TRUE(BeginExport(folder_, "cloud", second, folder_ / "cloud", {"cloud.ply"}).ok());
  ASSERT_TRUE(WithdrawConsent(folder_, kSimulatedVisitor).ok());
  const auto entered = ListAccess(folder_, second)->size();
  refused(second);
  EXPECT_EQ(ListAccess(folder_, second)->size(), entered) << "what is refused is no export";
  fs::remove_all(folder_ / "ledger");
  refused(second);
  const fs::path own = folder_ / "own";
  const auto write = [&own] { return ReplaceFile(own / "visitor.json", "{}"); };
  EXPECT_TRUE(WriteExport(folder_, "export", second, own, {"visitor.json"}, write, ExportFor::kVisitor).ok());
  EXPECT_TRUE(fs::exists(own / "visitor.json")) << "the visitor's own copy";
}

TEST_F(ExportMarkerTest, ADamagedMarkerOfAnotherSessionHindersNoExport) {
  const std::string session = StoreSession(1);
  WriteText(ExportMarker(out_, "s000001-0badcafe"), "{");
  EXPECT_TRUE(BeginExport(folder_, "export", session, out_, {"a.png"}).ok());
}

}  // namespace
}  // namespace stratalux::db
