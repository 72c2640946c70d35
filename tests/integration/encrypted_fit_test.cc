// SPDX-License-Identifier: Apache-2.0
// An encrypted visit from frames to report: what comes out is what comes out of the plain one, and nothing of it lies
// plain on the disk, whatever ends the run.
#include <algorithm>
#include <csignal>
#include <random>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include "db/base/memory_folder.h"
#include "db/catalogue/artifact_record.h"
#include "db/catalogue/fit_reader.h"
#include "db/catalogue/fit_record.h"
#include "tests/integration/small_fit.h"
#include "tests/support/text_file.h"

namespace stratalux {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using Json = nlohmann::json;
using std::chrono::milliseconds;

// By which the files of fits and artifacts begin: PNG, EXR, npy, PLY, a page, and what JSON files of stages hold.
const std::string kPlainMarks[] = {"\x89PNG\r\n\x1a\n", std::string("\x76\x2f\x31\x01\x02\0\0\0", 8),
                                   "\x93NUMPY\x01",     "ply\nformat",
                                   "<!doctype html",    "<!DOCTYPE html",
                                   "quaternion_wxyz"};

// Of manifest, index and records: what they may say.
bool SpeaksOfCalibration(const fs::path& file) {
  return file.filename() == "manifest.json" || file.filename() == "truth_calibration.json" ||
         file.filename().string().starts_with("index.sqlite");
}

std::vector<std::string> PlainFilesBelow(const fs::path& folder) {
  std::vector<std::string> found;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file() || SpeaksOfCalibration(entry.path())) continue;
    const std::string text = ReadText(entry.path());
    for (const std::string& mark : kPlainMarks)
      if (text.find(mark) != std::string::npos) found.push_back(entry.path().string());
  }
  return found;
}

// Of one process.
std::vector<fs::path> MemoryOf(pid_t pid) {
  std::vector<fs::path> folders;
  const std::string prefix = "stratalux-" + std::to_string(geteuid()) + "-" + std::to_string(pid) + "-";
  for (const fs::path& root : db::MemoryRoots()) {
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(root, error))
      if (entry.path().filename().string().starts_with(prefix)) folders.push_back(entry.path());
  }
  return folders;
}

class EncryptedFit : public SmallFit {
 protected:
  static void SetUpTestSuite() {
    SmallFit::SetUpTestSuite();
    if (HasFatalFailure() || fs::exists(Originals() / "encrypted")) return;
    fs::create_directories(Originals() / "encrypted");
    const Outcome capture = Capture(Originals() / "encrypted" / "store", "--encrypt");
    ASSERT_EQ(capture.code, 0) << capture.out;
    Running run(RunArguments(CopyOfOriginal("encrypted", Originals() / "sealed")), Originals() / "log");
    const Outcome outcome = run.Wait();
    ASSERT_EQ(outcome.code, 0) << outcome.out;
  }
  [[nodiscard]] fs::path Encrypted(const std::string& name) const {
    return CopyOfOriginal("encrypted", folder_ / name);
  }
  [[nodiscard]] fs::path Sealed(const std::string& name) const { return CopyOfOriginal("sealed", folder_ / name); }
  static fs::path FitOf(const fs::path& store) {
    for (const auto& entry : fs::directory_iterator(Session(store) / "fits")) return entry.path();
    ADD_FAILURE() << "no fit";
    return {};
  }
  static db::FileSeal SealOf(const fs::path& store) {
    const auto open = db::SessionStore::Open(store, db::AccessMode::kReadOnly);
    const auto row = open->FindSession("latest");
    return db::SealOf(store, row->info, row->key_id);
  }
  // "stage/file" -> bytes, plain; of a stage that has several artifacts, in any order.
  std::multimap<std::string, std::string> ArtifactsOf(const fs::path& store) const {
    std::multimap<std::string, std::string> files;
    db::FileSeal seal = SealOf(store);
    for (const auto& entry : fs::directory_iterator(Session(store) / "artifacts")) {
      const auto record = db::ReadArtifactRecord(entry.path());
      EXPECT_TRUE(record.ok()) << record.status().message();
      for (const db::RecordedFile& file : record->files) {
        fs::path from = entry.path() / file.name;
        if (seal.active()) {
          const std::string place = db::PlaceOfArtifact(entry.path().filename().string(), file.name);
          const fs::path into = folder_ / "opened";
          const Status opened = seal.Open(from, {place}, into);
          EXPECT_TRUE(opened.ok()) << opened.message();
          from = into;
        }
        files.emplace(record->identity.stage + "/" + file.name, ReadText(from));
      }
    }
    return files;
  }
  // Artifacts as they are stored, without their records' times.
  static State StoredArtifacts(const fs::path& store) {
    State state = StateOf(store);
    std::erase_if(state, [](const auto& file) { return !file.first.starts_with("artifacts"); });
    return state;
  }
  static void ExpectNothingPlain(const fs::path& store, const std::string& where) {
    EXPECT_THAT(PlainFilesBelow(store), IsEmpty()) << where;
  }
  // The run that ends what is there: then all is sealed, and as the undisturbed run sealed it.
  static void Finish(const fs::path& store, const std::string& where) {
    Running run(RunArguments(store), store.parent_path() / "log");
    const Outcome outcome = run.Wait();
    EXPECT_EQ(outcome.code, 0) << where << ": " << outcome.out;
    EXPECT_TRUE(StoredArtifacts(store) == StoredArtifacts(Originals() / "sealed" / "store")) << where;
    EXPECT_THAT(Leftovers(store, true), IsEmpty()) << where;
    EXPECT_THAT(MemoryOf(run.pid()), IsEmpty()) << where;
    ExpectNothingPlain(store, where);
    const Outcome verify = Db(store, "verify --deep");
    EXPECT_EQ(verify.code, 0) << where << ": " << verify.out;
  }
};

