// SPDX-License-Identifier: Apache-2.0
// The code that a visitor of a kiosk takes home: who has it may have everything forgotten.
//
// Ten symbols of Crockford's base 32 (50 bits drawn by chance, https://www.crockford.com/base32.html) and his check
// symbol, which finds every single wrong symbol and every two that changed places; drawn again while that is none of
// the 32 or no digit is among all. Written 7K3QZ-M0P4T-3. The visitor's pseudonym is the code itself (t-7k3qzm0p4t3):
// what a store, its copies and its manifests need to find the visitor is in each of them.
#pragma once

#include <string>

#include "shared/base/result.h"

namespace stratalux::db {

// A new code, as it is printed.
[[nodiscard]] std::string DrawTicket();
// The pseudonym of the visitor who has it. Letters may be of either case, O is 0, I and L are 1, blanks and hyphens do
// not count. kUsage for what is no code, and which of its faults it has.
[[nodiscard]] Result<std::string> VisitorOfTicket(const std::string& code);

}  // namespace stratalux::db
