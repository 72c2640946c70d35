// SPDX-License-Identifier: Apache-2.0
// The adapter over libmicrohttpd (0.9.75 and 1.0): the only place that knows it.
#include <algorithm>
#include <array>
#include <condition_variable>
#include <cstdarg>
#include <cstring>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>

#include <arpa/inet.h>
#include <fcntl.h>
#include <microhttpd.h>
#include <netinet/in.h>
#include <unistd.h>

#include "shared/http/connection_watch.h"
#include "shared/http/event_stream.h"
#include "shared/http/listener.h"
#include "shared/http/server.h"
#include "shared/http/side_thread.h"
#include "shared/http/target.h"

namespace stratalux::http {
namespace {

constexpr size_t kBlockBytes = 16 << 10;  // asked of a generator at once

constexpr std::pair<const char*, const char*> kHeadersOfAll[] = {
    {"Content-Security-Policy",
     "default-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'"},
    {"X-Content-Type-Options", "nosniff"},
    {"Referrer-Policy", "no-referrer"},
    {"Cross-Origin-Resource-Policy", "same-origin"},
    {"Cross-Origin-Opener-Policy", "same-origin"},
    {"Cache-Control", "no-store"}};

// One request and its answer.
struct Exchange {
  std::string target;
  bool begun = false, too_large = false;
  Request request;
  const Handler* handler = nullptr;
  bool sleeps = false;           // until its slow answer is made
  std::optional<Response> late;  // that answer
};

std::optional<Method> MethodOf(const std::string& name) {
  for (const Method method : {Method::kGet, Method::kHead, Method::kPost, Method::kPut, Method::kDelete})
    if (name == ToString(method)) return method;
  return std::nullopt;
}

std::string PeerOf(MHD_Connection* connection) {
  const MHD_ConnectionInfo* info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
  if (info == nullptr || info->client_addr == nullptr) return "";
  char text[INET6_ADDRSTRLEN] = "";
  const sockaddr* address = info->client_addr;
  const void* bytes = address->sa_family == AF_INET6
                          ? static_cast<const void*>(&reinterpret_cast<const sockaddr_in6*>(address)->sin6_addr)
                          : static_cast<const void*>(&reinterpret_cast<const sockaddr_in*>(address)->sin_addr);
  inet_ntop(address->sa_family, bytes, text, sizeof text);
  return text;
}

struct HeaderReader {
  std::map<std::string, std::string>* headers;
  size_t bytes = 0;
};

MHD_Result ReadHeader(void* context, MHD_ValueKind, const char* key, const char* value) {
  auto& reader = *static_cast<HeaderReader*>(context);
  std::string name = key == nullptr ? "" : key;
  const std::string text = value == nullptr ? "" : value;
  reader.bytes += name.size() + text.size() + 4;
  std::transform(name.begin(), name.end(), name.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  const auto [place, fresh] = reader.headers->emplace(name, text);
  if (!fresh) place->second += ", " + text;
  return MHD_YES;
}

// A viewer of a stream, as the library's answer.
struct Viewing {
  std::shared_ptr<EventStream> stream;
  MHD_Connection* connection;
  int64_t viewer;
};

ssize_t ReadEvents(void* context, uint64_t, char* buffer, size_t size) {
  const auto& viewing = *static_cast<Viewing*>(context);
  const auto taken =
      viewing.stream->Take(viewing.viewer, {buffer, size}, [&viewing] { MHD_suspend_connection(viewing.connection); });
  return taken.state == EventStream::Taken::State::kEnd ? MHD_CONTENT_READER_END_OF_STREAM
                                                        : static_cast<ssize_t>(taken.bytes);
}

void EndViewing(void* context) {
  const std::unique_ptr<Viewing> viewing(static_cast<Viewing*>(context));
  viewing->stream->Remove(viewing->viewer);
}

ssize_t ReadGenerator(void* context, uint64_t, char* buffer, size_t size) {
  try {
    const size_t bytes = (*static_cast<Generator*>(context))({buffer, size});
    return bytes == 0 ? MHD_CONTENT_READER_END_OF_STREAM : static_cast<ssize_t>(std::min(bytes, size));
  } catch (...) {
    return MHD_CONTENT_READER_END_WITH_ERROR;  // the other end sees an answer that broke off
  }
}

void EndGenerator(void* context) { delete static_cast<Generator*>(context); }

MHD_Response* OfBytes(const std::string& bytes) {
  // The library copies them; it only takes what could be written.
  return MHD_create_response_from_buffer(bytes.size(), const_cast<char*>(bytes.data()), MHD_RESPMEM_MUST_COPY);
}

MHD_Response* OfFile(const FileBody& file) {
  if (file.bytes == 0) return OfBytes("");
  const int fd = fcntl(file.fd.get(), F_DUPFD_CLOEXEC, 0);  // which the library closes
  if (fd < 0) return nullptr;
  MHD_Response* made = MHD_create_response_from_fd64(file.bytes, fd);
  if (made == nullptr) close(fd);
  return made;
}

MHD_Response* OfGenerator(const Generator& generator) {
  auto kept = std::make_unique<Generator>(generator);
  MHD_Response* made =
      MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, kBlockBytes, ReadGenerator, kept.get(), EndGenerator);
  if (made != nullptr) (void)kept.release();
  return made;
}

void IgnoreLibraryLog(void*, const char*, va_list) {}

// Targets are taken apart by ParseTarget; the library leaves them as they came.
size_t LeaveEscaped(void*, MHD_Connection*, char* text) { return std::strlen(text); }

}  // namespace

struct Server::Impl {
  ServerOptions options;
  Router router;
  Logger& logger;
  int port;
  AccessGuard guard;
  ConnectionWatch watch;
  MHD_Daemon* daemon = nullptr;

