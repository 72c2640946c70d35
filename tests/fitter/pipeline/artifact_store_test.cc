// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/artifact_store.h"

#include <chrono>
#include <csignal>
#include <fstream>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "fitter/pipeline/stage_graph.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

db::ArtifactIdentity Named(const std::string& stage, const std::string& options = "{}") {
  return {stage, 1, options, {{"frames", "f00d"}}, ""};
}

std::function<Result<std::set<std::string>>()> Wanted(std::set<std::string> names) {
  return [names = std::move(names)] { return names; };
}

class ArtifactStoreTest : public ScratchFolderTest {
 protected:
  ArtifactStore Open() {
    auto store = ArtifactStore::Open(folder_, PlainFiles(seal_), logger_);
    EXPECT_TRUE(store.ok()) << store.status().message();
    return std::move(*store);
  }
  // Writes two files, one of them in a folder; counts its calls.
  std::function<Status(const fs::path&)> Maker() {
    return [this](const fs::path& folder) {
      ++calls_;
      WriteText(folder / "map.exr", "pixels");
      fs::create_directory(folder / "rows");
      WriteText(folder / "rows" / "y.npy", "samples");
      return Status::Ok();
    };
  }
  [[nodiscard]] std::vector<std::string> Names() const {
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder_ / db::kArtifactsFolder))
      names.push_back(entry.path().filename().string());
    return names;
  }

  Logger logger_{LogLevel::kError};
  db::FileSeal seal_;
  int calls_ = 0;
};

