// SPDX-License-Identifier: Apache-2.0
// What the regions of a face do to the shape of the light that comes back, by photons: neither the skin table nor the
// rig is used. With STRATALUX_REGION_TABLE=FILE it writes the table that docs/simulated-rig.md quotes.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <span>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "firmware-host/simulated/scene/face_skin.h"
#include "firmware-host/simulated/scene/scene.h"
#include "shared/transport/layered_monte_carlo.h"

namespace stratalux::rig {
namespace {

// Light that falls on one point at right angles and leaves anywhere, in any direction.
struct Spread {
  double reflectance = 0.0;
  double half_light_mm = 0.0;       // the radius within which half of it leaves
  double effective_width_mm = 0.0;  // (integral of L)^2 / integral of L^2 of the line spread L, in bins of 0.1 mm
};

Spread Measure(const Tissue& tissue, int64_t photons, uint64_t seed) {
  constexpr double kBinMm = 0.1, kHalfMm = 15.0;
  MonteCarloOptions run;
  run.photons = photons;
  run.seed = seed;
  run.max_path_mm = 300.0;
  run.max_radius_mm = 60.0;
  std::vector<std::vector<EscapedPhoton>> chunks(static_cast<size_t>(MonteCarloChunks(run)));
  TraceLayeredTissue(tissue, run, [&](int64_t chunk, std::span<const EscapedPhoton> list) {
    chunks[chunk].insert(chunks[chunk].end(), list.begin(), list.end());
  });
  std::vector<std::pair<double, double>> by_radius;
  std::vector<double> line(static_cast<size_t>(2 * kHalfMm / kBinMm));
  double all = 0.0;
  for (const auto& chunk : chunks)
    for (const EscapedPhoton& e : chunk) {
      all += e.weight;
      by_radius.emplace_back(std::hypot(e.x_mm, e.y_mm), e.weight);
      // Every direction of the line is as good: two of them.
      for (const float u : {e.x_mm, e.y_mm})
        if (std::abs(u) < kHalfMm) line[static_cast<size_t>((u + kHalfMm) / kBinMm)] += 0.5 * e.weight;
    }
  std::sort(by_radius.begin(), by_radius.end());
  Spread spread{all / static_cast<double>(photons), 0.0, 0.0};
  double sum = 0.0;
  for (const auto& [radius, weight] : by_radius) {
    sum += weight;
    if (sum < 0.5 * all) continue;
    spread.half_light_mm = radius;
    break;
  }
  double squares = 0.0;
  for (const double l : line) squares += l * l;
  spread.effective_width_mm = kBinMm * all * all / squares;
  return spread;
}

constexpr double kScattering = 0.75;  // of living skin, where every region lies within the table's axis

struct Place {
  const char* name;
  SurfaceClass surface;
  SkinParameters skin;
};

// The skin in the middle of each region of a face without patches, freckles, vessels and redness.
std::vector<Place> Places(double regions, double scattering) {
  SceneDescription scene;
  scene.head = HeadDescription::Bald();
  scene.head.variation = 0.0;
  scene.skin.melanin = 0.03;
  scene.skin.blood = 0.004;
  scene.skin.epidermis_mm = kEpidermisMm;
  scene.skin.scattering = scattering;
  scene.skin.patches = scene.skin.redness = 0.0;
  scene.skin.freckles = scene.skin.vessels = 0;
  scene.skin.scar = true;
  scene.skin.regions = regions;
  const Scene face = *Scene::Create(scene, 1);
  std::vector<Place> places;
  for (const auto& [name, x, y] : {std::tuple{"cheek", -43.0, 20.0},
                                   {"forehead", 0.0, -65.0},
                                   {"nose", 0.0, 17.0},
                                   {"eyelid", 31.0, -12.0},
                                   {"lips", 0.0, 52.0},
                                   {"chin", 0.0, 79.0},
                                   {"scar", 31.0, 19.0}}) {
    const Material here = face.MaterialAt({x, y, 700.0});
    places.push_back({name, here.part, here.skin});
  }
  return places;
}

TEST(RegionShape, PlacesAreInTheirRegions) {
  const SurfaceClass surfaces[] = {SurfaceClass::kCheek,   SurfaceClass::kForehead, SurfaceClass::kNose,
                                   SurfaceClass::kEyelids, SurfaceClass::kLips,     SurfaceClass::kChin,
                                   SurfaceClass::kScar};
  const auto places = Places(1.0, kScattering);
  for (size_t i = 0; i < places.size(); ++i) EXPECT_EQ(places[i].surface, surfaces[i]) << places[i].name;
}

TEST(RegionShape, WithoutRegionsItIsTheSameAllOverEvenSkin) {
  // Nothing is left to differ but the scar's melanin and blood.
  for (const Place& place : Places(0.0, kScattering)) {
    EXPECT_FLOAT_EQ(place.skin.epidermis_mm, static_cast<float>(kEpidermisMm)) << place.name;
    EXPECT_FLOAT_EQ(place.skin.scattering, static_cast<float>(kScattering)) << place.name;
    if (place.surface == SurfaceClass::kScar) continue;
    EXPECT_FLOAT_EQ(place.skin.melanin, 0.03F) << place.name;
    EXPECT_FLOAT_EQ(place.skin.blood, 0.004F) << place.name;
  }
}

// R alone by few photons; the half-light radius over the cheek's is that of the page, within three standard errors
// (0.03 each). A region that the page says to be wider or narrower by more than that is.
TEST(RegionShape, RedLightSpreadsAsThePageSays) {
  const std::map<std::string, double> page = {{"cheek", 1.0}, {"forehead", 0.98}, {"nose", 1.14}, {"eyelid", 1.20},
                                              {"lips", 1.29}, {"chin", 0.98},     {"scar", 1.53}};
  constexpr int64_t kPhotons = 20000;
  const auto places = Places(1.0, kScattering);
  const Spread cheek = Measure(AbsorbingSkin(0, places[0].skin), kPhotons, 3);
  for (size_t i = 1; i < places.size(); ++i) {
    const Spread here = Measure(AbsorbingSkin(0, places[i].skin), kPhotons, 4 + i);
    EXPECT_NEAR(here.half_light_mm / cheek.half_light_mm, page.at(places[i].name), 0.09) << places[i].name;
    EXPECT_NEAR(here.effective_width_mm / cheek.effective_width_mm, page.at(places[i].name), 0.12) << places[i].name;
  }
}

TEST(RegionShape, AThinDermisAloneHardlyWidensIt) {
  // What the page says of eyelids; three standard errors of 0.03.
  const SkinParameters skin = Places(1.0, kScattering)[0].skin;
  const Tissue deep = AbsorbingSkin(0, skin);
  Tissue thin = deep;
  thin.layers[1].thickness_mm = 0.63 * kSkinMm - skin.epidermis_mm;
  EXPECT_NEAR(Measure(thin, 20000, 11).half_light_mm / Measure(deep, 20000, 12).half_light_mm, 0.98, 0.09);
}

TEST(RegionShape, TableOfThePage) {
  const char* file = std::getenv("STRATALUX_REGION_TABLE");
  if (!file) GTEST_SKIP() << "STRATALUX_REGION_TABLE=FILE writes the page's table";
  constexpr int64_t kPhotons = 200000;
  std::string rows =
      "| region | reflectance R, G, B | half-light radius R, G, B (mm) | over the cheek's | effective width R, G, B "
      "(mm) "
      "| over the cheek's |\n|---|---|---|---|---|---|\n";
  std::array<Spread, kSkinChannels> cheek;
  for (const Place& place : Places(1.0, kScattering)) {
    std::array<Spread, kSkinChannels> s;
    for (int c = 0; c < kSkinChannels; ++c)
      s[c] = Measure(AbsorbingSkin(c, place.skin), kPhotons, 7 + static_cast<uint64_t>(c));
    if (place.surface == SurfaceClass::kCheek) cheek = s;
    auto three = [&](const char* digits, const auto& value) {
      std::string text;
      for (size_t c = 0; c < kSkinChannels; ++c) {
        char number[32];
        std::snprintf(number, sizeof number, digits, value(c));
        text += (c ? ", " : "") + std::string(number);
      }
      return text;
    };
    rows += std::string("| ") + place.name + " | " + three("%.3f", [&](size_t c) { return s[c].reflectance; }) + " | " +
            three("%.2f", [&](size_t c) { return s[c].half_light_mm; }) + " | " +
            three("%.2f", [&](size_t c) { return s[c].half_light_mm / cheek[c].half_light_mm; }) + " | " +
            three("%.2f", [&](size_t c) { return s[c].effective_width_mm; }) + " | " +
            three("%.2f", [&](size_t c) { return s[c].effective_width_mm / cheek[c].effective_width_mm; }) + " |\n";
  }
  std::ofstream(file) << rows;
}

}  // namespace
}  // namespace stratalux::rig
