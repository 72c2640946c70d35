// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/kiosk_metrics.h"

#include <algorithm>
#include <utility>

#include "shared/base/formatted.h"

namespace stratalux::rig {
namespace {

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
  void Value(CheckFigure figure, size_t projector, double value) {
    const std::string of = figure == CheckFigure::kFrameRate ? "" : ",projector=\"" + std::to_string(projector) + "\"";
    text_ += name_ + "{figure=\"" + ToString(figure) + "\"" + of + "} " + Formatted("%.6g", value) + "\n";
  }
  [[nodiscard]] std::string Text() && { return std::move(text_); }

 private:
  std::string name_, text_;
};

// Of each figure of the newest one: `of` says what; nullopt is left out.
void WriteFigures(Exposition& out, const Selfcheck& newest,
                  const std::function<std::optional<double>(size_t figure, size_t projector)>& of) {
  for (size_t f = 0; f < newest.figures.size(); ++f)
    for (size_t p = 0; p < newest.figures[f].size(); ++p)
      if (const auto value = of(f, p)) out.Value(static_cast<CheckFigure>(f), p, *value);
}

void WriteSelfchecks(Exposition& out, const SelfcheckTrend& trend) {
  if (trend.checks.empty()) return;
  const Selfcheck& newest = trend.checks.back();
  out.Metric("selfcheck_timestamp_seconds", "gauge", "When the last self-check was, seconds since 1970.");
  out.Value(std::to_string(newest.at.ns / 1'000'000'000));
  out.Metric("selfcheck_passed", "gauge", "1 where the last self-check passed.");
  out.Value(newest.passed ? "1" : "0");
  out.Metric("selfcheck", "gauge", "What the last self-check measured.");
  WriteFigures(out, newest, [&](size_t f, size_t p) { return newest.figures[f][p]; });
  const auto usual = [&](size_t f, size_t p) { return p < trend.usual[f].size() ? trend.usual[f][p] : std::nullopt; };
  if (trend.days >= SelfcheckTrend::kFewestDays) {
    out.Metric("selfcheck_usual", "gauge", "Median of the days before.");
    WriteFigures(out, newest, [&](size_t f, size_t p) {
      const auto one = usual(f, p);
      return one ? std::optional(one->median) : std::nullopt;
    });
    out.Metric("selfcheck_limit", "gauge", "Distance from the median beyond which a figure drifted.");
    WriteFigures(out, newest, [&](size_t f, size_t p) {
      const auto one = usual(f, p);
      return one ? std::optional(one->limit) : std::nullopt;
    });
  }
  out.Metric("selfcheck_drifts", "gauge", "Figures of the last self-check that drifted.");
  out.Value(std::to_string(trend.drifts.size()));
}

}  // namespace

KioskMetrics::KioskMetrics(DayBook days, Clock now) : now_(std::move(now)), days_(std::move(days)) {
  // A counter that appears with its first event has no rate of it.
  for (const char* end : {"kept", "withdrawn"}) figures_.visits[end] = 0;
  for (const Word end : {Word::kRefused, Word::kLeft, Word::kTimeOut, Word::kSensitive, Word::kFault, Word::kDevice})
    figures_.visits[ToString(end)] = 0;
}

void KioskMetrics::Shown(const action::Show& show, WallNs at) {
  const Phase before = std::exchange(figures_.screen, show.screen);
  if (InVisit(show.screen) && !std::exchange(in_visit_, true)) {
    ++figures_.visits_begun;
    days_.Begun(at);
    captures_ = 0;
    kept_ = false;
  }
  if (!InVisit(show.screen) && std::exchange(in_visit_, false)) EndVisit(show.word, at);
  if (show.screen != Phase::kCapture) return;
  if (before != Phase::kCapture) BeginCapture(at);
  figures_.frames += std::max(0, show.number - done_);
  done_ = std::max(done_, show.number);
  const double seconds = std::chrono::duration<double>(now_() - capture_began_).count();
  if (done_ > 1 && seconds > 0.0) figures_.frames_per_second = done_ / seconds;
}

void KioskMetrics::BeginCapture(WallNs at) {
  if (captures_++ > 0) {
    ++figures_.retakes;
    days_.Retaken(at);
  }
  done_ = 0;
  capture_began_ = now_();
}

void KioskMetrics::EndVisit(Word word, WallNs at) {
  const char* end = !kept_ ? ToString(word) : word == Word::kRefused ? "withdrawn" : "kept";
  ++figures_.visits[end];
  days_.Ended(end, at);
}

void KioskMetrics::Told(Word word, WallNs at) {
  ++figures_.faults[ToString(word)];
  days_.Told(word, at);
}

std::string PrometheusText(const KioskFigures& figures, const KioskGauges& gauges, const SelfcheckTrend& selfchecks) {
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
  WriteSelfchecks(out, selfchecks);
  return std::move(out).Text();
}

}  // namespace stratalux::rig
