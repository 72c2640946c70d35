// SPDX-License-Identifier: Apache-2.0
#include "db/interchange/crate_session.h"

#include <algorithm>
#include <cctype>

#include <nlohmann/json.hpp>

#include "db/catalogue/consent.h"
#include "db/catalogue/info_check.h"
#include "db/catalogue/known_word.h"
#include "db/catalogue/manifest.h"
#include "db/interchange/crate_files.h"
#include "shared/base/json_nesting.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;
constexpr int kSessionSchema = 2;  // 1: without visit, attempt, findings and faults

bool Covers(const Consent& consent, CrateScope scope) {
  return scope == CrateScope::kResearch ? consent.research : consent.publication;
}

Result<Consent> ReadConsent(const Json& json) {
  if (json.is_null()) return Consent{};
  const Consent consent = ConsentFromJson(json.dump());
  for (const Json& scope : json.at("scope"))
    if (scope != "fit" && scope != "research" && scope != "publication")
      return Status(StatusCode::kNewerSchema, "the consent has a scope that this program does not know");
  if (consent.text_version.empty() || consent.language.empty() || consent.given_wall.ns <= 0)
    return Status::Integrity("the consent lacks text_version, language or given_wall_ns");
  return consent;
}

// What came with schema 2.
Status ReadVisit(const Json& json, SessionInfo& info) {
  json.at("visit").get_to(info.visit);
  if (!json.at("attempt").is_number_unsigned() || json.at("attempt") > kMostAttempts)
    return Status::Integrity("attempt is not a whole number from 0 to " + std::to_string(kMostAttempts));
  json.at("attempt").get_to(info.attempt);
  SLX_ASSIGN_OR_RETURN(info.found.findings, FindingsFromJson(json.at("findings").dump()));
  SLX_ASSIGN_OR_RETURN(info.found.faults, FaultsFromJson(json.at("faults").dump()));
  return Status::Ok();
}

Result<CrateSession> FromJson(const Json& json) {
  if (json.at("format") != "stratalux-crate-session") return Status::Integrity("not a session of a Stratalux crate");
  if (!json.at("schema").is_number_unsigned() || json.at("schema") == 0)
    return Status::Integrity("schema " + json.at("schema").dump() + " does not exist");
  if (json.at("schema").get<uint64_t>() > kSessionSchema)
    return Status(StatusCode::kNewerSchema, "schema " + json.at("schema").dump() + " is newer than this program (" +
                                                std::to_string(kSessionSchema) +
                                                "); a newer Stratalux wrote it: update this one");
  CrateSession session;
  SessionInfo& info = session.info;
  json.at("session").get_to(info.id);
  if (!IsSessionId(info.id)) return Status::Integrity("'" + info.id.substr(0, 80) + "' is not a session id");
  SLX_ASSIGN_OR_RETURN(info.kind, Known(ParseSessionKind(json.at("kind").get<std::string>())));
  json.at("rig").get_to(info.rig);
  json.at("visitor").get_to(info.visitor);
  SLX_ASSIGN_OR_RETURN(info.consent, ReadConsent(json.at("consent")));
  SLX_ASSIGN_OR_RETURN(info.retention, Known(ParseRetention(json.at("retention").get<std::string>())));
  json.at("simulated").get_to(info.simulated);
  if (!json.at("seed").is_number_unsigned()) return Status::Integrity("seed is not a whole number from 0");
  json.at("seed").get_to(info.seed);
  for (const char* time : {"started_wall_ns", "finished_wall_ns"})
    if (!json.at(time).is_number_integer()) return Status::Integrity(std::string(time) + " is not a whole number");
  json.at("started_wall_ns").get_to(info.started_wall.ns);
  json.at("finished_wall_ns").get_to(info.finished_wall.ns);
  SLX_ASSIGN_OR_RETURN(info.status, Known(ParseSessionStatus(json.at("status").get<std::string>())));
  if (info.status == SessionStatus::kRecording) return Status::Integrity("the session is not finished");
  json.at("reasons").get_to(info.reasons);
  if (json.at("schema") >= 2) SLX_RETURN_IF_ERROR(ReadVisit(json, info));
  json.at("program_version").get_to(info.program_version);
  if (json.contains("devices")) {
    SLX_ASSIGN_OR_RETURN(info.devices, DevicesFromJson(json.at("devices").dump()));
  }
  if (!json.at("frames").is_number_unsigned()) return Status::Integrity("frames is not a whole number from 0");
  json.at("frames").get_to(session.frames);
  session.has_plan = json.at("plan").get<bool>();
  session.has_calibration = json.at("calibration").get<bool>();
  if (!info.visitor.empty()) SLX_RETURN_IF_ERROR(CheckPseudonym(info.visitor));
  if (info.kind == SessionKind::kVisitor && (info.visitor.empty() || info.consent.text_version.empty()))
    return Status::Integrity("a visitor's session without pseudonym and consent cannot enter a store");
  return session;
}

}  // namespace