// The marks are what the plain run's files begin with: the search below finds them there.
TEST_F(EncryptedFit, HoldsWhatThePlainOneHoldsAndNothingPlain) {
  const fs::path plain = Fitted("plain"), sealed = Sealed("sealed");
  EXPECT_GT(PlainFilesBelow(plain).size(), 50U);
  ExpectNothingPlain(sealed, "after the run");
  const auto expected = ArtifactsOf(plain), found = ArtifactsOf(sealed);
  EXPECT_GT(expected.size(), 50U);
  std::vector<std::string> names, expected_names;
  for (const auto& [name, bytes] : found) names.push_back(name);
  for (const auto& [name, bytes] : expected) expected_names.push_back(name);
  EXPECT_EQ(names, expected_names);
  for (const auto& [name, bytes] : expected) {
    const auto [first, last] = found.equal_range(name);
    EXPECT_TRUE(std::any_of(first, last, [&](const auto& file) { return file.second == bytes; })) << name;
  }
  EXPECT_EQ(Db(sealed, "verify --deep").code, 0);
  const auto figures = [](const fs::path& store) {
    return Json::parse(ReadText(FitOf(store) / "metrics.json")).at("prediction");
  };
  EXPECT_EQ(figures(sealed), figures(plain));
}

TEST_F(EncryptedFit, IsShownWhereSomebodyAsksAndNowhereElse) {
  const fs::path plain = Fitted("plain"), store = Sealed("sealed"), out = folder_ / "seen";
  for (const char* verb : {"report latest", "report latest --path-only", "report latest --json"}) {
    const Outcome refused = Fit(store, verb);
    EXPECT_EQ(refused.code, 2) << verb;
    EXPECT_THAT(refused.out, HasSubstr("--out FOLDER")) << verb;
  }
  const Outcome report = Fit(store, "report latest --out " + out.string());
  EXPECT_EQ(report.code, 0) << report.out;
  EXPECT_THAT(report.out, HasSubstr((out / "report" / "index.html").string()));
  EXPECT_THAT(report.out, HasSubstr("is encrypted; the files in " + out.string() + " are not"));
  size_t compared = 0;
  for (const auto& entry : fs::recursive_directory_iterator(FitOf(plain))) {
    const std::string name = fs::relative(entry.path(), FitOf(plain)).string();
    if (!entry.is_regular_file() || name.ends_with("fit.json")) continue;
    EXPECT_TRUE(fs::exists(out / name)) << name;
    // Both name their session and their times.
    if (name == "metrics.json" || name == "report/index.html") continue;
    EXPECT_TRUE(ReadText(out / name) == ReadText(entry.path())) << name;
    ++compared;
  }
  EXPECT_GT(compared, 20U);
  EXPECT_THAT(ReadText(out / "report" / "index.html"), HasSubstr("<html"));

  const std::string light = "render latest --direction=1,-0.3,-0.4 --out ";
  const Outcome relit = Fit(store, light + (folder_ / "lit").string());
  EXPECT_EQ(relit.code, 0) << relit.out;
  EXPECT_THAT(relit.out, HasSubstr("is encrypted; the files in"));
  EXPECT_EQ(Fit(plain, light + (folder_ / "plain_lit").string()).code, 0);
  EXPECT_TRUE(ReadText(folder_ / "lit" / "total.png") == ReadText(folder_ / "plain_lit" / "total.png"));

  const fs::path face = folder_ / "face", plain_face = folder_ / "plain_face";
  const Outcome exported = Fit(store, "export latest --out " + face.string());
  EXPECT_EQ(exported.code, 0) << exported.out;
  EXPECT_THAT(exported.out, HasSubstr("is encrypted; the files in " + face.string() + " are not"));
  EXPECT_EQ(Fit(plain, "export latest --out " + plain_face.string()).code, 0);
  EXPECT_TRUE(ReadText(face / "depth.exr") == ReadText(plain_face / "depth.exr"));
  ExpectNothingPlain(store, "after looking");

  // All that left it goes with it.
  EXPECT_EQ(Db(store, "forget latest --yes").code, 0);
  EXPECT_FALSE(fs::exists(out)) << "a logged copy";
  EXPECT_FALSE(fs::exists(folder_ / "lit"));
  EXPECT_FALSE(fs::exists(face));
  EXPECT_THAT(PlainFilesBelow(store), IsEmpty());
}

