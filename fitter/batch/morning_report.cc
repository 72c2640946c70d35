// SPDX-License-Identifier: Apache-2.0
#include "fitter/batch/morning_report.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "db/base/durable_file.h"
#include "fitter/report/page_text.h"
#include "fitter/session/session_frames.h"
#include "shared/base/formatted.h"
#include "shared/base/median.h"
#include "shared/base/printable.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;

constexpr int kThumbnailWidth = 135;  // px; twice that on a page
constexpr size_t kThumbnails = 24;
constexpr double kFewNights = 7.0;

int Failed(const NightStatus& night) {
  return night.Count(NightEventKind::kFailed) + night.Count(NightEventKind::kSetAside);
}

std::string Gib(int64_t bytes) { return Formatted("%.1f GiB", static_cast<double>(bytes) / (int64_t{1} << 30)); }

std::string Joined(const std::vector<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ", ") + word;
  return text;
}

std::string Headline(const MorningFacts& facts) {
  const NightStatus& night = facts.night;
  std::string text =
      Formatted("%d of %lld visitors fitted", night.Count(NightEventKind::kDone), static_cast<long long>(night.chosen));
  if (Failed(night) > 0) text += Formatted(", %d failed", Failed(night));
  if (const int dropped = night.Count(NightEventKind::kDropped))
    text += Formatted(", %d withdrew or are no longer in the store", dropped);
  if (!night.ended)
    text += "; the night was cut off or is still running";
  else if (!night.end_reason.empty())
    text += "; " + night.end_reason;
  if (!facts.outliers.empty()) text += Formatted("; %zu figures to look at", facts.outliers.size());
  return text + ".";
}

Tone ToneOf(const MorningFacts& facts) {
  if (Failed(facts.night) > 0 || !facts.night.ended) return Tone::kBad;
  const bool full_soon = facts.nights_left && *facts.nights_left < kFewNights;
  return facts.outliers.empty() && !full_soon && facts.unread == 0 ? Tone::kGood : Tone::kDoubtful;
}

std::string DiskText(const MorningFacts& facts) {
  std::string text = Gib(facts.free_bytes) + " free";
  if (facts.nights_left)
    text += Formatted("; full after %.0f more nights like this one", std::floor(*facts.nights_left));
  return text;
}

// `folder`: of the night, with the workers' logs; a merged one has none, nor who never began.
ReportTable FailureTable(const NightStatus& night, const fs::path& folder) {
  ReportTable table{"Failed, and why", {"session", "state", "attempts", "reason"}, {}};
  for (const NightVisit& visit : night.visits) {
    if (visit.kind == NightEventKind::kDone) continue;
    table.rows.push_back(
        {visit.session, ToString(visit.kind), std::to_string(visit.attempts), PrintableLines(visit.reason)});
    const std::string log = Formatted("%s-%d.log", visit.session.c_str(), visit.attempts);
    std::error_code error;
    table.links.push_back(fs::exists(folder / log, error) ? log : "");
  }
  return table;
}

// Those that are fitted already are many, and nobody's worry.
ReportTable LeftOutTable(const NightStatus& night) {
  ReportTable table{"Left out", {"session", "why", "reason"}, {}};
  for (const NightEvent& event : night.left_out)
    if (event.why != "complete") table.rows.push_back({event.session, event.why, PrintableLines(event.reason)});
  return table;
}

ReportTable OutlierTable(const MorningFacts& facts) {
  ReportTable table{Formatted("More than 3.5 standard deviations from %zu earlier fits of this store", facts.earlier),
                    {"session", "figure", "value", "usual"},
                    {}};
  for (const Outlier& outlier : facts.outliers)
    table.rows.push_back({outlier.session, outlier.figure, Fixed(outlier.value),
                          Formatted("%s +- %s", Fixed(outlier.usual).c_str(), Fixed(outlier.spread).c_str())});
  return table;
}

std::string LinkTo(const FittedVisit& visit) {
  if (visit.sealed) return "";
  return "../../sessions/" + visit.visit.session + "/fits/" + visit.visit.fit + "/report/index.html";
}

