// SPDX-License-Identifier: Apache-2.0
// `stratalux-db consent give|withdraw|show`, `access`.
#include <algorithm>
#include <cstdio>
#include <memory>

#include <nlohmann/json.hpp>

#include "db/apps/command.h"
#include "db/catalogue/consent.h"
#include "db/privacy/access_log.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

struct ConsentFlags {
  std::string visitor, text_version, language, scope;
  CLI::App *give = nullptr, *withdraw = nullptr;
};

Json JsonOf(const ConsentRow& row) {
  Json json = {{"visitor", row.visitor},
               {"text_version", row.consent.text_version},
               {"language", row.consent.language},
               {"scope", Json::array()},
               {"given", ToIso8601(row.consent.given_wall)},
               {"withdrawn", row.withdrawn ? Json(ToIso8601(*row.withdrawn)) : Json()}};
  if (row.consent.fit) json["scope"].push_back("fit");
  if (row.consent.research) json["scope"].push_back("research");
  if (row.consent.publication) json["scope"].push_back("publication");
  return json;
}

std::string ConsentsAsText(const std::vector<ConsentRow>& rows) {
  char line[512];
  const auto format = [&line](const std::string& visitor, const std::string& text, const std::string& language,
                              const std::string& scope, const std::string& given, const std::string& withdrawn) {
    std::snprintf(line, sizeof line, "%-20s  %-12s  %-8s  %-24s  %-20s  %s\n", visitor.c_str(), text.c_str(),
                  language.c_str(), scope.c_str(), given.c_str(), withdrawn.c_str());
    return std::string(line);
  };
  std::string all = format("visitor", "text", "language", "scope", "given", "withdrawn");
  for (const ConsentRow& row : rows)
    all += format(row.visitor, row.consent.text_version, row.consent.language, ScopeText(row.consent),
                  ToIso8601(row.consent.given_wall), row.withdrawn ? ToIso8601(*row.withdrawn) : "-");
  return rows.empty() ? all + "(none)\n" : all;
}

int ShowConsents(const CommonFlags& common, const std::string& visitor) {
  const auto rows = ListConsents(common.store, visitor);
  if (!rows.ok()) return Report(rows.status());
  if (rows->empty() && !visitor.empty())
    return Report(Status::NotFound("visitor '" + visitor + "' has given no consent here"));
  if (!common.json) return Print(ConsentsAsText(*rows));
  Json json = Json::array();
  for (const ConsentRow& row : *rows) json.push_back(JsonOf(row));
  return Print(TextOf(json));
}

int RunConsent(const CommonFlags& common, const ConsentFlags& flags) {
  Status status;
  if (flags.give->parsed()) {
    Consent consent;
    consent.text_version = flags.text_version;
    consent.language = flags.language;
    status = SetScope(flags.scope, consent);
    if (status.ok()) status = GiveConsent(common.store, flags.visitor, consent);
  } else if (flags.withdraw->parsed()) {
    status = WithdrawConsent(common.store, flags.visitor);
    if (status.ok())
      std::fprintf(stderr,
                   "the visitor's sessions, if there are any, are due: `stratalux-db purge` removes them now\n");
  }
  return status.ok() ? ShowConsents(common, flags.visitor) : Report(status);
}

void AddConsent(Commands& commands) {
  const auto flags = std::make_shared<ConsentFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* consent = commands.Add("consent", "What visitors agreed to: give, withdraw, show",
                                   [&common, flags] { return RunConsent(common, *flags); });
  consent->footer(
      Examples({"consent give --visitor v-5f3a91c2 --text-version 2026-03 --language de --scope fit,research",
                "consent withdraw --visitor v-5f3a91c2", "consent show", "consent show --visitor v-5f3a91c2 --json"}));
  consent->require_subcommand(1);
  // --store and --json may stand behind the last word, too.
  consent->fallthrough();
  flags->give = consent->add_subcommand("give", "Record what a visitor agreed to; the newest consent counts");
  flags->withdraw = consent->add_subcommand("withdraw", "Record that a visitor has withdrawn consent");
  CLI::App* show = consent->add_subcommand("show", "List the consents, oldest first");
  for (CLI::App* verb : {flags->give, flags->withdraw, show}) {
    verb->fallthrough();
    CLI::Option* visitor = verb->add_option("--visitor", flags->visitor, "pseudonym");
    if (verb != show) visitor->required();
  }
  flags->give->add_option("--text-version", flags->text_version, "version of the text that was shown")->required();
  flags->give->add_option("--language", flags->language, "language in which it was shown, such as de")->required();
  flags->give->add_option("--scope", flags->scope, "fit, research, publication, joined by commas")->required();
}

int RunAccess(const CommonFlags& common, const std::string& session) {
  std::string prefix = session;
  if (session == "latest") {
    const auto store = SessionStore::Open(common.store, AccessMode::kReadOnly);
    if (!store.ok()) return Report(store.status());
    const auto row = store->FindSession(session);
    if (!row.ok()) return Report(row.status());
    prefix = row->info.id;
  }
  const auto entries = ListAccess(common.store, prefix);
  if (!entries.ok()) return Report(entries.status());
  Json json = Json::array();
  std::string text = "at                    who           action      session           detail\n";
  for (const AccessEntry& e : *entries) {
    json.push_back(
        {{"at", ToIso8601(e.at)}, {"who", e.who}, {"action", e.action}, {"session", e.session}, {"detail", e.detail}});
    char line[160];
    std::snprintf(line, sizeof line, "%-20s  %-12s  %-10s  %-16s  ", ToIso8601(e.at).c_str(), e.who.c_str(),
                  e.action.c_str(), e.session.c_str());
    text += line + (e.detail.empty() ? "-" : e.detail) + "\n";
  }
  if (entries->empty()) text += "(none)\n";
  return Print(common.json ? TextOf(json) : text);
}

void AddAccess(Commands& commands) {
  const auto session = std::make_shared<std::string>();
  const CommonFlags& common = commands.flags();
  CLI::App* access = commands.Add("access", "List who took what out of the store, oldest first",
                                  [&common, session] { return RunAccess(common, *session); });
  access->footer(Examples({"access", "access s000017", "access latest --json"}));
  access->add_option("SESSION", *session, "id or prefix, also of a forgotten session, or latest (default: all)");
}

}  // namespace

void AddPrivacyCommands(Commands& commands) {
  AddConsent(commands);
  AddAccess(commands);
}

}  // namespace stratalux::db
