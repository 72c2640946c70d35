// SPDX-License-Identifier: Apache-2.0
// Two images of the same size, pixel by pixel.
#pragma once

#include <functional>

#include "shared/image/image.h"

namespace stratalux::fit {

template <typename Operation>
[[nodiscard]] Image<float> Combine(const Image<float>& a, const Image<float>& b, Operation operation) {
  Image<float> result = a;
  for (size_t i = 0; i < result.size(); ++i) result.pixels()[i] = operation(a.pixels()[i], b.pixels()[i]);
  return result;
}
[[nodiscard]] inline Image<float> Sum(const Image<float>& a, const Image<float>& b) {
  return Combine(a, b, std::plus<>());
}
[[nodiscard]] inline Image<float> Difference(const Image<float>& a, const Image<float>& b) {
  return Combine(a, b, std::minus<>());
}

}  // namespace stratalux::fit
