// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/import.h"

#include <map>
#include <set>
#include <utility>

#include "db/catalogue/deletions.h"
#include "db/interchange/image_file.h"
#include "db/privacy/export_marker.h"
#include "shared/base/version.h"

namespace stratalux::db {
namespace {

std::string SizeText(int width, int height) { return std::to_string(width) + "x" + std::to_string(height); }

Status Complaint(const ImportFrame& frame, const std::string& message) {
  return Status::Usage(frame.where + ": " + frame.file.string() + ": " + message);
}

// 12-bit values out of 16-bit samples.
Status Align(const ImportFrame& frame, SampleAlignment alignment, Image<uint16_t>& image) {
  for (uint16_t& v : image.pixels()) {
    if (alignment == SampleAlignment::kLow && v > 4095)
      return Complaint(frame, "sample " + std::to_string(v) + " exceeds 12 bits; alignment = \"high\"?");
    if (alignment == SampleAlignment::kHigh) {
      if ((v & 15U) != 0)
        return Complaint(frame, "sample " + std::to_string(v) +
                                    " has bits below its 12 upper ones; alignment = "
                                    "\"low\" or bit_depth = 16?");
      v = static_cast<uint16_t>(v >> 4);
    }
  }
  return Status::Ok();
}

// The file's pixels, or what is wrong with them.
Result<Image<uint16_t>> ReadChecked(const ImportManifest& manifest, const ImportFrame& frame) {
  auto file = ReadImageFile(frame.file);
  if (!file.ok()) return Status::Usage(frame.where + ": " + file.status().message());
  const int file_bits = file->bits;
  Image<uint16_t>* image = &file->image;
  const int wanted_bits = manifest.bit_depth == 8 ? 8 : 16;
  if (file_bits != wanted_bits)
    return Complaint(frame, "has " + std::to_string(file_bits) + " bits a sample; bit_depth = " +
                                std::to_string(manifest.bit_depth) + " needs files of " + std::to_string(wanted_bits));
  if (image->channels() != 1) return Complaint(frame, "is a colour image; raw frames have one channel");
  const FrameRecord& r = frame.record;
  if (r.width > 0 && image->width() != r.width)
    return Complaint(frame,
                     "is " + std::to_string(image->width()) + " wide, but its pose is " + std::to_string(r.width));
  if (r.height > 0 && image->height() != r.height)
    return Complaint(frame,
                     "is " + std::to_string(image->height()) + " high, but its pose is " + std::to_string(r.height));
  if (r.crop_x + image->width() > manifest.camera_width || r.crop_y + image->height() > manifest.camera_height)
    return Complaint(frame, SizeText(image->width(), image->height()) + " at (" + std::to_string(r.crop_x) + ", " +
                                std::to_string(r.crop_y) + ") leaves the camera's frame of " +
                                SizeText(manifest.camera_width, manifest.camera_height));
  if (manifest.bit_depth == 12) SLX_RETURN_IF_ERROR(Align(frame, manifest.alignment, *image));
  return std::move(file->image);
}

// Reads all files and fills in their sizes; the frames of a pose must agree.
Status CheckFiles(ImportManifest& manifest, Progress& progress) {
  std::map<int, std::pair<int, int>> size_of_pose;
  for (ImportFrame& frame : manifest.frames) {
    SLX_ASSIGN_OR_RETURN(const auto image, ReadChecked(manifest, frame));
    const std::pair size(image.width(), image.height());
    const auto [first, fresh] = size_of_pose.try_emplace(frame.record.pose, size);
    if (!fresh && first->second != size)
      return Complaint(frame, "is " + SizeText(size.first, size.second) + ", but the first file of its pose is " +
                                  SizeText(first->second.first, first->second.second));
    frame.record.width = size.first;
    frame.record.height = size.second;
    progress.Advance();
  }
  return Status::Ok();
}

Status AppendFrame(SessionWriter& writer, const ImportManifest& manifest, const ImportFrame& frame) {
  SLX_ASSIGN_OR_RETURN(const auto image, ReadChecked(manifest, frame));
  FrameRecord record = frame.record;
  double sum = 0.0;
  for (uint16_t v : image.pixels()) sum += v;
  record.mean_dn = sum / static_cast<double>(image.size());
  if (record.format != PixelFormat::kMono8) return writer.Append(record, image.view());
  Image<uint8_t> narrow(image.width(), image.height());
  for (size_t i = 0; i < image.size(); ++i) narrow.data()[i] = static_cast<uint8_t>(image.data()[i]);
  return writer.Append(record, std::as_const(narrow).view());
}

// What `forget` could not reach, such as an export on another machine, must not come back by this door.
Status RefuseForgottenExports(const std::filesystem::path& store, const ImportManifest& manifest) {
  // An export's marker lies in its own folder, its frames below.
  std::set<std::filesystem::path> folders;
  for (const ImportFrame& frame : manifest.frames)
    for (auto folder = std::filesystem::absolute(frame.file).parent_path();
         folders.insert(folder).second && folder.has_relative_path();)
      folder = folder.parent_path();
  for (const auto& folder : folders)
    for (const std::string& session : ExportsIn(folder))
      SLX_RETURN_IF_ERROR(RefuseForgotten(store, session).WithContext(folder.string()));
  return Status::Ok();
}

}  // namespace

Result<ImportReport> ImportSession(SessionStore& store, const ImportOptions& options, Logger& logger) {
  SLX_ASSIGN_OR_RETURN(ImportManifest manifest, ReadImportManifest(options));
  for (const std::string& note : manifest.notes) logger.Warning(note);
  SLX_RETURN_IF_ERROR(RefuseForgottenExports(store.folder(), manifest));
  const auto total = static_cast<int64_t>(manifest.frames.size());
  {
    Progress progress(logger, "check", total);
    SLX_RETURN_IF_ERROR(CheckFiles(manifest, progress));
  }
  manifest.info.started_wall = WallNow();
  manifest.info.program_version = kVersion;
  SLX_ASSIGN_OR_RETURN(SessionWriter writer, store.BeginSession(manifest.info));
  Progress progress(logger, "import", total);
  for (const ImportFrame& frame : manifest.frames) {
    if (const Status status = AppendFrame(writer, manifest, frame); !status.ok()) {
      (void)writer.Finish(SessionStatus::kFailed, {status.message()}).ok();  // a file changed, or the disk is full
      return status.WithContext("session " + writer.info().id);
    }
    progress.Advance();
  }
  SLX_RETURN_IF_ERROR(writer.Finish(SessionStatus::kComplete));
  return ImportReport{writer.info().id, total};
}

}  // namespace stratalux::db
