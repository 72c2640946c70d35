// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/layer_pictures.h"

#include <algorithm>
#include <cmath>

#include "fitter/export/pictures.h"
#include "fitter/report/page_text.h"

namespace stratalux::fit {
namespace {

template <typename Value>
Image<float> MapOf(int width, int height, const Value& value) {
  Image<float> out(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) out(x, y) = static_cast<float>(value(x, y));
  return out;
}

// A scalar map between its 2nd and 98th percentile, with a colour bar.
ReportImage Scaled(const std::string& caption, const Image<float>& map, int digits, const std::string& unit) {
  const double low = Percentile(map, 0.02), high = Percentile(map, 0.98);
  return {caption, ToColourScale(map, low, high), Fixed(low, digits) + unit, Fixed(high, digits) + unit};
}

double Share(const Image<float>& part, const LayerMaps& maps, int x, int y, int c) {
  return part(x, y, c) / std::max(maps.total_weight(x, y, c), 1e-6F);
}

// Shares of the three bands as blue, green and red: grey where the light comes evenly from all depths.
ReportImage Composite(const LayerMaps& maps) {
  const int width = maps.shallow.width(), height = maps.shallow.height();
  Image<uint8_t> picture(width, height, 3, 40);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      if (!std::isfinite(maps.shallow(x, y, 0))) continue;
      const std::array<const Image<float>*, 3> bands = {&maps.deep, &maps.middle, &maps.shallow};
      for (int k = 0; k < 3; ++k)
        picture(x, y, k) =
            static_cast<uint8_t>(std::lround(255.0 * std::clamp(Share(*bands[k], maps, x, y, 0), 0.0, 1.0)));
    }
  return {"Which depth prevails: blue shallow, green middle, red deep (grey: a third each, as in the mean).",
          std::move(picture), "", ""};
}

// log10 of red over green: blood takes green light.
Image<float> Redness(const Image<float>& weight) {
  return MapOf(weight.width(), weight.height(), [&](int x, int y) {
    const float red = weight(x, y, 0), green = weight(x, y, 1);
    return red > 0.0F && green > 0.0F ? std::log10(red / green) : std::nan("");
  });
}

void AddColourPictures(const LayerMaps& maps, ReportSection& section) {
  section.images.push_back(
      Scaled("Redness, log10 of red over green weight: blood absorbs green light, so flushed skin, lips and vessels "
             "are bright.",
             Redness(maps.total_weight), 2, ""));
  section.images.push_back(
      Scaled("Redness of the shallow light: capillaries near the surface, blemishes.", Redness(maps.shallow), 2, ""));
  section.images.push_back(
      Scaled("Redness of the deep light: blood further below, larger vessels.", Redness(maps.deep), 2, ""));
  section.images.push_back(Scaled(
      "Absorption 1 - sum w of green light: melanin and blood; moles, hair roots and brows are bright.",
      MapOf(maps.absorption.width(), maps.absorption.height(), [&](int x, int y) { return maps.absorption(x, y, 1); }),
      2, ""));
}

std::string WeakCaption(const ShownLayers& shown) {
  if (!(shown.session_photons > 0.0)) return "";
  return " Profiles of fewer than " + Fixed(shown.session_photons, 0) + " photons (a ratio of " +
         Fixed(std::sqrt(shown.session_photons), 0) +
         " where read noise does not count) are weak: their layers lean on " +
         (shown.neighbours ? "those of their neighbours." : "the mean of the session.");
}

ReportTable MapsTable(const MapsFigures& f) {
  ReportTable table{"Profiles of these layers, which are fitted " + f.provenance +
                        ", none left out, and why the others are not fitted",
                    {"fitted"},
                    {{std::to_string(f.fitted)}}};
  for (const auto& [reason, count] : f.masked_by_reason) {
    table.header.push_back(reason);
    table.rows[0].push_back(std::to_string(count));
  }
  return table;
}

}  // namespace

ShownLayers ShownOf(const FittedLayers& layers, int projectors) {
  return {SummariseLayers(layers.map),          layers.signal_to_noise,
          layers.map.SessionPhotons(),          layers.map.session_photons > 0.0,
          ProvenanceOf(layers.map, projectors), {}};
}

ReportSection LayerPictures(const ShownLayers& shown) {
  const LayerMaps& maps = shown.maps;
  const int width = maps.total_weight.width(), height = maps.total_weight.height();
  const std::string shallow = Fixed(maps.bands.shallow_mm, 2), deep = Fixed(maps.bands.deep_mm, 2);
  ReportSection section{
      "Layer maps: what lies at which depth",
      "Sums over the layers of each pixel, " + shown.provenance +
          ", red light unless said otherwise. Light from deeper has spread wider, so layers are divided by their "
          "width: shallow below sigma " +
          shallow + " mm, deep from " + deep +
          " mm on, a third of all light in each. Dark grey: not fitted, or unknown. The maps are in this fit's folder" +
          (shown.of_all ? std::string(", below ") + kMapsFolder + "/," : std::string()) + " as EXR files.",
      {},
      {},
      {}};
  auto red = [&](const Image<float>& image) {
    return MapOf(width, height, [&](int x, int y) { return image(x, y, 0); });
  };
  section.images.push_back(
      Scaled("Total weight, sum w: how much of the light that enters comes back.", red(maps.total_weight), 2, ""));
  if (maps.total_weight.channels() == 3) AddColourPictures(maps, section);
  for (const auto& [band, caption] :
       {std::pair(&maps.shallow,
                  "Share of shallow light: epidermis, fine relief; dark where pigment or blood near the surface "
                  "absorbs it."),
        {&maps.middle, "Share of light from the middle: upper dermis and its small vessels."},
        {&maps.deep, "Share of deep light: high where skin is clear; dark over moles, hair roots and large vessels."}})
    section.images.push_back(
        Scaled(caption, MapOf(width, height, [&, b = band](int x, int y) { return Share(*b, maps, x, y, 0); }), 2, ""));
  section.images.push_back(Composite(maps));
  section.images.push_back(
      Scaled("Effective width: how far light spreads sideways, large where it is scattered much and absorbed little.",
             red(maps.effective_width_mm), 2, " mm"));
  section.images.push_back(
      Scaled("Mean depth by the shift of the layers. A slow drift over the face is the geometry's error, shared by all "
             "layers of a place: compare neighbours.",
             red(maps.mean_depth_mm), 2, " mm"));
  const Image<float> ratio = MapOf(width, height, [&](int x, int y) {
    return std::isfinite(maps.total_weight(x, y, 0)) ? shown.signal_to_noise(x, y, 0) : std::nanf("");
  });
  section.images.push_back(
      Scaled("Quality: signal over noise of a pixel's samples." + WeakCaption(shown), ratio, 0, ""));
  if (shown.of_all) section.tables.push_back(MapsTable(*shown.of_all));
  return section;
}

}  // namespace stratalux::fit
