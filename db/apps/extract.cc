// SPDX-License-Identifier: Apache-2.0
#include "db/apps/extract.h"

#include <cctype>
#include <cstdio>
#include <system_error>
#include <utility>

#include "db/privacy/export_marker.h"
#include "shared/image/png.h"

namespace stratalux::db {
namespace {

Status WriteFrame(const std::filesystem::path& file, PixelFormat format, Image<uint16_t> image) {
  if (format == PixelFormat::kMono8) {
    Image<uint8_t> narrow(image.width(), image.height(), image.channels());
    for (size_t i = 0; i < image.size(); ++i) narrow.data()[i] = static_cast<uint8_t>(image.data()[i]);
    return WritePng8(file, std::as_const(narrow).view());
  }
  if (format == PixelFormat::kMono12)
    for (uint16_t& v : image.pixels()) v = static_cast<uint16_t>(v << 4);
  return WritePng16(file, std::as_const(image).view());
}

}  // namespace

std::string ExtractedName(const FrameRow& frame) {
  char prefix[24];
  std::snprintf(prefix, sizeof prefix, "%06lld-", static_cast<long long>(frame.id));
  std::string name = prefix;
  for (char c : frame.record.pattern.ToString()) name += std::isalnum(static_cast<unsigned char>(c)) != 0 ? c : '-';
  return name + ".png";
}

Status ExtractFrames(const SessionStore& store, const std::string& session_id, const std::vector<FrameRow>& frames,
                     const std::filesystem::path& folder, Logger& logger) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return Status::Failed("cannot create " + folder.string() + ": " + error.message());
  std::vector<std::string> names;
  for (const FrameRow& frame : frames) names.push_back(ExtractedName(frame));
  return WriteExport(store.folder(), "extract", session_id, folder, names, [&]() -> Status {
    Progress progress(logger, "extract", static_cast<int64_t>(frames.size()));
    for (const FrameRow& frame : frames) {
      SLX_ASSIGN_OR_RETURN(auto image, store.ReadFrame(session_id, frame));
      SLX_RETURN_IF_ERROR(WriteFrame(folder / ExtractedName(frame), frame.record.format, std::move(image)));
      progress.Advance();
    }
    return Status::Ok();
  });
}

}  // namespace stratalux::db
