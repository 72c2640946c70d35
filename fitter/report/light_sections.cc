// SPDX-License-Identifier: Apache-2.0
#include "fitter/report/light_sections.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "fitter/export/pictures.h"
#include "fitter/report/page_text.h"

namespace stratalux::fit {
namespace {

constexpr int kMapWidth = 270;  // px, as pages show pictures

// Means of blocks, so that a page stays small; sites that are not numbers do not count.
Image<float> Shrunk(const Image<float>& map) {
  const int block = std::max(1, (map.width() + kMapWidth - 1) / kMapWidth);
  Image<float> out((map.width() + block - 1) / block, (map.height() + block - 1) / block);
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) {
      double sum = 0.0;
      int count = 0;
      for (int j = y * block; j < std::min((y + 1) * block, map.height()); ++j)
        for (int i = x * block; i < std::min((x + 1) * block, map.width()); ++i)
          if (std::isfinite(map(i, j))) {
            sum += map(i, j);
            ++count;
          }
      out(x, y) = count > 0 ? static_cast<float>(sum / count) : NAN;
    }
  return out;
}

ReportImage MapPicture(const std::string& what, const std::string& unit, const Image<float>& map, int digits,
                       const std::string& advice) {
  const Image<float> small = Shrunk(map);
  const double low = Percentile(small, 0.005), high = Percentile(small, 0.995);
  return {what + ", " + Fixed(low, digits) + " (dark) to " + Fixed(high, digits) + unit + " (light). " + advice,
          ToColourScale(small, low, high)};
}

// 1 + k[0] r^2 + k[1] r^4 over the picture of a device, r in half diagonals from the principal point.
Image<float> RadialMap(const Pinhole& m, const std::array<double, 2>& k) {
  const int width = std::min(kMapWidth, m.width), height = std::max(1, width * m.height / m.width);
  Image<float> map(width, height);
  const double half_diagonal = 0.5 * std::hypot(m.width, m.height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const double px = (x + 0.5) * m.width / width - 0.5 - m.cx, py = (y + 0.5) * m.height / height - 0.5 - m.cy;
      const double r2 = (px * px + py * py) / (half_diagonal * half_diagonal);
      map(x, y) = static_cast<float>(1.0 + r2 * (k[0] + r2 * k[1]));
    }
  return map;
}

// A response table as a curve over 0 .. 1.
ReportSeries CurveOf(const std::string& name, const std::vector<double>& response) {
  ReportSeries curve{name, {}, {}};
  for (size_t k = 0; k < response.size(); ++k) {
    curve.x.push_back(static_cast<double>(k) / static_cast<double>(response.size() - 1));
    curve.y.push_back(response[k]);
  }
  return curve;
}

ReportSeries Turned(const ReportSeries& curve) { return {curve.name, curve.y, curve.x}; }

// How far a curve lies above the straight line, per cent of full scale.
ReportSeries AboveStraight(const ReportSeries& curve) {
  ReportSeries off = curve;
  for (size_t i = 0; i < off.x.size(); ++i) off.y[i] = 100.0 * (curve.y[i] - curve.x[i]);
  return off;
}

ReportSeries Straight() { return {"straight", {0.0, 1.0}, {0.0, 1.0}}; }

ReportPlot TransferPlot(const PhotonTransfer& transfer) {
  ReportSeries points{"measured", {}, {}, true}, line{"fitted", {}, {}};
  for (const TransferPoint& p : transfer.points) {
    points.x.push_back(p.signal_dn);
    points.y.push_back(p.variance_dn2);
    line.x.push_back(p.signal_dn);
    line.y.push_back(transfer.read_noise_dn * transfer.read_noise_dn + p.signal_dn / transfer.gain_e_per_dn);
  }
  return {
      "Photon transfer: " + PlusMinus(transfer.gain_e_per_dn, transfer.gain_sd, 3) +
          " electrons per DN. Good: dots on the line to the end. Dots that fall below it at bright light: the camera "
          "saturates or bends; above it at all levels: the lamp flickers between the two frames of a pair.",
      "signal above black, DN",
      "variance, DN²",
      {points, line}};
}

ReportSection Camera(const LightReport& light, const RigCalibration& record) {
  ReportSection section{"Light: the camera", "", {}, {}, {}};
  ReportTable table{"", {"", "", "good"}, {}};
  if (const auto& dark = light.dark) {
    table.rows.push_back({"black level", Fixed(dark->black_level_dn, 2) + " DN", "above 20: negative noise is kept"});
    table.rows.push_back({"read noise", Fixed(dark->read_noise_dn, 3) + " DN", "as the data sheet says"});
    table.rows.push_back(
        {"offsets of the sites", "± " + Fixed(dark->offset_spread_dn, 3) + " DN", "below the read noise"});
    table.rows.push_back({"dark current", Fixed(dark->dark_current_dn_per_s, 3) + " DN/s", "hardly any in one frame"});
    table.rows.push_back({"hot pixels", std::to_string(dark->hot_pixels), "below one in a thousand"});
    section.images.push_back(MapPicture("Offset", " DN", dark->offset_dn, 2,
                                        "Good: even. A bright edge or corner: light leaks in; cover the lens better."));
    section.images.push_back(MapPicture("Read noise", " DN", dark->read_noise_dn_map, 2,
                                        "Good: even. Stripes: the power supply or the cable disturbs the camera."));
  }
  if (light.transfer) {
    table.rows.push_back({"gain", PlusMinus(light.transfer->gain_e_per_dn, light.transfer->gain_sd, 3) + " e-/DN",
                          "as the data sheet says"});
    section.plots.push_back(TransferPlot(*light.transfer));
  }
  if (const auto& response = light.camera_response) {
    table.rows.push_back(
        {"bend of the response, from a line between black and saturation",
         Fixed(100.0 * response->largest_deviation, 2) + " %",
         "any: it is undone; measured up to " + Fixed(100.0 * response->reached, 0) + " % of the range"});
    section.plots.push_back(
        {"Camera: linear light over the raw level, less a straight line of its slope at black. Good: smooth, some per "
         "cent at most. A step "
         "or "
         "a wave: exposure times are not what they are said to be.",
         "raw level, share of the range",
         "above straight, %",
         {AboveStraight(CurveOf("camera", response->response))}});
  }
  if (light.vignetting) {
    table.rows.push_back({"vignetting", "± " + Fixed(100.0 * light.vignetting_sd, 2) + " % at the corner",
                          "known to 1 %; if not, more flat poses"});
    section.images.push_back(MapPicture("Vignetting", "", RadialMap(record.camera.model, *light.vignetting), 3,
                                        "Good: falls smoothly towards the corners."));
  }
  if (light.camera_blur_px)
    table.rows.push_back({"blur", Fixed(*light.camera_blur_px, 3) + " px", "below 1 px; else focus the camera"});
  section.tables = {std::move(table)};
  return section;
}

std::string NameOf(const LightReport& light, size_t p) {
  const std::string& name = light.projectors[p].name;
  return name.empty() ? "projector " + std::to_string(p) : name;
}

// One curve a projector; nothing for those without.
std::vector<ReportSeries> ResponsesOf(const LightReport& light) {
  std::vector<ReportSeries> curves;
  for (size_t p = 0; p < light.projectors.size(); ++p)
    if (light.projectors[p].response.size() > 1)
      curves.push_back(CurveOf(NameOf(light, p), light.projectors[p].response));
  return curves;
}

void AddResponses(const LightReport& light, ReportSection& section) {
  const std::vector<ReportSeries> curves = ResponsesOf(light);
  if (curves.empty()) return;
  ReportPlot response{
      "Light over grey level. Good: rises everywhere, and the projectors agree. A curve that is flat at an "
      "end clips: check contrast and brightness settings; one unlike the others: reset its picture mode.",
      "grey level, share of white", "light, share of white", curves};
  ReportPlot inverse{"The inverse, by which grey levels are chosen for even steps of light.",
                     "light, share of white",
                     "grey level, share of white",
                     {}};
  for (const ReportSeries& curve : curves) inverse.series.push_back(Turned(curve));
  response.series.push_back(Straight());
  inverse.series.push_back(Straight());
  section.plots.push_back(std::move(response));
  section.plots.push_back(std::move(inverse));
}

void AddLines(const LightReport& light, ReportSection& section) {
  ReportPlot plot{
      "A projected line on the matt target, from its middle. Good: even on both sides, and no foot beside the "
      "line; a broad one: focus the projector at the working distance; a foot: a dirty lens.",
      "distance from the line's middle, columns",
      "light, share of white",
      {}};
  for (size_t p = 0; p < light.projectors.size(); ++p)
    if (const auto& line = light.projectors[p].line)
      plot.series.push_back({NameOf(light, p), line->offset_px, line->light, true});
  if (!plot.series.empty()) section.plots.push_back(std::move(plot));
}

std::string OrNone(const std::optional<double>& value, int digits) { return value ? Fixed(*value, digits) : "-"; }

ReportSection Projectors(const LightReport& light, const RigCalibration& record) {
  ReportSection section{"Light: the projectors", "", {}, {}, {}};
  ReportTable table{
      "Red and blue of white against green: projectors that differ by more than some per cent have different "
      "picture modes or lamps of different age. Lamp: largest change of white during the ramp; below 1 %, "
      "else let it warm up. Black: light of black over white; below 0.005.",
      {"", "white R, G, B", "black", "bend", "lamp", "blur, px", "line, columns", "line, mm", "half width, mm",
       "corner light"},
      {}};
  for (size_t p = 0; p < light.projectors.size(); ++p) {
    const ProjectorLightReport& l = light.projectors[p];
    const auto& w = l.white_dn_mm2_per_ms;
    const double r = l.falloff ? 1.0 + (*l.falloff)[0] + (*l.falloff)[1] : NAN;
    table.rows.push_back(
        {NameOf(light, p), w[1] > 0.0 ? Fixed(w[0] / w[1], 3) + ", 1, " + Fixed(w[2] / w[1], 3) : "-",
         OrNone(l.black_level, 5), l.response.empty() ? "-" : Fixed(100.0 * l.largest_deviation, 2) + " %",
         l.response.empty() ? "-" : Fixed(100.0 * l.lamp_drift, 2) + " %", OrNone(l.line_blur_px, 3),
         l.line ? Fixed(l.line->measured_px, 3) + " (" + std::to_string(l.line->width_px) + " planned)" : "-",
         l.line ? Fixed(l.line->mm, 3) : "-", l.line ? Fixed(l.line->fwhm_mm, 3) : "-",
         l.falloff ? PlusMinus(r, l.falloff_sd, 3) : "-"});
    if (l.falloff && p < record.projectors.size())
      section.images.push_back(MapPicture(NameOf(light, p) + ": light over its picture", "",
                                          RadialMap(record.projectors[p].model, *l.falloff), 3,
                                          "Good: falls smoothly to the corners, alike in all projectors."));
  }
  AddResponses(light, section);
  AddLines(light, section);
  section.tables = {std::move(table)};
  return section;
}

ReportTable Flats(const LightReport& light) {
  ReportTable table{
      "Poses of the matt target. Plane: how flat it was found; above 0.2 mm it is bent, or the geometry is "
      "off. Residual: what fall-off, vignetting and distance leave unexplained; above 1 %: the target shines, "
      "or stray light falls on it.",
      {"pose", "tilt", "distance, mm", "plane, mm", "used", "residual"},
      {}};
  for (const FlatPoseReport& flat : light.flats)
    table.rows.push_back({flat.session + (flat.pose >= 0 ? ", pose " + std::to_string(flat.pose) : ""),
                          Fixed(flat.tilt_deg, 1) + "°", Fixed(flat.distance_mm, 1), Fixed(flat.plane_rms_mm, 3),
                          Fixed(100.0 * flat.lit_share, 0) + " %", Fixed(100.0 * flat.residual, 2) + " %"});
  return table;
}

}  // namespace

std::vector<ReportSection> LightSections(const LightReport& light, const RigCalibration& record) {
  std::vector<ReportSection> sections;
  if (light.dark || light.transfer || light.camera_response || light.vignetting || light.camera_blur_px)
    sections.push_back(Camera(light, record));
  if (!light.projectors.empty()) sections.push_back(Projectors(light, record));
  ReportSection rest{"Light: target and what was not measured",
                     "The target's albedo is taken as " + Fixed(light.target_albedo, 3) +
                         "; every absolute reflectance follows from that number.",
                     {},
                     {},
                     {}};
  if (!light.flats.empty()) rest.tables.push_back(Flats(light));
  if (!light.carried_over.empty()) {
    ReportTable kept{light.earlier.empty() ? "Never measured" : "Kept from " + light.earlier, {"what, and why"}, {}};
    for (const std::string& what : light.carried_over) kept.rows.push_back({what});
    rest.tables.push_back(std::move(kept));
  }
  sections.push_back(std::move(rest));
  return sections;
}

}  // namespace stratalux::fit
