// SPDX-License-Identifier: Apache-2.0
// What is kept on disk is what was computed, or nothing.
#include "firmware-host/simulated/light_cache.h"

#include <atomic>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include "firmware-host/simulated/simulated_rig.h"
#include "firmware-host/simulated/skin/subcutis_table.h"
#include "tests/firmware-host/simulated/flat_world.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class LightCacheTest : public ScratchFolderTest {
 protected:
  ~LightCacheTest() override { std::fclose(log_); }
  std::vector<fs::path> Files() const {
    std::vector<fs::path> files;
    for (const auto& entry : fs::directory_iterator(folder_)) files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    return files;
  }
  std::string Logged() {
    EXPECT_TRUE(logger_.Flush());
    std::string text(4096, '\0');
    std::rewind(log_);
    text.resize(std::fread(text.data(), 1, text.size(), log_));
    return text;
  }
  static LightCache::Digest KeyOf(int number) {
    CacheKey key;
    key.Add(number);
    return key.Digest();
  }
  static void Write(const fs::path& file, const std::string& bytes) {
    std::ofstream(file, std::ios::binary | std::ios::trunc) << bytes;
  }

  std::FILE* log_ = std::tmpfile();  // before the logger that writes to it
  Logger logger_{LogLevel::kInfo, log_};
  const std::vector<float> values_ = {1.0F, -2.5F, 0.0F, 3e-30F, 7.0F};
};

TEST_F(LightCacheTest, GivesBackWhatWasKeptUnderItsKeyAlone) {
  LightCache cache(folder_ / "deeper", 1 << 20, logger_);
  EXPECT_FALSE(cache.Load(KeyOf(1), values_.size()));
  cache.Keep(KeyOf(1), values_);
  EXPECT_EQ(cache.Load(KeyOf(1), values_.size()), values_);
  EXPECT_FALSE(cache.Load(KeyOf(2), values_.size()));
  EXPECT_EQ(Logged(), "");
}

// Every byte, every length: nothing but the whole entry is believed, and what was refused can be kept anew.
TEST_F(LightCacheTest, DamagedEntriesAreRefusedAndNamed) {
  LightCache cache(folder_, 1 << 20, logger_);
  cache.Keep(KeyOf(1), values_);
  const fs::path file = Files().at(0);
  const std::string sound = ReadText(file);
  ASSERT_EQ(sound.size(), 48 + 4 * values_.size());
  for (size_t k = 0; k < sound.size(); ++k) {
    std::string flipped = sound;
    flipped[k] = static_cast<char>(flipped[k] ^ 0x10);
    Write(file, flipped);
    EXPECT_FALSE(cache.Load(KeyOf(1), values_.size())) << "byte " << k;
    EXPECT_FALSE(fs::exists(file)) << "byte " << k;
    Write(file, sound.substr(0, k));
    EXPECT_FALSE(cache.Load(KeyOf(1), values_.size())) << "cut to " << k;
  }
  Write(file, sound + "x");
  EXPECT_FALSE(cache.Load(KeyOf(1), values_.size()));
  EXPECT_THAT(Logged(), HasSubstr(file.string() + " is damaged"));
  cache.Keep(KeyOf(1), values_);
  EXPECT_EQ(cache.Load(KeyOf(1), values_.size()), values_);
}

TEST_F(LightCacheTest, AnEntryInAnothersPlaceIsRefused) {
  LightCache cache(folder_, 1 << 20, logger_);
  const std::vector<float> other = {9.0F, 8.0F, 7.0F, 6.0F, 5.0F};
  cache.Keep(KeyOf(1), values_);
  cache.Keep(KeyOf(2), other);
  const auto files = Files();
  ASSERT_EQ(files.size(), 2U);
  fs::rename(files[0], folder_ / "a");
  fs::rename(files[1], files[0]);
  fs::rename(folder_ / "a", files[1]);
  EXPECT_FALSE(cache.Load(KeyOf(1), values_.size()));
  EXPECT_FALSE(cache.Load(KeyOf(2), values_.size()));
}

