// SPDX-License-Identifier: Apache-2.0
#include "shared/pattern/column_code.h"

#include <algorithm>
#include <bit>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

namespace stratalux {
namespace {

constexpr ColumnCode kCodes[] = {ColumnCode::kGray, ColumnCode::kXor2, ColumnCode::kXor4, ColumnCode::kMinStripe};

bool IsLit(ColumnCode code, unsigned column, int plane, int bits) {
  return (WordOf(code, column, bits) >> (bits - 1 - plane) & 1U) != 0;
}

// Widths of a plane's stripes, but for those that the picture's edges cut.
std::vector<int> Stripes(ColumnCode code, int plane, int bits) {
  std::vector<int> widths;
  unsigned first = 0;
  for (unsigned column = 1; column < 1U << bits; ++column) {
    if (IsLit(code, column, plane, bits) == IsLit(code, column - 1, plane, bits)) continue;
    if (first > 0) widths.push_back(static_cast<int>(column - first));
    first = column;
  }
  return widths;
}

std::pair<int, int> NarrowestAndWidest(ColumnCode code, int plane, int bits) {
  const std::vector<int> widths = Stripes(code, plane, bits);
  const auto [narrow, wide] = std::minmax_element(widths.begin(), widths.end());
  return {*narrow, *wide};
}

TEST(ColumnCode, GivesEachColumnAWordOfItsOwnAndFindsItBack) {
  for (const ColumnCode code : kCodes)
    for (int bits = 1; bits <= kMaxCodeBits; ++bits) {
      std::vector<bool> seen(size_t{1} << bits, false);
      for (unsigned column = 0; column < 1U << bits; ++column) {
        const unsigned word = WordOf(code, column, bits);
        ASSERT_LT(word, 1U << bits) << ToString(code);
        ASSERT_FALSE(seen[word]) << ToString(code) << ", " << bits << " bits, column " << column;
        seen[word] = true;
        ASSERT_EQ(ColumnOf(code, word, bits), column) << ToString(code) << ", " << bits << " bits";
      }
    }
}

TEST(ColumnCode, ChangesOneBitAtATime) {
  for (const ColumnCode code : {ColumnCode::kGray, ColumnCode::kMinStripe})
    for (int bits = 2; bits <= kMaxCodeBits; ++bits)
      for (unsigned column = 0; column < 1U << bits; ++column) {
        const unsigned next = (column + 1) % (1U << bits);  // both are cycles
        ASSERT_EQ(std::popcount(WordOf(code, column, bits) ^ WordOf(code, next, bits)), 1)
            << ToString(code) << ", " << bits << " bits, column " << column;
      }
}

TEST(ColumnCode, OfGrayHasStripesThatDoubleFromTwo) {
  for (int plane = 1; plane < 10; ++plane) {
    const int width = 2 << (9 - plane);
    EXPECT_EQ(NarrowestAndWidest(ColumnCode::kGray, plane, 10), std::pair(width, width)) << plane;
  }
}

TEST(ColumnCode, OfXorHasNoStripeWiderThanItsBase) {
  for (int bits = 4; bits <= 11; ++bits) {
    for (int plane = 0; plane < bits - 1; ++plane)
      EXPECT_EQ(NarrowestAndWidest(ColumnCode::kXor2, plane, bits), std::pair(1, 2)) << plane << '/' << bits;
    EXPECT_EQ(NarrowestAndWidest(ColumnCode::kXor2, bits - 1, bits), std::pair(2, 2));
    for (int plane = 0; plane < bits - 2; ++plane)
      EXPECT_EQ(NarrowestAndWidest(ColumnCode::kXor4, plane, bits), std::pair(2, 4)) << plane << '/' << bits;
    EXPECT_EQ(NarrowestAndWidest(ColumnCode::kXor4, bits - 2, bits), std::pair(4, 4));
    EXPECT_EQ(NarrowestAndWidest(ColumnCode::kXor4, bits - 1, bits), std::pair(2, 2));
  }
}

TEST(ColumnCode, OfXorIsTheGrayCodeOnceTheBaseIsTakenOut) {
  for (const auto& [code, base] : {std::pair(ColumnCode::kXor2, 9), std::pair(ColumnCode::kXor4, 8)}) {
    ASSERT_EQ(BasePlane(code, 10), base);
    for (unsigned column = 0; column < 1024; ++column)
      for (int plane = 0; plane < 10; ++plane) {
        const bool flipped = plane < base && IsLit(code, column, base, 10);
        ASSERT_EQ(IsLit(code, column, plane, 10) != flipped, IsLit(ColumnCode::kGray, column, plane, 10));
      }
  }
}

TEST(ColumnCode, OfMinimumStripesHasTheWidthsThatAreKnown) {
  // By number of bits; of 5 to 7 no code has wider ones (Goddyn & Gvozdjak 2003).
  const std::vector<std::pair<int, int>> narrowest = {{3, 2}, {4, 2}, {5, 4},  {6, 4},  {7, 5},
                                                      {8, 6}, {9, 6}, {10, 8}, {11, 8}, {16, 8}};
  for (const auto& [bits, width] : narrowest) {
    int found = 1 << bits;
    for (int plane = 0; plane < bits; ++plane)
      for (const int stripe : Stripes(ColumnCode::kMinStripe, plane, bits)) found = std::min(found, stripe);
    EXPECT_EQ(found, width) << bits << " bits";
    // Cut off at the first and the last column, stripes may seem wider, never narrower.
    EXPECT_GE(NarrowestStripe(ColumnCode::kMinStripe, bits), width);
  }
}

TEST(ColumnCode, NamesItsNarrowestStripe) {
  EXPECT_EQ(NarrowestStripe(ColumnCode::kGray, 10), 2);
  EXPECT_EQ(NarrowestStripe(ColumnCode::kXor2, 10), 1);
  EXPECT_EQ(NarrowestStripe(ColumnCode::kXor4, 10), 2);
  EXPECT_EQ(NarrowestStripe(ColumnCode::kMinStripe, 10), 8);
}

TEST(ColumnCode, OfMinimumStripesIsTheSameForEver) {
  // Stored sessions were projected with it.
  std::string words;
  for (unsigned column = 0; column < 12; ++column)
    words += std::to_string(WordOf(ColumnCode::kMinStripe, column, 10)) + " ";
  EXPECT_EQ(words, "0 128 129 145 401 405 437 445 957 959 1023 1007 ");
  uint64_t hash = 1469598103934665603ULL;  // FNV-1a of all
  for (int bits = 1; bits <= kMaxCodeBits; ++bits)
    for (unsigned column = 0; column < 1U << bits; ++column)
      hash = (hash ^ WordOf(ColumnCode::kMinStripe, column, bits)) * 1099511628211ULL;
  EXPECT_EQ(hash, 7071916620530703554U);
}

TEST(ColumnCode, IsNamedAndOthersAreRefused) {
  for (const ColumnCode code : kCodes) EXPECT_EQ(*ParseColumnCode(ToString(code)), code);
  EXPECT_EQ(*ParseColumnCode("micro-phase"), ColumnCode::kMicroPhase);
  const auto unknown = ParseColumnCode("xor-8");
  ASSERT_FALSE(unknown.ok());
  EXPECT_EQ(unknown.status().code(), StatusCode::kUsage);
  EXPECT_EQ(unknown.status().message(),
            "code 'xor-8' is unknown; allowed: gray, xor-2, xor-4, min-stripe, micro-phase");
}

}  // namespace
}  // namespace stratalux
