// SPDX-License-Identifier: Apache-2.0
// Arrays as NumPy's .npy files, version 1.0, little-endian, C order: `numpy.load` reads them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "shared/base/result.h"

namespace stratalux::fit {

// `values` in rows of `columns`; columns 0: a one-dimensional array.
Status WriteNpy(const std::filesystem::path& file, std::span<const float> values, int64_t columns = 0);
Status WriteNpy(const std::filesystem::path& file, std::span<const int32_t> values, int64_t columns = 0);

// All values, whatever the shape. kNotFound: no such file; kIntegrity: no array of that type, or cut short.
Result<std::vector<float>> ReadNpyFloats(const std::filesystem::path& file);
Result<std::vector<int32_t>> ReadNpyIntegers(const std::filesystem::path& file);

// `count` values from the `first` on; kIntegrity where the file has fewer. Nothing else of it is read.
Result<std::vector<float>> ReadNpyFloats(const std::filesystem::path& file, int64_t first, int64_t count);

}  // namespace stratalux::fit
