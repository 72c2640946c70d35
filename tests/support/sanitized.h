// SPDX-License-Identifier: Apache-2.0
// What AddressSanitizer takes for itself: tests that need it skip by this, and say what it is.
#pragma once

namespace stratalux {

#if defined(__SANITIZE_ADDRESS__)
inline constexpr bool kUnderAddressSanitizer = true;
#else
inline constexpr bool kUnderAddressSanitizer = false;
#endif

}  // namespace stratalux
