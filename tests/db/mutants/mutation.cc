// SPDX-License-Identifier: Apache-2.0
#include "tests/db/mutants/mutation.h"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <limits>

#include "db/base/sqlite.h"
#include "db/care/session_rebuild.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {

namespace fs = std::filesystem;

std::vector<fs::path> MutableFiles(const fs::path& folder) {
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
  auto files = MutableFiles(folder);
  std::erase_if(files, [&ending](const fs::path& file) { return !file.string().ends_with(ending); });
  return files;
}

bool HasHash(const fs::path& file) {
  const std::string name = file.filename(), path = file.generic_string();
  return name == "manifest.json" || name.ends_with(".seg") || name == "truth_calibration.json" ||
         name.ends_with(".jsonl") || name == "signature.json" || name == "backup.json" ||
         path.find("/fits/") != std::string::npos || path.find("/artifacts/") != std::string::npos;
}

std::string Short(const fs::path& folder, const fs::path& file) { return file.lexically_relative(folder).string(); }

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

Mutant ChangeBytes(const fs::path& folder, Random& random) {
  const fs::path file = OneOf(MutableFiles(folder), random);
  std::vector<uint8_t> bytes = ReadBytes(file);
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

}  // namespace stratalux::db
