// SPDX-License-Identifier: Apache-2.0
// "did you mean": what somebody most likely wanted to type.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace stratalux {

// The candidate that takes the fewest insertions, deletions, replacements and swaps of neighbours; of equals the first.
// None where that is more than a third of the word's length (always one).
[[nodiscard]] std::optional<std::string> Nearest(const std::string& word, const std::vector<std::string>& candidates);

// "no command 'shwo'; did you mean 'show'?", or where none is near the names there are; empty where `word` is one of
// `names`.
[[nodiscard]] std::string UnknownName(const std::string& what, const std::string& word,
                                      const std::vector<std::string>& names);

}  // namespace stratalux
