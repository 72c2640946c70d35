// SPDX-License-Identifier: Apache-2.0
// `stratalux-fit decode`: projector coordinates of every camera pixel, for visitors and for imported boards alike.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <memory>
#include <sstream>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "db/privacy/export_marker.h"
#include "fitter/apps/run_command.h"
#include "fitter/export/exr_file.h"
#include "fitter/export/pictures.h"
#include "fitter/session/choose_session.h"
#include "fitter/session/quad_signal.h"
#include "fitter/stages/decode.h"
#include "fitter/structured_light/local_homography.h"
#include "shared/base/standard_output.h"
#include "shared/image/png.h"

namespace stratalux::fit {
namespace {

struct DecodeFlags {
  std::string store, session = "latest", out, reference;
  int projector = 0, pose = -1;
  bool json = false, bits_alone = false;
};

// Median distance, projector px, between a reference file's corners (pose, board x y, camera u v, projector x y) and
// our own sub-pixel look-up; -1 when no corner of this pose could be looked up.
Result<double> CompareCorners(const std::string& file, int pose, const DecodedMap& map, int crop_x, int crop_y,
                              int& found, int& total) {
  std::ifstream in(file);
  if (!in) return Status::Usage("cannot read " + file);
  std::vector<double> errors;
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream text(line);
    double v[7];
    for (double& x : v)
      if (!(text >> x)) return Status::Usage(file + ":" + std::to_string(number) + ": expected 7 numbers");
    if (static_cast<int>(v[0]) != pose) continue;
    ++total;
    const auto at = LookUpProjectorPoint(map, Eigen::Vector2d(v[3] - crop_x, v[4] - crop_y));
    if (!at) continue;
    ++found;
    errors.push_back(std::hypot(at->column_row.x() - v[5], at->column_row.y() - v[6]));
  }
  if (errors.empty()) return -1.0;
  std::nth_element(errors.begin(), errors.begin() + static_cast<int64_t>(errors.size() / 2), errors.end());
  return errors[errors.size() / 2];
}

// Of the axes that were captured.
Status WriteMaps(const DecodeFlags& f, const std::string& session, const std::string& name, const DecodedMap& map) {
  std::error_code error;
  std::filesystem::create_directories(f.out, error);
  std::vector<std::pair<std::string, const Image<float>*>> axes;
  std::vector<std::string> files;
  for (const auto& [axis, values] : {std::pair{"_column", &map.column}, std::pair{"_row", &map.row}}) {
    if (std::ranges::all_of(values->pixels(), [](float v) { return std::isnan(v); })) continue;
    axes.emplace_back(name + axis, values);
    files.push_back(name + axis + ".exr");
    files.push_back(name + axis + ".png");
  }
  return db::WriteExport(f.store, "decode", session, f.out, files, [&]() -> Status {
    for (const auto& [file, values] : axes) {
      const std::string base = (std::filesystem::path(f.out) / file).string();
      SLX_RETURN_IF_ERROR(WriteExr(base + ".exr", *values, {"Y"}));
      SLX_RETURN_IF_ERROR(
          WritePng8(base + ".png", ToColourScale(*values, Percentile(*values, 0.01), Percentile(*values, 0.99))));
    }
    return Status::Ok();
  });
}

Status DecodePose(const SessionFrames& frames, const DecodeFlags& f, int pose, nlohmann::ordered_json& results) {
  const CodeSize code = CodeSizeOf(frames);
  SLX_ASSIGN_OR_RETURN(const auto report,
                       DecodeProjector(frames, f.projector, pose, code.columns, code.rows, NoiseOf(frames),
                                       f.bits_alone ? CodeReading::kBitsAlone : CodeReading::kWithSinusoids));
  nlohmann::ordered_json result = {{"projector", f.projector}, {"pose", pose}};
  for (int r = 0; r < kDecodeReasons; ++r) result["pixels"][ToString(static_cast<DecodeReason>(r))] = report.counts[r];
  for (const auto& [axis, counts] :
       {std::pair{"columns", &report.column_bit_counts}, std::pair{"rows", &report.row_bit_counts}})
    for (size_t bits = 0; bits < counts->size(); ++bits)
      if ((*counts)[bits] > 0) result["trusted_bits"][axis][std::to_string(bits)] = (*counts)[bits];
  if (!f.reference.empty()) {
    const db::FrameRow* row = frames.Find(f.projector, CapturePhase::kReference, {.kind = PatternKind::kWhite}, pose);
    int found = 0, total = 0;
    SLX_ASSIGN_OR_RETURN(const double median, CompareCorners(f.reference, pose, report.map, row->record.crop_x,
                                                             row->record.crop_y, found, total));
    result["reference"] = {{"corners", total}, {"found", found}, {"median_px", median}};
  }
  if (!f.out.empty()) {
    const std::string name =
        "projector" + std::to_string(f.projector) + (pose >= 0 ? "_pose" + std::to_string(pose) : "");
    SLX_RETURN_IF_ERROR(WriteMaps(f, frames.info().id, name, report.map));
  }
  results.push_back(result);
  return Status::Ok();
}

std::string AsText(const nlohmann::ordered_json& results) {
  std::ostringstream text;
  for (const auto& r : results) {
    text << "projector " << r["projector"].get<int>() << " pose " << r["pose"].get<int>() << ":";
    for (const auto& [reason, count] : r["pixels"].items()) text << "  " << reason << " " << count.get<int64_t>();
    if (r.contains("reference"))
      text << "  reference: " << r["reference"]["found"].get<int>() << " of " << r["reference"]["corners"].get<int>()
           << " corners, median " << std::fixed << std::setprecision(3) << r["reference"]["median_px"].get<double>()
           << " px";
    text << "\n";
  }
  return text.str();
}

Status Decode(const DecodeFlags& f, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(const auto chosen, ChooseSession(f.store, f.session, SessionUse::kFrames, logger));
  SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(f.store, chosen));
  for (const std::string& note : frames.store().notes()) logger.Warning(note);
  if (frames.rows().empty()) return Status::NotFound("session " + frames.info().id + " has no frames");
  nlohmann::ordered_json results = nlohmann::ordered_json::array();
  for (int pose : frames.poses())
    if (f.pose < 0 || pose == f.pose) SLX_RETURN_IF_ERROR(DecodePose(frames, f, pose, results));
  if (results.empty())
    return Status::NotFound("session " + frames.info().id + " has no pose " + std::to_string(f.pose));
  return WriteStdout(f.json ? results.dump(1) + "\n" : AsText(results));
}

}  // namespace

