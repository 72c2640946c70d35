// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/kiosk_metrics.h"

#include <algorithm>
#include <utility>

#include "shared/base/formatted.h"

namespace stratalux::rig {
namespace {

constexpr size_t kMostFaults = 50;
constexpr int64_t kDayNs = 24LL * 3600 * 1'000'000'000;

bool InVisit(Phase phase) {
  return phase == Phase::kQuestion || phase == Phase::kConsent || phase == Phase::kPosition ||
         phase == Phase::kCountdown || phase == Phase::kCapture || phase == Phase::kGate || phase == Phase::kThanks;
}

// Values of labels may hold any character; three are written out.
std::string Escaped(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    if (c == '\\' || c == '"') escaped += '\\';
    escaped += c == '\n' ? std::string("\\n") : std::string(1, c);
  }
  return escaped;
}

class Exposition {
 public:
  void Metric(const std::string& name, const std::string& type, const std::string& help) {
    name_ = "stratalux_kiosk_" + name;
    text_ += "# HELP " + name_ + " " + help + "\n# TYPE " + name_ + " " + type + "\n";
  }
  void Value(const std::string& value) { text_ += name_ + " " + value + "\n"; }
  void Value(const std::string& label, const std::string& of, const std::string& value) {
    text_ += name_ + "{" + label + "=\"" + Escaped(of) + "\"} " + value + "\n";
  }
  [[nodiscard]] std::string Text() && { return std::move(text_); }

 private:
  std::string name_, text_;
};

}  // namespace

KioskMetrics::KioskMetrics(Clock now) : now_(std::move(now)) {
  // A counter that appears with its first event has no rate of it.
  for (const char* end : {"kept", "withdrawn"}) figures_.visits[end] = 0;
  for (const Word end : {Word::kRefused, Word::kLeft, Word::kTimeOut, Word::kSensitive, Word::kFault, Word::kDevice})
    figures_.visits[ToString(end)] = 0;
}

void KioskMetrics::Shown(const action::Show& show) {
  const Phase before = std::exchange(figures_.screen, show.screen);
  if (InVisit(show.screen) && !std::exchange(in_visit_, true)) {
    ++figures_.visits_begun;
    captures_ = 0;
    kept_ = false;
  }
  if (!InVisit(show.screen) && std::exchange(in_visit_, false)) EndVisit(show.word);
  if (show.screen != Phase::kCapture) return;
  if (before != Phase::kCapture) BeginCapture();
  figures_.frames += std::max(0, show.number - done_);
  done_ = std::max(done_, show.number);
  const double seconds = std::chrono::duration<double>(now_() - capture_began_).count();
  if (done_ > 1 && seconds > 0.0) figures_.frames_per_second = done_ / seconds;
}

void KioskMetrics::BeginCapture() {
  if (captures_++ > 0) ++figures_.retakes;
  done_ = 0;
  capture_began_ = now_();
}

void KioskMetrics::EndVisit(Word word) {
  const char* end = !kept_ ? ToString(word) : word == Word::kRefused ? "withdrawn" : "kept";
  ++figures_.visits[end];
}

void KioskMetrics::Told(Word word, WallNs at) {
  ++figures_.faults[ToString(word)];
  figures_.last_faults.push_front({at, word});
  if (figures_.last_faults.size() > kMostFaults) figures_.last_faults.pop_back();
}

KioskFigures KioskMetrics::figures(WallNs now) const {
  KioskFigures figures = figures_;
  std::erase_if(figures.last_faults, [now](const KioskFault& fault) { return now.ns - fault.at.ns > kDayNs; });
  return figures;
}

std::string PrometheusText(const KioskFigures& figures, const KioskGauges& gauges) {
  Exposition out;
  out.Metric("visits_begun_total", "counter", "Visits that somebody began.");
  out.Value(std::to_string(figures.visits_begun));
  out.Metric("visits_total", "counter", "Visits that are over, by how they ended.");
  for (const auto& [end, count] : figures.visits) out.Value("end", end, std::to_string(count));
  out.Metric("retakes_total", "counter", "Captures after the first of their visit.");
  out.Value(std::to_string(figures.retakes));
  out.Metric("frames_total", "counter", "Frames captured.");
  out.Value(std::to_string(figures.frames));
  out.Metric("faults_total", "counter", "What the operator was told, by word.");
  for (const auto& [word, count] : figures.faults) out.Value("word", word, std::to_string(count));
  out.Metric("state", "gauge", "1 for the state that the kiosk is in.");
  for (int i = 0; i < kPhases; ++i) {
    const auto phase = static_cast<Phase>(i);
    out.Value("state", ToString(phase), phase == figures.screen ? "1" : "0");
  }
  out.Metric("viewers", "gauge", "Screens that are connected.");
  out.Value(std::to_string(gauges.viewers));
  if (gauges.disk_free_bytes) {
    out.Metric("disk_free_bytes", "gauge", "Free on the disk of the store.");
    out.Value(std::to_string(*gauges.disk_free_bytes));
  }
  if (!gauges.temperatures.empty()) {
    out.Metric("temperature_celsius", "gauge", "Temperatures of the computer.");
    std::map<std::string, double> hottest;  // sensors of one name are one series
    for (const Temperature& one : gauges.temperatures) {
      const auto [place, fresh] = hottest.emplace(one.name, one.celsius);
      if (!fresh) place->second = std::max(place->second, one.celsius);
    }
    for (const auto& [name, celsius] : hottest) out.Value("sensor", name, Formatted("%.1f", celsius));
  }
  return std::move(out).Text();
}

}  // namespace stratalux::rig
