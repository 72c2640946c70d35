// SPDX-License-Identifier: Apache-2.0
#include "db/ledger/ledger_folder.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <thread>

#include <fcntl.h>
#include <sodium.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/descriptor.h"
#include "db/base/durable_file.h"
#include "db/base/listing.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr size_t kIdDigits = 32, kForkDigits = 16;
constexpr std::string_view kForkMark = ".fork-";
constexpr size_t kTailBytes = size_t{64} * 1024;  // holds the last line, unless it is a long certificate

bool IsHex(std::string_view text, size_t digits) {
  return text.size() == digits && text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

Status Failure(const std::string& what, const fs::path& file, int error) {
  return Status::Failed("cannot " + what + " " + file.string() + ": " + std::strerror(error));
}

Result<std::string> ReadAt(int fd, int64_t offset, size_t size, const fs::path& file) {
  std::string bytes(size, '\0');
  for (size_t done = 0; done < size;) {
    const ssize_t got = pread(fd, bytes.data() + done, size - done, offset + static_cast<int64_t>(done));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return Failure("read", file, errno);
    if (got == 0) return Status::Failed(file.string() + " became shorter while it was read");
    done += static_cast<size_t>(got);
  }
  return bytes;
}

// The own chain, opened to be written at its end.
struct OpenChain {
  fs::path file;
  UniqueFd fd;
  ChainEnd end;
  int64_t keep = 0;          // bytes; what follows is torn
  bool add_newline = false;  // the last line is whole but for that
};

// The bytes from the start of the last line that has an end (or of the file) on, and the offset at which they start.
Result<std::pair<std::string, int64_t>> ReadTail(const OpenChain& chain, int64_t size) {
  for (size_t part = kTailBytes;; part *= 4) {
    const int64_t from = std::max<int64_t>(0, size - static_cast<int64_t>(part));
    SLX_ASSIGN_OR_RETURN(std::string bytes, ReadAt(chain.fd.get(), from, static_cast<size_t>(size - from), chain.file));
    const size_t last = bytes.rfind('\n');
    const size_t before = last == std::string::npos || last == 0 ? std::string::npos : bytes.rfind('\n', last - 1);
    if (from == 0 && before == std::string::npos) return std::pair(std::move(bytes), int64_t{0});
    if (before != std::string::npos)
      return std::pair(bytes.substr(before + 1), from + static_cast<int64_t>(before) + 1);
  }
}

// Where a damaged last line does not tell its number, the lines do.
Result<int64_t> CountLines(const OpenChain& chain) {
  SLX_ASSIGN_OR_RETURN(const std::string bytes, ReadAt(chain.fd.get(), 0, static_cast<size_t>(chain.keep), chain.file));
  return std::count(bytes.begin(), bytes.end(), '\n');
}

Status FindEnd(OpenChain& chain, const std::string& store_id) {
  struct stat info {};
  if (fstat(chain.fd.get(), &info) != 0) return Failure("read", chain.file, errno);
  SLX_ASSIGN_OR_RETURN(const auto tail, ReadTail(chain, info.st_size));
  const auto& [bytes, from] = tail;
  const size_t newline = bytes.rfind('\n');
  const size_t ended = newline == std::string::npos ? 0 : newline + 1;
  const std::string_view torn = std::string_view(bytes).substr(ended);
  const LedgerLine last = ParseLine(torn);
  chain.keep = from + static_cast<int64_t>(ended);
  if (!torn.empty() && last.state != LineState::kDamaged) {
    chain.keep = info.st_size;
    chain.add_newline = true;
    chain.end = {last.n, last.hash};
    return Status::Ok();
  }
  if (ended == 0) {
    chain.end = {0, ChainStart(store_id)};
    return Status::Ok();
  }
  const LedgerLine whole = ParseLine(std::string_view(bytes).substr(0, newline));
  if (whole.state == LineState::kNewer)
    return Status(StatusCode::kNewerSchema,
                  chain.file.string() + " was written by a later version; use a newer stratalux");
  chain.end = {whole.n, whole.hash};
  if (whole.state == LineState::kWhole) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(chain.end.entries, CountLines(chain));
  return Status::Ok();
}

}  // namespace

fs::path LedgerFolder(const fs::path& store) { return store / "ledger"; }

Result<UniqueFd> LockLedger(const fs::path& store) {
  using namespace std::chrono_literals;
  const fs::path folder = LedgerFolder(store), file = folder / "lock";
  SLX_RETURN_IF_ERROR(MakeFolder(folder));
  UniqueFd lock = OpenDescriptor(file, O_RDWR | O_CREAT | O_NOFOLLOW);
  if (!lock.ok()) return Failure("write", file, errno);
  const auto deadline = std::chrono::steady_clock::now() + 10s;
  while (flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK && errno != EINTR) return Failure("lock", file, errno);
    if (std::chrono::steady_clock::now() > deadline)
      return Status::Busy("the ledger of " + store.string() + " is being written by another program; try again");
    std::this_thread::sleep_for(2ms);
  }
  return lock;
}