TEST_F(EncryptedFit, LeavesAsPlainFilesInExports) {
  const fs::path plain = Fitted("plain"), store = Sealed("sealed"), out = folder_ / "for-them";
  const Outcome exported = Db(store, "export --visitor simulated --out " + out.string());
  ASSERT_EQ(exported.code, 0) << exported.out;
  const fs::path copy = out / Session(store).filename() / "fits" / FitOf(store).filename();
  EXPECT_TRUE(ReadText(copy / "position.exr") == ReadText(FitOf(plain) / "position.exr"));
  EXPECT_THAT(ReadText(copy / "report" / "index.html"), HasSubstr("<html"));
  const Status whole = db::CheckFitFiles(copy);
  EXPECT_TRUE(whole.ok()) << "its record speaks of the plain files: " << whole.message();

  const fs::path crate = folder_ / "crate", elsewhere = folder_ / "elsewhere";
  const Outcome packed = Db(store, "export latest --scope research --crate " + crate.string());
  ASSERT_EQ(packed.code, 0) << packed.out;
  ASSERT_EQ(Db(elsewhere, "init").code, 0);
  const Outcome imported = Db(elsewhere, "import --crate " + crate.string());
  ASSERT_EQ(imported.code, 0) << imported.out;
  EXPECT_TRUE(ReadText(FitOf(elsewhere) / "position.exr") == ReadText(FitOf(plain) / "position.exr"));
  const Outcome verify = Db(elsewhere, "verify --deep");
  EXPECT_EQ(verify.code, 0) << verify.out;
}

TEST_F(EncryptedFit, WithoutItsKeyIsCheckedAndCopiedAndNotRead) {
  const fs::path store = Sealed("store"), out = folder_ / "out";
  fs::rename(store / "keys.sqlite", folder_ / "keys.sqlite");
  const State before = StateOf(store);
  for (const std::string& verb :
       {"run latest --heldout 0 " + std::string(kSmallFitOptions), "report latest --out " + out.string(),
        "render latest --direction=0,0,-1 --out " + out.string(), "export latest --out " + out.string()}) {
    const Outcome refused = Fit(store, verb);
    EXPECT_EQ(refused.code, 4) << verb << ": " << refused.out;
    EXPECT_THAT(refused.out, HasSubstr("stratalux-db key export")) << verb;
    EXPECT_FALSE(fs::exists(out)) << verb;
  }
  EXPECT_EQ(Fit(store, "clean latest --dry-run").code, 0);
  EXPECT_EQ(Db(store, "ls").code, 0);
  const Outcome verify = Db(store, "verify --deep");
  EXPECT_EQ(verify.code, 0) << verify.out;
  EXPECT_THAT(verify.out, HasSubstr("sealed files were hashed, but not opened: their key is not here"));
  EXPECT_TRUE(StateOf(store) == before);
  fs::rename(folder_ / "keys.sqlite", store / "keys.sqlite");
  EXPECT_EQ(Fit(store, "report latest --out " + out.string()).code, 0);
}

