// SPDX-License-Identifier: Apache-2.0
#include "fitter/evaluation/interval_figures.h"

#include <algorithm>
#include <cmath>

#include "fitter/evaluation/metrics_json.h"
#include "fitter/export/npy_file.h"
#include "fitter/stages/stage_json.h"

namespace stratalux::fit {
namespace {

constexpr const char* kErrorsFile = "errors.npy";
// Of a light and colour: parts of the error are then told to some per cent, and the rest would only be more to keep.
constexpr int64_t kMostSamples = 4000;
constexpr size_t kColumns = 9;

// What all hold-outs but `but` say of a colour.
std::vector<ErrorSample> SamplesOf(const std::vector<HeldOutErrors>& heldout, int colour, const HeldOutErrors* but) {
  std::vector<ErrorSample> samples;
  for (const HeldOutErrors& errors : heldout) {
    if (&errors == but) continue;
    for (size_t light = 0; light < errors.lights.size(); ++light) {
      const auto& own = errors.samples[light * errors.colours + colour];
      samples.insert(samples.end(), own.begin(), own.end());
    }
  }
  return samples;
}

// Of all colours; empty where one of them is not told, or the hold-outs differ in them.
std::vector<PredictionError> LearnColours(const std::vector<HeldOutErrors>& heldout, const HeldOutErrors* but) {
  std::vector<PredictionError> colours;
  const int all = heldout.front().colours;
  if (std::ranges::any_of(heldout, [all](const HeldOutErrors& errors) { return errors.colours != all; })) return {};
  for (int c = 0; c < all; ++c) {
    const auto learnt = LearnPredictionError(SamplesOf(heldout, c, but));
    if (!learnt) return {};
    colours.push_back(*learnt);
  }
  return colours;
}

IntervalFigures::Covered CoverageOf(const HeldOutErrors& errors, size_t light,
                                    const std::vector<PredictionError>& colours) {
  IntervalFigures::Covered covered{errors.projector, errors.lights[light], 0.0, 0.0, 0};
  double within = 0.0, widths = 0.0, predictions = 0.0;
  for (int c = 0; c < errors.colours; ++c)
    for (const ErrorSample& s : errors.samples[light * errors.colours + c]) {
      const double share = ShareWithin({&s, 1}, colours[c]);
      if (std::isnan(share)) continue;  // not usable
      within += share;
      widths += std::pow(colours[c].HalfWidth(s.causes), 2);
      predictions += std::pow(double(s.causes.prediction), 2);
      ++covered.samples;
    }
  if (!(predictions > 0.0)) return {};
  covered.share = within / static_cast<double>(covered.samples);
  covered.half_width = std::sqrt(widths / predictions);
  return covered;
}

}  // namespace

int64_t ErrorSampleStride(int64_t judged) { return std::max<int64_t>(1, (judged + kMostSamples - 1) / kMostSamples); }

Status SaveErrors(const std::filesystem::path& folder, const HeldOutErrors& errors) {
  std::vector<float> rows;
  for (size_t of = 0; of < errors.samples.size(); ++of)
    for (const ErrorSample& s : errors.samples[of]) {
      const size_t colours = static_cast<size_t>(errors.colours);
      const float row[] = {static_cast<float>(of / colours),
                           static_cast<float>(of % colours),
                           s.causes.prediction,
                           s.causes.tan_incidence,
                           s.causes.step,
                           s.causes.spread,
                           s.residual,
                           s.squared_error,
                           s.noise_variance};
      static_assert(std::size(row) == kColumns);
      rows.insert(rows.end(), std::begin(row), std::end(row));
    }
  return WriteNpy(folder / kErrorsFile, rows, kColumns);
}

Status LoadErrors(const std::filesystem::path& folder, HeldOutErrors& errors) {
  SLX_ASSIGN_OR_RETURN(const auto rows, ReadNpyFloats(folder / kErrorsFile));
  errors.samples.assign(errors.lights.size() * errors.colours, {});
  const auto fault = [&] {
    return Status::Integrity((folder / kErrorsFile).string() + ": its rows are not those of compare.json");
  };
  if (rows.size() % kColumns != 0) return fault();
  for (auto row = rows.begin(); row != rows.end(); row += kColumns) {
    const auto names = [](float value, size_t count) { return value >= 0.0F && value < static_cast<float>(count); };
    if (!names(row[0], errors.lights.size()) || !names(row[1], static_cast<size_t>(errors.colours))) return fault();
    errors.samples[static_cast<size_t>(row[0]) * errors.colours + static_cast<size_t>(row[1])].push_back(
        {{row[2], row[3], row[4], row[5]}, row[6], row[7], row[8]});
  }
  return Status::Ok();
}

Result<IntervalFigures> ReadIntervals(const std::filesystem::path& metrics_json) {
  IntervalFigures figures;
  SLX_RETURN_IF_ERROR(ReadJson(metrics_json, [&](const nlohmann::json& json) {
    if (!json.contains("intervals") || json.at("intervals").value("schema", 1) != kIntervalsSchema) return;
    json.at("intervals").at("learnt_from").get_to(figures.learnt_from);
    for (const auto& colour : json.at("intervals").at("colours"))
      figures.colours.push_back(colour.get<PredictionError>());
  }));
  return figures;
}

IntervalFigures FindIntervals(const std::vector<HeldOutErrors>& heldout) {
  IntervalFigures figures;
  if (heldout.empty()) return figures;
  for (const HeldOutErrors& errors : heldout) figures.learnt_from.push_back(errors.projector);
  figures.colours = LearnColours(heldout, nullptr);
  if (heldout.size() < 2) return figures;
  for (const HeldOutErrors& errors : heldout) {
    const auto others = LearnColours(heldout, &errors);
    if (others.empty()) continue;
    for (size_t light = 0; light < errors.lights.size(); ++light) {
      const auto covered = CoverageOf(errors, light, others);
      if (covered.samples > 0) figures.covered.push_back(covered);
    }
  }
  return figures;
}

}  // namespace stratalux::fit
