// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit modulation`: how much contrast each captured set of sinusoids keeps, of imports and captures alike.
#include <array>
#include <charconv>
#include <filesystem>
#include <iomanip>
#include <memory>
#include <optional>
#include <sstream>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/privacy/export_marker.h"
#include "fitter/apps/run_command.h"
#include "fitter/export/exr_file.h"
#include "fitter/session/choose_session.h"
#include "fitter/session/sinusoid_sets.h"
#include "fitter/stages/modulation.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

using OrderedJson = nlohmann::ordered_json;

struct ModulationFlags {
  std::string store, session = "latest", out;
  std::vector<std::string> regions;
  int pose = -1;
  bool json = false;
};

struct PlaceModulation {
  SinusoidPlace place;
  std::vector<SetModulation> sets;
};

Result<Region> ParseRegion(const std::string& text) {
  std::array<int, 4> v{};
  const char* at = text.data();
  const char* const end = at + text.size();
  for (size_t i = 0; i < v.size(); ++i) {
    const auto [behind, error] = std::from_chars(at, end, v[i]);
    const bool stops = i + 1 < v.size() ? behind != end && *behind == ',' : behind == end;
    if (error != std::errc{} || !stops || v[i] < (i < 2 ? 0 : 1))
      return Status::Usage("--region " + text + ": expected X,Y,WIDTH,HEIGHT in px, such as 170,20,340,590");
    at = behind + 1;
  }
  return Region{v[0], v[1], v[2], v[3]};
}

Status LiesIn(const Region& region, ImageView<const float> map, const SinusoidPlace& place) {
  // Not the sum: it could exceed an int.
  if (region.width_px <= map.width() && region.x_px <= map.width() - region.width_px &&
      region.height_px <= map.height() && region.y_px <= map.height() - region.height_px)
    return Status::Ok();
  return Status::Usage("--region " + std::to_string(region.x_px) + "," + std::to_string(region.y_px) + "," +
                       std::to_string(region.width_px) + "," + std::to_string(region.height_px) +
                       ": leaves the picture of " + place.ToString() + ", " + std::to_string(map.width()) + "x" +
                       std::to_string(map.height()) + " px");
}

OrderedJson MediansOf(const SetModulation& set, const SetModulation& coarsest, const Region& region) {
  const auto value = [](const SiteMedian& m) { return m.value ? OrderedJson(*m.value) : OrderedJson(nullptr); };
  const SiteMedian own = MedianIn(set.modulation.value, region);
  OrderedJson medians = {{"sites", own.sites}, {"median", value(own)}};
  if (&set == &coarsest) return medians;
  const SiteMedian ratio = MedianRatioIn(set.modulation.value, coarsest.modulation.value, region);
  const SiteMedian coarse = MedianIn(coarsest.modulation.value, region);
  medians["ratio"] = {{"to_period_px", coarsest.period_px}, {"sites", ratio.sites}, {"median", value(ratio)}};
  medians["ratio"]["of_medians"] =
      own.value && coarse.value.value_or(0.0) > 0.0 ? OrderedJson(*own.value / *coarse.value) : OrderedJson(nullptr);
  return medians;
}

// Each set against the coarsest one of its axis.
Result<OrderedJson> DescribeModulation(const PlaceModulation& of, const std::vector<Region>& regions) {
  OrderedJson results = OrderedJson::array();
  for (const SetModulation& set : of.sets) {
    const SetModulation* coarsest = &set;
    for (const SetModulation& other : of.sets)
      if (other.axis == set.axis && other.period_px > coarsest->period_px) coarsest = &other;
    const Image<float>& map = set.modulation.value;
    OrderedJson result = {{"projector", of.place.projector},
                          {"pose", of.place.pose},
                          {"axis", AxisName(set.axis)},
                          {"period_px", set.period_px},
                          {"shifts", set.shifts}};
    for (int r = 0; r < kModulationReasons; ++r)
      result["pixels"][ToString(static_cast<ModulationReason>(r))] = set.modulation.counts[static_cast<size_t>(r)];
    result.update(MediansOf(set, *coarsest, {0, 0, map.width(), map.height()}));
    result["regions"] = OrderedJson::array();
    for (const Region& region : regions) {
      SLX_RETURN_IF_ERROR(LiesIn(region, map, of.place));
      OrderedJson part = {
          {"x", region.x_px}, {"y", region.y_px}, {"width", region.width_px}, {"height", region.height_px}};
      part.update(MediansOf(set, *coarsest, region));
      result["regions"].push_back(part);
    }
    results.push_back(result);
  }
  return results;
}

std::string MediansText(const OrderedJson& medians) {
  const auto number = [](const OrderedJson& value) {
    std::ostringstream text;
    if (value.is_null())
      text << "none";
    else
      text << std::fixed << std::setprecision(3) << value.get<double>();
    return text.str();
  };
  std::string text = "median " + number(medians["median"]) + " of " + std::to_string(medians["sites"].get<int64_t>());
  if (medians.contains("ratio"))
    text += ", ratio to period " + std::to_string(medians["ratio"]["to_period_px"].get<int>()) +
            " px: " + number(medians["ratio"]["median"]) + " (median of the sites'), " +
            number(medians["ratio"]["of_medians"]) + " (of the medians)";
  return text + "\n";
}