void AddDecodeCommand(CLI::App& app, int& exit_code) {
  auto flags = std::make_shared<DecodeFlags>();
  auto* verb =
      app.add_subcommand("decode", "Projector coordinates of every camera pixel; works on imported boards too");
  verb->footer("Example:\n  stratalux-fit decode latest --store store --out decoded --reference reference_corners.txt");
  verb->add_option("session", flags->session, "Session: id, unique prefix, or latest")->capture_default_str();
  verb->add_option("--store", flags->store, "Store folder")->envname("STRATALUX_STORE")->required();
  verb->add_option("--projector", flags->projector, "Projector")->check(CLI::Range(0, 15))->capture_default_str();
  verb->add_option("--pose", flags->pose, "Only this board pose")->check(CLI::Range(0, 10000));
  verb->add_option("--out", flags->out, "Folder for column and row maps (EXR, PNG)");
  verb->add_option("--reference", flags->reference,
                   "Corner file to compare with (pose, board x y, camera u v, projector x y)");
  verb->add_flag("--bits-alone", flags->bits_alone, "Without the sinusoids that were captured");
  verb->add_flag("--json", flags->json, "Machine-readable result on stdout");
  verb->callback([flags, &exit_code] {
    Logger logger;
    const Status status = Decode(*flags, logger);
    if (!status.ok()) logger.Error(status.message());
    exit_code = status.exit_code();
  });
}

}  // namespace stratalux::fit
