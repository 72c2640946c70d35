// SPDX-License-Identifier: Apache-2.0
// Another subcutis: the shipped correction against photons in that very tissue, and against what physics demands.
#include "firmware-host/simulated/skin/subcutis_table.h"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <mutex>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/skin_albedo.h"
#include "firmware-host/simulated/skin/subcutis_table_check.h"
#include "shared/units/angle.h"
#include "tests/firmware-host/simulated/skin/shipped_table.h"
#include "tests/support/run_program.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using Kinds = SubcutisGrid;

const SubcutisTable& ShippedSubcutis() {
  static const SubcutisTable table = *SubcutisTable::Load(SubcutisTable::DefaultPath());
  return table;
}
const SkinTable& ShippedWithSubcutis() {
  static const SkinTable table = ShippedTable().With(ShippedSubcutis());
  return table;
}

SkinParameters SkinOver(double absorption, double skin_mm, SkinParameters skin = {0.012F, 0.003F, 0.08F, 0.74F}) {
  skin.subcutis_absorption = static_cast<float>(absorption);
  skin.skin_mm = skin_mm;
  return skin;
}

TEST(SubcutisTable, TheUsualSubcutisIsTheSkinTablesToTheBit) {
  SkinKernel alone, with;
  const SkinAlbedo albedo_alone(ShippedTable()), albedo_with(ShippedWithSubcutis());
  for (int c = 0; c < kSkinChannels; ++c)
    for (const SkinParameters& skin : {SkinParameters{}, SkinParameters{0.2F, 0.03F, 0.06F, 0.55F}}) {
      ASSERT_TRUE(skin.UsualSubcutis());
      for (const float theta : {0.0F, 0.4F, 1.2F}) {
        ShippedTable().Interpolate(c, skin, {theta, 0.7F, 1.0F}, alone);
        ShippedWithSubcutis().Interpolate(c, skin, {theta, 0.7F, 1.0F}, with);
        for (const float x : {0.01F, 0.2F, 1.5F, 7.0F}) ASSERT_EQ(alone(x, 0.5F * x), with(x, 0.5F * x));
      }
      EXPECT_EQ(albedo_alone(c, skin), albedo_with(c, skin));
      for (const float weight : Kinds::KindsAround(skin)) EXPECT_EQ(weight, 0.0F);
      for (const float ratio : ShippedSubcutis().LogRatio(c, skin, {})) EXPECT_EQ(ratio, 0.0F);
    }
  // Nor do photons in the tissue itself notice that it could be another.
  const Tissue usual = AbsorbingSkin(1, {}), clear = ClearSkin(1, {}, 1.0);
  EXPECT_EQ(usual.layers[0].thickness_mm + usual.layers[1].thickness_mm, kSkinMm);
  EXPECT_EQ(clear.layers[0].thickness_mm, kSkinMm);
}

TEST(SubcutisKinds, WeighNodesAloneAndAreClampedOutside) {
  for (int kind = 0; kind < Kinds::kKinds; ++kind) {
    const auto weights = Kinds::KindsAround(Kinds::WithKind(kind, {}));
    for (int k = 0; k < Kinds::kKinds; ++k) EXPECT_NEAR(weights[k], k == kind ? 1.0F : 0.0F, 1e-6F) << kind;
  }
  EXPECT_EQ(Kinds::KindsAround(SkinOver(9.0, 0.2)), Kinds::KindsAround(SkinOver(4.0, 0.98)));
  EXPECT_EQ(Kinds::KindsAround(SkinOver(0.0, 5.0)), Kinds::KindsAround(SkinOver(1.0, 1.98)));
  // A parabola over the depth: between its nodes it is that, not a straight line.
  const auto between = Kinds::KindsAround(SkinOver(1.0, 1.23));
  EXPECT_NEAR(between[1], 0.75F, 1e-6F);   // 1.48 mm
  EXPECT_NEAR(between[3], 0.375F, 1e-6F);  // 0.98 mm
}

