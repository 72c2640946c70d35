// SPDX-License-Identifier: Apache-2.0
// The rows of consents, as a part of the caller's transaction. Internal to db/; consent.h is for programs.
#pragma once

#include <optional>
#include <string>

#include "db/base/sqlite.h"
#include "shared/capture/session.h"

namespace stratalux::db {

// kGiven: just now, whatever stands there. kOfSession: what a session was made under; a row that is there already stays
// as it is, withdrawn or not.
enum class ConsentSource { kGiven, kOfSession };

// The visitor, too, where it is new.
Status InsertConsent(Connection& connection, const std::string& visitor, const Consent& consent, ConsentSource source);

// When the consent was withdrawn under which a session was made, or the visitor's newest where that is not known here.
[[nodiscard]] Result<std::optional<WallNs>> WithdrawnOn(Connection& connection, const std::string& visitor,
                                                        WallNs given);

}  // namespace stratalux::db
