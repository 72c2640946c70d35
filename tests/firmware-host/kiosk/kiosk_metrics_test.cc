// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/kiosk_metrics.h"

#include <regex>
#include <sstream>

#include <gmock/gmock.h>

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;

class KioskMetricsTest : public ::testing::Test {
 protected:
  void Show(Phase screen, Word word = Word::kNone, int number = 0, int of = 0) {
    metrics_.Shown({screen, word, {}, number, of, {}}, at_);
  }
  void Visit() {
    for (const Phase phase : {Phase::kQuestion, Phase::kConsent, Phase::kPosition, Phase::kCountdown}) Show(phase);
  }
  [[nodiscard]] KioskFigures figures() const { return metrics_.figures(); }

  std::chrono::steady_clock::time_point now_;
  WallNs at_{0};
  KioskMetrics metrics_{{}, [this] { return now_; }};
};

TEST_F(KioskMetricsTest, EveryVisitEndsOnceAndByItsName) {
  Show(Phase::kIdle);
  Show(Phase::kQuestion);
  Show(Phase::kIdle, Word::kSensitive);
  Visit();
  Show(Phase::kCapture);
  metrics_.Kept();
  Show(Phase::kThanks);
  Show(Phase::kIdle);
  Visit();
  Show(Phase::kCapture);
  metrics_.Kept();
  Show(Phase::kThanks);
  Show(Phase::kForgetting, Word::kRefused);
  Show(Phase::kIdle, Word::kRefused);
  Visit();
  Show(Phase::kSafe, Word::kEmergencyStop);
  Show(Phase::kIdle);
  const KioskFigures all = figures();
  EXPECT_EQ(all.visits_begun, 4);
  EXPECT_EQ(all.visits.at("sensitive"), 1);
  EXPECT_EQ(all.visits.at("kept"), 1);
  EXPECT_EQ(all.visits.at("withdrawn"), 1);
  EXPECT_EQ(all.visits.at("emergency_stop"), 1);
  int64_t sum = 0;
  for (const auto& [end, count] : all.visits) sum += count;
  EXPECT_EQ(sum, 4);
}

TEST_F(KioskMetricsTest, RetakesFramesAndTheirRateAreOfTheCapture) {
  Visit();
  Show(Phase::kCapture);
  now_ += 2s;
  Show(Phase::kCapture, Word::kNone, 50, 100);
  EXPECT_DOUBLE_EQ(figures().frames_per_second.value(), 25.0);
  Show(Phase::kGate, Word::kMoved, 1, 3);
  Show(Phase::kCountdown);
  Show(Phase::kCapture);
  now_ += 4s;
  Show(Phase::kCapture, Word::kNone, 80, 100);
  EXPECT_EQ(figures().retakes, 1);
  EXPECT_EQ(figures().frames, 130);
  EXPECT_DOUBLE_EQ(figures().frames_per_second.value(), 20.0);
}

// A program that begins counts for Prometheus from nothing and goes on with the day.
TEST_F(KioskMetricsTest, TheDayOutlivesTheProgram) {
  Show(Phase::kQuestion);
  Show(Phase::kIdle, Word::kRefused);
  Visit();
  Show(Phase::kCapture);
  Show(Phase::kGate);
  Show(Phase::kCapture);
  metrics_.Told(Word::kLamp, at_);
  DayBook days = DayBook::From(metrics_.days().ToJson());
  days.CutOff();
  metrics_ = KioskMetrics(std::move(days));
  Show(Phase::kQuestion);
  Show(Phase::kIdle, Word::kRefused);
  EXPECT_EQ(figures().visits.at("refused"), 1);
  EXPECT_EQ(figures().retakes, 0);
  const DayCounts today = metrics_.days().Today(at_);
  EXPECT_EQ(today.visits_begun, 3);
  EXPECT_EQ(today.visits.at("refused"), 2);
  EXPECT_EQ(today.visits.at("cut_off"), 1);
  EXPECT_EQ(today.retakes, 1);
  EXPECT_EQ(today.faults.at("lamp"), 1);
}

// As a scraper reads it: HELP and TYPE before the samples of a name, every sample a name, labels and a number, no
// series twice (prometheus.io, "Exposition formats").
void ExpectExposition(const std::string& text) {
  static const std::regex kSample(
      R"re(([a-zA-Z_:][a-zA-Z0-9_:]*)(\{[a-zA-Z_]\w*="(\\[\\"n]|[^"\\\n])*"(,[a-zA-Z_]\w*="(\\[\\"n]|[^"\\\n])*")*\})? (-?[0-9.]+))re");
  std::map<std::string, int> series;
  std::string typed;
  std::istringstream lines(text);
  ASSERT_EQ(text.back(), '\n');
  for (std::string line; std::getline(lines, line);) {
    std::smatch match;
    if (line.starts_with("# TYPE ")) {
      std::istringstream words(line);
      std::string skip, type;
      words >> skip >> skip >> typed >> type;
      EXPECT_TRUE(type == "counter" || type == "gauge") << line;
      EXPECT_EQ(type == "counter", typed.ends_with("_total")) << line;
    } else if (!line.starts_with("# HELP ")) {
      ASSERT_TRUE(std::regex_match(line, match, kSample)) << line;
      EXPECT_EQ(match[1], typed) << line;
      EXPECT_EQ(series[match[1].str() + match[2].str()]++, 0) << line;
    }
  }
  EXPECT_GT(series.size(), 20U);
}

TEST_F(KioskMetricsTest, AreReadByPrometheus) {
  Show(Phase::kGate, Word::kMoved, 1, 3);
  metrics_.Told(Word::kLamp, {0});
  const std::string text =
      PrometheusText(figures(), {2, int64_t{5} << 30, {{"core \"a\\b\"\n", 41.25}, {"soc", 50.0}, {"soc", 52.5}}});
  ExpectExposition(text);
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_state{state=\"gate\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_state{state=\"idle\"} 0\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_faults_total{word=\"lamp\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_visits_total{end=\"refused\"} 0\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_disk_free_bytes 5368709120\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_temperature_celsius{sensor=\"soc\"} 52.5\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_viewers 2\n"));
}

TEST_F(KioskMetricsTest, TheLastSelfcheckAndWhatIsUsualAreRead) {
  SelfcheckBook book;
  for (int day = 0; day < 10; ++day) {
    Selfcheck check;
    check.at = {(1'795'507'200 + day * 86'400LL) * 1'000'000'000};
    check.passed = true;
    check.Of(CheckFigure::kLevel) = {1000.0, day < 9 ? 500.0 : 400.0};
    check.Of(CheckFigure::kRedGreen) = {std::nullopt, std::nullopt};
    check.Of(CheckFigure::kFrameRate) = {28.5};
    book.Add(check);
  }
  const std::string text = PrometheusText(figures(), {}, TrendOf(book));
  ExpectExposition(text);
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_selfcheck{figure=\"level\",projector=\"1\"} 400\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_selfcheck{figure=\"frame_rate\"} 28.5\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_selfcheck_usual{figure=\"level\",projector=\"1\"} 500\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_selfcheck_limit{figure=\"level\",projector=\"1\"} 5\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_selfcheck_drifts 1\n"));
  EXPECT_THAT(text, HasSubstr("stratalux_kiosk_selfcheck_timestamp_seconds 1796284800\n"));
  EXPECT_EQ(text.find("red_green"), std::string::npos) << "a grey camera has none";
  EXPECT_EQ(PrometheusText(figures(), {}).find("stratalux_kiosk_selfcheck"), std::string::npos) << "none yet";
}

}  // namespace
}  // namespace stratalux::rig