Result<std::vector<ChainFile>> ListChains(const fs::path& folder) {
  std::vector<ChainFile> chains;
  SLX_ASSIGN_OR_RETURN(const std::vector<fs::path> entries, EntriesOf(folder));
  for (const fs::path& path : entries) {
    const std::string stem = path.stem().string(), id = stem.substr(0, kIdDigits);
    const std::string_view rest = std::string_view(stem).substr(id.size());
    const bool fork = rest.starts_with(kForkMark) && IsHex(rest.substr(kForkMark.size()), kForkDigits);
    if (path.extension() == ".jsonl" && IsHex(id, kIdDigits) && (rest.empty() || fork)) chains.push_back({path, id});
  }
  return chains;
}

Result<std::string> ReadChain(const fs::path& file) {
  constexpr const char* kRemedy =
      "; those whom it forgets could come back unnoticed: let this account read it, or restore it from a backup";
  std::error_code error;
  const auto type = fs::symlink_status(file, error).type();
  if (type == fs::file_type::none)
    return Status::Failed("cannot check " + file.string() + ": " + error.message() + kRemedy);
  if (type != fs::file_type::regular)
    return Status::Integrity(file.string() + " is not a regular file; a chain of the ledger belongs there");
  auto bytes = ReadFile(file, kMostChainBytes);
  if (!bytes.ok()) return Status::Failed(bytes.status().message() + kRemedy);
  return bytes;
}

Result<std::string> OwnStoreId(const fs::path& store) {
  auto id = StoreId(store);
  const bool none = id.status().code() == StatusCode::kNotFound || id.status().code() == StatusCode::kIntegrity;
  if (!none) return id;
  if (sodium_init() < 0) return Status::Failed("libsodium finds no source of random numbers");
  uint8_t bytes[kIdDigits / 2];
  randombytes_buf(bytes, sizeof bytes);
  char text[kIdDigits + 1];
  sodium_bin2hex(text, sizeof text, bytes, sizeof bytes);
  SLX_RETURN_IF_ERROR(SyncFolder(store));  // that the folder lies in, before anything in it is spoken of
  SLX_RETURN_IF_ERROR(ReplaceFile(LedgerFolder(store) / "store.id", std::string(text) + "\n"));
  return std::string(text);
}

Status AppendLocked(const fs::path& store, const std::vector<LedgerEntry>& entries) {
  if (entries.empty()) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const std::string id, OwnStoreId(store));
  OpenChain chain;
  chain.file = LedgerFolder(store) / (id + ".jsonl");
  chain.fd = OpenDescriptor(chain.file, O_RDWR | O_CREAT | O_APPEND | O_NOFOLLOW);
  if (!chain.fd.ok()) return Failure("write", chain.file, errno);
  SLX_RETURN_IF_ERROR(FindEnd(chain, id));
  if (ftruncate(chain.fd.get(), chain.keep) != 0) return Failure("cut", chain.file, errno);
  std::string lines = chain.add_newline ? "\n" : "";
  for (const LedgerEntry& entry : entries) lines += MakeLine(entry, chain.end) + "\n";
  Status written = WriteAll(chain.fd.get(), lines.data(), lines.size(), chain.file.string());
  if (written.ok() && fdatasync(chain.fd.get()) != 0) written = Failure("sync", chain.file, errno);
  if (!written.ok()) {
    // Nobody was told of it: gone as far as that can be had, torn and cut by the next append otherwise.
    if (ftruncate(chain.fd.get(), chain.keep) != 0) return written.WithContext("and it could not be undone");
    return written;
  }
  return SyncFolder(LedgerFolder(store));
}

Result<std::string> StoreIdIn(const fs::path& folder) {
  const fs::path file = folder / "store.id";
  std::error_code error;
  const auto read = ReadFile(file);
  if (!read.ok() && fs::symlink_status(file, error).type() != fs::file_type::not_found)
    return Status::Failed(read.status().message() + "; let this account read it, so that the store keeps its id");
  SLX_ASSIGN_OR_RETURN(const std::string text, read);
  if (text.size() != kIdDigits + 1 || text.back() != '\n' || !IsHex(text.substr(0, kIdDigits), kIdDigits))
    return Status::Integrity(
        file.string() + " holds no store id; the next entry makes a new one (what the old chain says still counts)");
  return text.substr(0, kIdDigits);
}

Result<std::string> StoreId(const fs::path& store) { return StoreIdIn(LedgerFolder(store)); }

Status MakeStoreId(const fs::path& store) {
  if (StoreId(store).ok()) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const auto lock, LockLedger(store));
  return OwnStoreId(store).status();
}

Status AppendToLedger(const fs::path& store, const LedgerEntry& entry) {
  SLX_ASSIGN_OR_RETURN(const auto lock, LockLedger(store));
  return AppendLocked(store, {entry});
}

}  // namespace stratalux::db
