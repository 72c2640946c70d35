// SPDX-License-Identifier: Apache-2.0
// Codecs on the frames of a visit, on one core, beside the image files one would use else (docs/benchmarks.md).
//   STRATALUX_BENCH_STORE=store build/bench/bin/codec_bench
// Rates are per second of this program's processor time, so that a machine with other work gives the same ones.
#include <cstdio>
#include <map>
#include <string>

#include <benchmark/benchmark.h>

#include "db/segment/frame_codec.h"
#include "tests/bench/db/image_file_peers.h"
#include "tests/bench/db/visit_frames.h"

namespace stratalux::bench {
namespace {

constexpr size_t kMostFrames = 64;

std::vector<VisitFrame>& Visit() {
  static std::vector<VisitFrame> frames;
  return frames;
}
// Bytes of all frames by codec, for the ratios of the table.
std::map<std::string, double>& TotalBytes() {
  static std::map<std::string, double> bytes;
  return bytes;
}

db::FrameShape ShapeOf(const FrameRecord& r) { return {r.format, r.cfa, r.width, r.height, r.channels}; }

// One iteration codes every frame; `encode` gives a frame's bytes.
template <typename Encode>
void Measure(benchmark::State& state, const std::string& name, Encode encode) {
  double bytes = 0;
  for (auto _ : state) {
    bytes = 0;
    for (const VisitFrame& frame : Visit()) bytes += static_cast<double>(encode(frame));
  }
  TotalBytes()[name] = bytes;
  state.counters["frames/s"] =
      benchmark::Counter(static_cast<double>(Visit().size()), benchmark::Counter::kIsIterationInvariantRate);
  state.counters["smaller"] = TotalBytes()["raw12"] / bytes;  // than packed: raw12 runs first
}

void EncodeWith(benchmark::State& state, StoreCodec codec) {
  db::FrameEncoder encoder(codec);
  Measure(state, ToString(codec), [&encoder](const VisitFrame& frame) {
    const auto encoded = encoder.Encode(ShapeOf(frame.record), frame.pixels.pixels());
    SLX_CHECK(encoded.ok());
    return encoded->bytes.size();
  });
}

void DecodeWith(benchmark::State& state, StoreCodec codec) {
  db::FrameEncoder encoder(codec);
  struct Stored {
    db::Codec codec;
    std::vector<uint8_t> bytes;
  };
  std::map<const VisitFrame*, Stored> stored;
  for (const VisitFrame& frame : Visit()) {
    const auto encoded = encoder.Encode(ShapeOf(frame.record), frame.pixels.pixels());
    SLX_CHECK(encoded.ok());
    stored[&frame] = {encoded->codec, {encoded->bytes.begin(), encoded->bytes.end()}};
  }
  db::FrameDecoder decoder;
  Measure(state, ToString(codec), [&](const VisitFrame& frame) {
    const Stored& s = stored[&frame];
    const auto image = decoder.Decode(ShapeOf(frame.record), s.codec, s.bytes);
    SLX_CHECK(image.ok());
    benchmark::DoNotOptimize(image->data());
    return s.bytes.size();
  });
}

void Png(benchmark::State& state) {
  std::vector<uint8_t> file;
  Measure(state, "png", [&file](const VisitFrame& frame) { return EncodePng(frame.pixels.view(), file); });
}
void Tiff(benchmark::State& state, TiffCompression compression) {
  std::vector<uint8_t> file;
  Measure(state, compression == TiffCompression::kZstd ? "tiff zstd" : "tiff deflate",
          [&](const VisitFrame& frame) { return EncodeTiff(frame.pixels.view(), compression, file); });
}

void Register() {
  const auto add = [](const char* name, auto function, int iterations) {
    benchmark::RegisterBenchmark(name, function)->Iterations(iterations)->Unit(benchmark::kMillisecond);
  };
  add(
      "encode raw12", [](benchmark::State& s) { EncodeWith(s, StoreCodec::kRaw12); }, 4);
  add(
      "encode delta", [](benchmark::State& s) { EncodeWith(s, StoreCodec::kDelta); }, 4);
  add(
      "decode raw12", [](benchmark::State& s) { DecodeWith(s, StoreCodec::kRaw12); }, 4);
  add(
      "decode delta", [](benchmark::State& s) { DecodeWith(s, StoreCodec::kDelta); }, 4);
  add("encode PNG, level 1", Png, 1);
  add(
      "encode TIFF, deflate 1, predictor", [](benchmark::State& s) { Tiff(s, TiffCompression::kDeflate); }, 1);
  add(
      "encode TIFF, zstd 1, predictor", [](benchmark::State& s) { Tiff(s, TiffCompression::kZstd); }, 1);
}

}  // namespace
}  // namespace stratalux::bench

int main(int argc, char** argv) {
  using namespace stratalux::bench;
  benchmark::Initialize(&argc, argv);
  auto frames = LoadVisit(kMostFrames);
  if (!frames.ok()) {
    std::fprintf(stderr, "codec_bench: %s\n", frames.status().message().c_str());
    return frames.status().exit_code();
  }
  Visit() = std::move(frames).value();
  std::printf("%zu frames of %d x %d\n", Visit().size(), Visit()[0].record.width, Visit()[0].record.height);
  Register();
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
