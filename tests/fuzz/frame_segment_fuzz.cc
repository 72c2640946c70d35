// SPDX-License-Identifier: Apache-2.0
// Segments: frames-0001.seg and truth.seg of a session. The first byte says whether hashes are made to fit, as a forger
// would: without that hardly an input passes them.
#include <algorithm>
#include <cstring>
#include <vector>

#include <xxhash.h>

#include "db/segment/frame_codec.h"
#include "db/segment/segment_layout.h"
#include "db/segment/segment_scan.h"
#include "db/segment/truth_segment.h"
#include "tests/fuzz/target.h"

namespace {

using namespace stratalux;
using namespace stratalux::db;

// Larger ones cost time and no thought.
constexpr size_t kMostSamples = 1 << 20;

// As many whole headers as follow each other get hashes that fit, and so does a footer behind them.
void MakeHashesFit(std::vector<uint8_t>& bytes) {
  if (bytes.size() < sizeof(FileHeader)) return;
  FileHeader file{};
  std::memcpy(&file, bytes.data(), sizeof file);
  file.hash = HashOf(file);
  std::memcpy(bytes.data(), &file, sizeof file);
  std::vector<FrameHeader> headers;
  size_t at = sizeof file;
  for (FrameHeader header{}; bytes.size() - at >= sizeof header; headers.push_back(header)) {
    std::memcpy(&header, bytes.data() + at, sizeof header);
    if (header.magic != kFrameMagic || header.payload_bytes > bytes.size() - at - sizeof header) break;
    PayloadHash(std::span(bytes).subspan(at + sizeof header, header.payload_bytes), header.payload_hash);
    header.header_hash = HashOf(header);
    std::memcpy(bytes.data() + at, &header, sizeof header);
    at += sizeof header + header.payload_bytes;
  }
  if (bytes.size() - at < sizeof(FooterStart) + sizeof(Trailer)) return;
  FooterStart start{};
  std::memcpy(&start, bytes.data() + at, sizeof start);
  if (start.magic != kFooterMagic) return;
  const size_t end = bytes.size() - sizeof(Trailer);
  for (size_t i = 0; i < headers.size() && at + sizeof start + (i + 1) * sizeof(FrameHeader) <= end; ++i)
    std::memcpy(bytes.data() + at + sizeof start + i * sizeof(FrameHeader), &headers[i], sizeof(FrameHeader));
  Trailer trailer{};
  std::memcpy(trailer.magic, kEndMagic, sizeof trailer.magic);
  trailer.footer_offset = at;
  trailer.footer_hash = XXH3_64bits(bytes.data() + at, end - at);
  std::memcpy(bytes.data() + end, &trailer, sizeof trailer);
}

void ReadFrame(const SegmentReader& reader, const SegmentFrame& frame, FrameDecoder& decoder) {
  (void)fuzz::Judge(RecordOf(frame.header));
  std::vector<uint8_t> payload;
  const Status read = reader.ReadPayload(frame.offset, frame.header, payload);
  fuzz::Judge(read);
  if (!read.ok() || !CheckShape(ShapeOf(frame.header)).ok() || ShapeOf(frame.header).samples() > kMostSamples) return;
  payload.resize(frame.header.payload_bytes);
  (void)fuzz::Judge(decoder.Decode(ShapeOf(frame.header), static_cast<Codec>(frame.header.codec), payload));
}

void ReadFrames(const SegmentReader& reader) {
  bool sealed = false;
  (void)fuzz::Judge(reader.Walk(true, &sealed));
  const auto walked = reader.Walk(false, &sealed);
  (void)fuzz::Judge(walked);
  (void)reader.SealedTail();
  (void)reader.IntactEnd();
  FrameDecoder decoder;
  for (const SegmentFrame& frame : reader.Footer().value_or(std::vector<SegmentFrame>())) {
    (void)fuzz::Judge(reader.ListedHeader(frame.offset));
    ReadFrame(reader, frame, decoder);
  }
  for (const SegmentFrame& frame : ScanSegment(reader, {}).frames) ReadFrame(reader, frame, decoder);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  static const fuzz::InputFolder folder;
  std::vector<uint8_t> bytes(data + 1, data + size);
  if (data[0] % 2 == 1) MakeHashesFit(bytes);
  const auto file = folder.Put("truth.seg", bytes);
  Status damage;
  const auto reader = SegmentReader::OpenDamaged(file, &damage);
  fuzz::Judge(damage);
  if (fuzz::Judge(reader)) ReadFrames(*reader);
  const auto truth = TruthSegment::Open(file);
  if (!fuzz::Judge(truth)) return 0;
  for (const std::string& name : truth->names()) (void)fuzz::Judge(truth->Read(name));
  return 0;
}
