// SPDX-License-Identifier: Apache-2.0
// stratalux-soak: captures on the small simulated rig, random faults and seeds, until so many frames are reached.
// Prints the table; exit code 1 when a frame was mis-associated.
#include <cstdio>
#include <optional>
#include <string>

#include <CLI/CLI.hpp>

#include "tests/firmware-host/soak/soak.h"

namespace stratalux::rig {
namespace {

int Main(int argc, char** argv) {
  SoakOptions base;
  base.plan = SmallPlan();
  int64_t frames = 100000;
  uint64_t seed = 1, first = 0;
  double rate = 0.005;
  std::string only, code = ToString(base.plan.code);
  bool verbose = false, clean = false, free_running = false;
  CLI::App app("Captures with random faults on the simulated rig; counts frames that are not what they are said to be");
  app.add_option("--frames", frames)->capture_default_str();
  app.add_option("--seed", seed, "of scenes, noise and faults")->envname("STRATALUX_SEED")->capture_default_str();
  app.add_option("--rate", rate, "chance of a fault at each exposure and each pulse")->capture_default_str();
  app.add_option("--burst", base.faults.burst, "faults come in runs of so many at most")->capture_default_str();
  app.add_option("--pair", base.faults.pair, "chance that a second kind comes at once")->capture_default_str();
  app.add_option("--kind", only, "one kind of fault only, such as projector_lag");
  app.add_option("--scene", base.scene)->capture_default_str();
  app.add_flag("--scattering", base.scattering);
  app.add_option("--width", base.camera_width)->capture_default_str();
  app.add_option("--height", base.camera_height)->capture_default_str();
  app.add_option("--brackets", base.plan.brackets);
  app.add_option("--code", code, "of the projectors' columns and rows")->capture_default_str();
  app.add_flag("--free-running", free_running);
  app.add_flag("--overlapped", base.overlapped, "the camera exposes while it reads out");
  app.add_flag("--learnt", base.learnt, "by the deadlines that a selftest learnt");
  app.add_option("--slow-rate", base.slow_rate, "chance of a frame that comes 10 to 80 ms late");
  app.add_option("--jump-rate", base.jump_rate, "chance of a subject that jumps by 1 to 6 mm");
  app.add_flag("--clean", clean, "no faults");
  app.add_option("--first", first, "number of the first capture: one that --verbose named is repeated by it");
  app.add_flag("--verbose", verbose, "each capture that went wrong");
  CLI11_PARSE(app, argc, argv);
  if (free_running) base.plan.sync_mode = SyncMode::kFreeRunning;
  if (!clean) base.faults.rate = rate;
  const auto parsed = ParseColumnCode(code);
  if (!parsed.ok()) {
    std::fprintf(stderr, "stratalux-soak: %s\n", parsed.status().message().c_str());
    return parsed.status().exit_code();
  }
  base.plan.code = *parsed;
  if (!only.empty()) {
    const auto kind = ParseFaultKind(only);
    if (!kind.ok()) {
      std::fprintf(stderr, "stratalux-soak: %s\n", kind.status().message().c_str());
      return kind.status().exit_code();
    }
    base.faults.kinds = {*kind};
  }
  SoakTable table;
  int64_t held = 0;
  for (uint64_t n = first; table.frames() < frames; ++n) {
    SoakOptions options = base;
    options.seed = seed + n % 7;  // seven faces
    options.faults.seed = seed * 1000003 + n;
    const SoakCapture capture = CaptureOnce(options);
    table.Add(capture);
    held += capture.learnt_held;
    if (!verbose) continue;
    if (capture.mis_associated.empty() && capture.changed_unsaid.empty() && !clean &&
        capture.report.status == SessionStatus::kComplete)
      continue;
    std::printf("fault seed %llu: %s, %d shot again; wrong:", static_cast<unsigned long long>(options.faults.seed),
                ToString(capture.report.status), capture.report.retried);
    for (const int step : capture.mis_associated) std::printf(" %d", step);
    std::printf("; changed: %zu; spoilt %.3f; faults:", capture.changed_unsaid.size(), capture.spoilt_most);
    for (const InjectedFault& fault : capture.injected)
      std::printf(" %s@%lld", ToString(fault.kind), static_cast<long long>(fault.number));
    std::printf("\n  %s\n", capture.report.FaultSummary().c_str());
    for (const std::string& reason : capture.report.Reasons()) std::printf("  %s\n", reason.c_str());
    std::fflush(stdout);
  }
  table.Print();
  if (base.learnt) std::printf("learnt deadlines held to the end of %lld captures\n", static_cast<long long>(held));
  return table.mis_associated() == 0 ? 0 : 1;
}

}  // namespace
}  // namespace stratalux::rig

int main(int argc, char** argv) { return stratalux::rig::Main(argc, argv); }
