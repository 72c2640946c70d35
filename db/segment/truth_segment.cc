// SPDX-License-Identifier: Apache-2.0
#include "db/segment/truth_segment.h"

#include <cstring>

#include "db/segment/frame_cipher.h"
#include "db/segment/header_check.h"
#include "db/segment/pixel_hash.h"
#include "db/segment/segment.h"

namespace stratalux::db {

Result<TruthSegment> TruthSegment::Open(const std::filesystem::path& file) {
  if (std::error_code error; !std::filesystem::exists(file, error))
    return Status::NotFound(file.string() + " does not exist");
  SLX_ASSIGN_OR_RETURN(const auto reader, SegmentReader::Open(file));
  bool sealed = false;
  SLX_ASSIGN_OR_RETURN(const auto frames, reader.Walk(false, &sealed));
  TruthSegment truth;
  truth.file_ = file;
  for (const SegmentFrame& f : frames) {
    SLX_RETURN_IF_ERROR(CheckHeader(f.header, RecordKind::kTruthMap).WithContext(file.string()));
    truth.entries_.push_back(
        {std::string(f.header.pattern, strnlen(f.header.pattern, sizeof f.header.pattern)), f.offset});
  }
  return truth;
}

std::vector<std::string> TruthSegment::names() const {
  std::vector<std::string> names;
  for (const Entry& e : entries_) names.push_back(e.name);
  return names;
}

Result<Image<float>> TruthSegment::Read(const std::string& name) const {
  for (const Entry& e : entries_) {
    if (e.name != name) continue;
    SLX_ASSIGN_OR_RETURN(const auto reader, SegmentReader::Open(file_));
    FrameHeader h{};
    SLX_ASSIGN_OR_RETURN(auto stored, reader.Read(e.offset, &h));
    // STORE/sessions/<id>/truth.seg
    FrameOpener opener(file_.parent_path().parent_path().parent_path());
    SLX_ASSIGN_OR_RETURN(const auto bytes,
                         opener.Open(reader.session_id(), h, std::move(stored)).WithContext(file_.string()));
    Image<float> map(h.width, h.height, h.channels);
    if (bytes.size() != map.size() * sizeof(float))
      return Status::Integrity(file_.string() + ": map '" + name + "' has the wrong length");
    SLX_ASSIGN_OR_RETURN(const SecretKey* key, opener.KeyOf(reader.session_id(), h));
    if (HasPixelHash(h) && HashPixels(bytes, key) != PixelHashOf(h))
      return Status::Integrity(file_.string() + ": map '" + name + "' does not match its pixel hash");
    std::memcpy(map.data(), bytes.data(), bytes.size());
    return map;
  }
  return Status::NotFound(file_.string() + " has no map '" + name + "'");
}

}  // namespace stratalux::db
