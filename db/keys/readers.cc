// SPDX-License-Identifier: Apache-2.0
#include "db/keys/readers.h"

#include <algorithm>

#include "db/base/durable_file.h"
#include "db/keys/sealed_key.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

fs::path ReaderFile(const fs::path& store, const ReaderId& id) { return store / kReadersFolder / (ToHex(id) + ".pub"); }

}  // namespace

Result<std::vector<ReaderPublicKey>> ListReaders(const fs::path& store) {
  std::vector<fs::path> files;
  std::error_code error;
  const fs::path folder = store / kReadersFolder;
  if (!fs::exists(fs::symlink_status(folder, error))) return std::vector<ReaderPublicKey>();
  for (auto entry = fs::directory_iterator(folder, error); !error && entry != fs::end(entry); entry.increment(error))
    if (entry->path().extension() == ".pub") files.push_back(entry->path());
  if (error) return Status::Failed("cannot read " + folder.string() + ": " + error.message());
  std::sort(files.begin(), files.end());
  std::vector<ReaderPublicKey> readers;
  for (const fs::path& file : files) {
    const auto reader = ParseReaderPublicKey(file.string());
    if (!reader.ok() || file != ReaderFile(store, IdOf(*reader)))
      return Status::Integrity(
          file.string() +
          " does not hold the public key that its name stands for: remove it, and `stratalux-db key share`"
          " that reader's key again");
    readers.push_back(*reader);
  }
  return readers;
}

Status AddReader(const fs::path& store, const ReaderPublicKey& reader) {
  SLX_RETURN_IF_ERROR(MakeFolder(store / kReadersFolder));
  const fs::path file = ReaderFile(store, IdOf(reader));
  if (const auto there = ParseReaderPublicKey(file.string()); there.ok() && *there == reader) return Status::Ok();
  return ReplaceFile(file, ToText(reader) + "\n");
}

Result<bool> RemoveReader(const fs::path& store, const ReaderId& reader) {
  std::error_code error;
  const fs::path file = ReaderFile(store, reader);
  if (!fs::remove(file, error) && !error) return false;
  if (error) return Status::Failed("cannot remove " + file.string() + ": " + error.message());
  SLX_RETURN_IF_ERROR(SyncFolder(file.parent_path()));
  return true;
}

Status SealToReaders(const fs::path& store, const std::string& session_id, const SessionKey& key) {
  SLX_ASSIGN_OR_RETURN(const auto readers, ListReaders(store));
  for (const ReaderPublicKey& reader : readers)
    SLX_RETURN_IF_ERROR(WriteSealedKey(store / "sessions" / session_id, session_id, key, reader));
  return Status::Ok();
}

}  // namespace stratalux::db
