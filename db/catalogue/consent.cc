// SPDX-License-Identifier: Apache-2.0
#include "db/catalogue/consent.h"

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <random>
#include <sstream>

#include <nlohmann/json.hpp>

#include "db/catalogue/consent_rows.h"
#include "db/catalogue/session_index.h"
#include "db/keys/key_store.h"
#include "db/ledger/ledger.h"

namespace stratalux::db {
namespace {

// Quoted for a shell: the remedy can be pasted.
std::string Quoted(const std::string& text) {
  std::string quoted = "'";
  for (const char c : text) quoted += c == '\'' ? "'\\''" : std::string(1, c);
  return quoted + "'";
}

Status Missing(const std::filesystem::path& store, const std::string& visitor, const std::string& why) {
  return Status::Usage("visitor " + Quoted(visitor) + " " + why +
                       ": no capture without consent; record it with"
                       " `stratalux-db consent give --store " +
                       Quoted(store.string()) + " --visitor " + Quoted(visitor) +
                       " --text-version VERSION --language LANGUAGE --scope fit`");
}

// Bytes of other alphabets are taken for letters.
bool IsLetter(unsigned char c) { return std::isalpha(c) != 0 || c >= 0x80; }
bool IsDigit(unsigned char c) { return std::isdigit(c) != 0; }

bool HasCapitalisedWord(const std::string& text) {
  std::istringstream words(text);
  for (std::string word; words >> word;)
    if (std::isupper(static_cast<unsigned char>(word[0])) != 0 && std::all_of(word.begin(), word.end(), IsLetter))
      return true;
  return false;
}

// 1987-05-12, 12.5.1987, 12/05/87: three groups of digits, one mark between each two, the year in front or at the end.
bool IsDate(const std::string& text) {
  std::vector<size_t> groups(1);
  for (const char c : text) {
    if (IsDigit(static_cast<unsigned char>(c))) {
      ++groups.back();
    } else if (std::string_view("-./ ").find(c) != std::string_view::npos) {
      groups.push_back(0);
    } else {
      return false;
    }
  }
  if (groups.size() != 3) return false;
  auto is_short = [](size_t digits) { return digits == 1 || digits == 2; };
  return is_short(groups[1]) &&
         ((groups[0] == 4 && is_short(groups[2])) || (is_short(groups[0]) && (groups[2] == 4 || groups[2] == 2)));
}

// What a text looks like that names a person; null where it does not.
const char* LooksLike(const std::string& text) {
  if (text == kSimulatedVisitor) return nullptr;
  const auto digits = std::count_if(text.begin(), text.end(), IsDigit);
  if (text.find('@') != std::string::npos) return "an e-mail address";
  if (IsDate(text)) return "a date";
  if (digits >= 6 && text.find_first_not_of("0123456789+-/(). ") == std::string::npos) return "a telephone number";
  if (digits == 0) return "a name";
  return text.find(' ') != std::string::npos && HasCapitalisedWord(text) ? "a name" : nullptr;
}

Result<std::vector<std::string>> SessionsOf(Connection& connection, const std::string& visitor) {
  SLX_ASSIGN_OR_RETURN(auto select, connection.Prepare("SELECT id FROM sessions WHERE visitor = ?1 ORDER BY number"));
  select.Bind(1, visitor);
  std::vector<std::string> ids;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return ids;
    ids.push_back(select.Text(0));
  }
}

}  // namespace

Status CheckPseudonym(const std::string& visitor) {
  using Json = nlohmann::ordered_json;
  if (visitor.empty()) return Status::Usage("--visitor: the pseudonym is empty");
  // JSON takes UTF-8 alone: what is none comes back otherwise than it went in.
  const Json json = visitor;
  const std::string shown = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  if (Json::parse(shown) != json) return Status::Usage("--visitor " + shown + ": the pseudonym is not UTF-8 text");
  for (const unsigned char c : visitor)
    if (c < 0x20 || c == 0x7f) return Status::Usage("--visitor " + shown + ": the pseudonym has control characters");
  return Status::Ok();
}

Status CheckNewPseudonym(const std::string& visitor) {
  SLX_RETURN_IF_ERROR(CheckPseudonym(visitor));
  const char* like = LooksLike(visitor);
  if (like == nullptr) return Status::Ok();
  std::random_device random;
  char instead[16];
  std::snprintf(instead, sizeof instead, "v-%08x", random());
  return Status::Usage(
      "--visitor " + Quoted(visitor) + ": looks like " + like +
      ", which must not be kept in a store; use a pseudonym that says nothing about the person, such as " + instead);
}

Status SetScope(const std::string& text, Consent& consent) {
  std::istringstream in(text);
  bool any = false;
  for (std::string scope; std::getline(in, scope, ',');) {
    bool* member = scope == "fit"           ? &consent.fit
                   : scope == "research"    ? &consent.research
                   : scope == "publication" ? &consent.publication
                                            : nullptr;
    if (member == nullptr)
      return Status::Usage("scope '" + scope + "' is unknown; allowed: fit, research, publication, joined by commas");
    *member = any = true;
  }
  return any ? Status::Ok() : Status::Usage("a consent needs a scope: fit, research, publication, joined by commas");
}

std::string ScopeText(const Consent& consent) {
  std::string text;
  for (const auto& [given, name] : {std::pair(consent.fit, "fit"), std::pair(consent.research, "research"),
                                    std::pair(consent.publication, "publication")})
    if (given) text += (text.empty() ? "" : ",") + std::string(name);
  return text;
}

