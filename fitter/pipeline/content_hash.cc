// SPDX-License-Identifier: Apache-2.0
#include "fitter/pipeline/content_hash.h"

#include <cstdio>

#include <xxhash.h>

namespace stratalux::fit {

std::string ContentHashOf(const std::string& text) {
  const XXH128_hash_t hash = XXH3_128bits(text.data(), text.size());
  char hex[33];
  std::snprintf(hex, sizeof hex, "%016llx%016llx", static_cast<unsigned long long>(hash.high64),
                static_cast<unsigned long long>(hash.low64));
  return hex;
}

}  // namespace stratalux::fit