// Light of one incidence that leaves beyond `from_mm`, to 30 mm: a share of what came.
double SharesOfTable(const SkinTable& table, int channel, const SkinParameters& skin, double theta_rad,
                     double from_mm) {
  constexpr int kSteps = 12, kAzimuths = 8;
  const auto weights = SkinKernel::WeightsOf([&](double r) { return r >= from_mm ? 1.0 : 0.0; });
  const double last = std::pow(std::sin(RadFromDeg(85.0)), 2);
  SkinKernel kernel;
  double sum = 0.0;
  for (int step = 0; step < kSteps; ++step)
    for (int az = 0; az < kAzimuths; ++az) {
      const double theta_out = std::asin(std::sqrt((step + 0.5) / kSteps * last));
      table.Interpolate(channel, skin,
                        {static_cast<float>(theta_rad), static_cast<float>(theta_out),
                         static_cast<float>((az + 0.5) * M_PI / kAzimuths)},
                        kernel);
      sum += kernel.Integral(weights) * M_PI * last / (kSteps * kAzimuths);
    }
  return sum;
}

TEST(SubcutisTable, CorrectedLightIsThatOfPhotonsInThatVeryTissue) {
  // Whole kernels against photons that are absorbed on their way, with no path lengths, nodes or ratios: at the corners
  // and half-way between all of them, near and far.
  constexpr int64_t kPhotons = 40000;
  const double theta = RadFromDeg(42.0);
  const struct {
    int channel;
    double absorption, skin_mm, least_change;
  } cases[] = {{0, 4.0, 1.98, 0.03}, {0, 1.0, 0.98, 0.0},  {0, 4.0, 0.98, 0.12},
               {0, 2.0, 1.23, 0.04}, {1, 4.0, 0.98, 0.01}, {2, 2.0, 0.98, 0.0}};
  for (const auto& at : cases) {
    const SkinParameters skin = SkinOver(at.absorption, at.skin_mm);
    MonteCarloOptions run;
    run.photons = kPhotons;
    run.seed = 4711;
    run.sin2_theta_low = run.sin2_theta_high = std::pow(std::sin(theta), 2);
    run.max_path_mm = 200.0;
    std::array<double, 2> sum{}, squares{};
    std::mutex mutex;
    TraceLayeredTissue(AbsorbingSkin(at.channel, skin), run, [&](int64_t, std::span<const EscapedPhoton> list) {
      const std::lock_guard lock(mutex);
      for (const EscapedPhoton& e : list) {
        const double r = std::hypot(e.x_mm, e.y_mm);
        if (1.0 - double(e.uz) * e.uz >= std::pow(std::sin(RadFromDeg(85.0)), 2) || r >= 30.0) continue;
        for (size_t k = 0; k < (r >= 3.0 ? 2 : 1); ++k) {
          sum[k] += e.weight / kPhotons;
          squares[k] += std::pow(e.weight / kPhotons, 2);
        }
      }
    });
    const std::string what = "channel " + std::to_string(at.channel) + ", absorption " + std::to_string(at.absorption) +
                             ", skin of " + std::to_string(at.skin_mm) + " mm";
    // What the tables may be off: the skin table's cells 1 % of all and 2 % of far light, the correction half of that.
    const double all = SharesOfTable(ShippedWithSubcutis(), at.channel, skin, theta, 0.0);
    EXPECT_NEAR(all, sum[0], 3.5 * std::sqrt(squares[0]) + 0.015 * sum[0]) << what;
    const double far = SharesOfTable(ShippedWithSubcutis(), at.channel, skin, theta, 3.0);
    EXPECT_NEAR(far, sum[1], 3.5 * std::sqrt(squares[1]) + 0.03 * sum[1]) << what;
    const double usual = SharesOfTable(ShippedTable(), at.channel, SkinOver(1.0, kSkinMm), theta, 0.0);
    EXPECT_GE(std::abs(all / usual - 1.0), at.least_change) << what << ": else nothing was corrected";
  }
}

