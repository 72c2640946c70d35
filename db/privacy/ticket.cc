// SPDX-License-Identifier: Apache-2.0
#include "db/privacy/ticket.h"

#include <cctype>
#include <cstdint>
#include <string_view>

#include <sodium.h>

namespace stratalux::db {
namespace {

// The last five are check symbols alone.
constexpr std::string_view kSymbols = "0123456789ABCDEFGHJKMNPQRSTVWXYZ*~$=U";
constexpr uint32_t kBase = 32, kCheckBase = 37;
constexpr size_t kDrawn = 10, kHalf = 5;

uint64_t CheckOf(std::string_view drawn) {
  uint64_t remainder = 0;
  for (const char c : drawn) remainder = (remainder * kBase + kSymbols.find(c)) % kCheckBase;
  return remainder;
}

char Canonical(char c) {
  const char upper = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  if (upper == 'O') return '0';
  return upper == 'I' || upper == 'L' ? '1' : upper;
}

Status NoTicket(const std::string& why) {
  return Status::Usage("the ticket's code " + why + "; it has eleven letters and digits, such as 7K3QZ-M0P4T-3");
}

}  // namespace

std::string DrawTicket() {
  while (true) {
    std::string code;
    for (size_t i = 0; i < kDrawn; ++i) code += kSymbols[randombytes_uniform(kBase)];
    const uint64_t check = CheckOf(code);
    if (check >= kBase) continue;
    code += kSymbols[check];
    // A pseudonym of letters alone could be a name (CheckNewPseudonym).
    if (code.find_first_of("0123456789") == std::string::npos) continue;
    return code.substr(0, kHalf) + "-" + code.substr(kHalf, kHalf) + "-" + code.substr(kDrawn);
  }
}

Result<std::string> VisitorOfTicket(const std::string& code) {
  std::string symbols;
  for (const char c : code)
    if (c != '-' && c != ' ') symbols += Canonical(c);
  if (symbols.size() != kDrawn + 1) return NoTicket("has " + std::to_string(symbols.size()) + " symbols");
  for (const char c : symbols)
    if (kSymbols.substr(0, kBase).find(c) == std::string_view::npos) return NoTicket("has a symbol that no code has");
  if (kSymbols[CheckOf(std::string_view(symbols).substr(0, kDrawn))] != symbols.back())
    return NoTicket("is mistyped: its last symbol does not agree with the others");
  std::string visitor = "t-";
  for (const char c : symbols) visitor += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return visitor;
}

}  // namespace stratalux::db
