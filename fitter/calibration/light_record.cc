// SPDX-License-Identifier: Apache-2.0
#include "fitter/calibration/light_record.h"

#include <array>

#include <nlohmann/json.hpp>

#include "shared/base/formatted.h"

namespace stratalux::fit {
namespace {

using Json = nlohmann::ordered_json;

Json DarkJson(const DarkReport& d) {
  return {{"frames", d.frames},
          {"black_level_dn", d.black_level_dn},
          {"offset_spread_dn", d.offset_spread_dn},
          {"read_noise_dn", d.read_noise_dn},
          {"dark_current_dn_per_s", d.dark_current_dn_per_s},
          {"hot_pixels", d.hot_pixels}};
}

Json TransferJson(const PhotonTransfer& t) {
  Json signal = Json::array(), variance = Json::array();
  for (const TransferPoint& p : t.points) {
    signal.push_back(p.signal_dn);
    variance.push_back(p.variance_dn2);
  }
  return {{"gain_e_per_dn", t.gain_e_per_dn},
          {"gain_sd", t.gain_sd},
          {"read_noise_dn", t.read_noise_dn},
          {"signal_dn", signal},
          {"variance_dn2", variance}};
}

Json CameraResponseJson(const CameraResponseReport& r) {
  return {{"response", r.response},
          {"largest_deviation", r.largest_deviation},
          {"residual", r.residual},
          {"reached", r.reached},
          {"exposures_ms", r.exposures_ms}};
}

Json ProjectorJson(const ProjectorLightReport& p) {
  Json json = {{"name", p.name}};
  if (!p.response.empty()) {
    json["response"] = p.response;
    json["largest_deviation"] = p.largest_deviation;
    json["lamp_drift"] = p.lamp_drift;
    json["worst_fall"] = p.worst_fall;
  }
  if (p.falloff) {
    json["falloff"] = *p.falloff;
    json["falloff_sd"] = p.falloff_sd;
    json["white_dn_mm2_per_ms"] = p.white_dn_mm2_per_ms;
  }
  if (p.black_level) json["black_level"] = *p.black_level;
  if (p.line_blur_px) json["line_blur_px"] = *p.line_blur_px;
  if (p.line)
    json["line"] = {{"width_px", p.line->width_px}, {"measured_px", p.line->measured_px}, {"mm", p.line->mm},
                    {"fwhm_mm", p.line->fwhm_mm},   {"offset_px", p.line->offset_px},     {"light", p.line->light}};
  return json;
}

void AppendProjector(std::string& text, const ProjectorLightReport& p) {
  if (p.response.empty() && !p.falloff) return;
  text += Formatted("  %s:", p.name.c_str());
  if (!p.response.empty())
    text += Formatted(" response %.2f %% off a line at most, lamp drift %.2f %%;", 100.0 * p.largest_deviation,
                      100.0 * p.lamp_drift);
  if (p.falloff)
    text += Formatted(" fall-off %.1f +- %.1f %% at the edge, white %.4g %.4g %.4g DN mm2/ms;",
                      100.0 * ((*p.falloff)[0] + (*p.falloff)[1]), 100.0 * p.falloff_sd, p.white_dn_mm2_per_ms[0],
                      p.white_dn_mm2_per_ms[1], p.white_dn_mm2_per_ms[2]);
  if (p.black_level) text += Formatted(" black %.5f of white;", *p.black_level);
  if (p.line_blur_px) text += Formatted(" blur %.2f px;", *p.line_blur_px);
  if (p.line) text += Formatted(" line of %d px: %.3f px, %.3f mm", p.line->width_px, p.line->measured_px, p.line->mm);
  text += "\n";
}

}  // namespace

std::string LightJson(const LightReport& report) {
  Json json = {{"sessions", report.sessions}, {"target_albedo", report.target_albedo}};
  if (report.dark) json["dark"] = DarkJson(*report.dark);
  if (report.transfer) json["photon_transfer"] = TransferJson(*report.transfer);
  if (report.camera_response) json["camera_response"] = CameraResponseJson(*report.camera_response);
  if (report.vignetting) {
    json["vignetting"] = *report.vignetting;
    json["vignetting_sd"] = report.vignetting_sd;
  }
  if (report.camera_blur_px) json["camera_blur_px"] = *report.camera_blur_px;
  json["flats"] = Json::array();
  for (const FlatPoseReport& f : report.flats)
    json["flats"].push_back({{"session", f.session},
                             {"tilt_deg", f.tilt_deg},
                             {"distance_mm", f.distance_mm},
                             {"plane_rms_mm", f.plane_rms_mm},
                             {"lit_share", f.lit_share},
                             {"residual", f.residual}});
  json["projectors"] = Json::array();
  for (const ProjectorLightReport& p : report.projectors) json["projectors"].push_back(ProjectorJson(p));
  json[report.earlier.empty() ? "never_measured" : "carried_over"] = report.carried_over;
  return json.dump(1, ' ', false, Json::error_handler_t::replace);
}

std::string LightText(const LightReport& report) {
  std::string text = "light:\n";
  if (const auto& d = report.dark)
    text += Formatted(
        "  dark: black level %.2f DN (sites differ by %.2f), read noise %.3f DN, dark current %.2f DN/s, %lld hot "
        "pixels\n",
        d->black_level_dn, d->offset_spread_dn, d->read_noise_dn, d->dark_current_dn_per_s,
        static_cast<long long>(d->hot_pixels));
  if (const auto& t = report.transfer)
    text += Formatted("  gain %.4f +- %.4f electrons/DN (read noise by photon transfer %.2f DN)\n", t->gain_e_per_dn,
                      t->gain_sd, t->read_noise_dn);
  if (const auto& r = report.camera_response)
    text +=
        Formatted("  camera response: %.2f %% off a line at most, measured to %.0f %% of the range, residual %.3f %%\n",
                  100.0 * r->largest_deviation, 100.0 * r->reached, 100.0 * r->residual);
  if (report.vignetting)
    text += Formatted("  vignetting: %.1f +- %.1f %% at the edge\n",
                      100.0 * ((*report.vignetting)[0] + (*report.vignetting)[1]), 100.0 * report.vignetting_sd);
  if (report.camera_blur_px) text += Formatted("  camera blur %.2f px\n", *report.camera_blur_px);
  for (const FlatPoseReport& f : report.flats)
    text +=
        Formatted("  flat, session %s: %.0f mm away, tilt %.1f degrees, flat to %.2f mm, light explained to %.2f %%\n",
                  f.session.c_str(), f.distance_mm, f.tilt_deg, f.plane_rms_mm, 100.0 * f.residual);
  for (const ProjectorLightReport& p : report.projectors) AppendProjector(text, p);
  const std::string why = report.earlier.empty() ? "  never measured: " : "  kept from " + report.earlier + ": ";
  for (const std::string& kept : report.carried_over) text += why + kept + "\n";
  return text;
}

}  // namespace stratalux::fit
