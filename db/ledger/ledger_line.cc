// SPDX-License-Identifier: Apache-2.0
#include "db/ledger/ledger_line.h"

#include <algorithm>
#include <array>
#include <limits>

#include <nlohmann/json.hpp>
#include <sodium.h>

#include "shared/base/json_nesting.h"
#include "shared/base/json_number.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t kHashDigits = 64;
constexpr std::string_view kHashKey = ",\"hash\":\"";

// {..., "hash":"<64 digits>"}: the hash is of all before it, closed by a brace.
struct Parts {
  std::string hashed;
  std::string hash;
};
std::optional<Parts> Split(std::string_view line) {
  const size_t tail = kHashKey.size() + kHashDigits + 2;
  if (line.size() < tail || !line.ends_with("\"}")) return std::nullopt;
  const std::string_view end = line.substr(line.size() - tail);
  if (!end.starts_with(kHashKey)) return std::nullopt;
  return Parts{std::string(line.substr(0, line.size() - tail)) + "}",
               std::string(end.substr(kHashKey.size(), kHashDigits))};
}

std::optional<LedgerKind> KindFrom(const std::string& text) {
  for (const LedgerKind kind : {LedgerKind::kConsent, LedgerKind::kWithdrawal, LedgerKind::kForgetting,
                                LedgerKind::kForgotten, LedgerKind::kNote})
    if (text == ToString(kind)) return kind;
  return std::nullopt;
}

// No id of ours is empty or leads out of a folder.
bool IsId(const std::string& id) { return !id.empty() && id[0] != '.' && id.find('/') == std::string::npos; }

// Throws what nlohmann throws for other types.
std::optional<LedgerEntry> EntryFrom(const Json& json) {
  LedgerEntry entry;
  const auto kind = KindFrom(json.at("kind").get<std::string>());
  if (!kind) return std::nullopt;
  entry.kind = *kind;
  entry.at = {WholeAt<int64_t>(json, "at_wall_ns")};
  json.at("sessions").get_to(entry.sessions);
  json.at("visitor").get_to(entry.visitor_hmac);
  const Json& detail = json.at("detail");
  if (!detail.is_null()) entry.detail_json = detail.dump(-1, ' ', false, Json::error_handler_t::replace);
  if (!std::all_of(entry.sessions.begin(), entry.sessions.end(), IsId)) return std::nullopt;
  return entry;
}

Json DetailOf(const std::string& text) {
  if (text.empty()) return nullptr;
  Json json = CheckNesting(text).ok() ? Json::parse(text, nullptr, false) : Json(Json::value_t::discarded);
  return json.is_discarded() ? Json(text) : json;
}

}  // namespace

const char* ToString(LedgerKind kind) {
  switch (kind) {
    case LedgerKind::kConsent:
      return "consent";
    case LedgerKind::kWithdrawal:
      return "withdrawal";
    case LedgerKind::kForgetting:
      return "forgetting";
    case LedgerKind::kForgotten:
      return "forgotten";
    case LedgerKind::kNote:
      break;
  }
  return "note";
}

namespace {

Json MomentsJson(const std::vector<WallNs>& given) {
  Json moments = Json::array();
  for (const WallNs at : given) moments.push_back(at.ns);
  return moments;
}

// The moments that an entry of this kind has under `name`.
std::vector<WallNs> MomentsIn(const LedgerEntry& entry, LedgerKind kind, const char* name) {
  std::vector<WallNs> given;
  if (entry.kind != kind || !CheckNesting(entry.detail_json).ok()) return given;
  const Json detail = Json::parse(entry.detail_json, nullptr, false);
  const auto moments = detail.is_object() ? detail.find(name) : detail.end();
  if (moments == detail.end() || !moments->is_array()) return given;
  constexpr auto kMost = static_cast<uint64_t>(std::numeric_limits<int64_t>::max());
  for (const Json& at : *moments)
    if (at.is_number_unsigned() && at.get<uint64_t>() <= kMost)
      given.push_back({static_cast<int64_t>(at.get<uint64_t>())});
  return given;
}

}  // namespace

std::string WithdrawalDetail(const std::vector<WallNs>& given) {
  return Json({{"given_wall_ns", MomentsJson(given)}}).dump();
}

std::vector<WallNs> ConsentsWithdrawnBy(const LedgerEntry& entry) {
  return MomentsIn(entry, LedgerKind::kWithdrawal, "given_wall_ns");
}

std::string VisitorForgottenDetail(const std::vector<WallNs>& given) {
  return Json({{"visitor_forgotten", MomentsJson(given)}}).dump();
}

std::vector<WallNs> ConsentsForgottenBy(const LedgerEntry& entry) {
  return MomentsIn(entry, LedgerKind::kNote, "visitor_forgotten");
}

std::string LedgerHash(std::string_view bytes) {
  std::array<uint8_t, kHashDigits / 2> hash{};
  crypto_generichash(hash.data(), hash.size(), reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size(), nullptr,
                     0);
  std::string text(kHashDigits + 1, '\0');
  sodium_bin2hex(text.data(), text.size(), hash.data(), hash.size());
  text.pop_back();
  return text;
}

std::string ChainStart(const std::string& store_id) { return LedgerHash("stratalux ledger of store " + store_id); }

std::string MakeLine(const LedgerEntry& entry, ChainEnd& end) {
  const Json json = {{"schema", kLedgerSchema},
                     {"n", end.entries + 1},
                     {"prev", end.hash},
                     {"kind", ToString(entry.kind)},
                     {"at_wall_ns", entry.at.ns},
                     {"sessions", entry.sessions},
                     {"visitor", entry.visitor_hmac},
                     {"detail", DetailOf(entry.detail_json)}};
  std::string line = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  ++end.entries;
  end.hash = LedgerHash(line);
  line.pop_back();
  return line + std::string(kHashKey) + end.hash + "\"}";
}

LedgerLine ParseLine(std::string_view text) {
  LedgerLine line;
  const auto parts = Split(text);
  const bool whole = parts && LedgerHash(parts->hashed) == parts->hash;
  line.hash = whole ? parts->hash : LedgerHash(text);
  bool known = false;
  try {
    const Json json = Json::parse(text);
    line.n = WholeAt<int64_t>(json, "n");
    json.at("prev").get_to(line.prev);
    known = WholeAt<int64_t>(json, "schema") <= kLedgerSchema;
    if (CheckNesting(text).ok()) line.entry = EntryFrom(json);
  } catch (const nlohmann::json::exception&) {
    line.entry.reset();
  }
  // Later versions keep the rule of the hash: what matches it and is not understood is theirs.
  if (whole) line.state = known && line.entry ? LineState::kWhole : LineState::kNewer;
  // That it is gone binds; what else the certificate says may be what was damaged.
  if (line.state == LineState::kDamaged && line.entry && line.entry->kind == LedgerKind::kForgotten)
    line.entry->kind = LedgerKind::kForgetting;
  return line;
}

}  // namespace stratalux::db
