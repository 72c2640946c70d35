// SPDX-License-Identifier: Apache-2.0
// OpenEXR files of maps: 32-bit float channels, linear.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "shared/base/result.h"
#include "shared/image/image.h"

namespace stratalux::fit {

// Writes `image` with the given channel names (as many as image.channels(); e.g. "R","G","B", or "depth.00"...).
Status WriteExr(const std::filesystem::path& file, ImageView<const float> image,
                const std::vector<std::string>& channels);
// Reads the named channels back, in that order; kNotFound for a missing file or channel.
Result<Image<float>> ReadExr(const std::filesystem::path& file, const std::vector<std::string>& channels);

}  // namespace stratalux::fit
