// SPDX-License-Identifier: Apache-2.0
#include "fitter/profiles/profile_csv.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iostream>
#include <map>
#include <numeric>
#include <optional>
#include <sstream>

#include "shared/base/printable.h"
#include "shared/base/standard_output.h"

namespace stratalux::fit {
namespace {

constexpr std::array<const char*, 5> kColumns = {"source", "incidence_deg", "exit_deg", "slit_mm", "u_mm"};
constexpr double kMaxAngleDeg = 89.0;
constexpr double kRegular = 0.02;  // of a step: what rounding to a few digits may do to u

std::string Trim(const std::string& text) {
  const size_t first = text.find_first_not_of(" \t\r");
  if (first == std::string::npos) return "";
  return text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
}

// Fields of one line, RFC 4180 quotes without line breaks inside. nullopt: a quote is left open.
std::optional<std::vector<std::string>> Split(const std::string& line) {
  std::vector<std::string> fields(1);
  bool quoted = false, was_quoted = false;
  for (size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (quoted && c == '"' && i + 1 < line.size() && line[i + 1] == '"') {
      fields.back() += line[++i];
    } else if (c == '"' && (quoted || Trim(fields.back()).empty())) {
      quoted = !quoted;
      was_quoted = true;
      if (quoted) fields.back().clear();
    } else if (c == ',' && !quoted) {
      if (!was_quoted) fields.back() = Trim(fields.back());
      was_quoted = false;
      fields.emplace_back();
    } else if (!(was_quoted && !quoted)) {
      fields.back() += c;  // spaces after a closing quote are dropped
    }
  }
  if (quoted) return std::nullopt;
  if (!was_quoted) fields.back() = Trim(fields.back());
  return fields;
}

Status At(const CsvTable& table, int line, const std::string& message) {
  return Status::Usage(table.name + ":" + std::to_string(line) + ": " + message);
}

Result<CsvTable> ReadTable(std::istream& in, const std::string& name) {
  CsvTable table;
  table.name = name;
  std::string text;
  for (int line = 1; std::getline(in, text); ++line) {
    if (line == 1 && text.starts_with("\xEF\xBB\xBF")) text.erase(0, 3);  // byte order mark
    const std::string trimmed = Trim(text);
    if (trimmed.empty() || trimmed[0] == '#') continue;
    auto fields = Split(text);
    if (!fields) return At(table, line, "a quote is not closed");
    if (table.header.empty()) {
      table.header = *fields;
      continue;
    }
    if (fields->size() != table.header.size())
      return At(table, line,
                std::to_string(fields->size()) + " fields, the header names " + std::to_string(table.header.size()));
    table.rows.push_back(std::move(*fields));
    table.line.push_back(line);
  }
  if (table.header.empty()) return Status::Usage(name + ": empty; the first line must name the columns");
  if (table.rows.empty()) return Status::Usage(name + ": no data after the header");
  return table;
}

Result<size_t> Column(const CsvTable& table, const std::string& name) {
  const auto count = std::count(table.header.begin(), table.header.end(), name);
  if (count == 0)
    return At(table, 1,
              "column '" + name + "' is missing; needed: source, incidence_deg, exit_deg, " +
                  "slit_mm, u_mm (and radiance to fit)");
  if (count > 1) return At(table, 1, "column '" + name + "' appears twice");
  return static_cast<size_t>(std::find(table.header.begin(), table.header.end(), name) - table.header.begin());
}

Result<double> Number(const CsvTable& table, size_t row, size_t column) {
  const std::string& text = table.rows[row][column];
  double value = 0.0;
  const char* begin = text.data() + (text.starts_with("+") ? 1 : 0);
  const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
    return At(table, table.line[row], table.header[column] + " = '" + text + "' is not a finite number");
  return value;
}

struct Row {
  double u = 0.0, radiance = 0.0;
  size_t row = 0;
};

// Sorts one source's rows by u and checks that they lie on a regular grid.
Status MakeRegular(const CsvTable& table, std::vector<Row>& rows, LineProfile& profile) {
  std::stable_sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) { return a.u < b.u; });
  profile.first_u_mm = rows.front().u;
  profile.samples = static_cast<int>(rows.size());
  if (rows.size() < 3)
    return At(table, table.line[rows[0].row],
              "source '" + profile.source + "' has " + std::to_string(rows.size()) + " samples, at least 3 are needed");
  profile.step_mm = (rows.back().u - rows.front().u) / static_cast<double>(rows.size() - 1);
  for (size_t k = 1; k < rows.size(); ++k)
    if (!(rows[k].u > rows[k - 1].u)) {
      std::ostringstream message;
      message << "source '" << profile.source << "': u_mm = " << rows[k].u << " appears twice";
      return At(table, table.line[rows[k].row], message.str());
    }
  bool regular = true;
  for (size_t k = 1; k < rows.size(); ++k)
    regular = regular && std::abs(rows[k].u - profile.first_u_mm - static_cast<double>(k) * profile.step_mm) <=
                             kRegular * profile.step_mm;
  if (regular) return Status::Ok();
  // Name the row that departs from the usual step.
  std::vector<double> steps;
  for (size_t k = 1; k < rows.size(); ++k) steps.push_back(rows[k].u - rows[k - 1].u);
  std::vector<double> sorted = steps;
  std::sort(sorted.begin(), sorted.end());
  const double usual = sorted[(sorted.size() - 1) / 2];
  size_t worst = 0;
  while (worst + 1 < steps.size() && std::abs(steps[worst] - usual) <= kRegular * usual) ++worst;
  std::ostringstream message;
  message << "source '" << profile.source << "': u_mm = " << rows[worst + 1].u << " breaks the regular step of "
          << usual << " mm (expected " << rows[worst].u + usual << "); resample the profile on a regular grid";
  return At(table, table.line[rows[worst + 1].row], message.str());
}

}  // namespace