ReportTable FittedTable(const MorningFacts& facts) {
  std::vector<std::string> names;
  for (const FittedVisit& visit : facts.fitted)
    for (const auto& [name, value] : visit.figures)
      if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
  std::sort(names.begin(), names.end());
  ReportTable table{"Fitted. The reports of encrypted visits are sealed: `stratalux-fit report SESSION --out FOLDER`",
                    {"session", "s", "processor s", "GiB", "attempts"},
                    {}};
  table.header.insert(table.header.end(), names.begin(), names.end());
  table.header.push_back("findings");
  for (const FittedVisit& visit : facts.fitted) {
    std::vector<std::string> row = {visit.visit.session, Fixed(visit.visit.seconds, 0),
                                    Fixed(visit.visit.cpu_seconds, 0),
                                    Fixed(static_cast<double>(visit.visit.peak_bytes) / (int64_t{1} << 30), 2),
                                    std::to_string(visit.visit.attempts)};
    for (const std::string& name : names) {
      const auto found = visit.figures.find(name);
      row.push_back(found == visit.figures.end() ? "-" : Fixed(found->second));
    }
    row.push_back(Joined(visit.findings));
    table.rows.push_back(std::move(row));
    table.links.push_back(LinkTo(visit));
  }
  return table;
}

ReportTable StageTable(const MorningFacts& facts) {
  ReportTable table{"Processor seconds of the stages, medians", {"stage", "tonight", "earlier"}, {}};
  for (const SlowStage& stage : facts.stages)
    table.rows.push_back({stage.stage, Fixed(stage.tonight_s, 1), stage.usual_s > 0.0 ? Fixed(stage.usual_s, 1) : "-"});
  return table;
}

// A projector's white, small: the mean of whole blocks of the mosaic, the brightest 2 % white.
Result<ReportImage> Thumbnail(const fs::path& store, const FittedVisit& visit) {
  SLX_ASSIGN_OR_RETURN(const auto frames, SessionFrames::Open(store.string(), visit.visit.session));
  int count = 0;
  SLX_ASSIGN_OR_RETURN(const Image<float> white, frames.MeanWhite(0, count));
  const int step = std::max(2, white.width() / kThumbnailWidth / 2 * 2);
  Image<float> small(white.width() / step, white.height() / step);
  std::vector<double> values;
  for (int y = 0; y < small.height(); ++y)
    for (int x = 0; x < small.width(); ++x) {
      double sum = 0.0;
      int good = 0;
      for (int v = 0; v < step; ++v)
        for (int u = 0; u < step; ++u)
          if (const float value = white(x * step + u, y * step + v); std::isfinite(value)) {
            sum += value;
            ++good;
          }
      small(x, y) = good > 0 ? static_cast<float>(sum / good) : 0.0F;
      values.push_back(small(x, y));
    }
  if (values.empty()) return Status::Failed("no pixels");
  const auto bright = values.begin() + static_cast<std::ptrdiff_t>(0.98 * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), bright, values.end());
  const double scale = *bright > 0.0 ? 1.0 / *bright : 0.0;
  ReportImage image{visit.visit.session, Image<uint8_t>(small.width(), small.height())};
  for (int y = 0; y < small.height(); ++y)
    for (int x = 0; x < small.width(); ++x) {
      const double tone = std::sqrt(std::clamp(scale * static_cast<double>(small(x, y)), 0.0, 1.0));
      image.pixels(x, y) = static_cast<uint8_t>(std::lround(255.0 * tone));
    }
  image.link = LinkTo(visit);
  return image;
}

// Columns under their names; the last one is as long as it likes.
std::string TableText(const ReportTable& table) {
  std::vector<std::vector<std::string>> rows = {table.header};
  rows.insert(rows.end(), table.rows.begin(), table.rows.end());
  std::string text = table.caption + "\n";
  for (const auto& row : rows) {
    text += " ";
    for (size_t i = 0; i < row.size(); ++i) {
      size_t width = 0;
      for (const auto& other : rows) width = std::max(width, other[i].size());
      text += " " + row[i] + std::string(i + 1 < row.size() ? width + 1 - row[i].size() : 0, ' ');
    }
    text.erase(text.find_last_not_of(' ') + 1);
    text += "\n";
  }
  return text;
}