  std::mutex mutex;
  std::condition_variable wake;
  bool stopping = false;
  std::vector<std::weak_ptr<EventStream>> streams;
  std::thread timer;
  SideThread side;

  Impl(ServerOptions o, Router r, Logger& l, int p)
      : options(std::move(o)),
        router(std::move(r)),
        logger(l),
        port(p),
        guard(options.access, p),
        watch(options.limits.idle, options.limits.answer),
        side(static_cast<size_t>(options.limits.slow_answers)) {}
  ~Impl() { Stop(); }

  Status Start(UniqueFd socket);
  void Stop();
  void Watch();
  void Remember(const std::shared_ptr<EventStream>& stream);

  // The refusal of a request whose header has been read; nullopt: it may go on.
  std::optional<Response> Begin(Exchange& exchange, MHD_Connection* connection, const std::string& method);
  std::optional<Response> Admit(Exchange& exchange, std::optional<Method> method);
  Response Call(const Exchange& exchange, const SlowAnswer& make);
  MHD_Result AnswerLater(SlowAnswer make, Exchange& exchange, MHD_Connection* connection);
  MHD_Response* Make(Response& response, const Exchange& exchange, MHD_Connection* connection);
  MHD_Result Answer(Response response, const Exchange& exchange, MHD_Connection* connection);
  MHD_Result Handle(Exchange& exchange, MHD_Connection* connection, const char* method, const char* data, size_t* size);