Result<ProfileFile> ReadProfiles(const std::string& path, bool with_radiance) {
  ProfileFile file;
  if (path == "-") {
    SLX_ASSIGN_OR_RETURN(file.table, ReadTable(std::cin, "standard input"));
  } else {
    std::ifstream in(path);
    if (!in) return Status::NotFound(path + ": " + std::strerror(errno));
    SLX_ASSIGN_OR_RETURN(file.table, ReadTable(in, path));
  }
  const CsvTable& table = file.table;
  std::array<size_t, kColumns.size()> column{};
  for (size_t i = 0; i < kColumns.size(); ++i) {
    SLX_ASSIGN_OR_RETURN(column[i], Column(table, kColumns[i]));
  }
  size_t radiance_column = 0;
  if (with_radiance) {
    SLX_ASSIGN_OR_RETURN(radiance_column, Column(table, "radiance"));
  }
  std::map<std::string, size_t> index;
  std::vector<std::vector<Row>> rows;
  for (size_t r = 0; r < table.rows.size(); ++r) {
    LineProfile p;
    p.source = table.rows[r][column[0]];
    if (p.source.empty()) return At(table, table.line[r], "source is empty");
    if (!IsUtf8(p.source))
      return At(table, table.line[r], "source '" + Printable(p.source) + "' is not UTF-8; save the table as UTF-8");
    SLX_ASSIGN_OR_RETURN(p.incidence_deg, Number(table, r, column[1]));
    SLX_ASSIGN_OR_RETURN(p.exit_deg, Number(table, r, column[2]));
    SLX_ASSIGN_OR_RETURN(p.slit_mm, Number(table, r, column[3]));
    for (size_t k : {size_t{1}, size_t{2}}) {
      const double angle = k == 1 ? p.incidence_deg : p.exit_deg;
      if (std::abs(angle) > kMaxAngleDeg)
        return At(table, table.line[r],
                  std::string(kColumns[k]) + " = " + table.rows[r][column[k]] + ", allowed: -89 .. 89");
    }
    if (!(p.slit_mm > 0.0))
      return At(table, table.line[r], "slit_mm = " + table.rows[r][column[3]] + " must be positive");
    Row row;
    row.row = r;
    SLX_ASSIGN_OR_RETURN(row.u, Number(table, r, column[4]));
    if (with_radiance) {
      SLX_ASSIGN_OR_RETURN(row.radiance, Number(table, r, radiance_column));
    }
    const auto [at, is_new] = index.emplace(p.source, file.profiles.size());
    if (is_new) {
      file.profiles.push_back(p);
      rows.emplace_back();
    }
    const LineProfile& first = file.profiles[at->second];
    if (first.incidence_deg != p.incidence_deg || first.exit_deg != p.exit_deg || first.slit_mm != p.slit_mm)
      return At(
          table, table.line[r],
          "source '" + p.source + "' changes its incidence, exit or slit; give each geometry a source of its own");
    rows[at->second].push_back(row);
  }
  file.placement.resize(table.rows.size());
  for (size_t i = 0; i < file.profiles.size(); ++i) {
    SLX_RETURN_IF_ERROR(MakeRegular(table, rows[i], file.profiles[i]));
    for (size_t k = 0; k < rows[i].size(); ++k) {
      file.placement[rows[i][k].row] = {static_cast<int>(i), static_cast<int>(k)};
      if (with_radiance) file.profiles[i].radiance.push_back(rows[i][k].radiance);
    }
  }
  return file;
}

Status WriteProfiles(const std::string& path, const CsvTable& table, const std::vector<double>& radiance) {
  const auto old = std::find(table.header.begin(), table.header.end(), "radiance");
  const size_t skipped = static_cast<size_t>(old - table.header.begin());  // past the end: none
  std::ostringstream text;
  auto write = [&](const std::vector<std::string>& fields, const std::string& last) {
    for (size_t i = 0; i < fields.size(); ++i) {
      if (i == skipped) continue;
      const bool quote = fields[i].find_first_of(",\"") != std::string::npos;
      if (quote) text << '"';
      for (char c : fields[i]) text << (quote && c == '"' ? "\"\"" : std::string(1, c));
      text << (quote ? "\"," : ",");
    }
    text << last << '\n';
  };
  write(table.header, "radiance");
  for (size_t r = 0; r < table.rows.size(); ++r) {
    std::array<char, 32> number{};
    const auto end = std::to_chars(number.data(), number.data() + number.size(), radiance[r]).ptr;
    write(table.rows[r], std::string(number.data(), end));
  }
  if (path == "-") return WriteStdout(text.str());
  std::ofstream out(path, std::ios::trunc);
  out << text.str();
  out.flush();
  return out ? Status::Ok() : Status::Failed("cannot write " + path + ": " + std::strerror(errno));
}

}  // namespace stratalux::fit
