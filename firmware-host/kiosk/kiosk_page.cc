// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/kiosk/kiosk_page.h"

#include <mutex>
#include <utility>

#include <nlohmann/json.hpp>

#include "firmware-host/kiosk/host_facts.h"
#include "firmware-host/kiosk/kiosk_metrics.h"
#include "firmware-host/kiosk/operator_status.h"
#include "firmware-host/kiosk/page_state.h"
#include "firmware-host/kiosk/page_words.h"
#include "firmware-host/kiosk/store_facts.h"
#include "firmware-host/kiosk/ticket_picture.h"
#include "firmware-host/preview/preview_picture.h"
#include "firmware-host/session/state_file.h"
#include "firmware-host/session/state_writer.h"
#include "shared/base/json_nesting.h"
#include "shared/base/program_data.h"
#include "shared/http/event_stream.h"
#include "shared/http/server.h"
#include "shared/http/static_files.h"

namespace stratalux::rig {
namespace {

using http::Method;
using http::Request;
using http::Response;
using Json = nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

constexpr auto kBetweenPreviews = 200ms;
constexpr auto kStandsStill = 10s;
// A viewer who is gone is found out by it, and holds one of few connections until then.
constexpr auto kKeepAlive = 2s;
constexpr auto kStoreFor = 5s;   // what the store said is good
constexpr auto kBatchFor = 60s;  // what systemd said of it
constexpr int kSessions = 20;
// For two operators' browsers, each of which asks for five pictures and the figures at once.
constexpr int kSlowAnswers = 12;

Response Empty(int status) {
  Response response;
  response.status = status;
  return response;
}

Response JsonOf(const Json& json) { return Response::Of("application/json", json.dump() + "\n"); }

// The object in a request's body; nullopt where it is none.
std::optional<Json> ObjectOf(const Request& request) {
  if (!CheckNesting(request.body).ok()) return std::nullopt;
  Json json = Json::parse(request.body, nullptr, false);
  return json.is_object() ? std::optional(std::move(json)) : std::nullopt;
}
std::string TextIn(const Json& json, const char* name) {
  const auto found = json.find(name);
  return found != json.end() && found->is_string() ? found->get<std::string>() : "";
}
bool TrueIn(const Json& json, const char* name) {
  const auto found = json.find(name);
  return found != json.end() && found->is_boolean() && found->get<bool>();
}

std::string WithCode(std::string text, const std::string& code) {
  const std::string place = "{code}";
  if (const size_t at = text.find(place); at != std::string::npos) text.replace(at, place.size(), code);
  return text;
}

}  // namespace

struct KioskPage::Impl {
  KioskPageOptions options;
  KioskPageInput input;
  Logger& logger;
  std::vector<PageLanguage> languages;
  std::shared_ptr<http::EventStream> stream =
      // Nobody who comes back may read what was shown before: there was another visitor's ticket among it.
      std::make_shared<http::EventStream>(http::EventStreamOptions{.kept_bytes = 0});

  std::mutex mutex;
  PageState state;
  KioskMetrics metrics;
  std::string state_note;  // what of an earlier program could not be read
  std::optional<StateWriter> days_kept;
  int64_t changes_kept = 0;
  SelfcheckTrend selfchecks;
  bool ticket_fetched = false;
  std::string preview;  // JPEG
  std::optional<Clock::time_point> previewed;
  Clock::time_point beat = Clock::now();

  std::mutex store_mutex;
  StoreStatus of_store;
  std::optional<Clock::time_point> store_read;
  db::DisclosureLog disclosures;

  std::mutex batch_mutex;
  TimerFacts batch_timer;
  std::optional<Clock::time_point> batch_asked;

  std::optional<http::Server> server;

  Impl(const KioskPageOptions& o, KioskPageInput i, Logger& l, std::vector<PageLanguage> all)
      : options(o),
        input(std::move(i)),
        logger(l),
        languages(std::move(all)),
        state(o.languages, o.opens),
        disclosures(o.store, "kiosk") {}

  void Publish() { stream->Publish("state", state.Json()); }
  http::Router Routes();
  void AddFiles(http::Router& router);
  void AddVisitor(http::Router& router);
  void AddOperator(http::Router& router);
  void AddHealth(http::Router& router);

