// SPDX-License-Identifier: Apache-2.0
// Changes of sealed files (docs/file-formats.md, "Sealed files") by one who knows the format and all hashes, and has no
// key.
#include <algorithm>
#include <cstring>

#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "db/catalogue/recorded_files.h"
#include "tests/db/mutants/mutation.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using Bytes = std::vector<uint8_t>;

constexpr size_t kHeaderBytes = 64, kPlaceBytesAt = 12, kPlainBytesAt = 48;
constexpr size_t kPieceBytes = (size_t{1} << 20) + 16;  // stored: with its tag
constexpr Field kFields[] = {{"magic", 0, 8},    {"version", 8, 4}, {"place_bytes", kPlaceBytesAt, 4},
                             {"key_id", 16, 16}, {"nonce", 32, 16}, {"plain_bytes", kPlainBytesAt, 8},
                             {"reserved", 56, 8}};

std::vector<fs::path> SealedFiles(const fs::path& folder) {
  auto files = MutableFiles(folder);
  std::erase_if(files, [](const fs::path& file) {
    const Bytes bytes = ReadBytes(file);
    return bytes.size() < kHeaderBytes || std::memcmp(bytes.data(), "SLXSEAL", 8) != 0;
  });
  return files;
}

size_t PiecesAt(const Bytes& sealed) {
  uint32_t place = 0;
  std::memcpy(&place, sealed.data() + kPlaceBytesAt, sizeof place);
  return kHeaderBytes + place;
}

// As long as the header says, whatever is there.
void MakeLengthFit(Bytes& sealed) {
  const size_t stored = sealed.size() - PiecesAt(sealed);
  const uint64_t plain = stored - 16 * std::max<size_t>(1, (stored + kPieceBytes - 1) / kPieceBytes);
  std::memcpy(sealed.data() + kPlainBytesAt, &plain, sizeof plain);
}

std::string ChangeHeaderField(Bytes& sealed, Random& random) {
  const Field& field = kFields[Below(random, std::size(kFields))];
  ChangeField(field, sealed.data() + field.offset, random);
  return field.name;
}

std::string ChangePieces(Bytes& sealed, Random& random) {
  const size_t begin = PiecesAt(sealed), at = begin + Below(random, sealed.size() - begin);
  sealed[at] ^= static_cast<uint8_t>(1 + Below(random, 255));
  return "byte " + std::to_string(at) + " of its pieces";
}

// Cut somewhere or behind a piece, its tag kept.
std::string Cut(Bytes& sealed, Random& random) {
  const size_t begin = PiecesAt(sealed), pieces = (sealed.size() - begin) / kPieceBytes;
  const size_t kept =
      Below(random, 2) == 0 ? Below(random, pieces + 1) * kPieceBytes : 16 + Below(random, sealed.size() - begin - 16);
  if (kept < 16) return ChangePieces(sealed, random);
  sealed.resize(begin + kept);
  MakeLengthFit(sealed);
  return "cut to " + std::to_string(kept) + " bytes of its pieces, its length made to fit";
}

// The first piece in the place of the second, too; or the two exchanged.
std::string MovePieces(Bytes& sealed, Random& random) {
  const auto first = sealed.begin() + static_cast<std::ptrdiff_t>(PiecesAt(sealed));
  const auto size = std::min<std::ptrdiff_t>((sealed.end() - first) / 2, kPieceBytes);
  if (Below(random, 2) == 0) {
    std::copy(first, first + size, first + size);
    return "its first piece twice";
  }
  std::swap_ranges(first, first + size, first + size);
  return "its first two pieces swapped";
}

// What another file holds: as it is, or named for this place.
std::string PutAnother(Bytes& sealed, const fs::path& other, Random& random) {
  const Bytes another = ReadBytes(other);
  if (Below(random, 2) == 0) {
    sealed = another;
    return "in its place " + other.filename().string();
  }
  const auto begin = sealed.begin() + static_cast<std::ptrdiff_t>(PiecesAt(sealed));
  const Bytes place(sealed.begin() + kHeaderBytes, begin);
  sealed.assign(another.begin(), another.begin() + kHeaderBytes);
  const auto size = static_cast<uint32_t>(place.size());
  std::memcpy(sealed.data() + kPlaceBytesAt, &size, sizeof size);
  sealed.insert(sealed.end(), place.begin(), place.end());
  sealed.insert(sealed.end(), another.begin() + static_cast<std::ptrdiff_t>(PiecesAt(another)), another.end());
  return "in its place " + other.filename().string() + ", named for it";
}

std::string Change(Bytes& sealed, const std::vector<fs::path>& all, Random& random) {
  switch (Below(random, 6)) {
    case 0:
      return ChangeHeaderField(sealed, random);
    case 1: {
      const size_t at = kHeaderBytes + Below(random, PiecesAt(sealed) - kHeaderBytes);
      sealed[at] ^= static_cast<uint8_t>(1 + Below(random, 255));
      return "byte " + std::to_string(at) + ", of its place";
    }
    case 2:
      return ChangePieces(sealed, random);
    case 3:
      return Cut(sealed, random);
    case 4:
      return MovePieces(sealed, random);
    default:
      return PutAnother(sealed, OneOf(all, random), random);
  }
}

// artifact.json or fit.json of the folder that the file is in says of it what is there now.
void EnterInRecord(const fs::path& file) {
  for (fs::path folder = file.parent_path(); !folder.empty() && folder != folder.parent_path();
       folder = folder.parent_path())
    for (const char* name : {"artifact.json", "fit.json"}) {
      if (!fs::exists(folder / name)) continue;
      const Bytes text = ReadBytes(folder / name);
      Json record = Json::parse(text);
      for (Json& entry : record.at("files"))
        if (folder / entry.at("name").get<std::string>() == file) {
          entry["bytes"] = fs::file_size(file);
          entry["xxh3_128"] = HashOfFile(file).value();
        }
      record.erase("hash");
      return WriteText(folder / name, WithOwnHash(record.dump(1)));
    }
}

}  // namespace

Mutant ChangeSealed(const fs::path& folder, Random& random) {
  const auto files = SealedFiles(folder);
  if (files.empty()) return ChangeBytes(folder, random);
  const fs::path file = OneOf(files, random);
  const Bytes before = ReadBytes(file);
  Bytes sealed = before;
  std::string what = Short(folder, file) + ", sealed: " + Change(sealed, files, random);
  WriteBytes(file, sealed);
  const bool anew = Below(random, 2) == 0;
  if (anew) EnterInRecord(file);
  return {what + (anew ? ", entered in its record" : ""), Short(folder, file), sealed != before && !anew};
}

}  // namespace stratalux::db