TEST(SubcutisTable, ItsRatiosAreThoseOfFreshPhotons) {
  for (const SubcutisPlaces places : {SubcutisPlaces::kNodes, SubcutisPlaces::kBetween}) {
    const auto samples =
        CheckSubcutis(ShippedSubcutis(),
                      {.photons = 12000, .seed = 31, .theta_in_deg = {50.0}, .channels = {0, 2}, .places = places});
    // Skins, kinds, channels.
    ASSERT_EQ(samples.size(), places == SubcutisPlaces::kNodes ? size_t{72 * 5 * 2} : size_t{30 * 5 * 2});
    for (const int channel : {0, 2}) {
      const InterpolationSummary all = Summarise(samples, channel, -1, 1.0);
      ASSERT_GT(all.samples, 100);
      EXPECT_LT(std::abs(all.largest), 0.04) << channel;
      // These few photons are off together in all skins, most where they are fewest: 3 to 10 mm.
      for (const auto& [ring, most] : {std::pair{0, 0.02}, {1, 0.02}, {2, 0.02}, {3, 0.02}, {4, 0.03}})
        EXPECT_LT(Summarise(samples, channel, ring, 1.0).rms, most) << channel << ", ring " << ring;
    }
  }
}

TEST(SubcutisCheck, SeesATableThatIsOfTooFewPhotons) {
  Logger quiet(LogLevel::kError);
  const auto poor = GenerateSubcutisTable({1000, 5, 0}, {0.5, 0.74}, quiet);
  ASSERT_TRUE(poor.ok());
  const auto samples = CheckSubcutis(*poor, {.photons = 12000, .seed = 31, .theta_in_deg = {50.0}, .channels = {0}});
  double worst = 0.0;
  for (int ring = 0; ring + 1 < static_cast<int>(kCheckRingsMm.size()); ++ring)
    worst = std::max(worst, Summarise(samples, 0, ring, 1.0).rms);
  EXPECT_GT(worst, 0.02);
}

TEST(SubcutisTable, StaysExactlyReciprocal) {
  for (int c = 0; c < kSkinChannels; ++c)
    for (const float in : {0.0F, 0.3F, 1.1F})
      for (const float out : {0.2F, 0.9F, 1.4F})
        EXPECT_EQ(ShippedSubcutis().LogRatio(c, SkinOver(3.0, 1.2), {in, out, 0.7F}),
                  ShippedSubcutis().LogRatio(c, SkinOver(3.0, 1.2), {out, in, 2.9F}));
  // And so does the kernel: from here to there as from there to here, turned into the other lamp's frame.
  constexpr auto kAzimuth = static_cast<float>(M_PI / 2);
  const auto at = [](const SkinKernel& kernel, double r, double psi) {
    return kernel(static_cast<float>(r * std::cos(psi)), static_cast<float>(r * std::sin(psi)));
  };
  SkinKernel there, back;
  ShippedWithSubcutis().Interpolate(0, SkinOver(4.0, 0.98), {0.1F, 0.9F, kAzimuth}, there);
  ShippedWithSubcutis().Interpolate(0, SkinOver(4.0, 0.98), {0.9F, 0.1F, kAzimuth}, back);
  for (const double r : {0.05, 0.5, 3.0})
    for (int k = 0; k < 16; ++k) {
      const double psi = 2.0 * M_PI * (k + 0.5) / 16.0;
      EXPECT_NEAR(at(back, r, kAzimuth - M_PI - psi) / at(there, r, psi), 1.0, 0.01) << r << " mm, direction " << k;
    }
  // It is the skin table's times the ratio, ring by ring, but for what runs across a ring's borders.
  const SkinDirections directions{0.6F, 0.2F, 1.0F};
  const SkinParameters skin = SkinOver(4.0, 0.98);
  SkinKernel usual, other;
  ShippedTable().Interpolate(0, SkinOver(1.0, kSkinMm), directions, usual);
  ShippedWithSubcutis().Interpolate(0, skin, directions, other);
  const auto rings = ShippedSubcutis().LogRatio(0, skin, directions);
  for (int r = 12; r <= 20; ++r) {  // 0.6 to 7.5 mm
    const double low = SkinGrid::RadiusEdgeMm(r), high = SkinGrid::RadiusEdgeMm(r + 1);
    const auto weights = SkinKernel::WeightsOf([&](double mm) { return mm >= low && mm < high ? 1.0 : 0.0; });
    EXPECT_NEAR(std::log(other.Integral(weights) / usual.Integral(weights)), rings[r], 0.02) << r;
  }
}

