// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_fits.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <fstream>

#include <nlohmann/json.hpp>

#include "db/base/durable_file.h"
#include "db/catalogue/fit_metrics.h"
#include "db/interchange/crate_files.h"
#include "db/interchange/crate_frames.h"
#include "shared/base/json_nesting.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int64_t kTextLimit = int64_t{64} << 20;  // bytes; a longer file is looked through, not changed

// A letter or digit, or a part of one in UTF-8.
bool IsWordByte(char c) {
  return std::isalnum(static_cast<unsigned char>(c)) != 0 || (static_cast<unsigned char>(c) & 0x80U) != 0;
}

// Where `word` stands by itself, from `at` on; npos: nowhere.
size_t FindWord(std::string_view text, std::string_view word, size_t at) {
  for (at = text.find(word, at); at != std::string_view::npos; at = text.find(word, at + 1)) {
    const size_t end = at + word.size();
    if ((at == 0 || !IsWordByte(text[at - 1])) && (end == text.size() || !IsWordByte(text[end]))) return at;
  }
  return at;
}

std::string ReplaceWords(const std::string& text, const std::string& word, const std::string& by) {
  std::string replaced;
  size_t done = 0;
  for (size_t at = FindWord(text, word, 0); at != std::string::npos; at = FindWord(text, word, done)) {
    replaced += text.substr(done, at - done) + by;
    done = at + word.size();
  }
  return replaced + text.substr(done);
}

// "42" or "a" stands in many a file without meaning anybody.
bool IsDistinctive(const std::string& pseudonym) {
  return pseudonym.size() >= 3 &&
         std::any_of(pseudonym.begin(), pseudonym.end(), [](unsigned char c) { return std::isdigit(c) == 0; });
}

// Every text of the document, at most 64 levels deep; true if any changed.
bool ReplaceTexts(Json& json, const PseudonymChange& change) {
  bool changed = false;
  if (json.is_string()) {
    const auto text = json.get<std::string>();
    const std::string replaced = text == change.from          ? change.to
                                 : IsDistinctive(change.from) ? ReplaceWords(text, change.from, change.to)
                                                              : text;
    changed = replaced != text;
    if (changed) json = replaced;
  } else if (json.is_structured()) {
    for (Json& inner : json) changed |= ReplaceTexts(inner, change);
  }
  return changed;
}

bool HasSuffix(const fs::path& file, std::initializer_list<const char*> suffixes) {
  return std::any_of(suffixes.begin(), suffixes.end(), [&](const char* s) { return file.extension() == s; });
}

Result<bool> MentionsWord(const fs::path& file, const std::string& word) {
  std::ifstream in(file, std::ios::binary);
  std::string window;
  std::vector<char> piece(size_t{1} << 20);
  while (in.read(piece.data(), static_cast<std::streamsize>(piece.size())), in.gcount() > 0) {
    window.append(piece.data(), static_cast<size_t>(in.gcount()));
    if (FindWord(window, word, 0) != std::string::npos) return true;
    if (window.size() > word.size() + 1) window.erase(0, window.size() - word.size() - 1);
  }
  if (in.bad()) return Status::Failed("cannot read " + file.string());
  return false;
}

Status WriteWhole(const fs::path& file, const std::string& text) {
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out << text;
  out.close();
  return out.good() ? Status::Ok() : Status::Failed("cannot write " + file.string() + "; is the disk full?");
}

Status CopyBytes(const fs::path& from, const fs::path& to) {
  std::ifstream in(from, std::ios::binary);
  std::ofstream out(to, std::ios::binary | std::ios::trunc);
  std::vector<char> piece(size_t{1} << 20);
  while (in.read(piece.data(), static_cast<std::streamsize>(piece.size())), in.gcount() > 0)
    out.write(piece.data(), in.gcount());
  out.close();
  if (in.bad() || !in.eof()) return Status::Failed("cannot read " + from.string());
  return out.good() ? Status::Ok() : Status::Failed("cannot write " + to.string() + "; is the disk full?");
}

}  // namespace

std::vector<fs::path> FitFiles(const fs::path& folder) {
  std::vector<fs::path> files;
  std::error_code error;
  for (auto entry = fs::recursive_directory_iterator(folder, error);
       !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
    const fs::path name = entry->path().lexically_relative(folder);
    if (entry->path().extension() == ".partial") entry.disable_recursion_pending();
    if (fs::is_regular_file(entry->symlink_status(error)) && IsCratePath(name.string())) files.push_back(name);
  }
  std::sort(files.begin(), files.end());
  return files;
}

Result<CopiedFit> CopyFitFile(const fs::path& from, const fs::path& to, const PseudonymChange& change) {
  SLX_RETURN_IF_ERROR(MakeFolder(to.parent_path()));
  std::error_code error;
  const auto copy = [&]() -> Result<CopiedFit> {
    SLX_RETURN_IF_ERROR(CopyBytes(from, to));
    return CopiedFit::kCopied;
  };
  if (change.none()) return copy();
  const bool small = fs::file_size(from, error) <= static_cast<uintmax_t>(kTextLimit) && !error;
  if (small && to.extension() == ".json") {
    SLX_ASSIGN_OR_RETURN(const std::string text, ReadCrateFile(from, kTextLimit));
    Json json = CheckNesting(text).ok() ? Json::parse(text, nullptr, false) : Json(Json::value_t::discarded);
    if (!json.is_discarded()) {
      if (!ReplaceTexts(json, change)) return copy();
      SLX_RETURN_IF_ERROR(WriteWhole(to, json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n"));
      return CopiedFit::kCopied;
    }
  }
  const bool page = HasSuffix(to, {".html", ".htm"});
  if (!IsDistinctive(change.from)) return page ? Result<CopiedFit>(CopiedFit::kLeftOut) : copy();
  if (small && (page || HasSuffix(to, {".csv", ".txt", ".md", ".svg", ".toml", ".xml"}))) {
    SLX_ASSIGN_OR_RETURN(const std::string text, ReadCrateFile(from, kTextLimit));
    const std::string replaced = ReplaceWords(text, change.from, change.to);
    SLX_RETURN_IF_ERROR(WriteWhole(to, ReplaceWords(replaced, HtmlOf(change.from), change.to)));
    return CopiedFit::kCopied;
  }
  SLX_ASSIGN_OR_RETURN(const bool mentioned, MentionsWord(from, change.from));
  return mentioned ? Result<CopiedFit>(CopiedFit::kLeftOut) : copy();
}

std::string FitsCsv(const std::vector<FitRow>& fits) {
  std::string text = CsvLine({"fit", "created", "created_wall_ns", "calibration"});
  for (const FitRow& fit : fits)
    text += CsvLine({fit.id, ToIso8601(fit.created_wall), std::to_string(fit.created_wall.ns),
                     fit.calibration_json.empty() ? "no" : "yes"});
  return text;
}

std::string MetricsCsv(const std::vector<FitRow>& fits) {
  std::string text = CsvLine({"fit", "metric", "value"});
  for (const FitRow& fit : fits)
    for (const auto& [name, value] : FlattenMetrics(fit.metrics_json))
      text += CsvLine({fit.id, name, ShortestText(value)});
  return text;
}

}  // namespace stratalux::db
