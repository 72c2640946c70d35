// SPDX-License-Identifier: Apache-2.0
#include "tests/db/store_fixture.h"

#include <cstdlib>
#include <fstream>

#include "tests/support/text_file.h"

namespace stratalux::db {

std::filesystem::path TemporaryFolder() {
  std::error_code error;
  const bool asked = std::getenv("TMPDIR") != nullptr;
  return !asked && std::filesystem::is_directory("/dev/shm", error) ? "/dev/shm"
                                                                    : std::filesystem::temp_directory_path();
}

void StoreTest::SetUp() {
  std::string name = (TemporaryFolder() / "stratalux-db-XXXXXX").string();
  ASSERT_NE(mkdtemp(name.data()), nullptr);
  folder_ = name;
  const Status status = SessionStore::Create(folder_);
  ASSERT_TRUE(status.ok()) << status.message();
}

void StoreTest::TearDown() { std::filesystem::remove_all(folder_); }

SessionStore StoreTest::OpenStore(AccessMode mode) const {
  auto store = SessionStore::Open(folder_, mode);
  EXPECT_TRUE(store.ok()) << store.status().message();
  return std::move(store).value();
}

std::string StoreTest::StoreSession(int frames, const WriterOptions& options) const {
  SessionStore store = OpenStore();
  SessionInfo info = SimulatedVisit();
  info.rig = "bench";
  auto writer = store.BeginSession(info, options);
  EXPECT_TRUE(writer.ok()) << writer.status().message();
  for (int i = 0; i < frames; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
  EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
  return writer->info().id;
}

std::filesystem::path StoreTest::Segment(const std::string& session, int number) const {
  return folder_ / "sessions" / session / ("frames-000" + std::to_string(number) + ".seg");
}

SessionInfo SimulatedVisit() {
  SessionInfo info;
  info.simulated = true;
  return info;
}

CaptureFindings SomeFindings() {
  return {{{FindingKind::kMoved, 2, 117, 0.0625, 0.03, ""},
           {FindingKind::kDevice, -1, -1, 0.0, 0.0, "/dev/video0: \"gone\""}},
          {{"lost frame", 2}, {"wrong level", 14}}};
}

FrameRecord RecordFor(int step, PixelFormat format, int width, int height, int channels) {
  FrameRecord r;
  r.step = step;
  r.projector = step % 4;
  r.phase = CapturePhase::kCorrespondence;
  r.pattern = *Pattern::Parse("gray rows bit=3/10 inverse");
  r.bracket = 1;
  r.pose = 2;
  r.retry = 3;
  r.trigger_number = 1000 + step;
  r.trigger_time = {5'000'000'000 + step};
  r.sync_time = {5'000'000'100 + step};
  r.driver_sequence = 77 + step;
  r.frame_time = {5'000'000'200 + step};
  r.frame_clock = ClockSource::kMonotonic;
  r.exposure_ms = 16.25;
  r.gain = 1.5;
  r.level_check = LevelCheck::kPassed;
  r.mean_dn = 123.5;
  r.format = format;
  r.cfa = Cfa::kGbrg;
  r.width = width;
  r.height = height;
  r.channels = channels;
  r.crop_x = 11;
  r.crop_y = 13;
  return r;
}

Image<uint16_t> PixelsFor(const FrameRecord& r) {
  const unsigned top = (1U << BitDepth(r.format)) - 1U;
  Image<uint16_t> image(r.width, r.height, r.channels);
  for (size_t i = 0; i < image.size(); ++i)
    image.data()[i] = static_cast<uint16_t>((i * 40503U + static_cast<unsigned>(r.step) * 2654435U) & top);
  image.data()[0] = static_cast<uint16_t>(top);
  return image;
}

Status AppendTo(SessionWriter& writer, int step) {
  const FrameRecord record = RecordFor(step, PixelFormat::kMono12, 6, 4);
  const auto pixels = PixelsFor(record);
  return writer.Append(record, pixels.view());
}

std::vector<uint8_t> ReadBytes(const std::filesystem::path& file) {
  EXPECT_TRUE(std::filesystem::exists(file)) << file;
  const std::string text = ReadText(file);
  const auto* bytes = reinterpret_cast<const uint8_t*>(text.data());
  return {bytes, bytes + text.size()};
}

void WriteBytes(const std::filesystem::path& file, const std::vector<uint8_t>& bytes) {
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  ASSERT_TRUE(out.flush().good()) << file;
}

void FlipBits(const std::filesystem::path& file, size_t at, uint8_t mask) {
  std::fstream stream(file, std::ios::binary | std::ios::in | std::ios::out);
  stream.seekg(static_cast<std::streamoff>(at));
  const auto byte = static_cast<char>(stream.get() ^ mask);
  stream.seekp(static_cast<std::streamoff>(at));
  stream.put(byte);
  ASSERT_TRUE(stream.flush().good()) << file;
}

void WriteText(const std::filesystem::path& file, const std::string& text) {
  WriteBytes(file, {text.begin(), text.end()});
}

}  // namespace stratalux::db
