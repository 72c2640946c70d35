// SPDX-License-Identifier: Apache-2.0
// The note by which a visit without a ticket is found again.
#include "db/privacy/open_visits.h"

#include <fstream>

#include <gmock/gmock.h>

#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

class OpenVisitsTest : public StoreTest {
 protected:
  [[nodiscard]] std::vector<std::string> Visitors() const {
    std::vector<std::string> visitors;
    const auto visits = OpenVisits(folder_);
    EXPECT_TRUE(visits.ok()) << visits.status().message();
    if (visits.ok())
      for (const OpenVisit& visit : *visits) visitors.push_back(visit.visitor);
    return visitors;
  }
  void Note(const std::string& text) const {
    std::ofstream(folder_ / "visits" / "visit-1.open", std::ios::binary | std::ios::trunc) << text;
  }
};

TEST_F(OpenVisitsTest, AreNotedOnceAndClosed) {
  for (int attempt = 0; attempt < 2; ++attempt) ASSERT_TRUE(NoteOpenVisit(folder_, "visit-1", "v-5f3a91c2").ok());
  EXPECT_THAT(Visitors(), ::testing::ElementsAre("v-5f3a91c2"));
  ASSERT_TRUE(CloseVisit(folder_, "visit-1").ok());
  EXPECT_THAT(Visitors(), ::testing::IsEmpty());
}

// A disk that failed in the midst of closing: wiped, not removed. Who then refuses must be found.
TEST_F(OpenVisitsTest, OneThatWasHalfClosedIsNotedAnew) {
  ASSERT_TRUE(NoteOpenVisit(folder_, "visit-1", "v-5f3a91c2").ok());
  for (const std::string& left : {std::string(10, '\0'), std::string(), std::string("v-5f3a")}) {
    Note(left);
    ASSERT_TRUE(NoteOpenVisit(folder_, "visit-1", "v-5f3a91c2").ok());
    EXPECT_THAT(Visitors(), ::testing::ElementsAre("v-5f3a91c2"));
  }
}

}  // namespace
}  // namespace stratalux::db