  static void* OnTarget(void*, const char* uri, MHD_Connection*) {
    auto exchange = std::make_unique<Exchange>();
    exchange->target = uri;
    return exchange.release();
  }
  static MHD_Result OnRequest(void* self, MHD_Connection* connection, const char*, const char* method, const char*,
                              const char* data, size_t* size, void** context) {
    try {
      return static_cast<Impl*>(self)->Handle(*static_cast<Exchange*>(*context), connection, method, data, size);
    } catch (const std::exception& error) {
      static_cast<Impl*>(self)->logger.Error(std::string("http: a request was dropped: ") + error.what());
      return MHD_NO;
    }
  }
  static void OnDone(void* self, MHD_Connection* connection, void** context, MHD_RequestTerminationCode) {
    const std::unique_ptr<Exchange> exchange(static_cast<Exchange*>(std::exchange(*context, nullptr)));
    static_cast<Impl*>(self)->watch.Reads(connection);  // the next one
  }
  static void OnConnection(void* self, MHD_Connection* connection, void**, MHD_ConnectionNotificationCode code) {
    ConnectionWatch& watch = static_cast<Impl*>(self)->watch;
    if (code == MHD_CONNECTION_NOTIFY_CLOSED) return watch.Closed(connection);
    const MHD_ConnectionInfo* info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    if (info != nullptr) watch.Opened(connection, info->connect_fd);
  }
};

Status Server::Impl::Start(UniqueFd socket) {
  const int fd = fcntl(socket.get(), F_DUPFD_CLOEXEC, 0);  // which the library closes
  const ServerLimits& limits = options.limits;
  // A pool holds what is read of a header and what is written of an answer's; room for the sum and a little.
  const size_t pool = 4 * limits.header_bytes + 2048;
  std::vector<MHD_OptionItem> more;
  if (options.threads > 1) more.push_back({MHD_OPTION_THREAD_POOL_SIZE, options.threads, nullptr});
  more.push_back({MHD_OPTION_END, 0, nullptr});
  daemon = MHD_start_daemon(
      MHD_USE_POLL_INTERNAL_THREAD | MHD_ALLOW_SUSPEND_RESUME | MHD_USE_ERROR_LOG, 0, nullptr, nullptr, OnRequest, this,
      MHD_OPTION_EXTERNAL_LOGGER, IgnoreLibraryLog, nullptr, MHD_OPTION_LISTEN_SOCKET, fd, MHD_OPTION_CONNECTION_LIMIT,
      static_cast<unsigned>(limits.connections), MHD_OPTION_PER_IP_CONNECTION_LIMIT,
      static_cast<unsigned>(limits.connections_per_peer), MHD_OPTION_CONNECTION_TIMEOUT,
      static_cast<unsigned>(limits.idle.count()), MHD_OPTION_CONNECTION_MEMORY_LIMIT, pool, MHD_OPTION_URI_LOG_CALLBACK,
      OnTarget, nullptr, MHD_OPTION_UNESCAPE_CALLBACK, LeaveEscaped, nullptr, MHD_OPTION_NOTIFY_COMPLETED, OnDone, this,
      MHD_OPTION_NOTIFY_CONNECTION, OnConnection, this, MHD_OPTION_ARRAY, more.data(), MHD_OPTION_END);
  if (daemon == nullptr) {
    close(fd);
    return Status::Failed("the HTTP server does not start: no memory, or no more threads");
  }
  timer = std::thread([this] { Watch(); });
  return Status::Ok();
}

void Server::Impl::Stop() {
  std::vector<std::weak_ptr<EventStream>> open;
  {
    const std::lock_guard lock(mutex);
    stopping = true;
    open.swap(streams);
  }
  wake.notify_all();
  // Nothing may sleep any more when the library stops.
  side.Stop();
  for (const auto& stream : open)
    if (const auto held = stream.lock()) held->Close();
  if (timer.joinable()) timer.join();
  if (MHD_Daemon* running = std::exchange(daemon, nullptr)) MHD_stop_daemon(running);
}

void Server::Impl::Watch() {
  const auto tick = std::min<std::chrono::milliseconds>(options.limits.keep_alive, std::chrono::milliseconds(250));
  auto next_comment = std::chrono::steady_clock::now() + options.limits.keep_alive;
  std::unique_lock lock(mutex);
  while (!wake.wait_for(lock, tick, [this] { return stopping; })) {
    const auto now = std::chrono::steady_clock::now();
    watch.EndLate(now);
    if (now < next_comment) continue;
    next_comment = now + options.limits.keep_alive;
    for (const auto& stream : streams)
      if (const auto held = stream.lock()) held->KeepAlive();
  }
}

void Server::Impl::Remember(const std::shared_ptr<EventStream>& stream) {
  const std::lock_guard lock(mutex);
  if (stopping) return stream->Close();
  std::erase_if(streams, [](const auto& known) { return known.expired(); });
  const auto same = [&stream](const auto& known) { return known.lock() == stream; };
  if (std::none_of(streams.begin(), streams.end(), same)) streams.push_back(stream);
}

std::optional<Response> Server::Impl::Begin(Exchange& exchange, MHD_Connection* connection, const std::string& method) {
  Request& request = exchange.request;
  HeaderReader reader{&request.headers};
  reader.bytes = exchange.target.size() + method.size() + 12;  // "GET / HTTP/1.1\r\n" and the empty line
  MHD_get_connection_values(connection, MHD_HEADER_KIND, ReadHeader, &reader);
  if (reader.bytes > options.limits.header_bytes) return Response::Text(431, "the request's header is too large");
  const std::string length = request.Header("content-length");
  const bool counts =
      !length.empty() && length.size() < 18 && length.find_first_not_of("0123456789") == std::string::npos;
  if (!length.empty() && !counts) return Response::Text(400, "the length of the request's body is not a number");
  if (counts && std::stoull(length) > options.limits.body_bytes)
    return Response::Text(413, "the request's body is too large");
  request.peer = PeerOf(connection);
  return Admit(exchange, MethodOf(method));
}

std::optional<Response> Server::Impl::Admit(Exchange& exchange, std::optional<Method> method) {
  Request& request = exchange.request;
  auto target = ParseTarget(exchange.target);
  if (!target.ok()) return Response::Text(400, target.status().message());
  request.method = method.value_or(Method::kDelete);
  request.path = target->path();
  request.query = target->query;
  if (auto refusal = guard.CheckHost(request)) return refusal;
  auto match = router.Find(request.method, *target);
  if (method)
    if (auto answer = guard.CheckSignIn(request)) return answer;
  // Strangers do not learn which paths there are.
  const Audience audience = match.handler == nullptr ? Audience::kHoldersOfToken : match.audience;
  if (auto refusal = guard.CheckToken(request, audience)) return refusal;
  if (match.allowed.empty()) return Response::Text(404, "there is nothing at " + request.path);
  if (match.handler == nullptr || !method) {
    std::string allowed;
    for (const Method one : match.allowed) allowed += (allowed.empty() ? "" : ", ") + std::string(ToString(one));
    Response refusal = Response::Text(405, "the methods allowed here are " + allowed);
    return std::move(refusal.With("Allow", allowed));
  }
  if (auto refusal = guard.CheckOrigin(request)) return refusal;
  request.wildcards = std::move(match.wildcards);
  exchange.handler = match.handler;
  return std::nullopt;
}

Response Server::Impl::Call(const Exchange& exchange, const SlowAnswer& make) {
  const std::string what = std::string(ToString(exchange.request.method)) + " " + PercentEncode(exchange.request.path);
  try {
    return make();
  } catch (const std::exception& error) {
    logger.Error("http: " + what + ": " + error.what());
  } catch (...) {
    logger.Error("http: " + what + ": an exception without a text");
  }
  return Response::Text(500, "this failed; the program's log says why");
}

MHD_Result Server::Impl::AnswerLater(SlowAnswer make, Exchange& exchange, MHD_Connection* connection) {
  // A connection that sleeps is neither read nor closed by the library, so that its exchange stays.
  auto piece = [this, make = std::move(make), &exchange, connection](bool ending) {
    try {
      exchange.late = ending ? Response::Text(503, "this server is shutting down") : Call(exchange, make);
    } catch (...) {  // no memory: nothing is answered
    }
    MHD_resume_connection(connection);
  };
  const auto sleep = [&exchange, connection] {
    exchange.sleeps = true;
    MHD_suspend_connection(connection);
  };
  if (side.Add(std::move(piece), sleep)) return MHD_YES;
  return Answer(Response::Text(503, "too many requests are under way; try again soon"), exchange, connection);
}

MHD_Response* Server::Impl::Make(Response& response, const Exchange& exchange, MHD_Connection* connection) {
  if (const auto* bytes = std::get_if<std::string>(&response.body)) return OfBytes(*bytes);
  if (const auto* file = std::get_if<FileBody>(&response.body)) return OfFile(*file);
  if (const auto* generator = std::get_if<Generator>(&response.body)) return OfGenerator(*generator);
  if (std::holds_alternative<SlowAnswer>(response.body)) return nullptr;
  const auto& stream = std::get<std::shared_ptr<EventStream>>(response.body);
  Remember(stream);
  watch.Streams(connection);
  auto viewing = std::make_unique<Viewing>(Viewing{stream, connection, 0});
  viewing->viewer =
      stream->Add(exchange.request.Header("last-event-id"), [connection] { MHD_resume_connection(connection); });
  MHD_Response* made =
      MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, kBlockBytes, ReadEvents, viewing.get(), EndViewing);
  if (made == nullptr)
    stream->Remove(viewing->viewer);
  else
    (void)viewing.release();
  return made;
}

