// SPDX-License-Identifier: Apache-2.0
// The live preview on a small simulated rig, as a browser has it.
#include "firmware-host/preview/live_preview.h"

#include <algorithm>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <thread>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "tests/firmware-host/session/small_station.h"
#include "tests/shared/http/http_client.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using Json = nlohmann::json;

class LivePreviewTest : public ScratchFolderTest {
 protected:
  LivePreviewTest() : options_(SmallStation(folder_)) {}
  ~LivePreviewTest() override {
    if (loop_.joinable()) End();
  }
  void Begin() {
    auto station = CaptureStation::Open(options_, stop_, logger_);
    if (!station.ok()) throw std::runtime_error(station.status().message());
    station_ = std::move(*station);
    PreviewPageOptions page = PreviewOptionsOf(*station_, options_.config);
    auto started = PreviewPage::Start(page, logger_);
    if (!started.ok()) throw std::runtime_error(started.status().message());
    page_ = std::move(*started);
    loop_ = std::thread([this] { ended_ = RunPreview(*station_, options_.config, *page_, stop_, logger_); });
  }
  void End() {
    stop_.Request(StopReason::kOperator);
    loop_.join();
  }
  [[nodiscard]] int lit() const {
    const auto switches = station_->rig().simulation->switches();
    return static_cast<int>(std::count_if(switches.begin(), switches.end(), [](LightSwitch* light) {
      bool on = true;
      return light->Read(on) != 0 || on;
    }));
  }
  [[nodiscard]] int Post(const std::string& place) const {
    const std::string here = "127.0.0.1:" + std::to_string(page_->port());
    return http::Ask(page_->port(), "POST", place,
                     {{"Host", here}, {"Origin", "http://" + here}, {"Connection", "close"}})
        .status;
  }
  // The first look of a new viewer that is as wanted.
  Json Until(const std::function<bool(const Json&)>& wanted) const {
    Json look;
    for (int i = 0; i < 200; ++i) {
      http::Client client(page_->port());
      client.Send("GET /events HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(page_->port()) + "\r\n\r\n");
      const std::string text = client.ReadUntil("}\n\n");
      const size_t at = text.rfind("data: ");
      look = at == std::string::npos ? Json() : Json::parse(text.substr(at + 6), nullptr, false);
      if (look.is_object() && wanted(look)) return look;
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    ADD_FAILURE() << "never: " << look.dump();
    return look;
  }
  Json NextPicture() const {
    const int64_t now = Until([](const Json&) { return true; })["picture"];
    return Until([now](const Json& look) { return look["picture"] > now + 1; });
  }

  StationOptions options_;
  StopToken stop_;
  Logger logger_{LogLevel::kError};
  std::unique_ptr<CaptureStation> station_;
  std::unique_ptr<PreviewPage> page_;
  std::thread loop_;
  Status ended_;
};

TEST_F(LivePreviewTest, ShowsTheDarkAndTheWhiteOfOneProjectorAndStoresNothing) {
  Begin();
  const Json dark = NextPicture();
  EXPECT_EQ(dark["light"], -1);
  EXPECT_EQ(lit(), 0);
  ASSERT_EQ(Post("/light/2"), 204);
  const Json white = NextPicture();
  EXPECT_EQ(white["light"], 2);
  EXPECT_GT(white["level"], 4.0 * dark["level"].get<double>());
  EXPECT_EQ(lit(), 1) << "one projector, lit between the frames, too: nothing flickers";
  const http::Answer picture = http::Get(page_->port(), "/preview.jpg");
  EXPECT_EQ(picture.headers.at("content-type"), "image/jpeg");
  EXPECT_EQ(picture.headers.at("cache-control"), "no-store");
  EXPECT_THAT(picture.headers.at("content-security-policy"), HasSubstr("default-src 'self'"));
  ASSERT_EQ(Post("/light/0"), 204);
  EXPECT_EQ(NextPicture()["light"], 0);
  EXPECT_EQ(lit(), 1) << "the other one is dark";
  ASSERT_EQ(Post("/light/off"), 204);
  NextPicture();
  EXPECT_EQ(lit(), 0);
  End();
  EXPECT_TRUE(ended_.ok()) << ended_.message();
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store"));
}

TEST_F(LivePreviewTest, ALongerExposureIsBrighterWithinTheCamerasBounds) {
  Begin();
  ASSERT_EQ(Post("/light/1"), 204);
  ASSERT_EQ(Post("/exposure/4"), 204);
  const Json low = NextPicture();
  EXPECT_EQ(low["exposure_ms"], 4.0);
  ASSERT_EQ(Post("/exposure/8"), 204);
  EXPECT_NEAR(NextPicture()["level"].get<double>() / low["level"].get<double>(), 2.0, 0.4);
  for (const char* no : {"/exposure/0.1", "/exposure/5000", "/exposure/nan", "/exposure/-4", "/exposure/4x"})
    EXPECT_EQ(Post(no), 400) << no;
  for (const char* no : {"/light/4", "/light/-1", "/light/on"}) EXPECT_EQ(Post(no), 404) << no;
  EXPECT_EQ(http::Ask(page_->port(), "POST", "/light/1", {{"Origin", "http://elsewhere.example"}}).status, 403);
}

TEST_F(LivePreviewTest, EmergencyStopTakesTheLightAndOnlyResetGivesItBackUnlit) {
  Begin();
  ASSERT_EQ(Post("/light/1"), 204);
  NextPicture();
  SimulatedRig& rig = *station_->rig().simulation;
  rig.Happen(RigSignal::kEmergencyStop, SignalLevel::kActive);
  const Json stopped = Until([](const Json& look) { return look["stopped"]; });
  EXPECT_THAT(stopped["why"].get<std::string>(), HasSubstr("emergency stop"));
  EXPECT_EQ(stopped["light"], -1);
  EXPECT_EQ(lit(), 0);
  EXPECT_EQ(Post("/light/1"), 409);
  ASSERT_EQ(Post("/reset"), 204);
  std::this_thread::sleep_for(std::chrono::milliseconds(400));
  EXPECT_TRUE(Until([](const Json&) { return true; })["stopped"]) << "it is pressed still";
  rig.Happen(RigSignal::kEmergencyStop, SignalLevel::kRest);
  std::this_thread::sleep_for(std::chrono::milliseconds(400));
  EXPECT_TRUE(Until([](const Json&) { return true; })["stopped"]) << "nobody has pressed Reset";
  ASSERT_EQ(Post("/reset"), 204);
  const Json again = Until([](const Json& look) { return !look["stopped"]; });
  EXPECT_EQ(again["light"], -1);
  EXPECT_EQ(lit(), 0) << "who looks lights it again";
  ASSERT_EQ(Post("/light/1"), 204);
  NextPicture();
  EXPECT_EQ(lit(), 1);
}

TEST_F(LivePreviewTest, ALightGoesOutInTimeAndSaysSo) {
  options_.config.max_on_time_s = 0.5;
  Begin();
  ASSERT_EQ(Post("/light/3"), 204);
  Until([](const Json& look) { return look["light"] == 3; });
  const Json out = Until([](const Json& look) { return look["light"] == -1; });
  EXPECT_THAT(out["why"].get<std::string>(), HasSubstr("max_on_time_s"));
  EXPECT_FALSE(out["stopped"]) << "no fault: it can be lit again";
  NextPicture();
  EXPECT_EQ(lit(), 0);
}

TEST_F(LivePreviewTest, ACameraThatIsUnpluggedIsSaidAndComesBack) {
  Begin();
  NextPicture();
  SimulatedRig& rig = *station_->rig().simulation;
  rig.Happen(RigSignal::kCamera, SignalLevel::kActive);
  const Json gone = Until([](const Json& look) { return look["stopped"]; });
  EXPECT_THAT(gone["why"].get<std::string>(), HasSubstr("camera"));
  rig.Happen(RigSignal::kCamera, SignalLevel::kRest);
  ASSERT_EQ(Post("/reset"), 204);
  Until([](const Json& look) { return !look["stopped"]; });
  NextPicture();
}

}  // namespace
}  // namespace stratalux::rig
