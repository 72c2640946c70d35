// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/plain_front.h"

#include <algorithm>
#include <sstream>

#include <nlohmann/json.hpp>
#include <poll.h>
#include <unistd.h>

#include "db/catalogue/consent.h"
#include "shared/base/printable.h"

namespace stratalux::rig {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t kLongestLine = 200;
constexpr const char* kWhatThereIs =
    "commands: start, not-sensitive, sensitive, agree SCOPES LANGUAGE [TEXT], refuse, leave, operator clean, "
    "operator out_of_order, operator open, operator selfcheck, operator reset, stop";

// Place of `name` in a list of the configuration.
Result<uint8_t> PlaceOf(const std::string& name, const std::vector<std::string>& names, const char* what) {
  const auto at = std::find(names.begin(), names.end(), name);
  if (at != names.end()) return static_cast<uint8_t>(at - names.begin());
  std::string all;
  for (const std::string& one : names) all += (all.empty() ? "" : ", ") + one;
  return Status::Usage(std::string(what) + " '" + Printable(name) + "' is not one of [kiosk]'s: " + all);
}

Result<VisitEvent> ParseAgreement(const std::vector<std::string>& words, const KioskConfig& kiosk) {
  if (words.size() < 3 || words.size() > 4)
    return Status::Usage(std::string("agree SCOPES LANGUAGE [TEXT]; ") + kWhatThereIs);
  Consent consent;
  SLX_RETURN_IF_ERROR(db::SetScope(words[1], consent));
  event::Agree agreed;
  agreed.choice = {consent.fit, consent.research, consent.publication, 0, 0};
  SLX_ASSIGN_OR_RETURN(agreed.choice.language, PlaceOf(words[2], kiosk.languages, "language"));
  if (words.size() == 4) {
    SLX_ASSIGN_OR_RETURN(agreed.choice.text, PlaceOf(words[3], kiosk.consent_texts, "text"));
  }
  return VisitEvent(agreed);
}

}  // namespace

Result<VisitEvent> ParseCommand(const std::string& line, const KioskConfig& kiosk) {
  std::istringstream in(line);
  const std::vector<std::string> words{std::istream_iterator<std::string>(in), {}};
  const std::string first = words.empty() ? "" : words[0];
  if (first == "agree") return ParseAgreement(words, kiosk);
  if (first == "operator" && words.size() == 2)
    for (int i = 0; i < kOperatorCommands; ++i)
      if (words[1] == ToString(static_cast<OperatorCommand>(i)))
        return VisitEvent(event::Operator{static_cast<OperatorCommand>(i)});
  if (words.size() == 1) {
    if (first == "start") return VisitEvent(event::Start{});
    if (first == "not-sensitive") return VisitEvent(event::NotSensitive{});
    if (first == "sensitive") return VisitEvent(event::Sensitive{});
    if (first == "refuse") return VisitEvent(event::Refuse{});
    if (first == "leave") return VisitEvent(event::Leave{});
    if (first == "stop") return VisitEvent(event::Shutdown{});
  }
  return Status::Usage("'" + Printable(line) + "' is not a command; " + kWhatThereIs);
}

std::string ScreenAsJson(const action::Show& screen) {
  Json json = {{"screen", ToString(screen.screen)}, {"word", ToString(screen.word)}};
  if (!screen.closures.empty()) json["closed_for"] = Json::array();
  for (int i = 0; i < kClosures; ++i)
    if (screen.closures.Has(static_cast<Closure>(i))) json["closed_for"].push_back(ToString(static_cast<Closure>(i)));
  if (screen.of > 0) {
    json["number"] = screen.number;
    json["of"] = screen.of;
  }
  // What there is to say at the gate: `leave` keeps, where something is worth it.
  if (screen.screen == Phase::kGate && screen.usable) json["offers"] = {"start", "leave", "refuse"};
  if (screen.screen == Phase::kGate && !screen.usable) json["offers"] = {"start", "refuse"};
  if (!(screen.box == FaceBox())) json["box"] = {screen.box.left, screen.box.top, screen.box.right, screen.box.bottom};
  return json.dump();
}

std::vector<VisitEvent> PlainFront::Take() {
  std::vector<VisitEvent> events;
  pollfd ready{in_, POLLIN, 0};
  if (in_ < 0 || poll(&ready, 1, 0) <= 0) return events;
  char buffer[512];
  const ssize_t count = read(in_, buffer, sizeof buffer);
  if (count <= 0) {
    in_ = -1;
    return events;
  }
  begun_.append(buffer, static_cast<size_t>(count));
  for (size_t end = 0; (end = begun_.find('\n')) != std::string::npos; begun_.erase(0, end + 1)) {
    const Result<VisitEvent> command = ParseCommand(begun_.substr(0, end), kiosk_);
    if (command.ok()) events.push_back(*command);
    if (!command.ok()) logger_.Warning(command.status().message());
  }
  if (begun_.size() > kLongestLine) {
    logger_.Warning("a command longer than " + std::to_string(kLongestLine) + " bytes is ignored");
    begun_.clear();
  }
  return events;
}

bool PlainFront::Print(const std::string& line) {
  pollfd ready{out_, POLLOUT, 0};
  return poll(&ready, 1, 0) > 0 && write(out_, line.data(), line.size()) == static_cast<ssize_t>(line.size());
}

// A screen that is not seen stops no visit.
void PlainFront::Show(const action::Show& screen) { static_cast<void>(Print(ScreenAsJson(screen) + "\n")); }
bool PlainFront::GiveTicket(const std::string& code) { return Print(Json({{"ticket", code}}).dump() + "\n"); }
void PlainFront::TellOperator(Word word) {
  static_cast<void>(Print(Json({{"operator", ToString(word)}}).dump() + "\n"));
}

}  // namespace stratalux::rig
