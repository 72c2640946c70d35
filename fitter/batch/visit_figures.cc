// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/visit_figures.h"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <nlohmann/json.hpp>

#include "db/catalogue/artifact_record.h"
#include "fitter/batch/bytes_below.h"
#include "fitter/batch/morning_facts.h"
#include "fitter/batch/newest_fits.h"
#include "shared/base/json_nesting.h"
#include "shared/base/median.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

double SecondsOf(const std::vector<db::FrameRow>& frames) {
  auto first = frames.front().record.trigger_time, last = frames.front().record.frame_time;
  for (const db::FrameRow& frame : frames) {
    first = std::min(first, frame.record.trigger_time);
    last = std::max(last, frame.record.frame_time);
  }
  return static_cast<double>(last.ns - first.ns) * 1e-9;
}

Status Positive(const char* name, double value) {
  if (std::isfinite(value) && value > 0.0) return Status::Ok();
  return Status::Usage(std::string("visitors' figures: ") + name + " " + nlohmann::json(value).dump() +
                       ": must be above 0");
}

}  // namespace

Status VisitFigures::Validate() const {
  if (fit_cpu_s.empty()) return Status::Usage("visitors' figures: fit_cpu_s: needs the time of at least one fit");
  for (const double seconds : fit_cpu_s) SLX_RETURN_IF_ERROR(Positive("fit_cpu_s", seconds));
  SLX_RETURN_IF_ERROR(Positive("longest_stage_share", longest_stage_share));
  if (longest_stage_share > 1.0) return Status::Usage("visitors' figures: longest_stage_share: must be at most 1");
  SLX_RETURN_IF_ERROR(Positive("capture_s", capture_s));
  SLX_RETURN_IF_ERROR(Positive("frames_bytes", frames_bytes));
  SLX_RETURN_IF_ERROR(Positive("artifact_bytes", artifact_bytes));
  return Positive("fit_bytes", fit_bytes);
}

Result<VisitFigures> MeasureVisits(const db::SessionStore& store, size_t most) {
  VisitFigures figures;
  std::vector<double> shares, captures, frames_bytes, fit_bytes, artifact_bytes;
  int64_t sites = 0;
  SLX_RETURN_IF_ERROR(LookAtNewestFits(store, [&](const NewestFit& newest) {
    double seconds = 0.0, longest = 0.0;
    for (const auto& [stage, cpu] : StageSecondsOf(newest.fit.metrics_json)) {
      seconds += cpu;
      longest = std::max(longest, cpu);
    }
    if (seconds <= 0.0) return true;
    if (sites == 0) sites = newest.sites;
    if (newest.sites != sites) return true;
    SeenFiles seen;
    const fs::path folder = store.SessionFolder(newest.session.info.id);
    figures.fit_cpu_s.push_back(seconds);
    shares.push_back(longest / seconds);
    captures.push_back(SecondsOf(newest.frames));
    frames_bytes.push_back(static_cast<double>(newest.session.bytes));
    fit_bytes.push_back(static_cast<double>(BytesBelow(folder / "fits", seen)));
    artifact_bytes.push_back(static_cast<double>(BytesBelow(folder / db::kArtifactsFolder, seen)));
    return figures.fit_cpu_s.size() < most;
  }));
  if (figures.fit_cpu_s.empty())
    return Status::NotFound("store " + store.folder().string() +
                            ": no visitor was fitted, so it is not known what one costs; fit one with `stratalux-fit "
                            "run`");
  figures.longest_stage_share = Median(shares);
  figures.capture_s = Median(captures);
  figures.frames_bytes = Median(frames_bytes);
  figures.fit_bytes = Median(fit_bytes);
  figures.artifact_bytes = Median(artifact_bytes);
  SLX_RETURN_IF_ERROR(figures.Validate());
  return figures;
}

std::string ToJson(const VisitFigures& figures) {
  const nlohmann::ordered_json json = {
      {"fit_cpu_s", figures.fit_cpu_s}, {"longest_stage_share", figures.longest_stage_share},
      {"capture_s", figures.capture_s}, {"frames_bytes", figures.frames_bytes},
      {"fit_bytes", figures.fit_bytes}, {"artifact_bytes", figures.artifact_bytes}};
  return json.dump(1);
}

Result<VisitFigures> ParseVisitFigures(const std::string& text) {
  SLX_RETURN_IF_ERROR(CheckNesting(text));
  const auto json = nlohmann::json::parse(text, nullptr, false);
  if (!json.is_object()) return Status::Usage("visitors' figures: not a JSON object");
  VisitFigures figures;
  for (const auto& [key, value] : json.items()) {
    const auto number = [&, &value = value](double& to) {
      if (value.is_number()) to = value.get<double>();
      return value.is_number();
    };
    bool good = false;
    if (key == "fit_cpu_s") {
      good =
          value.is_array() && std::all_of(value.begin(), value.end(), [](const auto& one) { return one.is_number(); });
      if (good) figures.fit_cpu_s = value.get<std::vector<double>>();
    } else if (key == "longest_stage_share") {
      good = number(figures.longest_stage_share);
    } else if (key == "capture_s") {
      good = number(figures.capture_s);
    } else if (key == "frames_bytes") {
      good = number(figures.frames_bytes);
    } else if (key == "fit_bytes") {
      good = number(figures.fit_bytes);
    } else if (key == "artifact_bytes") {
      good = number(figures.artifact_bytes);
    }
    if (!good) return Status::Usage("visitors' figures: " + key + ": unknown, or not of its type");
  }
  SLX_RETURN_IF_ERROR(figures.Validate());
  return figures;
}

}  // namespace stratalux::fit