TEST_F(ArtifactStoreTest, IsMadeOnceAndReadOnlyAndFoundByAnotherRun) {
  const auto made = Open().Obtain(Named("shape"), Maker());
  ASSERT_TRUE(made.ok()) << made.status().message();
  const auto found = Open().Obtain(Named("shape"), Maker());
  ASSERT_TRUE(found.ok());
  EXPECT_EQ(calls_, 1);
  EXPECT_EQ(found->folder, made->folder);
  ASSERT_EQ(found->record.files.size(), 2U);
  EXPECT_EQ(found->record.files[1].name, "rows/y.npy");
  struct stat info {};
  ASSERT_EQ(stat((made->folder / "rows" / "y.npy").c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777U, 0440U);
  EXPECT_THAT(Names(), ElementsAre(Named("shape").FolderName())) << "no lock, nothing half made";
}

TEST_F(ArtifactStoreTest, AKeyIsOfAllThatDecidesTheBytes) {
  db::ArtifactIdentity other = Named("shape");
  const std::string key = other.Key();
  other.version = 2;
  EXPECT_NE(other.Key(), key);
  other = Named("shape", R"({"pool":2})");
  EXPECT_NE(other.Key(), key);
  other = Named("shape");
  other.inputs["frames"] = "beef";
  EXPECT_NE(other.Key(), key);
  other = Named("shape");
  other.isa = "AVX2";
  EXPECT_NE(other.Key(), key);
  EXPECT_EQ(Named("shape", R"({"a":1,"b":2})").Key(), Named("shape", R"({ "b":2, "a":1 })").Key()) << "canonical";
}

TEST_F(ArtifactStoreTest, AFailureLeavesNothing) {
  const auto failed = Open().Obtain(Named("shape"), [](const fs::path& folder) {
    WriteText(folder / "half", "x");
    return Status::Failed("no face");
  });
  EXPECT_THAT(failed.status().message(), HasSubstr("no face"));
  EXPECT_THAT(Names(), IsEmpty());
}

// Each way to spoil it is found by who reads it, names the file, and is mended by clean and the next run.
TEST_F(ArtifactStoreTest, AFileSwappedCutOrRemovedIsNamed) {
  const fs::path folder = Open().Obtain(Named("shape"), Maker())->folder;
  const auto spoil = [&](const std::function<void(const fs::path&)>& how, const std::string& file) {
    how(folder / file);
    const auto read = Open().Read(Named("shape"));
    EXPECT_EQ(read.status().code(), StatusCode::kIntegrity) << file;
    EXPECT_THAT(read.status().message(), HasSubstr((folder / file).string()));
    auto store = Open();
    const auto cleaned = store.Clean(Wanted({folder.filename().string()}), {.damaged_only = true});
    ASSERT_TRUE(cleaned.ok());
    EXPECT_THAT(cleaned->removed, ElementsAre(folder.filename().string()));
    EXPECT_TRUE(Open().Obtain(Named("shape"), Maker()).ok());
  };
  const auto rewrite = [](const std::string& text) {
    return [text](const fs::path& file) {
      fs::remove(file);
      WriteText(file, text);
    };
  };
  spoil(rewrite("PIXELS"), "map.exr");  // of the same size
  spoil(rewrite("pix"), "map.exr");
  spoil([](const fs::path& file) { fs::remove(file); }, "rows/y.npy");
  spoil(
      [](const fs::path& file) {
        fs::remove(file);
        fs::create_symlink("/etc/hostname", file);
      },
      "map.exr");
  spoil(rewrite("{}"), db::kArtifactRecordFile);
}

TEST_F(ArtifactStoreTest, AnotherArtifactUnderItsNameIsNoArtifact) {
  auto store = Open();
  const fs::path one = store.Obtain(Named("shape"), Maker())->folder, two = store.Obtain(Named("srd"), Maker())->folder;
  fs::remove_all(one);
  fs::rename(two, one);
  const auto read = Open().Read(Named("shape"));
  EXPECT_EQ(read.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(read.status().message(), HasSubstr(two.filename().string()));
}

// Processes: one makes, the others wait and read; what a killed one left goes, and the next one makes it.
TEST_F(ArtifactStoreTest, ThreeRunsAtOnceMakeItOnce) {
  const fs::path log = folder_ / "made";
  std::vector<pid_t> children;
  for (int i = 0; i < 3; ++i) {
    const pid_t child = fork();
    if (child == 0) {
      auto store = ArtifactStore::Open(folder_, PlainFiles(seal_), logger_);
      const auto artifact = store->Obtain(Named("shape"), [&](const fs::path& folder) {
        std::ofstream(log, std::ios::app) << "x";
        std::this_thread::sleep_for(std::chrono::milliseconds(200));
        WriteText(folder / "map.exr", "pixels");
        return Status::Ok();
      });
      _exit(artifact.ok() ? 0 : 1);
    }
    children.push_back(child);
  }
  for (const pid_t child : children) {
    int status = 1;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_EQ(status, 0);
  }
  EXPECT_EQ(ReadText(log), "x");
  EXPECT_THAT(Names(), ElementsAre(Named("shape").FolderName()));
}

// Two machines whose locks do not reach each other: the second finds the first one's artifact when it is done.
TEST_F(ArtifactStoreTest, OfTwoThatCameOutDifferentlyTheFirstStaysAndItIsSaid) {
  char* text = nullptr;
  size_t length = 0;
  std::FILE* stream = open_memstream(&text, &length);
  {
    Logger logger(LogLevel::kWarning, stream);
    auto store = ArtifactStore::Open(folder_, PlainFiles(seal_), logger);
    ASSERT_TRUE(store.ok());
    for (const auto& [stage, sample] : {std::pair("shape", "samples"), std::pair("srd", "others")}) {
      const fs::path first = store->FolderOf(Named(stage)), aside = folder_ / "aside";
      const auto made = store->Obtain(Named(stage), [&](const fs::path& folder) {
        // What another machine made meanwhile, in one step as always.
        EXPECT_TRUE(Open().Obtain(Named("elsewhere"), Maker()).ok());
        db::ArtifactRecord record = *db::ReadArtifactRecord(store->FolderOf(Named("elsewhere")));
        record.identity = Named(stage);
        fs::rename(store->FolderOf(Named("elsewhere")), aside);
        WriteText(aside / "new.json", ToJson(record));
        fs::rename(aside / "new.json", aside / db::kArtifactRecordFile);
        fs::rename(aside, first);
        const Status done = Maker()(folder);
        WriteText(folder / "rows" / "y.npy", sample);
        return done;
      });
      ASSERT_TRUE(made.ok()) << made.status().message();
      EXPECT_EQ(ReadText(made->folder / "rows" / "y.npy"), "samples") << "the first";
    }
    logger.Flush();
  }
  std::fclose(stream);
  const std::string said(text, length);
  std::free(text);
  EXPECT_THAT(said, HasSubstr(Named("srd").FolderName() + ": made twice at once, and rows/y.npy came out differently"));
  EXPECT_EQ(said.find("made twice", said.find("made twice") + 1), std::string::npos) << "equal ones are no finding";
}

TEST_F(ArtifactStoreTest, WhatAKilledRunLeftIsRemovedAndMadeByTheNext) {
  const fs::path begun = folder_ / "begun";
  const pid_t child = fork();
  if (child == 0) {
    auto store = ArtifactStore::Open(folder_, PlainFiles(seal_), logger_);
    static_cast<void>(store->Obtain(Named("shape"), [&](const fs::path& folder) {
      WriteText(folder / "map.exr", "pix");
      WriteText(begun, "");
      while (true) pause();
      return Status::Ok();
    }));
    _exit(1);
  }
  while (!fs::exists(begun)) std::this_thread::sleep_for(std::chrono::milliseconds(5));
  // While it lives, its work is left alone.
  static_cast<void>(Open());
  EXPECT_EQ(Names().size(), 2U) << "a lock and a folder";
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  auto store = Open();
  ASSERT_TRUE(store.Obtain(Named("shape"), Maker()).ok());
  EXPECT_EQ(calls_, 1);
  EXPECT_THAT(Names(), ElementsAre(Named("shape").FolderName()));
}

TEST_F(ArtifactStoreTest, CleanTakesNothingFromARunThatGoesOn) {
  auto run = Open(), cleaning = Open();
  {
    const auto in_use = run.Use(), by_another_run = Open().Use();
    ASSERT_TRUE(in_use.ok() && by_another_run.ok());
    ASSERT_TRUE(run.Obtain(Named("srd"), Maker()).ok());
    const auto refused = cleaning.Clean(Wanted({}), {});
    EXPECT_EQ(refused.status().code(), StatusCode::kBusy);
    EXPECT_THAT(refused.status().message(), HasSubstr("a run works on"));
    EXPECT_TRUE(cleaning.Clean(Wanted({}), {.dry_run = true}).ok());
    EXPECT_TRUE(run.Read(Named("srd")).ok());
  }
  EXPECT_EQ(cleaning.Clean(Wanted({}), {})->removed.size(), 1U);
}

TEST_F(ArtifactStoreTest, CleanLeavesWhatIsWantedOrYoung) {
  auto store = Open();
  const std::string wanted = store.Obtain(Named("shape"), Maker())->folder.filename().string();
  ASSERT_TRUE(store.Obtain(Named("srd"), Maker()).ok());
  EXPECT_THAT(store.Clean(Wanted({wanted}), {.keep_days = 1.0})->removed, IsEmpty());
  EXPECT_THAT(store.Clean(Wanted({wanted}), {.dry_run = true})->removed, ElementsAre(Named("srd").FolderName()));
  EXPECT_TRUE(store.Has(Named("srd")));
  EXPECT_EQ(store.Clean(Wanted({wanted}), {})->kept, 1);
  EXPECT_FALSE(store.Has(Named("srd")));
  EXPECT_THAT(Names(), ElementsAre(wanted));
}

// Of an encrypted session: its key lies in the store's folder.
class SealedArtifactTest : public ArtifactStoreTest {
 protected:
  SealedArtifactTest() : key_(db::CreateKey(folder_)->id) { seal_ = {folder_, "s000001-0badcafe", db::ToHex(key_)}; }
  [[nodiscard]] db::ArtifactIdentity Sealed(const std::string& stage) const {
    db::ArtifactIdentity identity = Named(stage);
    identity.seal = db::ToHex(key_);
    return identity;
  }
  db::KeyId key_;
};

TEST_F(SealedArtifactTest, IsStoredSealedAndReadPlain) {
  fs::path memory;
  {
    auto store = Open();
    const auto made = store.Obtain(Sealed("shape"), Maker());
    ASSERT_TRUE(made.ok()) << made.status().message();
    for (const char* name : {"map.exr", "rows/y.npy"}) {
      const auto header = db::ReadSealedHeader(made->folder / name);
      ASSERT_TRUE(header.ok() && *header) << name;
      EXPECT_EQ((*header)->place, "artifacts/" + Sealed("shape").FolderName() + "/" + name);
    }
    std::string map, samples;
    const Status read = store.ReadFiles(*made, [&](const fs::path& folder) {
      memory = folder;
      map = ReadText(folder / "map.exr");
      samples = ReadText(folder / "rows" / "y.npy");
      return Status::Ok();
    });
    ASSERT_TRUE(read.ok()) << read.message();
    EXPECT_EQ(map + samples, "pixelssamples");
    EXPECT_FALSE(fs::exists(memory)) << "for as long as it is read";
    EXPECT_TRUE(fs::exists(memory.parent_path()));
  }
  EXPECT_FALSE(fs::exists(memory.parent_path())) << "with the store";
}

// The record's hash is right, and it is still not what was made there.
TEST_F(SealedArtifactTest, AFileOfAnotherArtifactIsRefused) {
  auto store = Open();
  const auto one = store.Obtain(Sealed("shape"), Maker()), two = store.Obtain(Sealed("srd"), Maker());
  ASSERT_TRUE(one.ok() && two.ok());
  fs::remove(one->folder / "map.exr");
  fs::copy(two->folder / "map.exr", one->folder / "map.exr");
  const Status read = store.ReadFiles(*one, [](const fs::path&) { return Status::Ok(); });
  EXPECT_EQ(read.code(), StatusCode::kIntegrity);
  EXPECT_THAT(read.message(), HasSubstr(two->folder.filename().string()));
}

TEST_F(SealedArtifactTest, WithoutTheKeyNothingIsComputed) {
  ASSERT_TRUE(db::DestroyKey(folder_, key_).ok());
  const auto refused = Open().Obtain(Sealed("shape"), Maker());
  EXPECT_EQ(refused.status().code(), StatusCode::kNotFound);
  EXPECT_EQ(calls_, 0);
  EXPECT_THAT(Names(), IsEmpty());
}

// The stage is computed in memory, where nothing tells that the session goes meanwhile.
TEST_F(SealedArtifactTest, OfASessionThatIsForgottenMeanwhileNothingComesBack) {
  auto store = Open();
  const fs::path artifacts = folder_ / db::kArtifactsFolder;
  const auto late = store.Obtain(Sealed("shape"), [&](const fs::path& plain) {
    EXPECT_TRUE(Maker()(plain).ok());
    fs::remove_all(artifacts);
    return Status::Ok();
  });
  EXPECT_THAT(late.status().message(), HasSubstr("is gone"));
  EXPECT_FALSE(fs::exists(artifacts));
}

TEST_F(SealedArtifactTest, PlainOnesOfAnOlderProgramAreNotFoundAndCleaned) {
  {
    db::FileSeal sealed;
    std::swap(sealed, seal_);
    ASSERT_TRUE(Open().Obtain(Named("shape"), Maker()).ok());
    std::swap(sealed, seal_);
  }
  auto store = Open();
  ASSERT_TRUE(store.Obtain(Sealed("shape"), Maker()).ok());
  EXPECT_EQ(calls_, 2);
  const std::string plain = Named("shape").FolderName();
  EXPECT_THAT(store.Clean(Wanted({plain}), {.damaged_only = true, .keep_days = 9.0})->removed, ElementsAre(plain));
  EXPECT_THAT(Names(), ElementsAre(Sealed("shape").FolderName()));
}

// decode -> shape -> fit, and an option of each.
class StageGraphTest : public ArtifactStoreTest {
 protected:
  std::string Chain(StageGraph& graph, int decode, int fit) {
    const auto node = [&](const std::string& stage, int option, const std::vector<std::string>& upstream) {
      db::ArtifactIdentity identity{stage, 1, "{\"option\":" + std::to_string(option) + "}", {}, ""};
      for (const std::string& key : upstream) identity.inputs["before"] = key;
      return graph.Add({identity, stage, upstream, [this, stage](const fs::path& folder) {
                          ran_.push_back(stage);
                          WriteText(folder / "result", stage);
                          return Status::Ok();
                        }});
    };
    return node("fit", fit, {node("shape", 0, {node("decode", decode, {})})});
  }
  std::vector<std::string> Run(int decode, int fit) {
    ran_.clear();
    StageGraph graph(Open(), logger_);
    const auto made = graph.Need(Chain(graph, decode, fit));
    EXPECT_TRUE(made.ok()) << made.status().message();
    return ran_;
  }
  std::vector<std::string> ran_;
};

TEST_F(StageGraphTest, OnlyWhatChangedAndWhatIsBehindItRuns) {
  EXPECT_THAT(Run(1, 1), ElementsAre("decode", "shape", "fit"));
  EXPECT_THAT(Run(1, 1), IsEmpty());
  EXPECT_THAT(Run(1, 2), ElementsAre("fit"));
  EXPECT_THAT(Run(2, 1), ElementsAre("decode", "shape", "fit"));
  EXPECT_THAT(Run(1, 2), IsEmpty()) << "what was made stays";
}

TEST_F(StageGraphTest, APlanSaysWhatWouldRunAndWhyAndRunsNothing) {
  Run(1, 1);
  ran_.clear();
  StageGraph graph(Open(), logger_);
  const auto plan = graph.Plan({Chain(graph, 1, 2)});
  ASSERT_EQ(plan.size(), 2U);
  EXPECT_TRUE(plan[0].exists) << plan[0].label;
  EXPECT_FALSE(plan[1].exists);
  EXPECT_EQ(plan[1].why, "option 1 -> 2");
  EXPECT_THAT(ran_, IsEmpty());
}

TEST_F(StageGraphTest, ALostInputIsMadeAgainOnlyWhereItIsNeeded) {
  Run(1, 1);
  for (const auto& entry : fs::directory_iterator(folder_ / db::kArtifactsFolder))
    if (entry.path().filename().string().starts_with("decode")) fs::remove_all(entry.path());
  EXPECT_THAT(Run(1, 1), IsEmpty());
  EXPECT_THAT(Run(1, 2), ElementsAre("fit")) << "its own input is there";
}

}  // namespace
}  // namespace stratalux::fit
