// SPDX-License-Identifier: Apache-2.0
#include "tests/db/mutants/mutators.h"

#include <limits>

#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "db/base/sqlite.h"
#include "tests/db/mutants/mutation.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using Bytes = std::vector<uint8_t>;

Mutant MoveFiles(const fs::path& folder, Random& random) {
  const auto files = MutableFiles(folder);
  const fs::path file = OneOf(files, random);
  const std::string name = Short(folder, file);
  if (Below(random, 2) == 0) {
    fs::remove(file);
    return {name + " deleted", name, HasHash(file)};
  }
  if (Below(random, 3) == 0 && file.extension() == ".seg") {
    const fs::path copy = file.parent_path() / ("frames-000" + std::to_string(1 + Below(random, 9)) + ".seg");
    const bool replaced = fs::exists(copy);
    if (copy != file) fs::copy_file(file, copy, fs::copy_options::overwrite_existing);
    return {name + " copied to " + copy.filename().string(), name, copy != file && replaced};
  }
  std::vector<fs::path> alike;
  for (const fs::path& other : files)
    if (other != file && other.extension() == file.extension()) alike.push_back(other);
  if (alike.empty()) return ChangeBytes(folder, random);
  const fs::path other = OneOf(alike, random);
  const Bytes one = ReadBytes(file), two = ReadBytes(other);
  WriteBytes(file, two);
  WriteBytes(other, one);
  return {name + " and " + Short(folder, other) + " swapped", name, one != two && (HasHash(file) || HasHash(other))};
}

// --- JSON -----------------------------------------------------------------------------------------------------------

Json OtherValue(const Json& now, const std::string& key, Random& random) {
  if (key == "schema" && Below(random, 2) == 0) return now.is_number() ? Json(now.get<int64_t>() + 1) : Json(99);
  const Json values[] = {Json(),
                         Json(true),
                         Json(-1),
                         Json(0),
                         Json(1e300),
                         Json(~uint64_t{0}),
                         Json(std::numeric_limits<int64_t>::min()),
                         Json(uint64_t{0} - 320),
                         Json(""),
                         Json("other"),
                         Json("../../etc/passwd"),
                         Json(std::string(3000, 'x')),
                         Json::array(),
                         Json::array({1, "two", nullptr}),
                         Json::object(),
                         Json({{"a", 1}})};
  if (now.is_number_integer() && Below(random, 2) == 0) return now.get<int64_t>() + 1;
  if (now.is_string() && Below(random, 3) == 0) return now.get<std::string>() + "x";
  return values[Below(random, std::size(values))];
}

// Some member somewhere in `json`, changed; its path.
std::string ChangeMember(Json& json, Random& random) {
  Json* node = &json;
  std::string path;
  for (int depth = 0; depth < 6; ++depth) {
    if (!node->is_structured() || node->empty()) break;
    const size_t which = Below(random, node->size());
    auto member = node->begin();
    std::advance(member, static_cast<std::ptrdiff_t>(which));
    const std::string key = node->is_object() ? member.key() : std::to_string(which);
    path += "/" + key;
    if (member->is_structured() && !member->empty() && Below(random, 4) != 0) {
      node = &*member;
      continue;
    }
    if (Below(random, 6) == 0)
      node->erase(member);
    else
      *member = OtherValue(*member, key, random);
    return path;
  }
  json = OtherValue(json, "", random);
  return "/";
}

// A line of the ledger: changed, gone, twice or with another.
Mutant ChangeLedger(const fs::path& folder, Random& random) {
  const auto files = FilesOf(folder, ".jsonl");
  if (files.empty()) return ChangeBytes(folder, random);
  const fs::path file = OneOf(files, random);
  const Bytes bytes = ReadBytes(file);
  std::vector<std::string> lines(1);
  for (const uint8_t byte : bytes) {
    lines.back() += static_cast<char>(byte);
    if (byte == '\n') lines.emplace_back();
  }
  lines.pop_back();
  if (lines.empty()) return ChangeBytes(folder, random);
  const size_t at = Below(random, lines.size()), other = Below(random, lines.size());
  std::string what = "line " + std::to_string(at + 1) + " of " + Short(folder, file);
  switch (Below(random, 5)) {
    case 0:
      lines.erase(lines.begin() + static_cast<std::ptrdiff_t>(at));
      what += " deleted";
      break;
    case 1:
      lines.insert(lines.begin() + static_cast<std::ptrdiff_t>(other), std::string(lines[at]));
      what += " twice";
      break;
    case 2:
      std::swap(lines[at], lines[other]);
      what += " and line " + std::to_string(other + 1) + " swapped";
      break;
    default: {
      Json json = Json::parse(lines[at], nullptr, false);
      if (!json.is_structured()) return ChangeBytes(folder, random);
      what += ", " + ChangeMember(json, random);
      lines[at] = json.dump() + "\n";
    }
  }
  std::string text;
  for (const std::string& line : lines) text += line;
  WriteText(file, text);
  return {what, Short(folder, file), text != std::string(bytes.begin(), bytes.end())};
}