std::string ModulationText(const OrderedJson& results) {
  std::ostringstream text;
  for (const auto& r : results) {
    text << "projector " << r["projector"].get<int>() << " pose " << r["pose"].get<int>() << " "
         << r["axis"].get<std::string>() << " period " << r["period_px"].get<int>() << " px:";
    for (const auto& [reason, count] : r["pixels"].items()) text << "  " << reason << " " << count.get<int64_t>();
    text << "\n  picture: " << MediansText(r);
    for (const auto& part : r["regions"])
      text << "  region " << part["x"].get<int>() << "," << part["y"].get<int>() << "," << part["width"].get<int>()
           << "," << part["height"].get<int>() << ": " << MediansText(part);
  }
  return text.str();
}

std::string ModulationFile(const SinusoidPlace& place, const SetModulation& set) {
  return "projector" + std::to_string(place.projector) +
         (place.pose >= 0 ? "_pose" + std::to_string(place.pose) : std::string()) + "_modulation_" +
         AxisName(set.axis) + "_" + std::to_string(set.period_px) + ".exr";
}

// All of them, each whole or not there.
Status WriteModulationMaps(const ModulationFlags& f, const std::string& session,
                           const std::vector<PlaceModulation>& all) {
  std::vector<std::string> files;
  std::vector<const Image<float>*> maps;
  for (const PlaceModulation& of : all)
    for (const SetModulation& set : of.sets) {
      files.push_back(ModulationFile(of.place, set));
      maps.push_back(&set.modulation.value);
    }
  const std::filesystem::path out = f.out;
  return db::WriteExport(f.store, "modulation", session, out, files, [&]() -> Status {
    for (size_t i = 0; i < files.size(); ++i)
      SLX_RETURN_IF_ERROR(db::WriteExportedFile(
          out / files[i], [&](const std::filesystem::path& beside) { return WriteExr(beside, *maps[i], {"Y"}); }));
    return Status::Ok();
  });
}

// Of all places with a whole set; what is left out is named. kNotFound: there is no whole set at all.
Result<std::vector<PlaceModulation>> MeasureAll(const ModulationFlags& f, const SessionFrames& frames, Logger& logger) {
  std::vector<PlaceModulation> all;
  for (const SinusoidPlace& place : SinusoidPlaces(frames)) {
    if (f.pose >= 0 && place.pose != f.pose) continue;
    if (const std::string note = UnreadSets(frames, place); !note.empty()) logger.Warning(note);
    SLX_ASSIGN_OR_RETURN(auto sets, MeasureSets(frames, place));
    if (!sets.empty()) all.push_back({place, std::move(sets)});
  }
  if (all.empty())
    return Status::NotFound("session " + frames.info().id + " has no whole set of sinusoids" +
                            (f.pose >= 0 ? " in pose " + std::to_string(f.pose) : std::string()) +
                            "; capture or import all shifts of a period");
  return all;
}

Status MeasureModulationOf(const ModulationFlags& f, Logger& logger) {
  std::vector<Region> regions;
  for (const std::string& text : f.regions) {
    SLX_ASSIGN_OR_RETURN(regions.emplace_back(), ParseRegion(text));
  }
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(f.store, f.session, SessionUse::kFrames, logger));
  SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(f.store, chosen));
  for (const std::string& note : frames.store().notes()) logger.Warning(note);
  SLX_ASSIGN_OR_RETURN(const auto all, MeasureAll(f, frames, logger));
  OrderedJson results = OrderedJson::array();
  for (const PlaceModulation& of : all) {
    SLX_ASSIGN_OR_RETURN(const OrderedJson described, DescribeModulation(of, regions));
    results.insert(results.end(), described.begin(), described.end());
  }
  if (!f.out.empty()) SLX_RETURN_IF_ERROR(WriteModulationMaps(f, frames.info().id, all));
  return WriteStdout(f.json ? results.dump(1) + "\n" : ModulationText(results));
}

}  // namespace

void AddModulationCommand(CLI::App& app, int& exit_code) {
  auto flags = std::make_shared<ModulationFlags>();
  auto* verb = app.add_subcommand(
      "modulation",
      "Contrast that captured sinusoids keep, and how it falls from coarse to fine; works on imports too");
  verb->footer(
      "Example:\n"
      "  stratalux-fit modulation latest --store store --region 170,20,340,590 --region 20,720,590,90 --out contrast");
  verb->add_option("session", flags->session, "Session: id, unique prefix, or latest")->capture_default_str();
  verb->add_option("--store", flags->store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb->add_option("--pose", flags->pose, "Only this pose")->check(CLI::Range(0, 10000));
  verb->add_option("--region", flags->regions,
                   "X,Y,WIDTH,HEIGHT px of the picture to judge by itself; may be repeated");
  verb->add_option("--out", flags->out, "Folder for a map of each set (EXR)");
  verb->add_flag("--json", flags->json, "Machine-readable result on stdout");
  verb->callback([flags, &exit_code] {
    Logger logger;
    const Status status = MeasureModulationOf(*flags, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
