// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/selfcheck_keeper.h"

#include <algorithm>
#include <utility>

#include "firmware-host/session/state_file.h"

namespace stratalux::rig {
namespace {

void AddCard(const std::optional<CardFigures>& card, Selfcheck& check) {
  const auto add = [&check](CheckFigure figure, std::optional<double> value) { check.Of(figure).push_back(value); };
  add(CheckFigure::kLevel, card ? std::optional(card->level_dn) : std::nullopt);
  add(CheckFigure::kDark, card ? std::optional(card->dark_dn) : std::nullopt);
  add(CheckFigure::kRedGreen, card ? card->red_green : std::nullopt);
  add(CheckFigure::kBlueGreen, card ? card->blue_green : std::nullopt);
  add(CheckFigure::kEven, card ? std::optional(card->even) : std::nullopt);
  add(CheckFigure::kLit, card ? std::optional(card->lit) : std::nullopt);
}

}  // namespace

std::filesystem::path SelfchecksFile(const std::filesystem::path& folder, bool simulated) {
  return folder / (simulated ? "selfchecks-simulated.json" : "selfchecks.json");
}

Result<SelfcheckBook> ReadSelfchecks(const std::filesystem::path& file) {
  SelfcheckBook book;
  SLX_RETURN_IF_ERROR(
      ReadState(file, SelfcheckBook::kSchema, [&book](const std::string& text) { book = SelfcheckBook::From(text); }));
  return book;
}

std::optional<Selfcheck> SelfcheckOf(const RigCheckReport& report, double exposure_ms) {
  const bool lit =
      std::any_of(report.card.begin(), report.card.end(), [](const auto& card) { return card.has_value(); });
  if (!lit) return std::nullopt;
  Selfcheck check;
  check.passed = std::none_of(report.items.begin(), report.items.end(),
                              [](const CheckItem& item) { return item.state == CheckState::kFailed; });
  check.exposure_ms = exposure_ms;
  check.width = report.samples.front().width();
  check.height = report.samples.front().height();
  for (const auto& card : report.card) AddCard(card, check);
  check.Of(CheckFigure::kSync) = report.sync_ms;
  check.Of(CheckFigure::kFrameRate) = {report.frames_per_s > 0.0 ? std::optional(report.frames_per_s) : std::nullopt};
  return check;
}

SelfcheckKeeper::SelfcheckKeeper(std::filesystem::path file, Logger& logger) : file_(std::move(file)), logger_(logger) {
  if (file_.empty()) return;
  const Status taken =
      TakeState(file_, SelfcheckBook::kSchema, [this](const std::string& text) { book_ = SelfcheckBook::From(text); });
  if (taken.ok() || taken.code() == StatusCode::kNotFound) return;
  note_ = taken.message();
  logger_.Warning("the trend of self-checks starts again from nothing: " + note_);
  if (taken.code() == StatusCode::kFailed) file_.clear();
}

void SelfcheckKeeper::Add(Selfcheck check) {
  book_.Add(std::move(check));
  if (file_.empty()) return;
  const Status kept = KeepState(file_, book_.ToJson());
  note_ = kept.ok() ? "" : kept.message();
  if (!kept.ok()) logger_.Warning("the self-check's figures are not kept: " + note_);
}

SelfcheckTrend SelfcheckKeeper::trend() const {
  SelfcheckTrend trend = TrendOf(book_);
  trend.note = note_;
  return trend;
}

}  // namespace stratalux::rig
