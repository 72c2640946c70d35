// SPDX-License-Identifier: Apache-2.0
// What may be said of a session as a whole: asked when one begins, and of every manifest before it becomes rows.
#pragma once

#include "shared/base/result.h"
#include "shared/capture/session.h"

namespace stratalux::db {

// Texts without a zero byte, times from 1970 on, an attempt from 0 to kMostAttempts, findings (CheckFound), a plan that
// can be read, a calibration that is an object. The id is not looked at: a session that begins has none yet.
// kNewerSchema for the plan of a later version, else kIntegrity.
[[nodiscard]] Status CheckInfo(const SessionInfo& info);
inline constexpr int kMostAttempts = 1'000'000;

// What a manifest can hold: figures that are finite, counts from 0, steps and projectors up to a million.
[[nodiscard]] Status CheckFound(const CaptureFindings& found);

}  // namespace stratalux::db
