// SPDX-License-Identifier: Apache-2.0
#include "shared/pattern/column_code.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

#include "shared/base/check.h"

namespace stratalux {
namespace {

constexpr std::array<std::string_view, 5> kCodeNames = {"gray", "xor-2", "xor-4", "min-stripe", "micro-phase"};

// XORs the planes coarser than the base with it. Its own inverse: the base stays.
unsigned XoredWithBase(unsigned word, int base, int bits) {
  const unsigned base_bit = 1U << (bits - 1 - base);
  const unsigned coarser = ((1U << bits) - 1U) & ~(2U * base_bit - 1U);
  return (word & base_bit) != 0 ? word ^ coarser : word;
}

// A cycle through all words of so many bits, of which one changes at a time, as the bits that change: `changes` begins
// it, and each further stretch is the one before it with bit b renamed to `renamed`[b]. Found by search for the longest
// shortest run, among the cycles with such a symmetry; the tests count it.
struct LongRunCycle {
  int bits = 0;
  std::string_view changes, renamed;
};
constexpr std::array<LongRunCycle, 4> kLongRunCycles = {{{5, "43024103", "03214"},
                                                         {6, "4125413542031453", "240513"},
                                                         {7, "1326043120563140", "4512036"},
                                                         {8, "70425316402751436205437260451726", "32701564"}}};
constexpr int kFewestLongRunBits = 5;  // of fewer, no code has longer runs than the reflected one's 2

std::vector<uint16_t> WordsOf(const LongRunCycle& cycle) {
  std::vector<uint16_t> words;
  std::vector<int> changes;
  for (const char digit : cycle.changes) changes.push_back(digit - '0');
  unsigned word = 0;
  while (words.size() < size_t{1} << cycle.bits) {
    for (int& bit : changes) {
      words.push_back(static_cast<uint16_t>(word));
      word ^= 1U << bit;
      bit = cycle.renamed[static_cast<size_t>(bit)] - '0';
    }
  }
  return words;
}

// Two bits more: three steps of the cycle before, then one of the cycle 0, 1, 3, 2 of the new bits. Since 3 and 2^bits
// have no factor in common, the 2^bits 4 steps meet every pair of both once (Goddyn & Gvozdjak 2003). Runs of r become
// r + floor(r / 3), at most 8, the new bits' own.
std::vector<uint16_t> WithTwoMore(const std::vector<uint16_t>& words, int bits) {
  std::vector<uint16_t> more(4 * words.size());
  for (size_t i = 0; i < more.size(); ++i) {
    const unsigned slow = GrayFromBinary(static_cast<unsigned>(i / 4 % 4));
    more[i] = static_cast<uint16_t>(slow << bits | words[(3 * (i / 4) + i % 4) % words.size()]);
  }
  return more;
}

struct Table {
  std::vector<uint16_t> word_of, column_of;
};

Table MakeTable(std::vector<uint16_t> words) {
  Table table{std::move(words), {}};
  table.column_of.resize(table.word_of.size());
  for (size_t column = 0; column < table.word_of.size(); ++column)
    table.column_of[table.word_of[column]] = static_cast<uint16_t>(column);
  return table;
}

std::array<Table, kMaxCodeBits + 1> MakeTables() {
  std::array<Table, kMaxCodeBits + 1> tables;
  for (int bits = 1; bits <= kMaxCodeBits; ++bits) {
    const int searched = bits - kFewestLongRunBits;
    std::vector<uint16_t> words;
    if (searched < 0) {
      for (unsigned n = 0; n < 1U << bits; ++n) words.push_back(static_cast<uint16_t>(GrayFromBinary(n)));
    } else if (searched < static_cast<int>(kLongRunCycles.size())) {
      words = WordsOf(kLongRunCycles[static_cast<size_t>(searched)]);
    } else {
      words = WithTwoMore(tables[static_cast<size_t>(bits) - 2].word_of, bits - 2);
    }
    tables[static_cast<size_t>(bits)] = MakeTable(std::move(words));
  }
  return tables;
}

const Table& MinStripeTable(int bits) {
  static const std::array<Table, kMaxCodeBits + 1> tables = MakeTables();
  return tables[static_cast<size_t>(bits)];
}

}  // namespace

const char* ToString(ColumnCode code) { return kCodeNames[static_cast<size_t>(code)].data(); }

Result<ColumnCode> ParseColumnCode(const std::string& text) {
  const auto found = std::find(kCodeNames.begin(), kCodeNames.end(), text);
  if (found != kCodeNames.end()) return static_cast<ColumnCode>(found - kCodeNames.begin());
  std::string allowed;
  for (const std::string_view name : kCodeNames) allowed += (allowed.empty() ? "" : ", ") + std::string(name);
  return Status::Usage("code '" + text + "' is unknown; allowed: " + allowed);
}

unsigned WordOf(ColumnCode code, unsigned column, int bits) {
  SLX_CHECK(IsOfStripes(code));
  if (code == ColumnCode::kMinStripe) return MinStripeTable(bits).word_of[column & ((1U << bits) - 1U)];
  const std::optional<int> base = BasePlane(code, bits);
  const unsigned gray = GrayFromBinary(column);
  return base ? XoredWithBase(gray, *base, bits) : gray;
}

unsigned ColumnOf(ColumnCode code, unsigned word, int bits) {
  SLX_CHECK(IsOfStripes(code));
  if (code == ColumnCode::kMinStripe) return MinStripeTable(bits).column_of[word];
  const std::optional<int> base = BasePlane(code, bits);
  return BinaryFromGray(base ? XoredWithBase(word, *base, bits) : word);
}

std::optional<int> BasePlane(ColumnCode code, int bits) {
  if (code == ColumnCode::kXor2) return bits - 1;
  if (code == ColumnCode::kXor4) return std::max(bits - 2, 0);
  return std::nullopt;
}

int NarrowestStripe(ColumnCode code, int bits) {
  const unsigned columns = 1U << bits;
  unsigned narrowest = columns;
  for (int plane = 0; plane < bits; ++plane) {
    const auto lit = [&](unsigned column) { return (WordOf(code, column, bits) >> plane & 1U) != 0; };
    unsigned begin = 0;
    for (unsigned column = 1; column < columns; ++column) {
      if (lit(column) == lit(column - 1)) continue;
      if (begin > 0) narrowest = std::min(narrowest, column - begin);
      begin = column;
    }
  }
  return static_cast<int>(narrowest);
}

int GrayBits(int count) {
  int bits = 0;
  while ((1 << bits) < count) ++bits;
  return bits;
}

}  // namespace stratalux