TEST_F(LightCacheTest, TheEntriesUsedLongestAgoMakeRoom) {
  const size_t bytes = 48 + 4 * values_.size();
  LightCache cache(folder_, 3 * bytes, logger_);
  for (int k = 0; k < 3; ++k) cache.Keep(KeyOf(k), values_);
  const auto now = fs::file_time_type::clock::now();
  for (const fs::path& file : Files()) fs::last_write_time(file, now - std::chrono::hours(2));
  Write(folder_ / "dead.light.1.2.part", "abandoned");
  fs::last_write_time(folder_ / "dead.light.1.2.part", now - std::chrono::hours(2));
  EXPECT_TRUE(cache.Load(KeyOf(1), values_.size())) << "used now";
  cache.Keep(KeyOf(3), values_);
  cache.Keep(KeyOf(4), values_);
  EXPECT_EQ(Files().size(), 3U);
  EXPECT_TRUE(cache.Load(KeyOf(1), values_.size()));
  EXPECT_TRUE(cache.Load(KeyOf(3), values_.size()));
  EXPECT_TRUE(cache.Load(KeyOf(4), values_.size()));
  EXPECT_FALSE(cache.Load(KeyOf(0), values_.size()));
}

TEST_F(LightCacheTest, NoPlaceToWriteIsOneWarning) {
  Write(folder_ / "file", "in the way");
  LightCache cache(folder_ / "file", 1 << 20, logger_);
  cache.Keep(KeyOf(1), values_);
  cache.Keep(KeyOf(2), values_);
  EXPECT_FALSE(cache.Load(KeyOf(1), values_.size()));
  const std::string said = Logged();
  EXPECT_THAT(said, HasSubstr("warning: simulated rig: computed light is not kept"));
  EXPECT_EQ(said.find("warning"), said.rfind("warning")) << said;
}

TEST_F(LightCacheTest, AFullDiskIsAWarningAndLeavesNothing) {
  // A limit on the size of files stands for the disk that is full.
  auto keep = [&] {
    const rlimit limit = {60, 60};
    signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &limit);
    Logger quiet(LogLevel::kError);
    LightCache(folder_, 1 << 20, quiet).Keep(KeyOf(1), values_);
    _exit(fs::is_empty(folder_) ? 0 : 1);
  };
  EXPECT_EXIT(keep(), ::testing::ExitedWithCode(0), "");
}