TEST(SubcutisTable, MoreAbsorptionTakesLightFromEveryRingAndMoreOfItFurtherOut) {
  constexpr float kSmoothed = 0.002F;  // near the entry, where next to no light comes from below
  for (int c = 0; c < kSkinChannels; ++c)
    for (const double skin_mm : {1.98, 0.98})
      for (const float blood : {0.001F, 0.02F}) {
        const SkinParameters skin{0.02F, blood, 0.07F, 0.65F};
        auto before = ShippedSubcutis().LogRatio(c, SkinOver(1.0, skin_mm, skin), {});
        for (const double absorption : {1.5, 2.5, 4.0}) {
          const auto rings = ShippedSubcutis().LogRatio(c, SkinOver(absorption, skin_mm, skin), {});
          for (int r = 0; r < SkinGrid::kRadii; ++r) {
            EXPECT_LT(rings[r], before[r] + kSmoothed) << c << ", " << absorption << ", ring " << r;
            // From 1.4 to 4.3 mm, where the subcutis counts and photons are many.
            if (r >= 15 && r <= 18) {
              EXPECT_LT(rings[r] - before[r], rings[r - 1] - before[r - 1]) << c << ", ring " << r;
            }
          }
          before = rings;
        }
      }
}

TEST(SubcutisTable, LightThatComesAndGoesSteeplyWentDeeper) {
  for (const double skin_mm : {1.98, 0.98}) {
    const auto steep = ShippedSubcutis().LogRatio(0, SkinOver(4.0, skin_mm), {0.0F, 0.0F}),
               oblique = ShippedSubcutis().LogRatio(0, SkinOver(4.0, skin_mm), {1.3F, 1.3F});
    for (int r = 16; r <= 20; ++r) EXPECT_LT(steep[r], 1.05F * oblique[r]) << r;  // 1.9 to 7.5 mm; both below 0
  }
}

TEST(SubcutisTable, AThinnerDermisReturnsLessNearbyAndLetsBloodyLightGoFurther) {
  // Subcutis scatters less: light of a millimetre or two is lost to it. But it has no blood: where the dermis has much,
  // what comes from afar went through less of it.
  const auto pale = ShippedSubcutis().LogRatio(0, SkinOver(1.0, 0.98, {0.01F, 0.0005F, 0.08F, 1.0F}), {});
  const auto bloody = ShippedSubcutis().LogRatio(0, SkinOver(1.0, 0.98, {0.01F, 0.06F, 0.08F, 1.0F}), {});
  for (int r = 12; r <= 15; ++r) EXPECT_LT(pale[r], -0.02) << r;  // 0.6 to 1.9 mm
  for (int r = 17; r <= 20; ++r) EXPECT_GT(bloody[r], 0.1) << r;  // 2.5 to 7.5 mm
  for (int r = 12; r <= 20; ++r) EXPECT_GT(bloody[r], pale[r]) << r;
  // Thin and thinner.
  const auto half = ShippedSubcutis().LogRatio(0, SkinOver(1.0, 1.48, {0.01F, 0.06F, 0.08F, 1.0F}), {});
  for (int r = 18; r <= 20; ++r) EXPECT_GT(bloody[r], half[r]) << r;
}

