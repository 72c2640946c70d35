// SPDX-License-Identifier: Apache-2.0
// How deep a JSON text nests, before anything is made of it.
#pragma once

#include <string_view>

#include "shared/base/result.h"

namespace stratalux {

// kIntegrity for JSON that nests deeper than anything of ours (64): what copies, compares or writes it later recurses,
// and half a megabyte of brackets would end the program. For every text that somebody else may have written. Text that
// is no JSON may pass: the parser refuses it.
[[nodiscard]] Status CheckNesting(std::string_view json);

}  // namespace stratalux
