// SPDX-License-Identifier: Apache-2.0
// Chains of other stores, and of this one as it was elsewhere.
#include <algorithm>
#include <set>
#include <sstream>

#include "db/base/durable_file.h"
#include "db/ledger/ledger_folder.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

struct Chain {
  ChainFile file;
  std::string bytes;  // up to the last newline
  int64_t damaged_lines = 0, gaps = 0;
};

int64_t LinesIn(std::string_view bytes) { return std::count(bytes.begin(), bytes.end(), '\n'); }

// Whole lines, one of them readable: other bytes are no chain. kNewerSchema where a line is of a later version, kFailed
// where the file cannot be read.
Result<Chain> ReadSource(const ChainFile& file) {
  Chain chain{file, {}};
  SLX_ASSIGN_OR_RETURN(chain.bytes, ReadChain(file.path));
  const size_t torn_at = chain.bytes.rfind('\n') + 1;  // 0 where there is none
  const auto torn = ParseLine(std::string_view(chain.bytes).substr(torn_at));
  if (torn.state == LineState::kDamaged) {
    chain.bytes.resize(torn_at);
  } else {
    chain.bytes += '\n';
  }
  bool readable = chain.bytes.empty(), after_whole = true;
  int64_t n = 0;
  std::string hash = ChainStart(file.store_id);
  for (size_t at = 0; at < chain.bytes.size();) {
    const size_t newline = chain.bytes.find('\n', at);
    const LedgerLine line = ParseLine(std::string_view(chain.bytes).substr(at, newline - at));
    if (line.state == LineState::kNewer)
      return Status(StatusCode::kNewerSchema,
                    file.path.string() + ": written by a later version; use a newer stratalux to take it over");
    readable |= line.entry.has_value();
    const bool whole = line.state != LineState::kDamaged;
    chain.damaged_lines += whole ? 0 : 1;
    chain.gaps += whole && after_whole && (line.n != n + 1 || line.prev != hash) ? 1 : 0;
    after_whole = whole;
    n = line.n;
    hash = line.hash;
    at = newline + 1;
  }
  if (!readable) return Status::Integrity(file.path.string() + " holds no entry that can be read and was left out");
  return chain;
}

// <id>.fork-<16 digits of the hash of the first line that departs>.jsonl: the same name however long the fork grows.
fs::path ForkName(const fs::path& folder, const Chain& source, const std::string& main) {
  const auto differ = std::mismatch(source.bytes.begin(), source.bytes.end(), main.begin(), main.end());
  const auto offset = static_cast<size_t>(differ.first - source.bytes.begin());
  const size_t before = offset == 0 ? std::string::npos : source.bytes.rfind('\n', offset - 1);
  const size_t start = before == std::string::npos ? 0 : before + 1;
  const std::string line = source.bytes.substr(start, source.bytes.find('\n', start) - start);
  return folder / (source.file.store_id + ".fork-" + LedgerHash(line).substr(0, 16) + ".jsonl");
}

// A damaged copy of what is here: lines taken out or moved, none that stands in no file of the chain.
bool SaysNothingNew(const Chain& source, const std::set<std::string>& lines_here) {
  std::istringstream lines(source.bytes);
  for (std::string line; std::getline(lines, line);)
    if (!lines_here.contains(line)) return false;
  return true;
}

Status Take(const fs::path& file, const Chain& source, size_t known_bytes, LedgerMerge& merge) {
  SLX_RETURN_IF_ERROR(ReplaceFile(file, source.bytes));
  merge.chains += known_bytes == 0 ? 1 : 0;
  merge.entries += LinesIn(std::string_view(source.bytes).substr(known_bytes));
  return Status::Ok();
}

// Among the files that one store's chain has here: one that holds the source already, one that it goes on, or none.
Status MergeOne(const fs::path& folder, const Chain& source, LedgerMerge& merge) {
  if (source.bytes.empty()) return Status::Ok();
  const fs::path main = folder / (source.file.store_id + ".jsonl");
  std::string main_bytes, longest_bytes;
  fs::path longest;
  std::set<std::string> lines_here;
  SLX_ASSIGN_OR_RETURN(const std::vector<ChainFile> chains, ListChains(folder));
  for (const ChainFile& file : chains) {
    if (file.store_id != source.file.store_id) continue;
    SLX_ASSIGN_OR_RETURN(std::string bytes, ReadChain(file.path));
    bytes.resize(bytes.rfind('\n') + 1);  // a torn end was never acknowledged
    if (bytes.starts_with(source.bytes)) return Status::Ok();
    std::istringstream lines(bytes);
    for (std::string line; std::getline(lines, line);) lines_here.insert(line);
    if (file.path == main) main_bytes = bytes;
    if (source.bytes.starts_with(bytes) && (longest.empty() || bytes.size() > longest_bytes.size())) {
      longest = file.path;
      longest_bytes = std::move(bytes);
    }
  }
  if (!longest.empty()) return Take(longest, source, longest_bytes.size(), merge);
  std::error_code error;
  if (!fs::exists(main, error)) return Take(main, source, 0, merge);
  if (SaysNothingNew(source, lines_here)) {
    merge.problems.push_back(source.file.path.string() + " is damaged: it lacks lines of what is stored here as " +
                             main.filename().string() + ", or has them in another order; nothing of it is new");
    return Status::Ok();
  }
  const fs::path fork = ForkName(folder, source, main_bytes);
  merge.problems.push_back(source.file.path.string() + " differs from what is stored here as " +
                           main.filename().string() + ": kept as " + fork.filename().string() + "; both count");
  return Take(fork, source, 0, merge);
}

}  // namespace

Result<LedgerMerge> MergeLedger(const fs::path& store, const fs::path& folder) {
  LedgerMerge merge;
  SLX_ASSIGN_OR_RETURN(const std::vector<ChainFile> chains, ListChains(folder));
  if (chains.empty()) return merge;
  SLX_ASSIGN_OR_RETURN(const auto lock, LockLedger(store));
  Status newer;
  for (const ChainFile& file : chains) {
    const auto source = ReadSource(file);
    if (source.status().code() == StatusCode::kNewerSchema) {
      newer = source.status();
    } else if (source.status().code() == StatusCode::kFailed) {
      return source.status();
    } else if (!source.ok()) {
      merge.problems.push_back(source.status().message());
    } else {
      if (source->damaged_lines + source->gaps > 0)
        merge.problems.push_back(file.path.string() + ": " + std::to_string(source->damaged_lines) +
                                 " damaged lines, and " + std::to_string(source->gaps) +
                                 " that do not follow the one before; what can be read of it still counts");
      SLX_RETURN_IF_ERROR(MergeOne(LedgerFolder(store), *source, merge));
    }
  }
  if (!newer.ok()) return newer;
  return merge;
}

}  // namespace stratalux::db