TEST(SubcutisTable, TheAlbedoOfMattSkinFollows) {
  const SkinAlbedo albedo(ShippedWithSubcutis());
  for (int c = 0; c < kSkinChannels; ++c)
    for (const auto& [absorption, skin_mm] : {std::pair{4.0, 1.98}, {1.0, 0.98}, {4.0, 0.98}, {2.0, 1.23}}) {
      const SkinParameters skin = SkinOver(absorption, skin_mm, {0.02F, 0.005F, 0.06F, 0.65F});
      // Between the nodes the albedo is a few per cent off that of the kernels; what the subcutis does to it is not.
      const SkinParameters usual = SkinOver(1.0, kSkinMm, skin);
      const double exact =
          ShippedWithSubcutis().Albedo(c, skin, RadFromDeg(30)) / ShippedTable().Albedo(c, usual, RadFromDeg(30));
      EXPECT_NEAR(albedo(c, skin) / albedo(c, usual), exact, 0.01) << c << ", " << absorption << ", " << skin_mm;
    }
  EXPECT_LT(albedo(0, SkinOver(4.0, 0.98)), 0.9F * albedo(0, SkinOver(1.0, kSkinMm)));
}

TEST(SubcutisTable, SaysWhatLiesOutsideItsNodes) {
  EXPECT_TRUE(ShippedSubcutis().Check(SkinOver(4.0, 0.98)).ok());
  const struct {
    SkinParameters skin;
    const char* complaint;
  } cases[] = {
      {SkinOver(5.0, 1.98), "subcutis_absorption = 5: the table of other subcutis knows 1 .. 4"},
      {SkinOver(2.0, 0.6), "skin_mm = 0.6: the table of other subcutis knows 0.98 .. 1.98"},
      {SkinOver(2.0, 1.2, {0.02F, 0.003F, 0.08F, 0.4F}), "scattering = 0.4: the table of other subcutis knows"}};
  for (const auto& c : cases) {
    const Status status = ShippedSubcutis().Check(c.skin);
    EXPECT_EQ(status.code(), StatusCode::kUsage);
    EXPECT_THAT(status.message(), HasSubstr(c.complaint));
  }
}

TEST(GenerateSubcutisTable, FollowsFromSeedAndPhotonsAlone) {
  Logger quiet(LogLevel::kError);
  // Three chunks of photons, on one thread and on several.
  const auto one = GenerateSubcutisTable({4500, 3, 1}, {0.6}, quiet),
             many = GenerateSubcutisTable({4500, 3, 5}, {0.6}, quiet),
             other = GenerateSubcutisTable({4500, 4, 5}, {0.6}, quiet);
  ASSERT_TRUE(one.ok() && many.ok() && other.ok());
  EXPECT_TRUE(std::ranges::equal(one->codes(), many->codes()));
  EXPECT_FALSE(std::ranges::equal(one->codes(), other->codes()));
  EXPECT_EQ(one->seed(), 3U);
  for (const SkinTableRun& run : {SkinTableRun{10, 1, 0}, SkinTableRun{20'000'000, 1, 0}})
    EXPECT_EQ(GenerateSubcutisTable(run, {0.6}, quiet).status().code(), StatusCode::kUsage);
  EXPECT_EQ(GenerateSubcutisTable({1000, 1, 0}, {0.6, 0.5}, quiet).status().code(), StatusCode::kUsage);
}

class SubcutisFile : public ScratchFolderTest {
 protected:
  static std::string Whole() { return ReadText(SubcutisTable::DefaultPath()); }
  Status LoadOf(const std::string& bytes) {
    std::ofstream(file_, std::ios::binary) << bytes;
    const auto table = SubcutisTable::Load(file_);
    EXPECT_FALSE(table.ok());
    EXPECT_THAT(table.status().message(), HasSubstr(file_));
    return table.status();
  }
  const std::string file_ = (folder_ / "subcutis.bin").string();
};

