// SPDX-License-Identifier: Apache-2.0
// The rows of consents, as a part of the caller's transaction. Internal to db/; consent.h is for programs.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "db/base/sqlite.h"
#include "shared/capture/session.h"

namespace stratalux::db {

// kGiven: just now, whatever stands there. kOfSession: what a session was made under; a row that is there already stays
// as it is, withdrawn or not.
enum class ConsentSource { kGiven, kOfSession };

// The visitor, too, where it is new.
Status InsertConsent(Connection& connection, const std::string& visitor, const Consent& consent, ConsentSource source);

enum class ConsentsThat { kWereGiven, kHold };
// When they were given, in order; 0 where it is not known.
[[nodiscard]] Result<std::vector<WallNs>> ConsentMoments(Connection& connection, const std::string& visitor,
                                                         ConsentsThat which);

// When the consent was withdrawn under which a visitor's session was made, or the visitor's newest where that is not
// known here: what the view session_consents says. Of other sessions none.
[[nodiscard]] Result<std::optional<WallNs>> WithdrawnOn(Connection& connection, int64_t session_number);

}  // namespace stratalux::db