Status GiveConsent(const std::filesystem::path& store, const std::string& visitor, Consent consent) {
  SLX_RETURN_IF_ERROR(CheckNewPseudonym(visitor));
  if (consent.text_version.empty() || consent.language.empty())
    return Status::Usage("a consent must name the version of the text that was shown and its language");
  if (ScopeText(consent).empty()) return SetScope("", consent);
  if (consent.given_wall.ns == 0) consent.given_wall = WallNow();
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  return InsertConsent(index.connection(), visitor, consent, ConsentSource::kGiven);
}

Status WithdrawConsent(const std::filesystem::path& store, const std::string& visitor,
                       const std::function<void(WithdrawStep)>& after_step) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadWrite));
  Connection& connection = index.connection();
  // No session of the visitor begins meanwhile: its row waits for this transaction.
  SLX_ASSIGN_OR_RETURN(auto transaction, Transaction::Begin(connection));
  SLX_ASSIGN_OR_RETURN(const auto held, ConsentMoments(connection, visitor, ConsentsThat::kHold));
  if (held.empty()) return Status::NotFound("visitor " + Quoted(visitor) + " has given no consent that is still valid");
  LedgerEntry entry;
  entry.kind = LedgerKind::kWithdrawal;
  entry.at = WallNow();
  entry.detail_json = WithdrawalDetail(held);
  SLX_ASSIGN_OR_RETURN(entry.sessions, SessionsOf(connection, visitor));
  const auto name = FindVisitorName(store, visitor);  // none where no session was made here
  if (!name.ok() && name.status().code() != StatusCode::kNotFound) return name.status();
  entry.visitor_hmac = name.ok() ? *name : "";
  SLX_RETURN_IF_ERROR(AppendToLedger(store, entry));
  if (after_step) after_step(WithdrawStep::kLedger);
  SLX_ASSIGN_OR_RETURN(auto update, connection.Prepare("UPDATE consents SET withdrawn_wall_ns = ?2 WHERE"
                                                       " visitor = ?1 AND withdrawn_wall_ns IS NULL"));
  SLX_RETURN_IF_ERROR(update.Bind(1, visitor).Bind(2, entry.at.ns).Run());
  SLX_RETURN_IF_ERROR(transaction.Commit());
  if (after_step) after_step(WithdrawStep::kIndex);
  return Status::Ok();
}

Result<std::vector<ConsentRow>> ListConsents(const std::filesystem::path& store, const std::string& visitor) {
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  SLX_ASSIGN_OR_RETURN(
      auto select,
      index.connection().Prepare("SELECT visitor, text_version, language, fit, research, publication, given_wall_ns,"
                                 " coalesce(withdrawn_wall_ns, 0), withdrawn_wall_ns IS NOT NULL FROM consents"
                                 " WHERE ?1 = '' OR visitor = ?1 ORDER BY number"));
  select.Bind(1, visitor);
  std::vector<ConsentRow> rows;
  while (true) {
    SLX_ASSIGN_OR_RETURN(const bool more, select.Step());
    if (!more) return rows;
    ConsentRow row;
    row.visitor = select.Text(0);
    row.consent = {select.Text(1),         select.Text(2),         select.Integer(3) != 0,
                   select.Integer(4) != 0, select.Integer(5) != 0, {select.Integer(6)}};
    if (select.Integer(8) != 0) row.withdrawn = WallNs{select.Integer(7)};
    rows.push_back(std::move(row));
  }
}

Result<Consent> ValidConsent(const std::filesystem::path& store, const std::string& visitor) {
  SLX_RETURN_IF_ERROR(CheckPseudonym(visitor));
  const auto rows = ListConsents(store, visitor);
  if (rows.status().code() == StatusCode::kNotFound)
    return Missing(store, visitor, "has given no consent (there is no store yet: `stratalux-db init` makes it)");
  if (!rows.ok()) return rows.status();
  if (rows->empty()) return Missing(store, visitor, "has given no consent");
  const ConsentRow& newest = rows->back();
  if (newest.withdrawn) return Missing(store, visitor, "has withdrawn consent on " + ToIso8601(*newest.withdrawn));
  if (!newest.consent.fit)
    return Missing(store, visitor, "has consented to " + ScopeText(newest.consent) + " only, not to fit");
  return newest.consent;
}

Result<std::optional<WallNs>> SessionWithdrawnOn(const std::filesystem::path& store, const std::string& session_id) {
  SLX_ASSIGN_OR_RETURN(const Ledger ledger, Ledger::Read(store));
  if (const auto withdrawn = ledger.WithdrawnAt(session_id)) return withdrawn;
  SLX_ASSIGN_OR_RETURN(auto index, SessionIndex::Open(store, AccessMode::kReadOnly));
  const auto number = index.NumberOf(session_id);
  if (number.status().code() == StatusCode::kNotFound) return std::optional<WallNs>();
  if (!number.ok()) return number.status();
  return WithdrawnOn(index.connection(), *number);
}

Status RequireConsent(const std::filesystem::path& store, SessionInfo& info) {
  if (info.kind != SessionKind::kVisitor) return Status::Ok();
  if (info.visitor.empty()) {
    if (!info.simulated)
      return Status::Usage(
          "a visitor's session needs a pseudonym whose consent is recorded (--visitor;"
          " `stratalux-db consent give` records it)");
    info.visitor = kSimulatedVisitor;
  }
  auto consent = ValidConsent(store, info.visitor);
  if (!consent.ok() && info.simulated && info.visitor == kSimulatedVisitor) {
    const Consent given{kSimulatedConsentText, "none", true, true, true, WallNow()};
    SLX_RETURN_IF_ERROR(GiveConsent(store, info.visitor, given));
    consent = given;
  }
  if (!consent.ok()) return consent.status();
  info.consent = *consent;
  return Status::Ok();
}

}  // namespace stratalux::db
