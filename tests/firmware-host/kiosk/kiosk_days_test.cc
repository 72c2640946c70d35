// SPDX-License-Identifier: Apache-2.0
// The operator's day over the page's restarts and over what disks and clocks do.
#include <atomic>
#include <csignal>
#include <fstream>
#include <sstream>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/resource.h>

#include "shared/units/time.h"
#include "tests/firmware-host/kiosk/operator_token.h"
#include "tests/firmware-host/kiosk/page_script.h"
#include "tests/shared/http/http_client.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;
using Json = nlohmann::json;

constexpr int64_t kHour = 3600 * kSecondNs;

// As on a full disk: no file may grow.
class FullDisk {
 public:
  FullDisk() {
    signal_ = std::signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit none{0, before_.rlim_max};
    setrlimit(RLIMIT_FSIZE, &none);
  }
  ~FullDisk() {
    setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, signal_);
  }
  FullDisk(const FullDisk&) = delete;
  FullDisk& operator=(const FullDisk&) = delete;

 private:
  rlimit before_{};
  void (*signal_)(int) = SIG_DFL;
};

class KioskDays : public ScratchFolderTest {
 protected:
  void Start() {
    kiosk_.reset();
    KioskPageOptions options;
    options.operator_token = kOperatorToken;
    options.systemctl.clear();
    options.state = folder_;
    options.wall = [this] { return WallNs{wall_.load()}; };
    auto kiosk = ScriptedKiosk::Start(options, logger_);
    ASSERT_TRUE(kiosk.ok()) << kiosk.status().message();
    kiosk_ = std::move(*kiosk);
    kiosk_->Open();
  }
  [[nodiscard]] Json Status() const {
    const auto answer =
        http::Get(kiosk_->page().port(), "/operator/status", {{"Authorization", "Bearer " + kOperatorToken}});
    EXPECT_EQ(answer.status, 200);
    return Json::parse(answer.body);
  }
  void Refuse() {
    for (const char* event : {"start", "not_sensitive", "refuse"}) ASSERT_TRUE(kiosk_->Happen(event));
  }
  [[nodiscard]] fs::path File() const { return folder_ / "kiosk-days.json"; }
  [[nodiscard]] static std::string Read(const fs::path& file) {
    std::ostringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
  }
  void Write(const std::string& text) const {
    std::ofstream(File()) << text;
    fs::permissions(File(), fs::perms::owner_read | fs::perms::owner_write);
  }
  template <typename Condition>
  static bool Until(const Condition& condition) {
    for (int i = 0; i < 1000 && !condition(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return condition();
  }

  std::atomic<int64_t> wall_ = 1795532400'000'000'000;  // 2026-11-24T15:00:00Z
  Logger logger_{LogLevel::kError};
  std::unique_ptr<ScriptedKiosk> kiosk_;
};

TEST_F(KioskDays, GoOnAfterARestart) {
  Start();
  Refuse();
  Refuse();
  kiosk_->Happen("estop");
  kiosk_->Happen("start");
  Start();
  const Json status = Status();
  EXPECT_EQ(status["today"]["visits_begun"], 2);
  EXPECT_EQ(status["today"]["visits"]["refused"], 2);
  EXPECT_EQ(status["today"]["faults"], 1);
  EXPECT_EQ(status["faults"][0]["word"], "emergency_stop");
  EXPECT_TRUE(status["notes"].empty());
  EXPECT_THAT(http::Get(kiosk_->page().port(), "/metrics").body,
              HasSubstr("stratalux_kiosk_visits_total{end=\"refused\"} 0\n"))
      << "a counter of this program";
}

TEST_F(KioskDays, OfAKioskThatEndsWithinAVisitCountItAsCutOff) {
  Start();
  Refuse();
  kiosk_->Happen("start");
  ASSERT_TRUE(Until([&] { return Read(File()).find("\"visits_begun\":2") != std::string::npos; }));
  Start();
  const Json today = Status()["today"];
  EXPECT_EQ(today["visits_begun"], 2);
  EXPECT_EQ(today["visits"]["refused"], 1);
  EXPECT_EQ(today["visits"]["cut_off"], 1);
}

TEST_F(KioskDays, HoldCountsAndNobody) {
  Start();
  for (const char* event :
       {"start", "not_sensitive", "agree", "face_good", "face_good", "tick", "tick", "tick", "captured_good"})
    ASSERT_TRUE(kiosk_->Happen(event)) << event;
  ASSERT_EQ(kiosk_->state().phase, Phase::kThanks);
  ASSERT_EQ(http::Get(kiosk_->page().port(), "/ticket.svg").status, 200);  // as the visitor's screen does
  kiosk_->Happen("tick");
  ASSERT_TRUE(Until([&] { return Read(File()).find("\"kept\":1") != std::string::npos; }));
  const std::string text = Read(File());
  EXPECT_THAT(text, Not(HasSubstr(kScriptedTicket)));
  const Json kept = Json::parse(text);
  for (const auto& [name, value] : kept["days"][0].items())
    EXPECT_TRUE(name == "day" || value.is_number() || value.is_object()) << name;
}

TEST_F(KioskDays, AFileThatIsDamagedOrNewerIsSaidAndSetAside) {
  for (const auto& [text, aside] : {std::pair{R"({"schema": 1, "days)", "kiosk-days.json.damaged"},
                                    std::pair{R"({"schema": 2, "days": "another way"})", "kiosk-days.json.newer"}}) {
    kiosk_.reset();
    Write(text);
    Start();
    const Json status = Status();
    ASSERT_EQ(status["notes"].size(), 1U) << text;
    EXPECT_THAT(status["notes"][0].get<std::string>(), HasSubstr(aside));
    EXPECT_EQ(Read(folder_ / aside), text) << "not a byte of it is lost";
    EXPECT_EQ(status["today"]["visits_begun"], 0);
    Refuse();
    Start();
    EXPECT_EQ(Status()["today"]["visits_begun"], 1);
    EXPECT_TRUE(Status()["notes"].empty());
  }
}

TEST_F(KioskDays, AFileThatMayBeSomebodyElsesIsSaidAndLeft) {
  const std::string text = R"({"schema": 1})";
  Write(text);
  fs::permissions(File(), fs::perms::all);
  Start();
  Refuse();
  ASSERT_EQ(Status()["notes"].size(), 1U);
  EXPECT_THAT(Status()["notes"][0].get<std::string>(), HasSubstr("it stays as it is"));
  EXPECT_EQ(Status()["today"]["visits_begun"], 1);
  kiosk_.reset();
  EXPECT_EQ(Read(File()), text);
}

TEST_F(KioskDays, AFullDiskIsSaidAndTheKioskGoesOn) {
  Start();
  Refuse();
  ASSERT_TRUE(Until([&] { return Read(File()).find("\"refused\":1") != std::string::npos; }));
  {
    const FullDisk full;
    Refuse();
    ASSERT_TRUE(Until([&] { return !Status()["notes"].empty(); }));
    EXPECT_THAT(Status()["notes"][0].get<std::string>(), HasSubstr("kiosk-days.json"));
    EXPECT_EQ(Status()["today"]["visits"]["refused"], 2);
    EXPECT_THAT(Read(File()), HasSubstr("\"refused\":1")) << "the old one stays whole";
  }
  Refuse();
  ASSERT_TRUE(Until([&] { return Status()["notes"].empty(); }));
  EXPECT_TRUE(Until([&] { return Read(File()).find("\"refused\":3") != std::string::npos; }));
}

TEST_F(KioskDays, AClockThatIsSetBackOverMidnightGoesOnWithTheDayBefore) {
  setenv("TZ", "UTC0", 1);
  tzset();
  wall_ += 8 * kHour;  // 23:00
  Start();
  Refuse();
  wall_ += 2 * kHour;
  Refuse();
  Refuse();
  wall_ -= 2 * kHour;
  Start();
  Refuse();
  const Json status = Status();
  EXPECT_EQ(status["today"]["day"], "2026-11-24");
  EXPECT_EQ(status["today"]["visits"]["refused"], 2);
  ASSERT_EQ(status["other_days"].size(), 1U);
  EXPECT_EQ(status["other_days"][0]["day"], "2026-11-25");
  EXPECT_EQ(status["other_days"][0]["visits"]["refused"], 2);
}

}  // namespace
}  // namespace stratalux::rig
