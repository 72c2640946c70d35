// SPDX-License-Identifier: Apache-2.0
// How long the next visitor waits while a visit is forgotten in a large store: what opening the store and beginning a
// session take, again and again, until the forgetting in another process has scanned every file.
//   build/bench/bin/forget_bench [GIGABYTES=10]
// $TMPDIR decides which disk; what was just written may still lie in the memory of the system, so that the scan reads
// from there what fits. Ends with 1 where the forgetting left something.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <sys/wait.h>
#include <unistd.h>

#include "db/catalogue/consent.h"
#include "db/catalogue/session_store.h"
#include "db/privacy/forget.h"
#include "shared/base/check.h"
#include "shared/base/random.h"

namespace stratalux::bench {
namespace {

constexpr int kWidth = 1392, kHeight = 1042, kFramesPerVisit = 500, kDistinctFrames = 4;
constexpr const char* kForgotten = "v-5f3a91c2";
constexpr const char* kNext = "v-7b20d4e9";

std::vector<Image<uint16_t>> Noise() {
  std::vector<Image<uint16_t>> frames;
  for (int k = 0; k < kDistinctFrames; ++k) {
    Random random(1, static_cast<uint64_t>(k));
    Image<uint16_t>& frame = frames.emplace_back(kWidth, kHeight);
    for (size_t i = 0; i < frame.size(); ++i) frame.data()[i] = static_cast<uint16_t>(random.Uniform(0.0, 4095.0));
  }
  return frames;
}

void Append(db::SessionWriter& writer, const Image<uint16_t>& pixels, int step) {
  FrameRecord record;
  record.step = step;
  record.width = kWidth;
  record.height = kHeight;
  record.driver_sequence = record.trigger_number = step;
  SLX_CHECK(writer.Append(record, pixels.view()).ok());
}

// Its id.
std::string Visit(db::SessionStore& store, const std::string& visitor, const std::vector<Image<uint16_t>>& frames) {
  SessionInfo info;
  info.visitor = visitor;
  auto writer = store.BeginSession(info, {.codec = StoreCodec::kRaw12});
  SLX_CHECK(writer.ok());
  for (int step = 0; step < kFramesPerVisit; ++step) Append(*writer, frames[step % frames.size()], step);
  SLX_CHECK(writer->Finish(SessionStatus::kComplete).ok());
  return writer->info().id;
}

// Seconds from opening the store until a session may be written; it is one frame long.
double BeginOne(const std::filesystem::path& folder, const Image<uint16_t>& frame) {
  const auto asked = std::chrono::steady_clock::now();
  auto store = db::SessionStore::Open(folder, db::AccessMode::kReadWrite);
  SLX_CHECK(store.ok());
  SessionInfo info;
  info.visitor = kNext;
  auto writer = store->BeginSession(info, {});
  const std::chrono::duration<double> waited = std::chrono::steady_clock::now() - asked;
  if (!writer.ok()) std::fprintf(stderr, "forget_bench: %s\n", writer.status().message().c_str());
  SLX_CHECK(writer.ok());
  Append(*writer, frame, 0);
  SLX_CHECK(writer->Finish(SessionStatus::kComplete).ok());
  return waited.count();
}

int ForgetIn(const std::filesystem::path& folder, const std::string& session) {
  Logger quiet(LogLevel::kError);
  db::ForgetRequest request;
  request.sessions = {session};
  auto report = db::Forget(folder, request, quiet);
  // A session is being written at just this moment.
  while (report.status().code() == StatusCode::kBusy) report = db::Forget(folder, request, quiet);
  if (!report.ok()) std::fprintf(stderr, "forget_bench: %s\n", report.status().message().c_str());
  return report.ok() && report->leftovers.empty() ? 0 : 1;
}

void Print(const char* what, std::vector<double> seconds) {
  std::sort(seconds.begin(), seconds.end());
  if (seconds.empty()) return;
  std::printf("%-28s %4zu   median %6.1f ms   worst %6.1f ms\n", what, seconds.size(),
              1e3 * seconds[seconds.size() / 2], 1e3 * seconds.back());
}

int Main(double gigabytes) {
  std::string folder = (std::filesystem::temp_directory_path() / "stratalux-bench-XXXXXX").string();
  SLX_CHECK(mkdtemp(folder.data()) != nullptr);
  SLX_CHECK(db::SessionStore::Create(folder).ok());
  for (const char* visitor : {kForgotten, kNext})
    SLX_CHECK(db::GiveConsent(folder, visitor, {"2026-03", "en", true, true, false, {}}).ok());
  const auto frames = Noise();
  std::string forgotten;
  int64_t bytes = 0;
  {
    auto store = db::SessionStore::Open(folder, db::AccessMode::kReadWrite);
    SLX_CHECK(store.ok());
    while (static_cast<double>(bytes) < 1e9 * gigabytes) {
      const std::string id = Visit(*store, forgotten.empty() ? kForgotten : kNext, frames);
      if (forgotten.empty()) forgotten = id;
      bytes += store->FindSession(id)->bytes;
    }
  }
  std::vector<double> alone, beside;
  for (int k = 0; k < 20; ++k) alone.push_back(BeginOne(folder, frames[0]));
  std::fflush(stdout);
  const auto began = std::chrono::steady_clock::now();
  const pid_t child = fork();
  if (child == 0) _exit(ForgetIn(folder, forgotten));
  int status = 0;
  while (waitpid(child, &status, WNOHANG) == 0) beside.push_back(BeginOne(folder, frames[0]));
  const std::chrono::duration<double> took = std::chrono::steady_clock::now() - began;
  std::printf("%.1f GB; one visit of %d frames forgotten in %.1f s\n", 1e-9 * static_cast<double>(bytes),
              kFramesPerVisit, took.count());
  Print("sessions begun before it", alone);
  Print("sessions begun beside it", beside);
  std::filesystem::remove_all(folder);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 1;
}

}  // namespace
}  // namespace stratalux::bench

int main(int argc, char** argv) {
  const double gigabytes = argc > 1 ? std::atof(argv[1]) : 10.0;
  if (gigabytes > 0.0) return stratalux::bench::Main(gigabytes);
  std::fprintf(stderr, "usage: forget_bench [GIGABYTES=10]\n");
  return 2;
}