  Response Press(const Request& request);
  Response Preview();
  Response Ticket();
  Response Order(const Request& request);
  Response Withdraw(const Request& request);
  Response PictureOf(const std::string& session, const std::string& peer);
  // What takes the store from a visitor's capture waits until there is none.
  [[nodiscard]] bool NobodyIsServed();
  Response OperatorFigures();
  StoreStatus OfStore();
  TimerFacts OfBatch();
  // The days as an earlier program left them.
  void OpenDays();
  // Under the mutex, after what may have counted.
  void KeepDays();
  Response Health();
  Response Ready();
  Response Metrics();
};

http::Router KioskPage::Impl::Routes() {
  http::Router router;
  AddFiles(router);
  AddVisitor(router);
  AddOperator(router);
  AddHealth(router);
  return router;
}

void KioskPage::Impl::AddFiles(http::Router& router) {
  const auto page = [this](const char* name) {
    return [this, name](const Request&) { return http::FileOf(options.page_folder, name); };
  };
  router.Add(Method::kGet, "/", page("index.html"));
  router.Add(Method::kGet, "/operator", page("operator.html"));
  router.Add(Method::kGet, "/page/{file}",
             [this](const Request& request) { return http::FileOf(options.page_folder, request.Wildcard("file")); });
  router.Add(Method::kGet, "/languages/{file}", [this](const Request& request) {
    return http::FileOf(options.language_folder, request.Wildcard("file"));
  });
  router.Add(Method::kGet, "/languages.json", [this](const Request&) {
    Json list = Json::array();
    for (const PageLanguage& one : languages) list.push_back({{"id", one.id}, {"name", one.name}});
    return JsonOf(list);
  });
}

void KioskPage::Impl::AddVisitor(http::Router& router) {
  router.Add(Method::kGet, "/events", [this](const Request&) { return Response::Events(stream); });
  router.Add(Method::kPost, "/visitor/{verb}", [this](const Request& request) { return Press(request); });
  router.Add(Method::kGet, "/preview.jpg", [this](const Request&) { return Preview(); });
  router.Add(Method::kGet, "/ticket.svg", [this](const Request&) { return Ticket(); });
}

// What asks the store or systemctl may take seconds: beside the server's threads, which have visitors' presses to
// answer.
void KioskPage::Impl::AddOperator(http::Router& router) {
  const auto keepers = http::Audience::kKeepers;
  router.Add(
      Method::kGet, "/operator/status",
      [this](const Request&) { return Response::Later([this] { return OperatorFigures(); }); }, keepers);
  router.Add(
      Method::kGet, "/operator/sessions/{session}/picture.jpg",
      [this](const Request& request) {
        return Response::Later(
            [this, session = request.Wildcard("session"), peer = request.peer] { return PictureOf(session, peer); });
      },
      keepers);
  router.Add(
      Method::kPost, "/operator/withdraw", [this](const Request& request) { return Withdraw(request); }, keepers);
  router.Add(
      Method::kPost, "/operator/{command}", [this](const Request& request) { return Order(request); }, keepers);
}

void KioskPage::Impl::AddHealth(http::Router& router) {
  router.Add(Method::kGet, "/healthz", [this](const Request&) { return Health(); });
  router.Add(Method::kGet, "/readyz", [this](const Request&) { return Ready(); });
  router.Add(Method::kGet, "/metrics", [this](const Request&) { return Metrics(); });
}

Response KioskPage::Impl::Press(const Request& request) {
  const auto body = ObjectOf(request);
  if (!body) return Response::Text(400, "a press is a JSON object with nonce and screen");
  const PagePress press{request.Wildcard("verb"),  TextIn(*body, "nonce"),    TextIn(*body, "screen"),
                        TextIn(*body, "language"), TrueIn(*body, "research"), TrueIn(*body, "publication")};
  PressVerdict verdict;
  {
    const std::lock_guard lock(mutex);
    verdict = state.Press(press, Clock::now());
    if (verdict.changed) Publish();
  }
  // Not under the lock: what is told of it may come back as a screen at once.
  if (verdict.event) input.event(*verdict.event);
  return verdict.status == 204 ? Empty(204) : Response::Text(verdict.status, verdict.reason);
}

Response KioskPage::Impl::Preview() {
  const std::lock_guard lock(mutex);
  if (preview.empty()) return Response::Text(404, "no preview is shown now");
  return Response::Of("image/jpeg", preview);
}

Response KioskPage::Impl::Ticket() {
  std::string code;
  {
    const std::lock_guard lock(mutex);
    if (state.shown().screen == Phase::kThanks) code = state.ticket();
    if (!code.empty() && !std::exchange(ticket_fetched, true)) metrics.Kept();
  }
  if (code.empty()) return Response::Text(404, "no ticket is shown now");
  const auto picture = TicketPicture(WithCode(options.ticket_text, code));
  return picture.ok() ? Response::Of("image/svg+xml", *picture) : Response::Text(500, picture.status().message());
}

Response KioskPage::Impl::Order(const Request& request) {
  const std::string name = request.Wildcard("command");
  for (int i = 0; i < kOperatorCommands; ++i) {
    const auto command = static_cast<OperatorCommand>(i);
    if (name != ToString(command)) continue;
    logger.Info("kiosk: the operator at " + request.peer + " orders " + name);
    input.event(event::Operator{command});
    return Empty(202);
  }
  return Response::Text(404, "there is no such command");
}

Response KioskPage::Impl::Withdraw(const Request& request) {
  if (!input.withdraw) return Response::Text(501, "this kiosk does not forget by ticket; stratalux-db forget does");
  const auto busy = [] {
    return Response::Text(409, "a visit is under way; withdraw when it is over, or close the kiosk first");
  };
  if (!NobodyIsServed()) return busy();
  const auto body = ObjectOf(request);
  const std::string ticket = body ? TextIn(*body, "ticket") : "";
  if (ticket.empty()) return Response::Text(400, "a withdrawal is a JSON object with ticket");
  // It waits for whoever else writes into the store, and for withdrawals before it: somebody may have come meanwhile.
  return Response::Later([this, ticket, busy, peer = request.peer] {
    if (!NobodyIsServed()) return busy();
    const Status status = input.withdraw(ticket);
    logger.Info("kiosk: the operator at " + peer +
                " withdraws by ticket: " + (status.ok() ? std::string("done") : status.message()));
    if (status.ok()) return Empty(204);
    return Response::Text(status.code() == StatusCode::kNotFound ? 404 : 409, status.message());
  });
}

bool KioskPage::Impl::NobodyIsServed() {
  const std::lock_guard lock(mutex);
  const Phase screen = state.shown().screen;
  return screen == Phase::kIdle || screen == Phase::kClosed || screen == Phase::kSafe;
}

Response KioskPage::Impl::PictureOf(const std::string& session, const std::string& peer) {
  if (options.store.empty()) return Response::Text(404, "this kiosk shows no store");
  if (!NobodyIsServed()) return Response::Text(409, "a visit is under way; pictures are shown when it is over");
  const auto picture = SessionPicture(options.store, session, peer, disclosures);
  if (picture.ok()) return Response::Of("image/jpeg", *picture);
  const StatusCode code = picture.status().code();
  return Response::Text(code == StatusCode::kUsage      ? 403
                        : code == StatusCode::kNotFound ? 404
                                                        : 500,
                        picture.status().message());
}

StoreStatus KioskPage::Impl::OfStore() {
  const std::lock_guard lock(store_mutex);
  const auto now = Clock::now();
  if (options.store.empty() || (store_read && now - *store_read < kStoreFor)) return of_store;
  store_read = now;
  of_store.disk_free_bytes = FreeBytes(options.store);
  of_store.calibration_age_days = CalibrationAgeDays(options.store, options.rig, options.simulated, options.wall());
  auto recent = RecentSessions(options.store, kSessions);
  const auto fits = FitsOf(options.store, options.wall());
  of_store.fits = fits.ok() ? std::optional(*fits) : std::nullopt;
  if (recent.ok())
    of_store.sessions = std::move(*recent);
  else if (recent.status().code() != StatusCode::kNotFound)
    logger.Warning("kiosk: the operator sees no sessions: " + recent.status().message());
  return of_store;
}

// The first who asks within a minute waits for systemctl, outside of all other locks.
TimerFacts KioskPage::Impl::OfBatch() {
  const std::lock_guard lock(batch_mutex);
  const auto now = Clock::now();
  if (options.systemctl.empty() || (batch_asked && now - *batch_asked < kBatchFor)) return batch_timer;
  batch_asked = now;
  batch_timer = AskTimer(options.systemctl, kBatchTimer);
  return batch_timer;
}

Response KioskPage::Impl::OperatorFigures() {
  OperatorStatus status;
  status.store = OfStore();
  status.batch_timer = OfBatch();
  status.viewers = static_cast<int>(stream->viewers());
  status.temperatures = Temperatures();
  const WallNs now = options.wall();
  const std::lock_guard lock(mutex);
  status.screen = metrics.figures().screen;
  status.frames_per_second = metrics.figures().frames_per_second;
  status.today = metrics.days().Today(now);
  status.other_days = metrics.days().Others(now);
  status.faults = metrics.days().LastFaults(now);
  status.selfchecks = selfchecks;
  for (const std::string& note : {state_note, days_kept ? days_kept->trouble() : "", selfchecks.note})
    if (!note.empty()) status.notes.push_back(note);
  return Response::Of("application/json", ToJson(status));
}

void KioskPage::Impl::OpenDays() {
  if (options.state.empty()) return;
  const auto file = options.state / (options.simulated ? "kiosk-days-simulated.json" : "kiosk-days.json");
  DayBook days;
  const auto taken =
      TakeState(file, DayBook::kSchema, [&days](const std::string& text) { days = DayBook::From(text); });
  if (!taken.ok() && taken.code() != StatusCode::kNotFound) {
    state_note = taken.message();
    logger.Warning("the day's counts start again at zero: " + state_note);
    days = DayBook();
  }
  days.CutOff();
  metrics = KioskMetrics(std::move(days));
  if (taken.code() != StatusCode::kFailed) days_kept.emplace(file, logger);
  KeepDays();
}

void KioskPage::Impl::KeepDays() {
  const int64_t changes = metrics.days().changes();
  if (days_kept && std::exchange(changes_kept, changes) != changes) days_kept->Keep(metrics.days().ToJson());
}

Response KioskPage::Impl::Health() {
  const std::lock_guard lock(mutex);
  const auto still = std::chrono::duration_cast<std::chrono::seconds>(Clock::now() - beat);
  if (still < kStandsStill) return Response::Text(200, "ok");
  return Response::Text(503, "the machine's loop has stood still for " + std::to_string(still.count()) + " s");
}

Response KioskPage::Impl::Ready() {
  const std::lock_guard lock(mutex);
  const action::Show& shown = state.shown();
  if (shown.screen != Phase::kSafe && shown.screen != Phase::kClosed)
    return Response::Text(200, ToString(shown.screen));
  std::string why = ToString(shown.screen);
  if (shown.word != Word::kNone) why += std::string(" ") + ToString(shown.word);
  for (int i = 0; i < kClosures; ++i)
    if (shown.closures.Has(static_cast<Closure>(i))) why += std::string(" ") + ToString(static_cast<Closure>(i));
  return Response::Text(503, why);
}

Response KioskPage::Impl::Metrics() {
  KioskGauges gauges{static_cast<int>(stream->viewers()), std::nullopt, Temperatures()};
  if (!options.store.empty()) gauges.disk_free_bytes = FreeBytes(options.store);
  const std::lock_guard lock(mutex);
  return Response::Of("text/plain; version=0.0.4; charset=utf-8",
                      PrometheusText(metrics.figures(), gauges, selfchecks));
}

Status KioskPageOptions::Validate() const {
  if (!http::IsLoopback(address) && token.empty())
    return Status::Usage("the kiosk's page at " + address +
                         " can be reached by other machines: it needs a token (token_file), or 127.0.0.1");
  if (!token.empty() && token == operator_token)
    return Status::Usage("the operator's token is the same as the page's: whoever sees the page could run the kiosk");
  if (ticket_text.find("{code}") == std::string::npos)
    return Status::Usage("ticket_text '" + ticket_text + "' lacks {code}, which stands for the ticket's code");
  return Status::Ok();
}

Result<std::unique_ptr<KioskPage>> KioskPage::Start(const KioskPageOptions& given, KioskPageInput input,
                                                    Logger& logger) {
  SLX_RETURN_IF_ERROR(given.Validate());
  KioskPageOptions options = given;
  if (options.page_folder.empty()) options.page_folder = FirstThatIsThere(ProgramDataPlaces("kiosk/page"));
  if (options.language_folder.empty()) options.language_folder = FirstThatIsThere(ProgramDataPlaces("kiosk/languages"));
  for (const char* file : {"index.html", "operator.html"})
    if (const auto page = http::OpenBelow(options.page_folder, file); !page.ok())
      return Status::NotFound("the kiosk's page: " + options.page_folder + ": " + page.status().message());
  SLX_ASSIGN_OR_RETURN(auto languages, ReadLanguages(options.language_folder, options.languages));
  SLX_ASSIGN_OR_RETURN(const std::string nonce, http::RandomToken());
  auto impl = std::make_unique<Impl>(options, std::move(input), logger, std::move(languages));
  impl->OpenDays();
  impl->state.Show(impl->state.shown(), nonce, Clock::now());
  impl->Publish();
  http::ServerOptions server;
  server.address = options.address;
  server.port = options.port;
  server.limits.keep_alive = kKeepAlive;
  server.limits.slow_answers = kSlowAnswers;
  server.threads = 2;  // a forgetting that takes long keeps no screen waiting
  server.access = {.token = options.token, .link_use = http::LinkUse::kAlways, .host_names = options.host_names};
  server.access.keeper_token = options.operator_token;
  server.access.sign_in = "/operator/session";
  SLX_ASSIGN_OR_RETURN(auto started, http::Server::Start(std::move(server), impl->Routes(), logger));
  impl->server.emplace(std::move(started));
  return std::unique_ptr<KioskPage>(new KioskPage(std::move(impl)));
}

KioskPage::KioskPage(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
KioskPage::~KioskPage() { impl_->server->Stop(); }

void KioskPage::Show(const action::Show& show) {
  const auto nonce = http::RandomToken();
  if (!nonce.ok()) impl_->logger.Error("kiosk: no nonce for the page: " + nonce.status().message());
  const std::lock_guard lock(impl_->mutex);
  if (show.screen != Phase::kPosition) impl_->preview.clear();
  impl_->metrics.Shown(show, impl_->options.wall());
  impl_->KeepDays();
  // Without a new one the old one stays, which a page of the visit before may still know: better than none.
  if (impl_->state.Show(show, nonce.ok() ? *nonce : "", Clock::now())) impl_->Publish();
}

void KioskPage::ShowTicket(const std::string& code) {
  const std::lock_guard lock(impl_->mutex);
  impl_->ticket_fetched = false;
  if (impl_->state.SetTicket(code)) impl_->Publish();
}

bool KioskPage::TicketFetched() const {
  const std::lock_guard lock(impl_->mutex);
  return impl_->ticket_fetched;
}

void KioskPage::ShowPreview(const FrameRecord& record, ImageView<const uint16_t> frame) {
  {
    const std::lock_guard lock(impl_->mutex);
    const auto now = Clock::now();
    const bool soon = impl_->previewed && now - *impl_->previewed < kBetweenPreviews;
    if (soon || impl_->state.shown().screen != Phase::kPosition) return;
    impl_->previewed = now;
  }
  auto picture = PreviewPicture(record, frame);
  if (!picture.ok()) return impl_->logger.Warning("kiosk: " + picture.status().message());
  const std::lock_guard lock(impl_->mutex);
  // It may have ended meanwhile.
  if (impl_->state.shown().screen != Phase::kPosition) return;
  impl_->preview = std::move(*picture);
  impl_->state.NextPreview();
  impl_->Publish();
}

void KioskPage::Tell(Word word) {
  const std::lock_guard lock(impl_->mutex);
  impl_->metrics.Told(word, impl_->options.wall());
  impl_->KeepDays();
}

void KioskPage::ShowSelfchecks(const SelfcheckTrend& trend) {
  const std::lock_guard lock(impl_->mutex);
  impl_->selfchecks = trend;
}

void KioskPage::Beat() {
  const std::lock_guard lock(impl_->mutex);
  impl_->beat = Clock::now();
  if (impl_->state.Rest(impl_->beat)) impl_->Publish();
}

std::string KioskPage::url() const { return impl_->server->url(); }
int KioskPage::port() const { return impl_->server->port(); }
const std::vector<std::string>& KioskPage::languages() const { return impl_->state.languages(); }

}  // namespace stratalux::rig
