// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/simulated/fault_script.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <string_view>

#include "shared/config/toml_reader.h"

namespace stratalux::rig {
namespace {

constexpr std::array<std::string_view, kFaultKinds> kNames = {
    "frame_lost",    "frame_doubled", "frame_extra",    "frame_late",     "frame_stale",    "frame_frozen",
    "frame_corrupt", "frame_garbled", "frame_torn",     "exposure_latch", "subject_moved",  "subject_swayed",
    "lamp_drift",    "lamp_blink",    "camera_gone",    "frame_slow",     "edge_lost",      "edge_doubled",
    "sync_stuck",    "projector_lag", "projector_skip", "lines_gone",     "emergency_stop", "door_open"};

constexpr int kLongestBurst = 1000;
constexpr int kMostNumber = 1 << 30;  // of exposures and pulses
constexpr double kMostValue = 1e6;

std::string Names() {
  std::string list;
  for (const std::string_view name : kNames) list += (list.empty() ? "" : ", ") + std::string(name);
  return list;
}

// Faults that a session survives.
std::vector<FaultKind> Survivable() {
  return {FaultKind::kFrameLost,    FaultKind::kFrameDoubled, FaultKind::kFrameExtra,   FaultKind::kFrameLate,
          FaultKind::kFrameStale,   FaultKind::kFrameFrozen,  FaultKind::kFrameCorrupt, FaultKind::kFrameGarbled,
          FaultKind::kFrameTorn,    FaultKind::kEdgeLost,     FaultKind::kEdgeDoubled,  FaultKind::kProjectorLag,
          FaultKind::kProjectorSkip};
}

template <typename T>
bool ParseWhole(std::string_view text, T& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

}  // namespace

const char* ToString(FaultKind kind) { return kNames[static_cast<size_t>(kind)].data(); }

Result<FaultKind> ParseFaultKind(const std::string& text) {
  for (size_t i = 0; i < kNames.size(); ++i)
    if (kNames[i] == text) return static_cast<FaultKind>(i);
  return Status::Usage("fault '" + text + "' is unknown; allowed: " + Names());
}

Result<Fault> ParseFault(const std::string& text) {
  const std::string_view all = text;
  const size_t at = all.find('@');
  Fault fault;
  SLX_ASSIGN_OR_RETURN(fault.kind, ParseFaultKind(std::string(all.substr(0, at))));
  std::string_view rest = at == std::string_view::npos ? std::string_view() : all.substr(at + 1);
  bool sound = !rest.empty();
  if (const size_t equals = rest.find('='); equals != std::string_view::npos) {
    sound = sound && ParseWhole(rest.substr(equals + 1), fault.value) && std::abs(fault.value) <= kMostValue;
    rest = rest.substr(0, equals);
  }
  if (const size_t times = rest.find('x'); times != std::string_view::npos) {
    sound = sound && ParseWhole(rest.substr(times + 1), fault.count) && fault.count > 0 && fault.count <= kMostNumber;
    rest = rest.substr(0, times);
  }
  if (!sound || !ParseWhole(rest, fault.at) || fault.at < 0 || fault.at > kMostNumber)
    return Status::Usage("fault '" + text +
                         "': expected KIND@NUMBER[xCOUNT][=VALUE], such as frame_lost@17; numbers up to 2^30, values "
                         "up to 1e6");
  return fault;
}

Result<FaultOptions> ReadFaults(TomlTable& root) {
  FaultOptions options;
  for (TomlTable& table : root.Tables("fault")) {
    Fault fault;
    table.Require("kind");
    table.Require("at");
    std::string kind = ToString(fault.kind);
    int at = 0, count = 1;
    table.Get("kind", kind);
    table.Get("at", at, 0, kMostNumber);
    table.Get("count", count, 1, kMostNumber);
    table.Get("value", fault.value, -kMostValue, kMostValue);
    if (table.Has("along")) {
      std::vector<double> along;
      table.Get("along", along, -1e6, 1e6);
      if (along.size() != 3 || along == std::vector<double>(3))
        return Status::Usage(table.Where("along") + ": along takes a direction, [x, y, z]");
      std::copy(along.begin(), along.end(), fault.along.begin());
    }
    SLX_ASSIGN_OR_RETURN(fault.kind, ParseFaultKind(kind).WithContext(table.Where("kind")));
    fault.at = at;
    fault.count = count;
    options.script.push_back(fault);
  }
  TomlTable random = root.Table("faults");
  int seed = 1;
  random.Get("seed", seed, 0, 1 << 30);
  options.seed = static_cast<uint64_t>(seed);
  random.Get("rate", options.rate, 0.0, 1.0);
  random.Get("burst", options.burst, 1, kLongestBurst);
  random.Get("pair", options.pair, 0.0, 1.0);
  std::vector<std::string> kinds;
  random.Get("kinds", kinds);
  for (const std::string& kind : kinds) {
    SLX_ASSIGN_OR_RETURN(const FaultKind parsed, ParseFaultKind(kind).WithContext(random.Where("kinds")));
    options.kinds.push_back(parsed);
  }
  return options;
}

// Each number draws for itself: whether a run begins there, which kind it meets in one, how long its run is, and the
// pair.
Random FaultScript::DrawsAt(int64_t number, Where where) const {
  return Random(options_.seed, static_cast<uint64_t>(number) * 2 + (where == Where::kPulse ? 1 : 0));
}

bool FaultScript::InBurst(int64_t number, Where where) const {
  for (int64_t start = std::max<int64_t>(0, number - options_.burst + 1); start <= number; ++start) {
    Random random = DrawsAt(start, where);
    if (random.Uniform() >= options_.rate) continue;
    random.Uniform();  // the kind
    if (number < start + 1 + static_cast<int64_t>(random.Uniform() * options_.burst)) return true;
  }
  return false;
}

std::vector<Fault> FaultScript::At(int64_t number, Where where) const {
  std::vector<Fault> faults;
  for (const Fault& f : options_.script)
    if (IsLineFault(f.kind) == (where == Where::kPulse) && number >= f.at && number - f.at < f.count)
      faults.push_back(f);
  if (options_.rate <= 0.0) return faults;
  std::vector<FaultKind> kinds = options_.kinds.empty() ? Survivable() : options_.kinds;
  std::erase_if(kinds, [&](FaultKind k) { return IsLineFault(k) != (where == Where::kPulse); });
  if (kinds.empty() || !InBurst(number, where)) return faults;
  Random random = DrawsAt(number, where);
  random.Uniform();  // whether a run begins
  const auto draw = [&] {
    const auto pick = static_cast<size_t>(random.Uniform() * static_cast<double>(kinds.size()));
    faults.push_back({.kind = kinds[pick], .at = number});
    kinds.erase(kinds.begin() + static_cast<std::ptrdiff_t>(pick));
  };
  draw();
  random.Uniform();  // how long it is
  if (!kinds.empty() && random.Uniform() < options_.pair) draw();
  return faults;
}

}  // namespace stratalux::rig
