// SPDX-License-Identifier: Apache-2.0
#include "firmware-host/preview/preview_page.h"

#include <charconv>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <utility>

#include <nlohmann/json.hpp>

#include "firmware-host/preview/preview_picture.h"
#include "shared/base/program_data.h"
#include "shared/http/event_stream.h"
#include "shared/http/server.h"
#include "shared/http/static_files.h"

namespace stratalux::rig {
namespace {

using http::Method;
using http::Request;
using http::Response;

// One who focuses wants to see edges.
constexpr int kLargestPicture = 1392;
constexpr auto kKeepAlive = std::chrono::seconds(2);  // who is gone is found out by it

template <typename T>
std::optional<T> NumberOf(const std::string& text) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() ? std::optional<T>(value) : std::nullopt;
}

Response Done() {
  Response response;
  response.status = 204;
  return response;
}

}  // namespace

struct PreviewPage::Impl {
  const PreviewPageOptions options;
  Logger& logger;
  std::shared_ptr<http::EventStream> stream =
      std::make_shared<http::EventStream>(http::EventStreamOptions{.kept_bytes = 0});

  mutable std::mutex mutex;
  std::condition_variable changed;
  PreviewChoice choice;
  bool news = false, reset = false, stopped = false;
  std::string why, picture;  // JPEG
  int64_t pictures = 0;
  FrameFigures figures;
  std::optional<http::Server> server;

  Impl(PreviewPageOptions o, Logger& l) : options(std::move(o)), logger(l), choice(options.first) {}

  http::Router Routes();
  Response Light(const Request& request);
  Response Exposure(const Request& request);
  Response Reset();
  Response Picture() const;
  // The lock is held.
  Response Chosen();
  void Publish();
};

http::Router PreviewPage::Impl::Routes() {
  http::Router router;
  const std::string& folder = options.page_folder;
  router.Add(Method::kGet, "/", [&folder](const Request&) { return http::FileOf(folder, "preview.html"); });
  router.Add(Method::kGet, "/page/{file}",
             [&folder](const Request& request) { return http::FileOf(folder, request.Wildcard("file")); });
  router.Add(Method::kGet, "/events", [this](const Request&) { return Response::Events(stream); });
  router.Add(Method::kGet, "/preview.jpg", [this](const Request&) { return Picture(); });
  router.Add(Method::kPost, "/light/{projector}", [this](const Request& request) { return Light(request); });
  router.Add(Method::kPost, "/exposure/{ms}", [this](const Request& request) { return Exposure(request); });
  router.Add(Method::kPost, "/reset", [this](const Request&) { return Reset(); });
  return router;
}

Response PreviewPage::Impl::Chosen() {
  news = true;
  changed.notify_all();
  Publish();
  return Done();
}

Response PreviewPage::Impl::Light(const Request& request) {
  const std::string name = request.Wildcard("projector");
  const std::optional<int> projector = name == "off" ? -1 : NumberOf<int>(name);
  const bool there = projector && (*projector >= 0 || name == "off") && *projector < options.projectors;
  if (!there)
    return Response::Text(404, "light must be off, or a projector of 0 .. " + std::to_string(options.projectors - 1));
  const std::lock_guard lock(mutex);
  if (stopped && *projector >= 0) return Response::Text(409, "the light is stopped: " + why);
  choice.projector = *projector;
  return Chosen();
}

Response PreviewPage::Impl::Exposure(const Request& request) {
  const std::optional<double> ms = NumberOf<double>(request.Wildcard("ms"));
  // Written so that nan is none.
  if (!ms || !(*ms >= options.shortest_ms && *ms <= options.longest_ms))
    return Response::Text(400, "the exposure must be in " + nlohmann::json(options.shortest_ms).dump() + " .. " +
                                   nlohmann::json(options.longest_ms).dump() + " ms");
  const std::lock_guard lock(mutex);
  choice.exposure_ms = *ms;
  return Chosen();
}

