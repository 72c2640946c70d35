// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_truth.h"

#include <array>
#include <cctype>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <sstream>

#include "db/base/durable_file.h"
#include "db/interchange/crate_files.h"
#include "db/interchange/crate_frames.h"
#include "shared/base/read_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;

constexpr const char* kMaps = "truth/maps.csv";
constexpr const char* kCalibration = "truth/truth_calibration.json";
constexpr const char* kMapColumns = "name,file,width,height,channels";
constexpr int64_t kMapsLimit = int64_t{1} << 20;  // bytes

std::string MapFile(size_t number, const std::string& name) {
  char prefix[16];
  std::snprintf(prefix, sizeof prefix, "truth/%03zu-", number);
  std::string file = prefix;
  for (const char c : name) file += std::isalnum(static_cast<unsigned char>(c)) != 0 ? c : '-';
  return file + ".npy";
}

// Version 1.0 of numpy's format: magic, length, a Python dictionary padded so that the data begin at a multiple of 64.
std::string NpyHeader(int width, int height, int channels) {
  std::string shape = std::to_string(height) + ", " + std::to_string(width);
  if (channels > 1) shape += ", " + std::to_string(channels);
  std::string dictionary = "{'descr': '<f4', 'fortran_order': False, 'shape': (" + shape + "), }";
  constexpr size_t kPreamble = 10, kAlignment = 64;
  while ((kPreamble + dictionary.size() + 1) % kAlignment != 0) dictionary += ' ';
  dictionary += '\n';
  std::string header("\x93NUMPY\x01\x00", 8);
  header += static_cast<char>(dictionary.size() & 0xffU);
  header += static_cast<char>(dictionary.size() >> 8U);
  return header + dictionary;
}

Status WriteNpy(const fs::path& file, const Image<float>& map) {
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out << NpyHeader(map.width(), map.height(), map.channels());
  out.write(reinterpret_cast<const char*>(map.data()), static_cast<std::streamsize>(map.size() * sizeof(float)));
  out.close();
  return out.good() ? Status::Ok() : Status::Failed("cannot write " + file.string() + "; is the disk full?");
}

}  // namespace

Result<CrateTruth> CrateTruth::Open(const fs::path& session_folder) {
  CrateTruth truth;
  truth.session_ = session_folder;
  auto segment = TruthSegment::Open(session_folder / "truth.seg");
  if (segment.status().code() == StatusCode::kNotFound) return truth;
  if (!segment.ok()) return segment.status();
  truth.names_ = segment->names();
  truth.segment_ = std::move(segment).value();
  return truth;
}

std::vector<std::string> CrateTruth::Files() const {
  std::vector<std::string> files;
  for (size_t i = 0; i < names_.size(); ++i) files.push_back(MapFile(i, names_[i]));
  if (!names_.empty()) files.emplace_back(kMaps);
  if (std::error_code error; fs::exists(session_ / "truth_calibration.json", error)) files.emplace_back(kCalibration);
  return files;
}

Status CrateTruth::Write(const fs::path& crate_session) const {
  if (Files().empty()) return Status::Ok();
  SLX_RETURN_IF_ERROR(MakeFolder(crate_session / "truth"));
  std::string rows = std::string(kMapColumns) + "\n";
  for (size_t i = 0; i < names_.size(); ++i) {
    SLX_ASSIGN_OR_RETURN(const auto map, segment_->Read(names_[i]));
    SLX_RETURN_IF_ERROR(WriteNpy(crate_session / MapFile(i, names_[i]), map));
    rows += CsvLine({names_[i], MapFile(i, names_[i]), std::to_string(map.width()), std::to_string(map.height()),
                     std::to_string(map.channels())});
  }
  if (!names_.empty()) SLX_RETURN_IF_ERROR(ReplaceFile(crate_session / kMaps, rows));
  if (std::error_code error; !fs::exists(session_ / "truth_calibration.json", error)) return Status::Ok();
  SLX_ASSIGN_OR_RETURN(const std::string record, ReadFile(session_ / "truth_calibration.json"));
  return ReplaceFile(crate_session / kCalibration, record);
}

Result<std::vector<CrateTruthMap>> ReadTruthMaps(const fs::path& crate_session) {
  std::vector<CrateTruthMap> maps;
  const std::string file = (crate_session / kMaps).string();
  const auto text = ReadCrateFile(file, kMapsLimit);
  if (text.status().code() == StatusCode::kNotFound) return maps;
  if (!text.ok()) return text.status();
  std::istringstream in(*text);
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    const Status wrong = Status::Integrity(file + ":" + std::to_string(number) + ": not '" + kMapColumns + "'");
    if (number == 1) {
      if (line != kMapColumns) return wrong;
      continue;
    }
    CrateTruthMap map;
    std::array<char, 64> name{}, path{};
    int end = 0;
    // No map's name of ours holds a comma; what does is refused with the rest.
    if (std::sscanf(line.c_str(), "%63[^,],%63[^,],%6d,%6d,%2d%n", name.data(), path.data(), &map.width, &map.height,
                    &map.channels, &end) != 5 ||
        static_cast<size_t>(end) != line.size())
      return wrong;
    map.name = name.data();
    map.file = path.data();
    if (map.width < 1 || map.width > 65536 || map.height < 1 || map.height > 65536 || map.channels < 1 ||
        map.channels > 16 || map.file != MapFile(maps.size(), map.name))
      return wrong;
    maps.push_back(std::move(map));
  }
  return maps;
}

Result<Image<float>> ReadTruthMap(const fs::path& crate_session, const CrateTruthMap& map) {
  const std::string header = NpyHeader(map.width, map.height, map.channels);
  const int64_t samples = int64_t{map.width} * map.height * map.channels;
  const int64_t bytes = static_cast<int64_t>(header.size()) + samples * static_cast<int64_t>(sizeof(float));
  const fs::path file = crate_session / map.file;
  std::error_code error;
  if (fs::file_size(file, error) != static_cast<uintmax_t>(bytes) || error)
    return Status::Integrity(file.string() + " is not an array of the size that maps.csv states");
  SLX_ASSIGN_OR_RETURN(const std::string text, ReadCrateFile(file, bytes));
  if (!text.starts_with(header)) return Status::Integrity(file.string() + " is not the array that maps.csv describes");
  Image<float> image(map.width, map.height, map.channels);
  std::memcpy(image.data(), text.data() + header.size(), image.size() * sizeof(float));
  return image;
}

}  // namespace stratalux::db
