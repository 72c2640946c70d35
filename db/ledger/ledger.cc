// SPDX-License-Identifier: Apache-2.0
#include "db/ledger/ledger.h"

#include <algorithm>

#include "db/ledger/ledger_folder.h"
#include "db/ledger/old_tombstones.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kProblemsShown = 5;  // of one chain

// Whole lines, and what stands behind the last newline.
struct Lines {
  std::vector<std::string_view> ended;
  std::string_view torn;
};
Lines SplitLines(std::string_view bytes) {
  Lines lines;
  for (size_t at = 0; at < bytes.size();) {
    const size_t newline = bytes.find('\n', at);
    if (newline == std::string_view::npos) {
      lines.torn = bytes.substr(at);
      break;
    }
    lines.ended.push_back(bytes.substr(at, newline - at));
    at = newline + 1;
  }
  return lines;
}

// Entries that stand in a line which is none, as where a newline was lost.
std::vector<LedgerEntry> Salvage(std::string_view line) {
  constexpr std::string_view kStart = "{\"schema\":";
  std::vector<LedgerEntry> entries;
  for (size_t at = line.find(kStart); at != std::string_view::npos;) {
    const size_t next = line.find(kStart, at + 1);
    const std::string_view piece = line.substr(at, next == std::string_view::npos ? next : next - at);
    const size_t end = piece.rfind('}');
    if (end != std::string_view::npos)
      if (auto parsed = ParseLine(piece.substr(0, end + 1)); parsed.entry) entries.push_back(std::move(*parsed.entry));
    at = next;
  }
  return entries;
}

Status Newer(const fs::path& file, int64_t line) {
  return Status(StatusCode::kNewerSchema, file.string() + ", line " + std::to_string(line) +
                                              ": written by a later version; use a newer stratalux");
}

}  // namespace

// Builds a Ledger from what the files say.
class LedgerReader {
 public:
  void Add(const ChainFile& chain, bool own);
  void Bind(LedgerEntry entry);
  void Problem(const std::string& text) { ledger_.problems_.push_back(text); }
  [[nodiscard]] Result<Ledger> Finish() && {
    if (!unread_.ok()) return unread_;
    return std::move(ledger_);
  }

 private:
  void CheckPlace(const LedgerLine& line, const LedgerLine& before, const std::string& where);

  Ledger ledger_;
  Status unread_;        // a chain of a later version, or one that cannot be read: who knows whom it forgets
  int64_t damaged_ = 0;  // lines of the chain at hand
};

void LedgerReader::Bind(LedgerEntry entry) {
  for (const std::string& id : entry.sessions) {
    if (entry.kind == LedgerKind::kWithdrawal) {
      const auto [at, fresh] = ledger_.withdrawn_.emplace(id, entry.at);
      if (!fresh) at->second.ns = std::min(at->second.ns, entry.at.ns);
    }
    if (entry.kind == LedgerKind::kForgetting) ledger_.forgotten_.try_emplace(id);
    if (entry.kind == LedgerKind::kForgotten) ledger_.forgotten_[id] = entry.detail_json;
  }
  ledger_.entries_.push_back(std::move(entry));
}

// The line after a damaged one follows nobody knows what.
void LedgerReader::CheckPlace(const LedgerLine& line, const LedgerLine& before, const std::string& where) {
  if (line.state == LineState::kDamaged || before.state == LineState::kDamaged) return;
  if (line.n != before.n + 1 || line.prev != before.hash)
    Problem(where + ": does not follow entry " + std::to_string(before.n) +
            ": lines were removed, moved or inserted; what it says still counts");
}