bool NamesAnyOf(const std::set<std::string>& sessions, const NightStatus& night) {
  const auto named = [&](const auto& one) { return sessions.contains(one.session); };
  return std::any_of(night.visits.begin(), night.visits.end(), named) ||
         std::any_of(night.left_out.begin(), night.left_out.end(), named);
}

}  // namespace

MorningReport ReportOf(const MorningFacts& facts, const fs::path& store) {
  MorningReport report;
  report.page.title = "Night of " + ToIso8601(facts.night.began);
  report.page.subtitle =
      facts.folder.filename().string() + (facts.night.ended ? ", over at " + ToIso8601(*facts.night.ended) : "");
  report.page.banner = ReportBanner{ToneOf(facts), Headline(facts)};
  report.text = report.page.title + "\n" + Headline(facts) + "\nDisk: " + DiskText(facts) + "\n";
  if (facts.unread > 0) report.text += Formatted("%d lines of the night's log could not be read\n", facts.unread);
  ReportSection sorrows{"To look at", "", {}, {}, {}};
  for (ReportTable& table : std::vector<ReportTable>{FailureTable(facts.night, facts.folder), OutlierTable(facts),
                                                     LeftOutTable(facts.night)}) {
    if (table.rows.empty()) continue;
    report.text += "\n" + TableText(table);
    sorrows.tables.push_back(std::move(table));
  }
  if (!sorrows.tables.empty()) report.page.sections.push_back(std::move(sorrows));
  ReportSection fitted{"Fitted", "", {}, {}, {}};
  for (const FittedVisit& visit : facts.fitted) {
    if (visit.sealed || fitted.images.size() >= kThumbnails) continue;
    if (auto picture = Thumbnail(store, visit); picture.ok()) fitted.images.push_back(std::move(*picture));
  }
  if (!facts.fitted.empty()) {
    fitted.tables.push_back(FittedTable(facts));
    report.text += "\n" + TableText(fitted.tables.back());
    report.page.sections.push_back(std::move(fitted));
  }
  if (!facts.stages.empty()) report.page.sections.push_back({"Where the time goes", "", {}, {}, {StageTable(facts)}});
  report.page.sections.push_back({"Disk", DiskText(facts) + ".", {}, {}, {}});
  report.text = PrintableLines(report.text);
  return report;
}

Result<fs::path> WriteMorningReport(const fs::path& store, const std::string& night,
                                    const std::function<void()>& gathered) {
  // Asked once it is there: a forgetting that enters the ledger before this sees the report made anew, one that enters
  // it later comes to the nights' files behind it.
  while (true) {
    SLX_ASSIGN_OR_RETURN(const MorningFacts facts, GatherMorning(store, night));
    const MorningReport report = ReportOf(facts, store);
    SLX_ASSIGN_OR_RETURN(const std::string html, RenderHtml(report.page));
    if (gathered) gathered();
    const fs::path page = facts.folder / "report.html", text = facts.folder / "report.txt";
    Status written = db::ReplaceFile(text, report.text);
    if (written.ok()) written = db::ReplaceFile(page, html);
    const auto forgotten = ForgottenOf(store);
    if (forgotten.ok() && !NamesAnyOf(*forgotten, facts.night)) {
      SLX_RETURN_IF_ERROR(written);
      return page;
    }
    // Wiped, not replaced: that would leave the bytes of who is forgotten on the disk. Both, whatever becomes of one.
    const Status no_text = db::WipeFile(text), no_page = db::WipeFile(page);
    for (const Status& step : {no_text, no_page, forgotten.status()}) SLX_RETURN_IF_ERROR(step);
  }
}

}  // namespace stratalux::fit
