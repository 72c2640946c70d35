// SPDX-License-Identifier: Apache-2.0
#include "db/apps/table_output.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <set>

#include <nlohmann/json.hpp>

#include "db/apps/display_text.h"
#include "shared/base/json_nesting.h"
#include "shared/units/time.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

bool IsNumber(const Cell& cell) {
  return std::holds_alternative<int64_t>(cell) || std::holds_alternative<double>(cell);
}

std::string HexOf(const Blob& bytes) {
  std::string text;
  char pair[3];
  for (const uint8_t byte : bytes) {
    std::snprintf(pair, sizeof pair, "%02x", byte);
    text += pair;
  }
  return text;
}

// The fewest digits that read back as the same number.
std::string RealText(double value) {
  char text[40];
  const auto end = std::to_chars(text, text + sizeof text, value).ptr;
  return {text, end};
}

std::string RoundedText(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

Json ForPrograms(const Cell& cell, ColumnKind kind) {
  if (std::holds_alternative<std::monostate>(cell)) return nullptr;
  if (const auto* integer = std::get_if<int64_t>(&cell)) {
    if (kind == ColumnKind::kWallTime) return ToIso8601({*integer});
    if (kind == ColumnKind::kBoolean) return *integer != 0;
    return *integer;
  }
  if (const auto* real = std::get_if<double>(&cell)) return *real;
  if (const auto* bytes = std::get_if<Blob>(&cell)) return HexOf(*bytes);
  const auto& text = std::get<std::string>(cell);
  if (kind != ColumnKind::kJson || !CheckNesting(text).ok()) return text;
  const Json nested = Json::parse(PrintableJson(text), nullptr, false);
  return nested.is_discarded() ? Json(text) : nested;
}

std::string Quoted(const std::string& text) {
  if (!text.empty() && text.find_first_of(",\"\r\n") == std::string::npos && text.front() != ' ' && text.back() != ' ')
    return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string CsvField(const Cell& cell, ColumnKind kind) {
  if (std::holds_alternative<std::monostate>(cell)) return "";
  if (const auto* integer = std::get_if<int64_t>(&cell))
    return kind == ColumnKind::kWallTime ? ToIso8601({*integer}) : std::to_string(*integer);
  if (const auto* real = std::get_if<double>(&cell)) return RealText(*real);
  if (const auto* bytes = std::get_if<Blob>(&cell)) return Quoted(HexOf(*bytes));
  return Quoted(std::get<std::string>(cell));
}

std::vector<std::string> UniqueNames(const ResultTable& table) {
  std::vector<std::string> names;
  std::set<std::string> taken;
  for (const Column& column : table.columns) {
    std::string name = column.name;
    for (int i = 2; !taken.insert(name).second; ++i) name = column.name + "_" + std::to_string(i);
    names.push_back(name);
  }
  return names;
}

// A column of the table for people: its cells as text, their width, their side.
struct TextColumn {
  std::vector<std::string> cells;  // the header first
  int width = 0;
  bool right = false;
};

constexpr int kWidest = 120;

TextColumn TextColumnOf(const ResultTable& table, size_t c) {
  TextColumn out;
  out.cells.push_back(Printable(table.columns[c].name));
  const ColumnKind kind = table.columns[c].kind;
  bool numbers = false, others = false;
  for (const auto& row : table.rows) {
    out.cells.push_back(CellForPeople(row[c], kind));
    if (std::holds_alternative<std::monostate>(row[c])) continue;
    (IsNumber(row[c]) && kind != ColumnKind::kWallTime ? numbers : others) = true;
  }
  // One long text must not make every row as wide: it stands out instead.
  for (const std::string& cell : out.cells) out.width = std::max(out.width, std::min(DisplayWidth(cell), kWidest));
  out.right = numbers && !others;
  return out;
}

}  // namespace

std::string CellForPeople(const Cell& cell, ColumnKind kind) {
  if (std::holds_alternative<std::monostate>(cell)) return "-";
  if (const auto* integer = std::get_if<int64_t>(&cell)) {
    if (kind == ColumnKind::kWallTime) return ToIso8601({*integer});
    if (kind == ColumnKind::kBytes) return SizeText(*integer);
    if (kind == ColumnKind::kBoolean) return *integer != 0 ? "yes" : "no";
    return std::to_string(*integer);
  }
  if (const auto* real = std::get_if<double>(&cell))
    return RoundedText(kind == ColumnKind::kDays ? "%.1f" : "%.6g", *real);
  if (const auto* bytes = std::get_if<Blob>(&cell)) return HexOf(*bytes);
  const auto& text = std::get<std::string>(cell);
  return text.empty() ? "-" : Printable(text);
}

std::string TableAsText(const ResultTable& table) {
  std::vector<TextColumn> columns;
  for (size_t c = 0; c < table.columns.size(); ++c)
    if (table.columns[c].place == ColumnPlace::kEverywhere) columns.push_back(TextColumnOf(table, c));
  std::string text;
  for (size_t r = 0; r <= table.rows.size(); ++r) {
    std::string line;
    for (const TextColumn& column : columns) {
      const std::string& cell = column.cells[r];
      const std::string padding(static_cast<size_t>(std::max(0, column.width - DisplayWidth(cell))), ' ');
      line += (line.empty() ? "" : "  ") + (column.right ? padding + cell : cell + padding);
    }
    line.erase(line.find_last_not_of(' ') + 1);
    text += line + "\n";
  }
  return table.rows.empty() ? text + "(none)\n" : text;
}

std::string TableAsJson(const ResultTable& table) {
  const auto names = UniqueNames(table);
  Json json = Json::array();
  for (const auto& row : table.rows) {
    Json object = Json::object();
    for (size_t c = 0; c < row.size(); ++c) object[names[c]] = ForPrograms(row[c], table.columns[c].kind);
    json.push_back(std::move(object));
  }
  return PrintableJson(json.dump(2, ' ', false, Json::error_handler_t::replace)) + "\n";
}

std::string TableAsCsv(const ResultTable& table) {
  std::string text;
  const auto add_line = [&text](const std::vector<std::string>& fields) {
    for (size_t c = 0; c < fields.size(); ++c) text += (c > 0 ? "," : "") + fields[c];
    text += "\r\n";
  };
  std::vector<std::string> fields;
  for (const std::string& name : UniqueNames(table)) fields.push_back(Quoted(name));
  add_line(fields);
  for (const auto& row : table.rows) {
    for (size_t c = 0; c < row.size(); ++c) fields[c] = CsvField(row[c], table.columns[c].kind);
    add_line(fields);
  }
  return text;
}

}  // namespace stratalux::db
