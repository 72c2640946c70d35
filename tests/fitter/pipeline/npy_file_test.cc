// SPDX-License-Identifier: Apache-2.0
#include "fitter/export/npy_file.h"

#include <gtest/gtest.h>

#include "tests/support/scratch_folder.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

class NpyFile : public ScratchFolderTest {};

TEST_F(NpyFile, IsReadBackBitByBit) {
  const std::vector<float> values = {1.5F, -0.0F, 3e38F, 1e-42F, 7.0F, 8.0F};
  ASSERT_TRUE(WriteNpy(folder_ / "a.npy", values, 3).ok());
  EXPECT_EQ(*ReadNpyFloats(folder_ / "a.npy"), values);
  const std::vector<int32_t> none;
  ASSERT_TRUE(WriteNpy(folder_ / "b.npy", none).ok());
  EXPECT_EQ(*ReadNpyIntegers(folder_ / "b.npy"), none);
}

// https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
TEST_F(NpyFile, HasTheHeaderThatNumPyReads) {
  ASSERT_TRUE(WriteNpy(folder_ / "a.npy", std::vector<float>(6), 3).ok());
  const std::string text = ReadText(folder_ / "a.npy");
  EXPECT_EQ(text.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
  const size_t length = static_cast<uint8_t>(text[8]) + 256U * static_cast<uint8_t>(text[9]);
  EXPECT_EQ((10 + length) % 64, 0U);
  EXPECT_EQ(text[10 + length - 1], '\n');
  EXPECT_EQ(text.substr(10, 59), "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }");
  EXPECT_EQ(text.size(), 10 + length + 24);
}

TEST_F(NpyFile, ADamagedOneIsRefused) {
  EXPECT_EQ(ReadNpyFloats(folder_ / "none").status().code(), StatusCode::kNotFound);
  ASSERT_TRUE(WriteNpy(folder_ / "a.npy", std::vector<float>(6)).ok());
  EXPECT_EQ(ReadNpyIntegers(folder_ / "a.npy").status().code(), StatusCode::kIntegrity);
  const std::string text = ReadText(folder_ / "a.npy");
  for (const size_t length : {0UL, 7UL, 40UL, text.size() - 1}) {
    WriteText(folder_ / "cut.npy", text.substr(0, length));
    EXPECT_EQ(ReadNpyFloats(folder_ / "cut.npy").status().code(), StatusCode::kIntegrity) << length;
  }
}

}  // namespace
}  // namespace stratalux::fit