// Each by another hand: what is listed with right hashes is still not what was sealed.
TEST_F(EncryptedFit, FilesPutInTheirPlaceByAnotherAreNamed) {
  const fs::path store = Sealed("store"), fit = FitOf(store);
  const fs::path file = fit / "position.exr", page = fit / "report" / "index.html";
  const auto relist = [&] {
    const auto row = db::ReadFitRecord(fit, Session(store).filename().string());
    const auto record = db::FitRecordOf(fit, *row);
    fs::remove(fit / "fit.json");
    WriteText(fit / "fit.json", *record);
  };
  const auto put = [&](const fs::path& place, const std::string& bytes) {
    fs::remove(place);
    WriteText(place, bytes);
    relist();
  };
  const std::string intact = ReadText(file);
  const auto expect_named = [&](const std::string& why) {
    const Outcome lit = Fit(store, "render latest --direction=0,0,-1 --out " + (folder_ / "out").string());
    EXPECT_EQ(lit.code, 6) << why << ": " << lit.out;
    EXPECT_THAT(lit.out, HasSubstr(file.string())) << why;
    EXPECT_FALSE(fs::exists(folder_ / "out")) << why;
    const Outcome verify = Db(store, "verify --deep");
    EXPECT_EQ(verify.code, 6) << why << ": " << verify.out;
    EXPECT_THAT(verify.out, HasSubstr("position.exr")) << why;
  };
  std::string flipped = intact;
  flipped[flipped.size() / 2] = static_cast<char>(flipped[flipped.size() / 2] ^ 1);
  put(file, flipped);
  expect_named("a flipped bit");
  put(file, intact.substr(0, intact.size() - 1));
  expect_named("cut off");
  put(file, ReadText(fit / "normal_surface.exr"));
  expect_named("another map");
  put(file, ReadText(page));
  expect_named("the page");
  put(file, "");
  expect_named("empty");
  put(file, "plain bytes");
  expect_named("plain");
  EXPECT_THAT(Db(store, "verify").out, HasSubstr("plain fit of an encrypted session (position.exr)"));
  put(file, intact);
  EXPECT_EQ(Fit(store, "render latest --direction=0,0,-1 --out " + (folder_ / "out").string()).code, 0);
}

TEST_F(EncryptedFit, WhatAnOlderProgramLeftPlainIsNamedAndMended) {
  const fs::path store = Sealed("store"), fit = FitOf(store), seen = folder_ / "seen";
  const fs::path plain = Fitted("plain");
  const std::string id = Session(store).filename().string();
  // As it made them: plain artifacts under keys that name no seal, and a fit of plain files.
  fs::path old;
  for (const auto& entry : fs::directory_iterator(Session(plain) / "artifacts"))
    if (entry.path().filename().string().starts_with("shape-")) old = entry.path();
  fs::copy(old, Session(store) / "artifacts" / old.filename(), fs::copy_options::recursive);
  ASSERT_EQ(Fit(store, "report latest --out " + seen.string()).code, 0);
  const auto row = db::ReadFitRecord(fit, id);
  fs::remove_all(fit);
  fs::copy(seen, fit, fs::copy_options::recursive);
  for (const auto& entry : fs::directory_iterator(fit))
    if (entry.path().filename().string().starts_with(".")) fs::remove(entry.path());
  WriteText(fit / "fit.json", *db::FitRecordOf(fit, *row));
  EXPECT_THAT(PlainFilesBelow(store), Not(IsEmpty()));

  for (const char* depth : {"verify", "verify --deep"}) {
    const Outcome verify = Db(store, depth);
    EXPECT_EQ(verify.code, 6) << depth;
    EXPECT_THAT(verify.out, HasSubstr(old.filename().string() + ": plain artifact of an encrypted session")) << depth;
    EXPECT_THAT(verify.out, HasSubstr(fit.filename().string() + ": plain fit of an encrypted session")) << depth;
    EXPECT_THAT(verify.out, HasSubstr("`stratalux-fit clean " + id + "`")) << depth;
  }
  const Outcome look = Fit(store, "clean latest --damaged --dry-run");
  EXPECT_THAT(look.out, HasSubstr("fit " + fit.filename().string() + " would be sealed"));
  const Outcome clean = Fit(store, "clean latest --damaged");
  EXPECT_EQ(clean.code, 0) << clean.out;
  EXPECT_THAT(clean.out, HasSubstr(old.filename().string()));
  EXPECT_THAT(clean.out, HasSubstr("fit " + fit.filename().string() + " sealed"));
  EXPECT_THAT(clean.out, HasSubstr("1 artifacts removed"));
  ExpectNothingPlain(store, "after clean");
  EXPECT_THAT(Leftovers(store, true), IsEmpty());
  EXPECT_EQ(Db(store, "verify --deep").code, 0);
  ASSERT_EQ(Fit(store, "report latest --out " + (folder_ / "again").string()).code, 0);
  for (const char* name : {"position.exr", "report/index.html"})
    EXPECT_TRUE(ReadText(folder_ / "again" / name) == ReadText(seen / name)) << name;
}

