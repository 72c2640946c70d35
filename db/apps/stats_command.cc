// SPDX-License-Identifier: Apache-2.0
// `stratalux-db stats`: the store over time, in the terminal or as a page.
#include <cstdio>
#include <memory>

#include <unistd.h>

#include "db/apps/charts.h"
#include "db/apps/command.h"
#include "db/apps/display_text.h"
#include "db/apps/moment.h"
#include "db/apps/statistics.h"

namespace stratalux::db {
namespace {

struct StatsFlags {
  std::string since = "30d", until, html;
};

Status WritePage(const std::string& file, const std::string& page) {
  std::FILE* out = std::fopen(file.c_str(), "wb");
  if (out == nullptr) return Status::Failed("cannot write " + file);
  const bool written = std::fwrite(page.data(), 1, page.size(), out) == page.size();
  return std::fclose(out) == 0 && written ? Status::Ok()
                                          : Status::Failed("cannot write " + file + "; is its disk full?");
}

Result<Statistics> Load(const CommonFlags& common, const StatsFlags& flags) {
  WallNs until = WallNow();
  if (!flags.until.empty()) {
    SLX_ASSIGN_OR_RETURN(until, ParseMoment(flags.until, until).WithContext("--until"));
  }
  SLX_ASSIGN_OR_RETURN(const WallNs since, ParseMoment(flags.since, until).WithContext("--since"));
  SLX_ASSIGN_OR_RETURN(auto index, ReadOnlyIndex::Open(common.store));
  return LoadStatistics(index, since, until);
}

int RunStats(const CommonFlags& common, const StatsFlags& flags) {
  const auto statistics = Load(common, flags);
  if (!statistics.ok()) return Report(statistics.status());
  if (!flags.html.empty()) {
    const Status written = WritePage(flags.html, StatisticsAsHtml(*statistics, common.store));
    if (!written.ok()) return Report(written);
    if (!common.json) return Print("page " + flags.html + "\n");
  }
  if (common.json) return Print(StatisticsAsJson(*statistics));
  // What reads a pipe may not know block characters.
  const bool blocks = LocaleIsUtf8() && isatty(STDOUT_FILENO) == 1;
  return Print(StatisticsAsText(*statistics, blocks ? Glyphs::kBlocks : Glyphs::kAscii));
}

}  // namespace

void AddStatsCommand(Commands& commands) {
  const auto flags = std::make_shared<StatsFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* stats =
      commands.Add("stats", "Charts of the store over time: sessions, failures, disk, quality of the fits",
                   [&common, flags] { return RunStats(common, *flags); });
  stats->add_option("--since", flags->since, "first day: 2026-11-21, or 30d ago (default)");
  stats->add_option("--until", flags->until, "last day (default: today)");
  stats->add_option("--html", flags->html, "write one page with the charts to this file");
  stats->footer(R"(Examples:
  stratalux-db stats
  stratalux-db stats --since 26w
  stratalux-db stats --html stats.html && xdg-open stats.html
Block characters on a UTF-8 terminal, plain ASCII elsewhere. Days are UTC.)");
}

}  // namespace stratalux::db
