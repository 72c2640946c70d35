// SPDX-License-Identifier: Apache-2.0
// `stratalux-db export --visitor`: all that is known of a person, for that person, and gone with a `forget`.
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include "db/privacy/access_log.h"
#include "tests/db/interchange/crate_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::UnorderedElementsAre;

class VisitorExports : public CrateTest {
 protected:
  void SetUp() override {
    CrateTest::SetUp();
    out_ = base_ / "for-them";
  }
  [[nodiscard]] Outcome ExportVisitor() const {
    return Db(std::string("export --visitor ") + kVisitor + " --out " + out_.string());
  }
  [[nodiscard]] size_t PicturesOf(const std::string& id) const {
    std::error_code error;
    size_t pictures = 0;
    for (const auto& entry : fs::directory_iterator(out_ / id / "frames", error))
      pictures += static_cast<size_t>(entry.path().extension() == ".png");
    return pictures;
  }

  fs::path out_;
};

TEST_F(VisitorExports, HoldAllOfTheVisitorAndNothingOfOthers) {
  const std::string first = Visit(), second = Visit(), other = Simulated();
  ASSERT_EQ(ExportVisitor().code, 0);
  const auto json = nlohmann::json::parse(TextOfFile(out_ / "visitor.json"));
  EXPECT_EQ(json["pseudonym"], kVisitor);
  EXPECT_EQ(json["consents"].size(), 2U);
  std::vector<std::string> sessions;
  for (const auto& session : json["sessions"]) sessions.push_back(session["session"]);
  EXPECT_THAT(sessions, UnorderedElementsAre(first, second));
  for (const std::string& id : {first, second}) {
    EXPECT_EQ(PicturesOf(id), 4U);
    EXPECT_THAT(TextOfFile(out_ / "README.txt"), HasSubstr(id));
    EXPECT_THAT(TextOfFile(out_ / id / "fits" / "0badcafe" / "report" / "index.html"), HasSubstr(kVisitor));
  }
  EXPECT_FALSE(fs::exists(out_ / other));
}

TEST_F(VisitorExports, GoOnWhereTheyBrokeOff) {
  const std::string id = Visit();
  ASSERT_EQ(ExportVisitor().code, 0);
  for (const char* missing : {"visitor.json", "README.txt"}) fs::remove(out_ / missing);
  fs::remove_all(out_ / id / "frames");
  const Outcome again = ExportVisitor();
  EXPECT_EQ(again.code, 0) << again.out;
  EXPECT_TRUE(fs::exists(out_ / "visitor.json"));
  EXPECT_EQ(PicturesOf(id), 4U);
  EXPECT_THAT(ExportVisitor().out, HasSubstr("0 frames written"));
}

TEST_F(VisitorExports, AreForgottenToTheLastFile) {
  const std::string id = Visit();
  ASSERT_EQ(ExportVisitor().code, 0);
  const auto log = ListAccess(folder_, id);
  ASSERT_TRUE(log.ok()) << log.status().message();
  EXPECT_EQ(log->size(), 2U) << "the folder, and the visit within it";
  const Outcome forgotten = Db(std::string("forget --visitor ") + kVisitor + " --yes");
  EXPECT_EQ(forgotten.code, 0) << forgotten.out;
  EXPECT_FALSE(fs::exists(out_)) << "visitor.json and README.txt name the visitor";
}

// What the two files say of the other visits is no longer whole: they go with the first one.
TEST_F(VisitorExports, KeepTheOtherVisitsPictures) {
  const std::string first = Visit(), second = Visit();
  ASSERT_EQ(ExportVisitor().code, 0);
  ASSERT_EQ(Db("forget " + first + " --yes").code, 0);
  EXPECT_FALSE(fs::exists(out_ / first));
  EXPECT_FALSE(fs::exists(out_ / "visitor.json"));
  EXPECT_EQ(PicturesOf(second), 4U);
  ASSERT_EQ(ExportVisitor().code, 0) << "again, of what is left";
  EXPECT_THAT(TextOfFile(out_ / "README.txt"), ::testing::Not(HasSubstr(first)));
}

TEST_F(VisitorExports, TakeNoFolderThatHoldsOtherThingsAndNoUnknownVisitor) {
  Visit();
  fs::create_directories(out_);
  WriteText(out_ / "photo.jpg", "mine");
  EXPECT_EQ(ExportVisitor().code, 2);
  EXPECT_EQ(Db("export --visitor v-nobody1 --out " + (base_ / "empty").string()).code, 4);
  EXPECT_FALSE(fs::exists(base_ / "empty"));
}

}  // namespace
}  // namespace stratalux::db
