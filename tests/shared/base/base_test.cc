// SPDX-License-Identifier: Apache-2.0
#include <atomic>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

#include "shared/base/parallel.h"
#include "shared/base/random.h"
#include "shared/base/result.h"

namespace stratalux {
namespace {

// A success where an error belongs would be passed on as one, and what was never made be taken for made.
TEST(Result, OfASuccessIsAnError) {
  const Result<int> nothing(Status::Ok());
  EXPECT_FALSE(nothing.ok());
  EXPECT_EQ(nothing.status().code(), StatusCode::kFailed);
  EXPECT_TRUE(Result<int>(3).ok());
}

TEST(ParallelFor, VisitsEveryItemOnceWhateverTheThreads) {
  for (int threads : {1, 2, 5}) {
    std::vector<std::atomic<int>> visits(1001);
    ParallelFor(
        1001, 17,
        [&](int64_t begin, int64_t end) {
          for (int64_t i = begin; i < end; ++i) ++visits[i];
        },
        threads);
    for (const auto& v : visits) EXPECT_EQ(v.load(), 1);
  }
}

TEST(ParallelFor, RethrowsWhatTheBodyThrows) {
  EXPECT_THROW(ParallelFor(
                   100, 1,
                   [](int64_t begin, int64_t) {
                     if (begin == 42) throw std::runtime_error("x");
                   },
                   3),
               std::runtime_error);
}

TEST(Random, HasTheMomentsOfItsDistributions) {
  Random random(7);
  double sum = 0.0, square = 0.0, uniform = 0.0;
  constexpr int kCount = 200000;
  for (int i = 0; i < kCount; ++i) {
    const double x = random.Normal();
    sum += x;
    square += x * x;
    uniform += random.Uniform();
  }
  EXPECT_NEAR(sum / kCount, 0.0, 5.0 / std::sqrt(kCount));
  EXPECT_NEAR(square / kCount, 1.0, 5.0 * std::sqrt(2.0 / kCount));
  EXPECT_NEAR(uniform / kCount, 0.5, 5.0 / std::sqrt(12.0 * kCount));
}

TEST(Random, StreamsOfOneSeedDiffer) {
  EXPECT_EQ(Random(1, 2).Bits(), Random(1, 2).Bits());
  EXPECT_NE(Random(1, 2).Bits(), Random(1, 3).Bits());
  EXPECT_NE(Random(1, 2).Bits(), Random(2, 2).Bits());
}

Result<int> Half(int x) {
  if (x % 2 != 0) return Status::Usage("odd");
  return x / 2;
}
Result<int> Quarter(int x) {
  SLX_ASSIGN_OR_RETURN(const int half, Half(x));
  return Half(half).WithContext("second half");
}

TEST(ResultMacros, PassValuesAndErrorsWithContext) {
  EXPECT_EQ(*Quarter(8), 2);
  EXPECT_EQ(Quarter(3).status().message(), "odd");
  EXPECT_EQ(Quarter(6).status().message(), "second half: odd");
  EXPECT_EQ(Quarter(6).status().exit_code(), 2);
}

}  // namespace
}  // namespace stratalux