TEST_F(SubcutisFile, WhatIsMissingDamagedOrNewerIsToldApart) {
  const std::string whole = Whole();
  ASSERT_GT(whole.size(), 10000U);
  const Status missing = SubcutisTable::Load(file_ + ".none").status();
  EXPECT_EQ(missing.code(), StatusCode::kNotFound);
  EXPECT_THAT(missing.message(), HasSubstr("generate --subcutis")) << "says how to make one";
  for (const size_t size : {size_t{0}, size_t{7}, size_t{30}, whole.size() / 2, whole.size() - 1})
    EXPECT_EQ(LoadOf(whole.substr(0, size)).code(), StatusCode::kIntegrity) << size << " bytes";
  const auto changed = [&](size_t at, char to) {
    std::string bytes = whole;
    bytes[at] = to;
    return bytes;
  };
  EXPECT_EQ(LoadOf(changed(0, 'X')).code(), StatusCode::kIntegrity);
  for (const char version : {'0', '\0', '\xff'})
    EXPECT_EQ(LoadOf(changed(7, version)).code(), StatusCode::kIntegrity) << int{version};
  const Status newer = LoadOf(changed(7, '2'));
  EXPECT_EQ(newer.code(), StatusCode::kNewerSchema);
  EXPECT_THAT(newer.message(), HasSubstr("version 2, this program reads 1"));
  for (const size_t at : {size_t{50}, size_t{100}, whole.size() / 2, whole.size() - 1})
    EXPECT_EQ(LoadOf(changed(at, static_cast<char>(whole[at] ^ 1))).code(), StatusCode::kIntegrity) << "byte " << at;
  for (size_t field = 0; field < 5; ++field) {
    std::string bytes = whole;
    bytes.replace(8 + 8 * field, 8, 8, '\xff');
    EXPECT_EQ(LoadOf(bytes).code(), StatusCode::kIntegrity) << "header field " << field;
  }
  // A skin table is none.
  EXPECT_EQ(SubcutisTable::Load(SkinTable::DefaultPath()).status().code(), StatusCode::kIntegrity);
}

TEST_F(SubcutisFile, SavedAndLoadedIsTheSame) {
  ASSERT_TRUE(ShippedSubcutis().Save(file_).ok());
  const auto again = SubcutisTable::Load(file_);
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_TRUE(std::ranges::equal(again->codes(), ShippedSubcutis().codes()));
  EXPECT_EQ(again->manifest(), ShippedSubcutis().manifest());
  EXPECT_EQ(again->scatterings(), ShippedTable().scatterings()) << "those of the shipped skin table";
}

TEST_F(SubcutisFile, LiesBesideTheSkinTable) {
  setenv("STRATALUX_SKIN_TABLE", "/nowhere/mine.bin", 1);
  const std::string beside = SubcutisTable::DefaultPath();
  unsetenv("STRATALUX_SKIN_TABLE");
  EXPECT_EQ(beside, "/nowhere/subcutis_table.bin");
  EXPECT_LT(std::filesystem::file_size(SubcutisTable::DefaultPath()) +
                std::filesystem::file_size(SkinTable::DefaultPath()) +
                std::filesystem::file_size(SkinTable::DefaultWaxPath()),
            30'000'000U);
}

TEST_F(SubcutisFile, TheToolMakesAndChecksIt) {
  const auto tool = [](const std::string& arguments) { return Execute("stratalux-skin-table " + arguments); };
  EXPECT_EQ(tool("generate --subcutis --wax --out " + file_).code, 2);
  const std::string run = "generate --subcutis --scattering 0.5 0.74 --photons 2000 --seed 9 --out ";
  ASSERT_EQ(tool(run + file_ + " --threads 1").code, 0);
  ASSERT_EQ(tool(run + file_ + "2 --threads 3").code, 0);
  EXPECT_EQ(ReadText(file_), ReadText(file_ + "2"));
  const Outcome own = tool("check " + file_ + " --subcutis --photons 1000 --seed 9");
  EXPECT_EQ(own.code, 2);
  EXPECT_THAT(own.out, HasSubstr("use another"));
  const Outcome poor = tool("check " + file_ + " --subcutis --photons 4000 --seed 10");
  EXPECT_EQ(poor.code, 1) << poor.out;
  EXPECT_THAT(poor.out, HasSubstr("| both | half-way | B |"));
  EXPECT_EQ(tool("check " + SkinTable::DefaultPath() + " --subcutis").code, 6);
}

}  // namespace
}  // namespace stratalux::rig