Mutant ChangeJson(const fs::path& folder, Random& random) {
  if (Below(random, 5) == 0) return ChangeLedger(folder, random);
  auto files = FilesOf(folder, ".json");
  if (Below(random, 2) == 0) files = FilesOf(folder, "manifest.json");
  if (files.empty()) return ChangeBytes(folder, random);
  const fs::path file = OneOf(files, random);
  const Bytes bytes = ReadBytes(file);
  const std::string before(bytes.begin(), bytes.end());
  Json json = Json::parse(before, nullptr, false);
  if (json.is_discarded()) return ChangeBytes(folder, random);
  const Json was = json;
  const bool is_manifest = file.filename() == "manifest.json", had_hash = CheckOwnHash(before) == OwnHash::kRight;
  const std::string path = ChangeMember(json, random);
  const bool anew = had_hash && json.is_object() && Below(random, 2) == 0;
  std::string text;
  if (anew) {
    json.erase("hash");
    text = json.empty() ? "{}\n" : WithOwnHash(json.dump(1));
  } else {
    text = json.dump(1) + "\n";
    if (Below(random, 12) == 0) text.insert(text.size() / 2, "\xff\xfe");
  }
  WriteText(file, text);
  Mutant mutant{path + " of " + Short(folder, file) + (anew ? ", its hash made anew" : ""), Short(folder, file),
                had_hash && !anew};
  if (anew && is_manifest && Below(random, 2) == 0) {
    const std::string id = file.parent_path().filename();
    mutant.consistent = json != was && EnterAgain(folder, id);
    mutant.what += mutant.consistent ? ", its rows made anew" : "";
  }
  return mutant;
}

// --- the index ------------------------------------------------------------------------------------------------------

std::vector<std::string> Column(Connection& connection, const std::string& sql) {
  std::vector<std::string> values;
  auto select = connection.Prepare(sql);
  while (select.ok()) {
    const auto more = select->Step();
    if (!more.ok() || !*more) break;
    values.push_back(select->Text(0));
  }
  return values;
}

Mutant ChangeDatabase(const fs::path& folder, const std::string& name, Random& random) {
  auto connection = Connection::Open(folder / name, Connection::Mode::kReadWrite);
  if (!connection.ok() || !connection->Execute("PRAGMA foreign_keys = OFF; PRAGMA ignore_check_constraints = ON").ok())
    return ChangeBytes(folder, random);
  if (Below(random, 20) == 0) {
    const std::vector<std::string> statements = {"DROP VIEW session_overview",
                                                 "DROP VIEW session_findings",
                                                 "DROP INDEX frames_by_step",
                                                 "DROP INDEX sessions_by_visit",
                                                 "PRAGMA user_version = " + std::to_string(kSchemaVersion + 1),
                                                 "PRAGMA user_version = 5",
                                                 "PRAGMA application_id = 5",
                                                 "DELETE FROM sqlite_sequence",
                                                 "ALTER TABLE frames ADD COLUMN x TEXT",
                                                 "DROP TABLE metrics",
                                                 "CREATE VIEW v AS SELECT 1"};
    const std::string& statement = OneOf(statements, random);
    (void)connection->Execute(statement).ok();
    return {statement, name, false};
  }
  const auto tables = Column(*connection,
                             "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite\\_%' ESCAPE"
                             " '\\' AND name NOT IN ('jobs', 'job_fence', 'job_counts', 'access_log')");
  for (int attempt = 0; attempt < 50; ++attempt) {
    const std::string table = OneOf(tables, random);
    const auto columns = Column(*connection, "SELECT name FROM pragma_table_info('" + table + "')");
    const auto rows = connection->QueryInteger("SELECT count(*) FROM " + table);
    if (!rows.ok() || *rows == 0 || columns.empty()) continue;
    std::string row, literals;
    for (const std::string& column : columns)
      literals +=
          (literals.empty() ? "" : " || ' AND ' || ") + ("'\"" + column + "\" IS ' || quote(\"" + column + "\")");
    const auto found = Column(*connection, "SELECT " + literals + " FROM " + table + " LIMIT 1 OFFSET " +
                                               std::to_string(Below(random, static_cast<size_t>(*rows))));
    if (found.empty()) continue;
    const std::string column = OneOf(columns, random);
    const std::vector<std::string> values = {"NULL",
                                             "0",
                                             "1",
                                             "-1",
                                             "17",
                                             "9223372036854775807",
                                             "2.5",
                                             "9e999",
                                             "'other'",
                                             "'sweep'",
                                             "''",
                                             "x'00ff'",
                                             "CAST(x'fffe41' AS TEXT)",
                                             "zeroblob(16)",
                                             "\"" + column + "\" + 1",
                                             "\"" + column + "\" || 'x'"};
    std::string sql;
    if (Below(random, 8) == 0)
      sql = "DELETE FROM " + table + " WHERE " + found[0];
    else
      sql = "UPDATE " + table + " SET \"" + column + "\" = " + OneOf(values, random) + " WHERE " + found[0];
    if (connection->Execute(sql).ok()) return {name + ": " + sql.substr(0, 400), name, false};
  }
  return ChangeBytes(folder, random);
}

}  // namespace

Mutant Mutate(const SampleStore& sample, const fs::path& folder, Random& random) {
  if (sample.encrypted && Below(random, 3) == 0) return ChangeSealed(folder, random);
  switch (Below(random, 14)) {
    case 0:
    case 1:
    case 2:
      return ChangeBytes(folder, random);
    case 3:
      return MoveFiles(folder, random);
    case 4:
    case 5:
    case 6:
      return ChangeHeader(folder, random);
    case 7:
    case 8:
      return ChangePayload(folder, random);
    case 9:
    case 10:
      return ChangeJson(folder, random);
    default:
      // Keys are few and without rows of their own in most stores.
      return ChangeDatabase(folder, Below(random, 8) == 0 ? "keys.sqlite" : "index.sqlite", random);
  }
}

}  // namespace stratalux::db