bool IsSessionId(const std::string& id) {
  const auto plain = [](unsigned char c) { return std::isalnum(c) != 0 || c == '-' || c == '_'; };
  return !id.empty() && id.size() <= 64 && std::isalnum(static_cast<unsigned char>(id[0])) != 0 &&
         std::all_of(id.begin(), id.end(), plain);
}

Status MayLeave(const std::filesystem::path& store, const SessionInfo& info, CrateScope scope) {
  if (info.status == SessionStatus::kRecording)
    return Status::Usage("session " + info.id + " is still recording; export it when it has finished");
  if (info.kind != SessionKind::kVisitor) return Status::Ok();
  if (scope == CrateScope::kNotStated)
    return Status::Usage("session " + info.id + " shows a visitor: state the purpose, --scope research or" +
                         " --scope publication");
  const auto refuse = [&](const std::string& why) {
    return Status::Usage("session " + info.id + ": " + why + "; leave it out, or ask the visitor and record the " +
                         "answer with `stratalux-db consent give --scope fit," + ToString(scope) + "`");
  };
  if (info.visitor.empty()) return refuse("it names no visitor whose consent could be checked");
  SLX_ASSIGN_OR_RETURN(const auto withdrawn, SessionWithdrawnOn(store, info.id));
  if (withdrawn)
    return Status::Usage("session " + info.id + ": the consent that it was made under was withdrawn on " +
                         ToIso8601(*withdrawn) + "; it cannot leave the store any more");
  SLX_ASSIGN_OR_RETURN(const auto consents, ListConsents(store, info.visitor));
  if (consents.empty()) return refuse("no consent of its visitor is recorded");
  const ConsentRow& newest = consents.back();
  if (newest.withdrawn) return refuse("its visitor has withdrawn consent on " + ToIso8601(*newest.withdrawn));
  if (!Covers(newest.consent, scope))
    return refuse(std::string("its visitor has consented to ") + ScopeText(newest.consent) + ", not to " +
                  ToString(scope));
  return Status::Ok();
}

std::string CrateSessionText(const SessionInfo& info, int64_t frames, CrateScope scope) {
  const std::string consent = ConsentToJson(info.consent);
  Json json = {{"format", "stratalux-crate-session"},
               {"schema", kSessionSchema},
               {"session", info.id},
               {"kind", ToString(info.kind)},
               {"rig", info.rig},
               {"visitor", info.visitor},
               {"consent", consent.empty() ? Json() : Json::parse(consent)},
               {"exported_for", info.kind == SessionKind::kVisitor ? Json(ToString(scope)) : Json()},
               {"retention", ToString(info.retention)},
               {"simulated", info.simulated},
               {"seed", info.seed},
               {"started", ToIso8601(info.started_wall)},
               {"started_wall_ns", info.started_wall.ns},
               {"finished", info.finished_wall.ns == 0 ? Json() : Json(ToIso8601(info.finished_wall))},
               {"finished_wall_ns", info.finished_wall.ns},
               {"status", ToString(info.status)},
               {"reasons", info.reasons},
               {"visit", info.visit},
               {"attempt", info.attempt},
               {"findings", Json::parse(FindingsToJson(info.found.findings))},
               {"faults", Json::parse(FaultsToJson(info.found.faults))},
               {"program_version", info.program_version},
               {"frames", frames},
               {"plan", !info.plan_json.empty()},
               {"calibration", !info.calibration_json.empty()}};
  if (info.devices != SessionDevices{}) json["devices"] = Json::parse(DevicesToJson(info.devices));
  return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

Result<CrateSession> ParseCrateSession(const std::string& text, const std::string& file) {
  SLX_RETURN_IF_ERROR(CheckNesting(text).WithContext(file));
  try {
    auto session = FromJson(Json::parse(text));
    // What no version writes is damage, not somebody's wrong flag.
    if (session.status().code() == StatusCode::kUsage)
      return Status::Integrity(file + ": " + session.status().message());
    return std::move(session).WithContext(file);
  } catch (const nlohmann::json::exception& error) {
    return Status::Integrity(file + ": " + error.what());
  }
}

}  // namespace stratalux::db