TEST_F(LightCacheTest, ManyMayKeepAndLoadTheSameAtOnce) {
  const std::vector<float> many(50000, 4.0F);
  std::vector<std::thread> threads;
  std::atomic<int> wrong = 0;
  for (int t = 0; t < 4; ++t)
    threads.emplace_back([&] {
      Logger logger(LogLevel::kError);
      LightCache cache(folder_, 3 * (48 + 4 * many.size()), logger);  // as another process would have its own
      for (int k = 0; k < 50; ++k) {
        cache.Keep(KeyOf(k % 5), many);
        const auto found = cache.Load(KeyOf(k % 5), many.size());
        wrong += found && *found != many;
      }
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(wrong, 0);
}

TEST(LightCacheFolder, IsTheUsersAndMayBeTurnedOff) {
  auto folder = [] { return LightCache::FolderOfUser().string(); };
  setenv("STRATALUX_CACHE", "/a/b", 1);
  EXPECT_EQ(folder(), "/a/b");
  setenv("STRATALUX_CACHE", "", 1);
  EXPECT_EQ(folder(), "");
  unsetenv("STRATALUX_CACHE");
  setenv("XDG_CACHE_HOME", "/x", 1);
  EXPECT_EQ(folder(), "/x/stratalux");
  setenv("XDG_CACHE_HOME", "relative", 1);
  setenv("HOME", "/h", 1);
  EXPECT_EQ(folder(), "/h/.cache/stratalux");
}

// Through the rig: computed, kept and loaded light are the same bits, and whatever the light depends on is another
// entry.
TEST_F(LightCacheTest, KeptAndComputedLightAreTheSameBits) {
  SimulatedRigOptions options;
  options.camera_width = 88;
  options.camera_height = 66;
  options.projector_width = 128;
  options.projector_height = 96;
  auto shoot = [&](const SimulatedRigOptions& o) {
    const auto rig = *SimulatedRig::Create(o, logger_);
    EXPECT_TRUE(rig->camera().Start().ok());
    rig->switches()[1]->Set(true);
    std::vector<uint16_t> pixels;
    for (const Pattern& pattern : {Pattern{.kind = PatternKind::kComb, .period = 32, .width = 2, .shift = 4},
                                   Pattern{.kind = PatternKind::kGray, .axis = PatternAxis::kRows, .bit = 1, .bits = 5},
                                   Pattern{.kind = PatternKind::kSpots, .period = 16, .width = 3}}) {
      EXPECT_TRUE(rig->projectors()[1]->Load({pattern}).ok());
      EXPECT_TRUE(rig->lines().TriggerProjector(1).ok());
      EXPECT_TRUE((*rig->lines().WaitSync(std::chrono::milliseconds(50))).has_value());
      EXPECT_TRUE(rig->lines().TriggerCamera().ok());
      const auto frame = rig->camera().Wait(std::chrono::seconds(1));
      EXPECT_TRUE(frame.ok() && frame->has_value());
      pixels.insert(pixels.end(), (*frame)->pixels.pixels().begin(), (*frame)->pixels.pixels().end());
    }
    return pixels;
  };
  const auto computed = shoot(options);
  options.cache_folder = folder_;
  EXPECT_EQ(shoot(options), computed);
  EXPECT_EQ(Files().size(), 3U) << "columns, rows and the spots";
  for (const fs::path& file : Files())
    fs::last_write_time(file, fs::file_time_type::clock::now() - std::chrono::hours(1));
  EXPECT_EQ(shoot(options), computed);
  EXPECT_EQ(Files().size(), 3U);
  for (const fs::path& file : Files())
    EXPECT_GT(fs::last_write_time(file), fs::file_time_type::clock::now() - std::chrono::minutes(10)) << "was loaded";
  size_t files = 3;
  auto expect_others = [&](const char* what, const SimulatedRigOptions& o) {
    shoot(o);
    EXPECT_EQ(Files().size(), files += 3) << what;
  };
  SimulatedRigOptions other = options;
  other.seed = 2;
  expect_others("seed", other);
  other = options;
  other.devices.camera.distortion[0] = -0.05;
  expect_others("camera", other);
  other = options;
  other.devices.projector.turned_deg[1] = 0.1;
  expect_others("projector", other);
  other = options;
  other.devices.camera.cfa = Cfa::kMono;
  expect_others("colours", other);
}

TEST_F(LightCacheTest, AnotherSubcutisIsAnotherEntryAndTheUsualOneIsAsBefore) {
  const FlatWorld world({.camera_width = 128, .projector_px = 64});
  const SkinTable knows = world.table().With(*SubcutisTable::Load(SubcutisTable::DefaultPath()));
  LightCache cache(folder_, 1 << 20, logger_);
  // Of one pixel: what lies around it, and so where its light entered, stays the same.
  const auto entries = [&](const SkinTable& table, float absorption, double skin_mm) {
    const SkinAlbedo albedo(table);
    std::vector<SubjectPixel> pixels = {world.Pixel()};
    pixels[0].material.skin.subcutis_absorption = absorption;
    pixels[0].material.skin.skin_mm = skin_mm;
    LightTransportOptions options;
    options.cache = &cache;
    const LightTransport transport(world.scene(), table, albedo, world.rig(), 0, pixels, options);
    return Files().size();
  };
  EXPECT_EQ(entries(world.table(), 1.0F, kSkinMm), 2U) << "columns and rows";
  EXPECT_EQ(entries(knows, 1.0F, kSkinMm), 2U) << "that it knows others is nothing to the usual one";
  EXPECT_EQ(entries(knows, 2.0F, kSkinMm), 4U);
  EXPECT_EQ(entries(knows, 1.0F, 1.5), 6U);
  EXPECT_EQ(entries(knows, 2.0F, 1.5), 8U);
  EXPECT_EQ(entries(knows, 2.0F, 1.5), 8U);
  Logger quiet(LogLevel::kError);
  const SkinTable otherwise = world.table().With(*GenerateSubcutisTable({1000, 1, 0}, {0.5, 1.0}, quiet));
  EXPECT_EQ(entries(otherwise, 2.0F, 1.5), 10U) << "and so is another table of it";
}

}  // namespace
}  // namespace stratalux::rig
