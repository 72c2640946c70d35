// SPDX-License-Identifier: Apache-2.0
// Who agreed to what. A visitor's session begins only under a consent that holds and covers `fit`.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "shared/capture/session.h"

namespace stratalux::db {

// The pseudonym of a simulated capture without one; its consent is recorded by itself, marked by its text version.
inline constexpr const char* kSimulatedVisitor = "simulated";
inline constexpr const char* kSimulatedConsentText = "simulation";

struct ConsentRow {
  std::string visitor;
  Consent consent;
  std::optional<WallNs> withdrawn;
};

// Pseudonyms are text that every list and JSON file can show: UTF-8, no control characters, not empty. kUsage.
Status CheckPseudonym(const std::string& visitor);
// kUsage, with a pseudonym to take instead, for what looks like a name, an e-mail address, a telephone number or a date
// of birth. Asked where a pseudonym is new: older ones stay good.
Status CheckNewPseudonym(const std::string& visitor);
// Sets the scopes from "fit,research,publication" (any of them); kUsage for others and for none.
Status SetScope(const std::string& text, Consent& consent);
[[nodiscard]] std::string ScopeText(const Consent& consent);

// Records a new consent; given_wall is now when it is 0. kUsage without text version, language or scope.
Status GiveConsent(const std::filesystem::path& store, const std::string& visitor, Consent consent);
enum class WithdrawStep { kLedger, kIndex };
// Marks all that the visitor gave as withdrawn: first in the ledger, naming the visitor's sessions and when the
// consents were given, then in the index, which follows the ledger where it is cut off in between. kNotFound where none
// holds.
Status WithdrawConsent(const std::filesystem::path& store, const std::string& visitor,
                       const std::function<void(WithdrawStep)>& after_step = {});
// In the order in which they were given; all visitors for an empty pseudonym.
[[nodiscard]] Result<std::vector<ConsentRow>> ListConsents(const std::filesystem::path& store,
                                                           const std::string& visitor);
// The visitor's newest consent if it holds and covers `fit`. kUsage otherwise, with the command that records one.
[[nodiscard]] Result<Consent> ValidConsent(const std::filesystem::path& store, const std::string& visitor);

// When the consent was withdrawn that a visitor's session was made under, by ledger and index, of which either may be
// behind. None of other sessions, and of those that are not here.
[[nodiscard]] Result<std::optional<WallNs>> SessionWithdrawnOn(const std::filesystem::path& store,
                                                               const std::string& session_id);

// What BeginSession asks: fills visitor and consent of a visitor's session, or says why there is none (kUsage).
// Sessions of other kinds show nobody and pass.
Status RequireConsent(const std::filesystem::path& store, SessionInfo& info);

}  // namespace stratalux::db
