// SPDX-License-Identifier: Apache-2.0
// `stratalux-db serve`: the store as pages of a browser, until SIGINT, SIGTERM or SIGHUP.
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <optional>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "db/apps/command.h"
#include "db/apps/serve/site.h"
#include "db/base/durable_file.h"
#include "shared/base/log.h"
#include "shared/base/unique_fd.h"
#include "shared/http/server.h"

namespace stratalux::db {
namespace {

using Json = nlohmann::ordered_json;

struct ServeFlags {
  int port = 0;
  std::string address = "127.0.0.1";
  std::string token_file;
  bool no_open = false;
};

// Ctrl-C, the system's stop and the end of the terminal, taken by the main thread alone: blocked before others begin.
class StopSignals {
 public:
  StopSignals() {
    sigemptyset(&signals_);
    sigaddset(&signals_, SIGINT);
    sigaddset(&signals_, SIGTERM);
    struct sigaction hang_up {};
    sigaction(SIGHUP, nullptr, &hang_up);
    if (hang_up.sa_handler != SIG_IGN) sigaddset(&signals_, SIGHUP);  // nohup; blocked, it would come all the same
    pthread_sigmask(SIG_BLOCK, &signals_, nullptr);
    std::signal(SIGPIPE, SIG_IGN);
  }
  void Wait() const {
    int signal = 0;
    sigwait(&signals_, &signal);
  }

 private:
  sigset_t signals_{};
};

// A page that sends the browser on to the link: what a program is started with, every user of the machine may read, and
// this file its owner alone. Gone with this program.
class LinkPage {
 public:
  explicit LinkPage(const std::string& url) {
    const char* own = std::getenv("XDG_RUNTIME_DIR");
    const std::filesystem::path folder =
        own != nullptr && *own != '\0' ? std::filesystem::path(own) : std::filesystem::temp_directory_path();
    std::string name = folder / "stratalux-serve-XXXXXX.html";
    constexpr int kSuffix = 5;                                        // ".html"
    const UniqueFd file(mkostemps(name.data(), kSuffix, O_CLOEXEC));  // mode 0600
    if (!file.ok()) return;
    name_ = name;
    const std::string page =
        "<!DOCTYPE html><meta charset=\"utf-8\"><meta name=\"referrer\" content=\"no-referrer\">"
        "<meta http-equiv=\"refresh\" content=\"0; url=" +
        url + "\"><title>Stratalux</title>\n";
    if (!WriteAll(file.get(), page.data(), page.size(), name).ok()) Remove();
  }
  ~LinkPage() { Remove(); }
  LinkPage(const LinkPage&) = delete;
  LinkPage& operator=(const LinkPage&) = delete;
  // Empty: it could not be written.
  [[nodiscard]] const std::string& name() const { return name_; }

 private:
  void Remove() {
    if (!name_.empty()) unlink(name_.c_str());
    name_.clear();
  }
  std::string name_;
};

// By the desktop's own program, twice removed so that nobody waits for it.
void OpenBrowser(const std::string& page) {
  const pid_t child = fork();
  if (child < 0) return;
  if (child > 0) {
    int ignored = 0;
    (void)waitpid(child, &ignored, 0);
    return;
  }
  if (setsid() < 0 || fork() != 0) _exit(0);
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  const int null = open("/dev/null", O_RDWR);
  for (int fd = 0; fd < 3; ++fd) dup2(null, fd);
  execlp("xdg-open", "xdg-open", page.c_str(), static_cast<char*>(nullptr));
  _exit(127);
}

bool HasDesktop() {
  return isatty(STDOUT_FILENO) != 0 && (std::getenv("DISPLAY") != nullptr || std::getenv("WAYLAND_DISPLAY") != nullptr);
}

Result<http::AccessOptions> AccessOf(const ServeFlags& flags) {
  http::AccessOptions access;
  if (flags.token_file.empty()) {
    SLX_ASSIGN_OR_RETURN(access.token, http::RandomToken());
    return access;
  }
  SLX_ASSIGN_OR_RETURN(access.token, http::ReadTokenFile(flags.token_file));
  access.link_use = http::LinkUse::kAlways;
  return access;
}

Status CheckFlags(const ServeFlags& flags) {
  if (http::IsLoopback(flags.address) || !flags.token_file.empty()) return Status::Ok();
  return Status::Usage("--address " + flags.address +
                       " can be reached by other machines: give --token-file FILE (mode 0600, at least 16 characters),"
                       " or stay on 127.0.0.1");
}

// The token of a file is not repeated where a log might keep it.
int Announce(const CommonFlags& common, const ServeFlags& flags, const http::Server& server, const std::string& token) {
  const std::string link = server.url() + "/" + (flags.token_file.empty() ? "?token=" + token : "");
  if (common.json)
    return Print(
        TextOf(Json{{"url", link}, {"address", flags.address}, {"port", server.port()}, {"store", common.store}}));
  const std::string how =
      flags.token_file.empty() ? " (works once)\n" : "?token=... with the token of " + flags.token_file + "\n";
  return Print("Serving " + common.store + ", read-only. Ctrl-C ends it.\n" + link + how);
}

int RunServe(const CommonFlags& common, const ServeFlags& flags) {
  if (const Status status = CheckFlags(flags); !status.ok()) return Report(status);
  auto access = AccessOf(flags);
  if (!access.ok()) return Report(access.status());
  const StopSignals signals;
  Logger logger;
  Site site(common.store, logger);
  if (const auto index = site.OpenIndex(); !index.ok()) return Report(index.status());
  http::ServerOptions options;
  options.address = flags.address;
  options.port = flags.port;
  options.threads = 2;  // a question that takes long does not keep the pages waiting
  options.access = *access;
  auto server = http::Server::Start(std::move(options), RoutesOf(site), logger);
  if (!server.ok()) return Report(server.status());
  if (!http::IsLoopback(flags.address))
    logger.Warning("anyone who reaches " + server->url() +
                   " and has the token can see this store; the connection is not"
                   " encrypted: put a reverse proxy with TLS in front (docs/operators-guide.md)");
  if (const int printed = Announce(common, flags, *server, access->token); printed != 0) return printed;
  std::optional<LinkPage> page;
  if (!flags.no_open && flags.token_file.empty() && HasDesktop()) {
    page.emplace(server->url() + "/?token=" + access->token);
    if (!page->name().empty()) OpenBrowser(page->name());
  }
  signals.Wait();
  server->Stop();
  return 0;
}

}  // namespace

void AddServeCommand(Commands& commands) {
  const auto flags = std::make_shared<ServeFlags>();
  const CommonFlags& common = commands.flags();
  CLI::App* serve = commands.Add("serve", "Show the store in a browser, read-only, until Ctrl-C",
                                 [&common, flags] { return RunServe(common, *flags); });
  serve->add_option("--port", flags->port, "port (default: any free one)")->check(CLI::Range(0, 65535));
  serve->add_option("--address", flags->address, "IPv4 or IPv6 address (default: 127.0.0.1, this machine only)");
  serve->add_option("--token-file", flags->token_file,
                    "file whose first line is the token (default: a link that works once)");
  serve->add_flag("--no-open", flags->no_open, "do not open a browser");
  serve->footer(R"(Examples:
  stratalux-db serve --store store
  stratalux-db serve --store store --port 8080 --no-open
  stratalux-db serve --store store --address ::1 --json
  stratalux-db serve --store store --address 192.168.7.2 --token-file serve.token)");
}

}  // namespace stratalux::db
