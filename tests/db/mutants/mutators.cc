// SPDX-License-Identifier: Apache-2.0
#include "tests/db/mutants/mutators.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>

#include <nlohmann/json.hpp>
#include <xxhash.h>

#include "db/base/own_hash.h"
#include "db/base/sqlite.h"
#include "db/care/session_rebuild.h"
#include "db/catalogue/manifest.h"
#include "db/segment/frame_codec.h"
#include "db/segment/pixel_hash.h"
#include "db/segment/segment.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using Bytes = std::vector<uint8_t>;

size_t Below(Random& random, size_t n) { return n == 0 ? 0 : random() % n; }
template <typename T>
const T& OneOf(const std::vector<T>& all, Random& random) {
  return all[Below(random, all.size())];
}

// Locks and what SQLite makes anew say nothing.
std::vector<fs::path> FilesOf(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    const std::string name = entry.path().filename();
    if (!entry.is_regular_file() || name.ends_with(".lock") || name.ends_with("-shm") || name.ends_with("-wal") ||
        name == "lock" || name.ends_with("-journal"))
      continue;
    files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

std::vector<fs::path> FilesOf(const fs::path& folder, const std::string& ending) {
  auto files = FilesOf(folder);
  std::erase_if(files, [&ending](const fs::path& file) { return !file.string().ends_with(ending); });
  return files;
}

// A hash of its own, or one in the manifest or fit.json beside it.
bool HasHash(const fs::path& file) {
  const std::string name = file.filename();
  return name == "manifest.json" || name.ends_with(".seg") || name == "truth_calibration.json" ||
         name.ends_with(".jsonl") || name == "signature.json" || name == "backup.json" ||
         file.parent_path().parent_path().filename() == "fits";
}

std::string Short(const fs::path& folder, const fs::path& file) { return file.lexically_relative(folder).string(); }

// --- any file -------------------------------------------------------------------------------------------------------

Mutant ChangeBytes(const fs::path& folder, Random& random) {
  const fs::path file = OneOf(FilesOf(folder), random);
  Bytes bytes = ReadBytes(file);
  const std::string name = Short(folder, file);
  Mutant mutant{"", name, HasHash(file)};
  switch (Below(random, 6)) {
    case 0:
    case 1: {
      if (bytes.empty()) bytes.push_back(0);
      const size_t at = Below(random, bytes.size());
      bytes[at] = static_cast<uint8_t>(bytes[at] ^ (1U << Below(random, 8)));
      mutant.what = "a bit of " + name + " flipped at byte " + std::to_string(at);
      break;
    }
    case 2: {
      const size_t size = Below(random, bytes.size() + 1);
      bytes.resize(size);
      mutant.what = name + " cut to " + std::to_string(size) + " bytes";
      break;
    }
    case 3: {
      const size_t more = 1 + Below(random, 700);
      const bool zeros = Below(random, 2) == 0;
      for (size_t i = 0; i < more; ++i) bytes.push_back(zeros ? 0 : static_cast<uint8_t>(random()));
      mutant.what = name + " longer by " + std::to_string(more) + " bytes";
      break;
    }
    case 4:
      bytes.clear();
      mutant.what = name + " emptied";
      break;
    default: {
      const size_t at = Below(random, bytes.size()), size = Below(random, 64);
      for (size_t i = at; i < std::min(bytes.size(), at + size); ++i) bytes[i] = static_cast<uint8_t>(random());
      mutant.what = std::to_string(size) + " bytes of " + name + " random from byte " + std::to_string(at);
    }
  }
  WriteBytes(file, bytes);
  return mutant;
}

Mutant MoveFiles(const fs::path& folder, Random& random) {
  const auto files = FilesOf(folder);
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

// --- segments, hashes made anew up to a level -----------------------------------------------------------------------

enum class Level { kNone, kHeader, kFooter, kManifest, kIndex };

constexpr size_t kFooterStart = 16, kTrailer = 24;

class SegmentFile {
 public:
  explicit SegmentFile(fs::path file) : file_(std::move(file)), bytes_(ReadBytes(file_)) {
    const auto reader = SegmentReader::Open(file_);
    bool sealed = false;
    const auto frames = reader.ok() ? reader->Walk(false, &sealed) : reader.status();
    if (frames.ok()) frames_ = *frames;
    if (sealed) footer_ = static_cast<size_t>(reader->frames_end());
  }
  [[nodiscard]] std::vector<SegmentFrame>& frames() { return frames_; }
  // A stored hash that is left behind where hashes are made anew up to `level`. One that was never sealed has no
  // footer, and its manifest none to hash.
  [[nodiscard]] bool LeavesHash(Level level) const {
    return level < Level::kHeader || (footer_ != 0 && level < Level::kManifest);
  }
  [[nodiscard]] std::span<uint8_t> PayloadOf(const SegmentFrame& frame) {
    return std::span(bytes_).subspan(static_cast<size_t>(frame.offset) + sizeof(FrameHeader),
                                     frame.header.payload_bytes);
  }
  void Write(Level level) {
    for (size_t i = 0; i < frames_.size(); ++i) {
      FrameHeader& header = frames_[i].header;
      if (level >= Level::kHeader) header.header_hash = XXH3_64bits(&header, offsetof(FrameHeader, header_hash));
      std::memcpy(bytes_.data() + frames_[i].offset, &header, sizeof header);
      if (level >= Level::kFooter && footer_ != 0)
        std::memcpy(bytes_.data() + footer_ + kFooterStart + i * sizeof header, &header, sizeof header);
    }
    if (level >= Level::kFooter && footer_ != 0) {
      const uint64_t hash = XXH3_64bits(bytes_.data() + footer_, bytes_.size() - kTrailer - footer_);
      std::memcpy(bytes_.data() + bytes_.size() - sizeof hash, &hash, sizeof hash);
    }
    WriteBytes(file_, bytes_);
  }

 private:
  fs::path file_;
  Bytes bytes_;
  std::vector<SegmentFrame> frames_;
  size_t footer_ = 0;
};

// The session's rows as its files now have them.
bool EnterAgain(const fs::path& store, const std::string& id) {
  auto index = SessionIndex::Open(store, AccessMode::kReadWrite);
  auto session = RebuildSession(store / "sessions" / id);
  if (!index.ok() || !session.ok()) return false;
  const auto number = index->NumberOf(id);
  if (!number.ok()) return false;
  auto transaction = Transaction::Begin(index->connection());
  auto remove = index->connection().Prepare("DELETE FROM sessions WHERE id = ?1");
  if (!transaction.ok() || !remove.ok() || !remove->Bind(1, id).Run().ok()) return false;
  return InsertRebuilt(*index, *session, *number).ok() && transaction->Commit().ok();
}

// What lies beyond the segment, up to `level`; true where nothing disagrees any more.
bool MakeAnew(const fs::path& store, const fs::path& segment, Level level) {
  const fs::path session = segment.parent_path();
  if (level < Level::kManifest) return false;
  const auto contents = ReadManifestContents(session);
  if (!contents.ok() || !ReplaceSegments(session, contents->segments).ok()) return false;
  return level == Level::kIndex && EnterAgain(store, session.filename());
}

struct Field {
  const char* name;
  size_t offset, size;
  bool real = false;
};
constexpr Field kFields[] = {{"magic", 0, 4},
                             {"header_bytes", 4, 4},
                             {"frame", 8, 8},
                             {"step", 16, 4},
                             {"projector", 20, 4},
                             {"bracket", 24, 4},
                             {"pose", 28, 4},
                             {"retry", 32, 4},
                             {"phase", 36, 4},
                             {"trigger_number", 40, 8},
                             {"trigger_ns", 48, 8},
                             {"sync_ns", 56, 8},
                             {"driver_sequence", 64, 8},
                             {"frame_ns", 72, 8},
                             {"exposure_ms", 80, 8, true},
                             {"gain", 88, 8, true},
                             {"mean_dn", 96, 8, true},
                             {"frame_clock", 104, 2},
                             {"level_check", 106, 2},
                             {"format", 108, 2},
                             {"cfa", 110, 2},
                             {"codec", 112, 2},
                             {"cipher", 114, 2},
                             {"width", 116, 4},
                             {"height", 120, 4},
                             {"channels", 124, 4},
                             {"crop_x", 128, 4},
                             {"crop_y", 132, 4},
                             {"key_id", 136, 16},
                             {"nonce", 152, 24},
                             {"pattern", 176, 64},
                             {"payload_bytes", 240, 8},
                             {"payload_hash", 248, 16},
                             {"retake_cause", 264, 32},
                             {"pixel_hash", 296, 16}};

void ChangeField(const Field& field, uint8_t* at, Random& random) {
  if (field.real) {
    const double values[] = {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), -1.0,
                             1e300, 17.25};
    std::memcpy(at, &values[Below(random, std::size(values))], sizeof(double));
    return;
  }
  if (field.size > 8) {
    at[Below(random, field.size)] = static_cast<uint8_t>(random());
    return;
  }
  uint64_t value = 0;
  std::memcpy(&value, at, field.size);
  const uint64_t values[] = {value + 1,
                             value - 1,
                             0,
                             ~uint64_t{0},
                             uint64_t{0} - 320,
                             uint64_t{1} << 62,
                             value ^ (uint64_t{1} << Below(random, 8 * field.size)),
                             9,
                             random()};
  value = values[Below(random, std::size(values))];
  std::memcpy(at, &value, field.size);
}

Mutant ChangeHeader(const fs::path& folder, Random& random) {
  const auto segments = FilesOf(folder, ".seg");
  const fs::path file = OneOf(segments, random);
  SegmentFile segment(file);
  if (segment.frames().empty()) return ChangeBytes(folder, random);
  const size_t which = Below(random, segment.frames().size());
  FrameHeader& header = segment.frames()[which].header;
  const FrameHeader before = header;
  const Field& field = kFields[Below(random, std::size(kFields))];
  ChangeField(field, reinterpret_cast<uint8_t*>(&header) + field.offset, random);
  const auto level = static_cast<Level>(Below(random, 5));
  const bool changed = std::memcmp(&before, &header, sizeof header) != 0;
  segment.Write(level);
  const bool consistent = changed && MakeAnew(folder, file, level);
  return {std::string(field.name) + " of record " + std::to_string(which) + " in " + Short(folder, file) +
              ", hashes made anew to level " + std::to_string(static_cast<int>(level)),
          Short(folder, file), changed && segment.LeavesHash(level), consistent};
}

std::optional<PixelHash> PixelsOf(const FrameHeader& header, std::span<const uint8_t> payload) {
  FrameDecoder decoder;
  if (header.cipher != 0 || header.width < 1 || header.width > 64 || header.height < 1 || header.height > 64) return {};
  const auto image = decoder.Decode(ShapeOf(header), static_cast<Codec>(header.codec), payload);
  if (!image.ok()) return {};
  return HashPixels(static_cast<PixelFormat>(header.format), std::as_const(*image).pixels(), nullptr);
}

// Other pixels, or none that can be decoded; some bits of a compressed payload mean nothing.
Mutant ChangePayload(const fs::path& folder, Random& random) {
  const fs::path file = OneOf(FilesOf(folder, ".seg"), random);
  SegmentFile segment(file);
  if (segment.frames().empty()) return ChangeBytes(folder, random);
  const size_t which = Below(random, segment.frames().size());
  SegmentFrame& frame = segment.frames()[which];
  const auto payload = segment.PayloadOf(frame);
  if (payload.empty()) return ChangeBytes(folder, random);
  const Bytes before(payload.begin(), payload.end());
  switch (Below(random, 3)) {
    case 0:
      payload[Below(random, payload.size())] ^= static_cast<uint8_t>(1 + Below(random, 255));
      break;
    case 1:
      std::generate(payload.begin(), payload.end(), [&] { return static_cast<uint8_t>(random()); });
      break;
    default:
      std::fill(payload.begin(), payload.end(), uint8_t{0});
  }
  const bool changed = !std::equal(before.begin(), before.end(), payload.begin());
  const auto level = static_cast<Level>(Below(random, 5));
  const bool pixels = Below(random, 2) == 0;
  FrameHeader& header = frame.header;
  const PixelHash hash = PixelHashOf(header);
  const auto decoded = PixelsOf(header, payload);
  if (level >= Level::kHeader) {
    XXH128_canonical_t canonical;
    XXH128_canonicalFromHash(&canonical, XXH3_128bits(payload.data(), payload.size()));
    std::memcpy(header.payload_hash, canonical.digest, sizeof header.payload_hash);
    if (pixels && decoded) SetPixelHash(header, *decoded);
  }
  const bool told = PixelHashOf(header) != hash;
  const bool fits = decoded == PixelHashOf(header);
  segment.Write(level);
  const bool anew = changed && MakeAnew(folder, file, level);
  return {"payload of record " + std::to_string(which) + " in " + Short(folder, file) + ", hashes made anew to level " +
              std::to_string(static_cast<int>(level)) + (told ? ", and that of the pixels" : ""),
          Short(folder, file), changed && (segment.LeavesHash(level) || !fits), anew && told};
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
    const std::vector<std::string> statements = {
        "DROP VIEW session_overview",   "DROP VIEW session_findings",  "DROP INDEX frames_by_step",
        "DROP INDEX sessions_by_visit", "PRAGMA user_version = 8",     "PRAGMA user_version = 5",
        "PRAGMA application_id = 5",    "DELETE FROM sqlite_sequence", "ALTER TABLE frames ADD COLUMN x TEXT",
        "DROP TABLE metrics",           "CREATE VIEW v AS SELECT 1"};
    const std::string& statement = OneOf(statements, random);
    (void)connection->Execute(statement).ok();
    return {statement, name, false};
  }
  const auto tables = Column(*connection,
                             "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite\\_%' ESCAPE"
                             " '\\' AND name NOT IN ('jobs', 'job_fence', 'access_log')");
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

std::vector<fs::path> MutableFiles(const fs::path& folder) { return FilesOf(folder); }

Mutant Mutate(const SampleStore&, const fs::path& folder, Random& random) {
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
