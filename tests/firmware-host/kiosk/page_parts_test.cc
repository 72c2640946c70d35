// SPDX-License-Identifier: Apache-2.0
// What the page is made of: words, pictures, facts of the computer, the store's sessions.
#include <cstdio>
#include <set>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/catalogue/consent.h"
#include "db/privacy/access_log.h"
#include "firmware-host/kiosk/host_facts.h"
#include "firmware-host/kiosk/page_words.h"
#include "firmware-host/kiosk/store_facts.h"
#include "firmware-host/kiosk/ticket_picture.h"
#include "firmware-host/kiosk/words.h"
#include "firmware-host/preview/preview_picture.h"
#include "tests/db/store_fixture.h"
#include "tests/support/jpeg.h"
#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::rig {
namespace {

using ::testing::HasSubstr;
using Json = nlohmann::json;
namespace fs = std::filesystem;

const fs::path kShipped = fs::path(STRATALUX_SOURCE_DIR) / "firmware-host/kiosk/languages";

void CollectKeys(const Json& json, const std::string& place, std::set<std::string>& keys) {
  if (!json.is_object()) keys.insert(place);
  if (json.is_object())
    for (const auto& [name, value] : json.items()) CollectKeys(value, place + "/" + name, keys);
}
Json LanguageFile(const std::string& id) { return Json::parse(ReadText(kShipped / (id + ".json"))); }

class Languages : public ScratchFolderTest {
 protected:
  [[nodiscard]] Status Read(const Json& english, const Json& german) const {
    WriteText(folder_ / "en.json", english.dump());
    WriteText(folder_ / "de.json", german.dump());
    return ReadLanguages(folder_, {"en", "de"}).status();
  }
};

TEST_F(Languages, ThatAreShippedSayTheSameThings) {
  const auto languages = ReadLanguages(kShipped, {"en", "de", "ja"});
  ASSERT_TRUE(languages.ok()) << languages.status().message();
  EXPECT_EQ(languages->at(1).name, "Deutsch");
  std::set<std::string> english;
  CollectKeys(LanguageFile("en"), "", english);
  for (const char* id : {"de", "ja"}) {
    std::set<std::string> keys;
    CollectKeys(LanguageFile(id), "", keys);
    EXPECT_EQ(keys, english) << id;
  }
}

// What a text has places for is filled in by the page.
TEST_F(Languages, ThatAreShippedHaveTheSamePlaces) {
  const auto places = [](const std::string& text) {
    std::multiset<std::string> all;
    for (size_t at = text.find('{'); at != std::string::npos; at = text.find('{', at + 1))
      all.insert(text.substr(at, text.find('}', at) - at));
    return all;
  };
  std::set<std::string> keys;
  const Json english = LanguageFile("en");
  CollectKeys(english, "", keys);
  for (const std::string& key : keys) {
    const Json::json_pointer place(key);
    for (const char* id : {"de", "ja"})
      EXPECT_EQ(places(LanguageFile(id).at(place).dump()), places(english.at(place).dump())) << id << key;
  }
}

TEST_F(Languages, WithoutAWordOfTheMachineAreRefused) {
  const Json english = LanguageFile("en");
  ASSERT_TRUE(Read(english, LanguageFile("de")).ok());
  for (int i = 0; i < kWords; ++i) {
    Json german = LanguageFile("de");
    german["words"].erase(ToString(static_cast<Word>(i)));
    EXPECT_THAT(Read(english, german).message(), HasSubstr(std::string("/words/") + ToString(static_cast<Word>(i))));
  }
  Json german = LanguageFile("de");
  german["closures"].erase("hours");
  EXPECT_THAT(Read(english, german).message(), HasSubstr("de.json has no text for /closures/hours"));
  german = LanguageFile("de");
  german["screens"]["idle"]["begin"] = "";
  EXPECT_THAT(Read(english, german).message(), HasSubstr("/screens/idle/begin"));
  german["screens"]["idle"].erase("begin");
  EXPECT_THAT(Read(english, german).message(), HasSubstr("no text for /screens/idle/begin"));
  EXPECT_THAT(Read(english, Json::array()).message(), HasSubstr("not a JSON object"));
  EXPECT_EQ(ReadLanguages(folder_, {"../en"}).status().code(), StatusCode::kUsage);
  EXPECT_EQ(ReadLanguages(folder_, {"fr"}).status().code(), StatusCode::kUsage);
  EXPECT_EQ(ReadLanguages(folder_, {}).status().code(), StatusCode::kUsage);
}

// Modules of the SVG as rows of '#' and ' ', without the light ones around.
std::vector<std::string> ModulesOf(const std::string& svg, int& size) {
  EXPECT_EQ(std::sscanf(svg.c_str() + svg.find("viewBox"), "viewBox=\"0 0 %d", &size), 1);
  std::vector<std::string> rows(static_cast<size_t>(size), std::string(static_cast<size_t>(size), ' '));
  int x = 0, y = 0, width = 0;
  for (size_t at = svg.rfind("d=\""); (at = svg.find('M', at)) != std::string::npos; ++at) {
    EXPECT_EQ(std::sscanf(svg.c_str() + at, "M%d %dh%d", &x, &y, &width), 3);
    for (int i = 0; i < width; ++i) rows.at(static_cast<size_t>(y)).at(static_cast<size_t>(x + i)) = '#';
  }
  return rows;
}

TEST(TicketPicture, HasTheFindersAndTheLightAroundThatReadersLookFor) {
  const auto svg = TicketPicture("7K2M-9QXD-4");
  ASSERT_TRUE(svg.ok());
  int size = 0;
  const auto rows = ModulesOf(*svg, size);
  EXPECT_EQ((size - 8 - 17) % 4, 0) << "modules a side: 17 + 4 for each version";
  const std::vector<std::string> finder = {"#######", "#     #", "# ### #", "# ### #", "# ### #", "#     #", "#######"};
  const size_t far = static_cast<size_t>(size) - 4 - 7;
  for (const auto& [left, top] : {std::pair<size_t, size_t>{4, 4}, {far, 4}, {4, far}})
    for (size_t i = 0; i < 7; ++i) EXPECT_EQ(rows[top + i].substr(left, 7), finder[i]);
  for (size_t i = 0; i < 4; ++i) EXPECT_EQ(rows[i], std::string(static_cast<size_t>(size), ' '));
  EXPECT_NE(*svg, *TicketPicture("7K2M-9QXD-5"));
  EXPECT_EQ(TicketPicture("").status().code(), StatusCode::kUsage);
  EXPECT_EQ(TicketPicture(std::string(4000, 'a')).status().code(), StatusCode::kUsage);
}

TEST(PreviewPicture, IsSmallGreyAndBrightEnough) {
  FrameRecord record;  // an RGGB mosaic
  Image<uint16_t> frame(1392, 1042);
  for (int y = 0; y < frame.height(); ++y)
    for (int x = 0; x < frame.width(); ++x) frame(x, y) = x < frame.width() / 2 ? 60 : 20;
  const auto jpeg = PreviewPicture(record, frame.view());
  ASSERT_TRUE(jpeg.ok()) << jpeg.status().message();
  const auto picture = DecodeJpeg(*jpeg);
  EXPECT_EQ(picture.channels(), 1);
  EXPECT_LE(picture.width(), 640);
  EXPECT_GT(picture.width(), 300);
  EXPECT_NEAR(static_cast<double>(picture.width()) / picture.height(), 1392.0 / 1042.0, 0.02);
  // Room light of 1.5 % of white: without help sRGB 31 of 255.
  EXPECT_GT(picture(20, 100), 150);
  EXPECT_LT(picture(picture.width() - 20, 100), picture(20, 100) - 30);
  EXPECT_LT(jpeg->size(), 40'000U);
}

TEST(PreviewPicture, ANightStaysDark) {
  const auto jpeg = PreviewPicture({}, Image<uint16_t>(64, 48).view());
  ASSERT_TRUE(jpeg.ok());
  EXPECT_LT(DecodeJpeg(*jpeg)(10, 10), 3);
  EXPECT_EQ(PreviewPicture({}, ImageView<const uint16_t>()).status().code(), StatusCode::kUsage);
}

class HostFacts : public ScratchFolderTest {};

TEST_F(HostFacts, TemperaturesAreThoseOfHwmonElseOfTheZones) {
  const fs::path chip = folder_ / "class/hwmon/hwmon0", zone = folder_ / "class/thermal/thermal_zone0";
  fs::create_directories(chip);
  fs::create_directories(zone);
  WriteText(zone / "temp", "48200\n");
  WriteText(zone / "type", "cpu-thermal\n");
  auto found = Temperatures(folder_);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_EQ(found[0].name, "cpu-thermal");
  EXPECT_DOUBLE_EQ(found[0].celsius, 48.2);
  WriteText(chip / "name", "coretemp\n");
  WriteText(chip / "temp2_input", "51000\n");
  WriteText(chip / "temp1_input", "50000\n");
  WriteText(chip / "temp1_label", "Core 0\n");
  WriteText(chip / "temp3_input", "-274000\n");  // a sensor that is not there
  WriteText(chip / "temp4_input", "none\n");
  WriteText(chip / "fan1_input", "900\n");
  found = Temperatures(folder_);
  ASSERT_EQ(found.size(), 2U);
  EXPECT_EQ(found[0].name, "coretemp Core 0");
  EXPECT_EQ(found[1].name, "coretemp temp2");
  EXPECT_TRUE(Temperatures(folder_ / "nothing").empty());
}

TEST_F(HostFacts, FreeBytesAreOfTheFoldersDisk) {
  EXPECT_GT(FreeBytes(folder_).value_or(0), 0);
  EXPECT_GT(FreeBytes(folder_ / "yet" / "to be made").value_or(0), 0);
}

class RecentSessionsOfAStore : public db::StoreTest {};

TEST_F(RecentSessionsOfAStore, APictureIsSmallGreyAndEnteredOnceInTheAccessLog) {
  const std::string id = StoreSession(3);
  db::DisclosureLog log(folder_, "kiosk");
  for (int look = 0; look < 3; ++look) {
    const auto jpeg = SessionPicture(folder_, id, "127.0.0.1", log);
    ASSERT_TRUE(jpeg.ok()) << jpeg.status().message();
    EXPECT_EQ(DecodeJpeg(*jpeg).channels(), 1);
    EXPECT_LE(DecodeJpeg(*jpeg).width(), 160);
  }
  const auto entries = db::ListAccess(folder_, id);
  ASSERT_TRUE(entries.ok());
  ASSERT_EQ(entries->size(), 1U);
  EXPECT_EQ(entries->front().action, "kiosk");
  EXPECT_EQ(entries->front().detail, "a small picture, to 127.0.0.1");
}

TEST_F(RecentSessionsOfAStore, NoPictureOfWhoTookTheConsentBackOrWhoseKeyIsElsewhere) {
  const std::string taken_back = StoreSession(2);
  db::DisclosureLog log(folder_, "kiosk");
  ASSERT_TRUE(db::WithdrawConsent(folder_, db::kSimulatedVisitor).ok());
  EXPECT_EQ(SessionPicture(folder_, taken_back, "127.0.0.1", log).status().code(), StatusCode::kUsage);
  db::WriterOptions sealed;
  sealed.encryption = db::Encryption::kPerSession;
  const std::string id = StoreSession(2, sealed);
  EXPECT_TRUE(SessionPicture(folder_, id, "127.0.0.1", log).ok()) << "the key is here";
  fs::remove(folder_ / "keys.sqlite");
  const auto without = SessionPicture(folder_, id, "127.0.0.1", log);
  EXPECT_FALSE(without.ok());
  EXPECT_EQ(SessionPicture(folder_, "s000099-00000000", "127.0.0.1", log).status().code(), StatusCode::kNotFound);
  EXPECT_TRUE(db::ListAccess(folder_, taken_back)->empty());
}

TEST_F(RecentSessionsOfAStore, NewestFirstWithoutPictures) {
  const std::string first = StoreSession(2), second = StoreSession(3);
  const auto recent = RecentSessions(folder_, 10);
  ASSERT_TRUE(recent.ok()) << recent.status().message();
  ASSERT_EQ(recent->size(), 2U);
  EXPECT_EQ(recent->at(0).id, second);
  EXPECT_EQ(recent->at(0).frames, 3);
  EXPECT_EQ(recent->at(0).kind, "visitor");
  EXPECT_EQ(recent->at(1).id, first);
  EXPECT_EQ(RecentSessions(folder_, 1)->size(), 1U);
  EXPECT_FALSE(RecentSessions(folder_ / "nothing", 1).ok());
  EXPECT_FALSE(CalibrationAgeDays(folder_, "rig", true, {0}).has_value());
}

}  // namespace
}  // namespace stratalux::rig