Response PreviewPage::Impl::Reset() {
  const std::lock_guard lock(mutex);
  reset = true;
  return Chosen();
}

Response PreviewPage::Impl::Picture() const {
  const std::lock_guard lock(mutex);
  return picture.empty() ? Response::Text(404, "no picture yet") : Response::Of("image/jpeg", picture);
}

void PreviewPage::Impl::Publish() {
  const nlohmann::ordered_json look = {{"picture", pictures},
                                       {"light", choice.projector},
                                       {"exposure_ms", choice.exposure_ms},
                                       {"projectors", options.projectors},
                                       {"shortest_ms", options.shortest_ms},
                                       {"longest_ms", options.longest_ms},
                                       {"focus", figures.focus},
                                       {"level", figures.level},
                                       {"bright", figures.bright},
                                       {"saturated", figures.saturated},
                                       {"stopped", stopped},
                                       {"why", why}};
  stream->Publish("look", look.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
}

Result<std::unique_ptr<PreviewPage>> PreviewPage::Start(const PreviewPageOptions& given, Logger& logger) {
  PreviewPageOptions options = given;
  if (options.page_folder.empty()) options.page_folder = FirstThatIsThere(ProgramDataPlaces("preview/page"));
  if (const auto page = http::OpenBelow(options.page_folder, "preview.html"); !page.ok())
    return Status::NotFound("the preview's page: " + options.page_folder + ": " + page.status().message());
  auto impl = std::make_unique<Impl>(options, logger);
  http::ServerOptions server;
  server.port = options.port;
  server.limits.keep_alive = kKeepAlive;
  SLX_ASSIGN_OR_RETURN(auto started, http::Server::Start(std::move(server), impl->Routes(), logger));
  impl->server.emplace(std::move(started));
  return std::unique_ptr<PreviewPage>(new PreviewPage(std::move(impl)));
}

PreviewPage::PreviewPage(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PreviewPage::~PreviewPage() { impl_->server->Stop(); }

PreviewChoice PreviewPage::choice() const {
  const std::lock_guard lock(impl_->mutex);
  return impl_->choice;
}

void PreviewPage::PutOut(const std::string& why) {
  const std::lock_guard lock(impl_->mutex);
  impl_->choice.projector = -1;
  impl_->why = why;
  impl_->Publish();
}

bool PreviewPage::TakeReset() {
  const std::lock_guard lock(impl_->mutex);
  return std::exchange(impl_->reset, false);
}

void PreviewPage::Wait(std::chrono::nanoseconds time) {
  std::unique_lock lock(impl_->mutex);
  impl_->changed.wait_for(lock, time, [this] { return impl_->news; });
  impl_->news = false;
}

void PreviewPage::Show(const FrameRecord& record, ImageView<const uint16_t> frame, const FrameFigures& figures) {
  auto picture = PreviewPicture(record, frame, kLargestPicture);
  if (!picture.ok()) return impl_->logger.Warning("preview: " + picture.status().message());
  const std::lock_guard lock(impl_->mutex);
  impl_->picture = std::move(*picture);
  ++impl_->pictures;
  impl_->figures = figures;
  // Why the light went out stays until another one is chosen.
  if (impl_->stopped || impl_->choice.projector >= 0) impl_->why.clear();
  impl_->stopped = false;
  impl_->Publish();
}

void PreviewPage::Say(const std::string& why, Trouble trouble) {
  const std::lock_guard lock(impl_->mutex);
  const bool stopped = trouble == Trouble::kStopped;
  if (impl_->why == why && impl_->stopped == stopped) return;
  impl_->why = why;
  impl_->stopped = stopped;
  if (stopped) impl_->choice.projector = -1;
  impl_->Publish();
}

std::string PreviewPage::url() const { return impl_->server->url(); }
int PreviewPage::port() const { return impl_->server->port(); }

}  // namespace stratalux::rig