// A killed run leaves plain files in memory alone, and those the next run removes, before it does anything.
TEST_F(EncryptedFit, KilledLeavesNothingPlainOnTheDisk) {
  std::mt19937_64 random(Seed() * 23'000'003);
  std::uniform_real_distribution<double> anywhere(0.0, 1.0);
  const int kills = std::max(4, Kills() / 4);
  const fs::path store = Encrypted("store");
  int left_in_memory = 0;
  // By the clock; that of a busy machine may strike none at work: then some more, which wait for it.
  for (int i = 0; i < kills || (left_in_memory == 0 && i < kills + 20); ++i) {
    const std::string where = "kill " + std::to_string(i);
    Running run(RunArguments(store), folder_ / "log");
    bool ended = false;
    while (i >= kills && !ended && MemoryOf(run.pid()).empty()) ended = run.WaitFor(milliseconds(5));
    if (i < kills)
      ended = run.WaitFor(milliseconds(static_cast<int>(anywhere(random) * double(duration_.count()) / (i % 3 + 1))));
    if (ended)
      fs::remove_all(FitOf(store));  // there is something to do again
    else
      run.Send(SIGKILL);
    (void)run.Wait();
    ExpectNothingPlain(store, where);
    const auto memory = MemoryOf(run.pid());
    if (memory.empty()) continue;
    ++left_in_memory;
    const auto any_left = [&] {
      return std::ranges::any_of(memory, [](const auto& folder) { return fs::exists(folder); });
    };
    Running next(RunArguments(store), folder_ / "log");
    while (any_left() && !next.WaitFor(milliseconds(20)))
      ;
    (void)next.WaitFor(std::chrono::seconds(1));  // into its work
    next.Send(SIGINT);
    (void)next.Wait();
    EXPECT_FALSE(any_left()) << where;
    EXPECT_THAT(MemoryOf(next.pid()), IsEmpty()) << where << ": interrupted";
    ExpectNothingPlain(store, where + ", interrupted");
  }
  EXPECT_GT(left_in_memory, 0) << "none struck a run at work";
  Finish(store, "after kills");
}

// The same between two file calls of the store.
TEST_F(EncryptedFit, KilledAtAnyFileCallLeavesNothingPlainOnTheDisk) {
  std::mt19937_64 random(Seed() * 29'000'003);
  const fs::path store = Encrypted("store");
  const int kills = std::max(4, Kills() / 4);
  for (int i = 0; i < kills; ++i) {
    const auto call = static_cast<int64_t>(random() % 300);
    Running run(RunArguments(store), folder_ / "log", DiesAt(store, call));
    const Outcome outcome = run.Wait();
    EXPECT_TRUE(outcome.signal == SIGKILL || outcome.code == 0) << outcome.out;
    ExpectNothingPlain(store, "killed at call " + std::to_string(call));
    if (outcome.code == 0) break;
  }
  Finish(store, "after kills");
}

TEST_F(EncryptedFit, TwoRunsAtOnceShareTheirWork) {
  const fs::path store = Encrypted("store");
  std::vector<Running> runs;
  for (int i = 0; i < 2; ++i) runs.emplace_back(RunArguments(store), folder_ / ("log" + std::to_string(i)));
  for (Running& run : runs) {
    const Outcome outcome = run.Wait();
    EXPECT_EQ(outcome.code, 0) << outcome.out;
    EXPECT_THAT(MemoryOf(run.pid()), IsEmpty());
  }
  Finish(store, "after both");
}

}  // namespace
}  // namespace stratalux
