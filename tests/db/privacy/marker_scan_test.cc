// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/marker_scan.h"

#include <algorithm>
#include <random>
#include <set>

#include "tests/db/store_fixture.h"

namespace stratalux::db {
namespace {

using MarkerScanTest = StoreTest;

TEST_F(MarkerScanTest, FindsEveryMarkerAtEveryPlaceThatAPlainSearchFinds) {
  std::mt19937_64 random(7);
  std::vector<uint8_t> bytes(3 * (size_t{1} << 20) + 12345);
  for (uint8_t& b : bytes) b = static_cast<uint8_t>(random());
  MarkerScan scan;
  std::vector<std::vector<uint8_t>> markers;
  for (int i = 0; i < 300; ++i) {
    std::vector<uint8_t> marker(8 + random() % 40);
    for (uint8_t& b : marker) b = static_cast<uint8_t>(random());
    if (i % 3 == 1) std::copy_n(markers.back().begin(), 8, marker.begin());  // same start
    markers.push_back(marker);
    EXPECT_EQ(scan.Add(marker), i);
  }
  // Over the borders of the blocks of 1 MiB, at both ends, and anywhere.
  std::vector<size_t> places = {0,       bytes.size() - 48, (1 << 20) - 1, (1 << 20) - 8, (1 << 20) - 47,
                                2 << 20, (2 << 20) - 20};
  while (places.size() < 200) places.push_back(random() % (bytes.size() - 48));
  for (size_t i = 0; i < places.size(); ++i)
    std::copy(markers[i].begin(), markers[i].end(), bytes.begin() + static_cast<int64_t>(places[i]));
  std::set<std::pair<int64_t, int>> expected, found;
  for (int m = 0; m < static_cast<int>(markers.size()); ++m)
    for (auto at = bytes.begin();; ++at) {
      at = std::search(at, bytes.end(), markers[m].begin(), markers[m].end());
      if (at == bytes.end()) break;
      expected.emplace(at - bytes.begin(), m);
    }
  WriteBytes(folder_ / "haystack", bytes);
  const auto hits = scan.Scan(folder_ / "haystack");
  ASSERT_TRUE(hits.ok());
  for (const auto& hit : *hits) found.emplace(hit.offset, hit.marker);
  EXPECT_EQ(found, expected);
  EXPECT_GT(expected.size(), 190U);
}

TEST_F(MarkerScanTest, FindsNothingInFilesShorterThanAMarker) {
  MarkerScan scan;
  scan.Add("0123456789");
  for (const char* text : {"", "0", "01234567", "012345678"}) {
    WriteText(folder_ / "short", text);
    EXPECT_TRUE(scan.Scan(folder_ / "short")->empty());
  }
  WriteText(folder_ / "short", "0123456789");
  EXPECT_EQ(scan.Scan(folder_ / "short")->size(), 1U);
  EXPECT_FALSE(scan.Scan(folder_ / "none").ok());
}

}  // namespace
}  // namespace stratalux::db