MHD_Result Server::Impl::Answer(Response response, const Exchange& exchange, MHD_Connection* connection) {
  watch.Answers(connection);
  MHD_Response* made = Make(response, exchange, connection);
  if (made == nullptr) return MHD_NO;
  for (const auto& [name, value] : kHeadersOfAll) {
    const auto same = [name = name](const auto& header) { return header.first == name; };
    if (std::none_of(response.headers.begin(), response.headers.end(), same))
      MHD_add_response_header(made, name, value);
  }
  for (const auto& [name, value] : response.headers) {
    // Names and values that would begin another header are refused by the library.
    if (MHD_add_response_header(made, name.c_str(), value.c_str()) != MHD_YES)
      logger.Error("http: the header " + name + " of an answer cannot be sent");
  }
  const MHD_Result queued = MHD_queue_response(connection, static_cast<unsigned>(response.status), made);
  MHD_destroy_response(made);  // the connection keeps it
  return queued;
}

MHD_Result Server::Impl::Handle(Exchange& exchange, MHD_Connection* connection, const char* method, const char* data,
                                size_t* size) {
  if (!std::exchange(exchange.begun, true)) {
    auto refusal = Begin(exchange, connection, method);
    return refusal ? Answer(std::move(*refusal), exchange, connection) : MHD_YES;
  }
  if (*size > 0) {
    exchange.too_large |= exchange.request.body.size() + *size > options.limits.body_bytes;
    if (!exchange.too_large) exchange.request.body.append(data, *size);
    *size = 0;
    return MHD_YES;
  }
  if (exchange.sleeps) return exchange.late ? Answer(std::move(*exchange.late), exchange, connection) : MHD_NO;
  if (exchange.too_large) return Answer(Response::Text(413, "the request's body is too large"), exchange, connection);
  watch.Answers(connection);
  Response response = Call(exchange, [&exchange] { return (*exchange.handler)(exchange.request); });
  if (auto* make = std::get_if<SlowAnswer>(&response.body)) return AnswerLater(std::move(*make), exchange, connection);
  return Answer(std::move(response), exchange, connection);
}