void LedgerReader::Add(const ChainFile& chain, bool own) {
  const auto bytes = ReadChain(chain.path);
  if (bytes.status().code() == StatusCode::kIntegrity) return Problem(bytes.status().message());
  if (!bytes.ok()) {
    if (unread_.ok()) unread_ = bytes.status();
    return;
  }
  const Lines lines = SplitLines(*bytes);
  damaged_ = 0;
  LedgerLine before;
  before.state = LineState::kWhole;
  before.hash = ChainStart(chain.store_id);
  int64_t number = 0;
  auto add = [&](std::string_view text, bool torn) {
    const std::string where = chain.path.string() + ", line " + std::to_string(++number);
    LedgerLine line = ParseLine(text);
    if (torn && own && line.state == LineState::kDamaged) return;  // never acknowledged: the next append cuts it
    if (line.state == LineState::kNewer && unread_.ok()) unread_ = Newer(chain.path, number);
    CheckPlace(line, before, where);
    std::vector<LedgerEntry> readable;
    if (line.entry) readable.push_back(std::move(*line.entry));
    if (line.state == LineState::kDamaged) {
      if (readable.empty()) readable = Salvage(text);
      if (++damaged_ <= kProblemsShown)
        Problem(where + ": damaged, it does not match its hash; " +
                (readable.empty() ? "it cannot be read" : "what can be read of it still counts"));
    }
    for (LedgerEntry& entry : readable) Bind(std::move(entry));
    before = std::move(line);
  };
  for (const std::string_view text : lines.ended) add(text, false);
  if (!lines.torn.empty()) add(lines.torn, true);
  if (damaged_ > kProblemsShown)
    Problem(chain.path.string() + ": " + std::to_string(damaged_) + " damaged lines in all");
}

namespace {

Status AddFolder(const fs::path& folder, LedgerReader& reader) {
  SLX_ASSIGN_OR_RETURN(const std::vector<ChainFile> chains, ListChains(folder));
  const auto own = StoreIdIn(folder);
  if (!own.ok() && own.status().code() != StatusCode::kNotFound) reader.Problem(own.status().message());
  for (const ChainFile& chain : chains) {
    const bool is_own = own.ok() && chain.path.stem() == *own;
    if (chain.path.stem() != chain.store_id)
      reader.Problem(chain.path.string() + " differs from " + chain.store_id +
                     ".jsonl: the store was copied by hand and written to in both places; both count");
    reader.Add(chain, is_own);
  }
  return Status::Ok();
}

// Forgettings of stores before the ledger, until the first opening that may write takes them over.
Status AddTombstones(const fs::path& store, LedgerReader& reader) {
  SLX_ASSIGN_OR_RETURN(auto all, ReadOldTombstones(store));
  for (OldTombstone& old : all) reader.Bind(std::move(old.entry));
  return Status::Ok();
}

}  // namespace

Result<Ledger> Ledger::Read(const fs::path& store) {
  LedgerReader reader;
  SLX_RETURN_IF_ERROR(AddTombstones(store, reader));
  SLX_RETURN_IF_ERROR(AddFolder(LedgerFolder(store), reader));
  return std::move(reader).Finish();
}

Result<Ledger> Ledger::ReadFolder(const fs::path& folder) {
  LedgerReader reader;
  SLX_RETURN_IF_ERROR(AddFolder(folder, reader));
  return std::move(reader).Finish();
}

Result<LedgerNews> ReadLedgerNews(const fs::path& store, const std::map<std::string, int64_t>& heads) {
  LedgerNews news;
  SLX_ASSIGN_OR_RETURN(const std::vector<ChainFile> chains, ListChains(LedgerFolder(store)));
  for (const ChainFile& chain : chains) {
    const std::string name = chain.path.filename().string();
    std::error_code error;
    if (!fs::is_regular_file(fs::symlink_status(chain.path, error))) continue;  // Read() names it
    const auto size = static_cast<int64_t>(fs::file_size(chain.path, error));
    const auto head = heads.find(name);
    int64_t from = head == heads.end() ? 0 : head->second;
    news.heads[name] = from;
    if (from == size && !error) continue;
    if (from > size) from = 0;
    SLX_ASSIGN_OR_RETURN(const std::string bytes, ReadChain(chain.path));
    const auto lines = SplitLines(std::string_view(bytes).substr(std::min(bytes.size(), static_cast<size_t>(from))));
    for (const std::string_view text : lines.ended) {
      LedgerLine line = ParseLine(text);
      if (line.state == LineState::kNewer) return Newer(chain.path, line.n);
      if (line.entry) news.entries.push_back(std::move(*line.entry));
    }
    news.heads[name] = static_cast<int64_t>(bytes.size() - lines.torn.size());
  }
  news.changed = news.heads != heads;
  return news;
}

bool Ledger::IsForgotten(const std::string& session_id) const { return forgotten_.contains(session_id); }

std::optional<WallNs> Ledger::WithdrawnAt(const std::string& session_id) const {
  const auto found = withdrawn_.find(session_id);
  return found == withdrawn_.end() ? std::nullopt : std::optional(found->second);
}

}  // namespace stratalux::db
