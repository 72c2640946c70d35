// SPDX-License-Identifier: Apache-2.0
#include "shared/manual/manual.h"

#include <cstdlib>
#include <ctime>

#include "shared/base/version.h"
#include "shared/manual/command_table.h"
#include "shared/manual/completion.h"
#include "shared/manual/man_page.h"

namespace stratalux {
namespace {

std::string Date() {
  const char* epoch = std::getenv("SOURCE_DATE_EPOCH");
  const std::time_t now =
      epoch != nullptr ? static_cast<std::time_t>(std::strtoll(epoch, nullptr, 10)) : std::time(nullptr);
  std::tm utc{};
  gmtime_r(&now, &utc);
  char month[32];
  std::strftime(month, sizeof month, "%B", &utc);  // of the C locale, which no program of ours leaves
  return std::string(month) + " " + std::to_string(utc.tm_mday) + ", " + std::to_string(utc.tm_year + 1900);
}

}  // namespace

std::optional<std::string> AskedManual(const CLI::App& app, const std::string& program, int argc,
                                       const char* const* argv) {
  if (argc != 3 || std::string(argv[1]) != "manual") return std::nullopt;
  const std::string what = argv[2];
  const CommandEntry table = CommandTable(app, program);
  if (what == "man") return ManPage(table, kVersion, Date());
  if (what == "bash") return BashCompletion(table);
  if (what == "zsh") return ZshCompletion(table);
  if (what == "fish") return FishCompletion(table);
  return std::nullopt;
}

}  // namespace stratalux