Status ServerOptions::Validate() const {
  if (port < 0 || port > 65535) return Status::Usage("port " + std::to_string(port) + " must be within 0 .. 65535");
  if (threads < 1 || threads > 16) return Status::Usage("threads " + std::to_string(threads) + " must be 1 .. 16");
  if (limits.connections < threads || limits.connections_per_peer < 1)
    return Status::Usage("a server needs at least one connection for each thread and peer");
  if (limits.header_bytes < 1024 || limits.header_bytes > (1 << 20))
    return Status::Usage("header_bytes must be within 1 KiB .. 1 MiB");
  if (limits.idle.count() < 1 || limits.answer.count() < 1 || limits.keep_alive.count() < 1)
    return Status::Usage("the times of a server must be above 0");
  if (limits.slow_answers < 0) return Status::Usage("slow_answers must be 0 or more");
  return Status::Ok();
}

Result<Server> Server::Start(ServerOptions options, Router router, Logger& logger) {
  SLX_RETURN_IF_ERROR(options.Validate());
  SLX_ASSIGN_OR_RETURN(auto listener, Listen(options.address, options.port));
  auto impl = std::make_unique<Impl>(std::move(options), std::move(router), logger, listener.port);
  SLX_RETURN_IF_ERROR(impl->Start(std::move(listener.socket)));
  return Server(std::move(impl));
}

Server::Server(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Server::Server(Server&&) noexcept = default;
Server& Server::operator=(Server&&) noexcept = default;
Server::~Server() = default;

int Server::port() const { return impl_->port; }
std::string Server::url() const {
  const std::string& address = impl_->options.address;
  const bool v6 = address.find(':') != std::string::npos;
  return "http://" + (v6 ? "[" + address + "]" : address) + ":" + std::to_string(impl_->port);
}
int Server::connections() const {
  const MHD_DaemonInfo* info =
      impl_->daemon == nullptr ? nullptr : MHD_get_daemon_info(impl_->daemon, MHD_DAEMON_INFO_CURRENT_CONNECTIONS);
  return info == nullptr ? 0 : static_cast<int>(info->num_connections);
}
void Server::Stop() { impl_->Stop(); }

}  // namespace stratalux::http
