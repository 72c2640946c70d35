// SPDX-License-Identifier: Apache-2.0
// A visitor's sessions and consents go: because they left, took their consent back, or gave their ticket's code.
#pragma once

#include <string>

#include "shared/base/log.h"
#include "shared/base/result.h"

namespace stratalux::rig {

// kNotFound: the store holds nothing of them, or there is none. Tries again for a few seconds while another program
// writes or reads; then kBusy. kFailed: something was found after all.
[[nodiscard]] Status ForgetVisitor(const std::string& store, const std::string& visitor, Logger& logger);

}  // namespace stratalux::rig
