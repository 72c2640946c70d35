// SPDX-License-Identifier: Apache-2.0
// The store's pages over loopback, and the command that serves them.
#include <csignal>
#include <cstring>
#include <fstream>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <pty.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/apps/serve/html.h"
#include "db/apps/serve/site.h"
#include "db/base/sqlite.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/named_query.h"
#include "db/keys/key_store.h"
#include "db/ledger/ledger.h"
#include "db/privacy/access_log.h"
#include "db/privacy/forget.h"
#include "db/segment/segment.h"
#include "shared/base/read_file.h"
#include "shared/capture/reduced_picture.h"
#include "shared/http/server.h"
#include "shared/image/png.h"
#include "tests/db/store_fixture.h"
#include "tests/shared/http/http_client.h"
#include "tests/support/run_program.h"

namespace stratalux::db {
namespace {

using http::Answer;
using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::Not;

class ServePages : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    Restart();
  }
  void Restart() {
    site_ = std::make_unique<Site>(folder_, logger_);
    auto server = http::Server::Start({}, RoutesOf(*site_), logger_);
    ASSERT_TRUE(server.ok()) << server.status().message();
    server_ = std::make_unique<http::Server>(std::move(*server));
  }
  void TearDown() override {
    server_.reset();
    StoreTest::TearDown();
  }
  [[nodiscard]] Answer Get(const std::string& target) const { return http::Get(server_->port(), target); }
  [[nodiscard]] std::string VisitOf(const std::string& visitor, const WriterOptions& options = {},
                                    int frames = 3) const {
    Consent consent;
    consent.text_version = "2026-03";
    consent.language = "de";
    consent.fit = true;
    EXPECT_TRUE(GiveConsent(folder_, visitor, consent).ok());
    SessionStore store = OpenStore();
    SessionInfo info;
    info.visitor = visitor;
    info.started_wall = WallNow();
    auto writer = store.BeginSession(info, options);
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < frames; ++i) EXPECT_TRUE(AppendTo(*writer, i).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    return writer->info().id;
  }
  [[nodiscard]] std::filesystem::path AddFit(const std::string& session, const std::string& fit) const {
    const SessionStore store = OpenStore();
    const auto folder = store.FitFolder(session, fit);
    std::filesystem::create_directories(folder / "report");
    WriteText(folder / "report" / "index.html", "<script>1</script><h1>report</h1>");
    WriteText(folder / "position.exr", "exr");
    EXPECT_TRUE(OpenStore().RegisterFit({fit, session, "{}", R"({"fit": {"divergence": 0.5}})", {5}}).ok());
    return folder;
  }

  Logger logger_;
  std::unique_ptr<Site> site_;
  std::unique_ptr<http::Server> server_;
};

TEST_F(ServePages, ShowSessionsFramesFitsAndAnswers) {
  const std::string id = VisitOf("v-5f3a91c2", {}, 5);
  (void)AddFit(id, "f1");
  EXPECT_THAT(Get("/").body, HasSubstr("Sessions</dt><dd><a href=\"/sessions\">1</a>"));
  EXPECT_THAT(Get("/sessions").body, HasSubstr("href=\"/sessions/" + id + "\""));
  const std::string session = Get("/sessions/" + id).body;
  EXPECT_THAT(session, HasSubstr("correspondence"));
  EXPECT_THAT(session, HasSubstr("/sessions/" + id + "/fits/f1"));
  EXPECT_THAT(Get("/sessions/" + id + "/frames?phase=correspondence").body, HasSubstr("/pictures/" + id + "/4"));
  EXPECT_THAT(Get("/sessions/" + id + "/frames?phase=sweep").body, HasSubstr("No frames"));
  EXPECT_THAT(Get("/sessions/" + id + "/frames/2").body, HasSubstr("gray rows bit=3/10 inverse"));
  EXPECT_THAT(Get("/sessions/" + id + "/fits/f1").body, HasSubstr("fit.divergence"));
  for (const NamedQuery& query : NamedQueries()) EXPECT_EQ(Get("/queries/" + query.name).status, 200) << query.name;
  EXPECT_THAT(Get("/queries/last-night?since=1d").body, HasSubstr("href=\"/sessions/" + id + "\""));
  EXPECT_EQ(Get("/consent").status, 200);
  EXPECT_EQ(Get("/deletions").status, 200);
  EXPECT_EQ(Get("/style.css").headers.at("content-type"), "text/css; charset=utf-8");
}

TEST_F(ServePages, FilterAsLsDoes) {
  const std::string bench = StoreSession(1), visit = VisitOf("v-5f3a91c2");
  const auto lists = [this](const std::string& query) { return Get("/sessions?" + query).body; };
  EXPECT_THAT(lists("rig=bench"), HasSubstr(bench));
  EXPECT_THAT(lists("rig=bench"), Not(HasSubstr(visit)));
  EXPECT_THAT(lists("visitor=v-5f3a91c2"), HasSubstr(visit));
  EXPECT_THAT(lists("status=failed"), Not(HasSubstr(bench)));
  EXPECT_THAT(lists("since=2w"), HasSubstr(visit));
  EXPECT_THAT(lists("since=2w"), Not(HasSubstr(bench)));  // of 1970
  EXPECT_THAT(lists("limit=1"), HasSubstr("Show more"));
  EXPECT_EQ(Get("/sessions?status=happy").status, 400);
  EXPECT_EQ(Get("/sessions?since=yesterday").status, 400);
  EXPECT_EQ(Get("/sessions?limit=0").status, 400);
}

TEST_F(ServePages, ASessionSaysWhatWasFoundAndOfWhichVisitItIs) {
  const std::string other = StoreSession(1);
  SessionStore store = OpenStore();
  SessionInfo info = SimulatedVisit();
  info.visit = "evening";
  info.attempt = 2;
  auto writer = store.BeginSession(info);
  ASSERT_TRUE(writer.ok()) << writer.status().message();
  ASSERT_TRUE(writer->Finish(SessionStatus::kDegraded, {"/dev/video0: \"gone\""}, SomeFindings()).ok());
  const std::string id = writer->info().id, page = Get("/sessions/" + id).body;
  EXPECT_THAT(page, HasSubstr("projector 2: step 117: differs by"));
  EXPECT_THAT(page, HasSubstr("2 shots spoilt: lost frame"));
  EXPECT_EQ(page.find("/dev/video0"), page.rfind("/dev/video0"));
  EXPECT_THAT(page, HasSubstr("href=\"/sessions?visit=evening\""));
  const std::string listed = Get("/sessions?visit=evening").body;
  EXPECT_THAT(listed, HasSubstr(id));
  EXPECT_THAT(listed, Not(HasSubstr(other)));
  EXPECT_THAT(Get("/queries/findings?kind=moved").body, HasSubstr("href=\"/sessions/" + id + "\""));
  EXPECT_EQ(Get("/queries/findings?kind=mvoed").status, 400);
}

TEST_F(ServePages, NothingWrites) {
  const std::string id = StoreSession(1);
  for (const char* method : {"POST", "PUT", "DELETE", "PATCH", "OPTIONS"})
    EXPECT_EQ(http::Ask(server_->port(), method, "/sessions/" + id).status, 405) << method;
  EXPECT_EQ(http::Ask(server_->port(), "HEAD", "/sessions/" + id).status, 200);
}

TEST_F(ServePages, HostileTextsAreText) {
  const std::string hostile = "<script>alert(1)</script>\"'&\x1b[31m";
  SessionStore store = OpenStore();
  SessionInfo info = SimulatedVisit();
  info.rig = hostile;
  auto writer = store.BeginSession(info);
  ASSERT_TRUE(writer.ok());
  ASSERT_TRUE(AppendTo(*writer, 0).ok());
  ASSERT_TRUE(writer->Finish(SessionStatus::kDegraded, {hostile}).ok());
  const std::string id = writer->info().id;
  (void)AddFit(id, "f1");
  for (const std::string& place : std::vector<std::string>{
           std::string("/"), std::string("/sessions"), "/sessions/" + id, std::string("/queries/failures"),
           std::string("/queries/rigs"), "/sessions?visitor=" + std::string("%3Cscript%3Ealert(1)"),
           std::string("/queries/rigs?rig=%22%3E%3Cscript%3E"), "/sessions/%3Cscript%3Ealert(1)%3C%2Fscript%3E",
           std::string("/queries/%3Cscript%3E")}) {
    const Answer answer = Get(place);
    EXPECT_THAT(answer.body, Not(HasSubstr("<script"))) << place;
    EXPECT_THAT(answer.body, Not(HasSubstr("\x1b"))) << place;
  }
  EXPECT_THAT(Get("/sessions/" + id).body, HasSubstr("&lt;script&gt;alert(1)&lt;/script&gt;&quot;&#39;&amp;\\x1b[31m"));
}

TEST_F(ServePages, PicturesAreTheFramesReduced) {
  const std::string id = StoreSession(2);
  const Answer picture = Get("/pictures/" + id + "/1");
  ASSERT_EQ(picture.headers.at("content-type"), "image/png");
  const auto file = folder_ / "picture.png";
  WriteText(file, picture.body);
  int bits = 0;
  const auto image = ReadPng(file, &bits);
  ASSERT_TRUE(image.ok()) << image.status().message();
  EXPECT_EQ(image->width(), 3);  // a quad each
  EXPECT_EQ(image->height(), 2);
  const FrameRecord record = RecordFor(1, PixelFormat::kMono12, 6, 4);
  const auto pixels = PixelsFor(record);
  const auto expected = ReducedPicture(record, pixels.view(), 1024);
  for (size_t i = 0; i < image->size(); ++i) EXPECT_EQ(image->data()[i], expected.data()[i]);
  EXPECT_EQ(Get("/thumbnails/" + id).headers.at("content-type"), "image/png");
  EXPECT_THAT(Get("/pictures/" + id + "/7").body, HasSubstr("not here"));
  EXPECT_EQ(Get("/pictures/" + id + "/x").status, 400);
  EXPECT_EQ(Get("/pictures/none/0").status, 404);
}

TEST_F(ServePages, DamageIsSaidWhereItIsAndTheRestIsShown) {
  const std::string id = StoreSession(3), sound = StoreSession(1);
  FlipBits(Segment(id), kSegmentStart + sizeof(FrameHeader) + 5, 0x10);  // of frame 0's payload
  int damaged = 0;
  for (const char* frame : {"0", "1", "2"}) {
    const Answer picture = Get("/pictures/" + id + "/" + frame);
    EXPECT_EQ(picture.status, 200);
    if (picture.body.find("damaged") == std::string::npos) continue;
    ++damaged;
    EXPECT_THAT(Get("/sessions/" + id + "/frames/" + frame).body, HasSubstr("restore sessions/" + id));
  }
  EXPECT_GE(damaged, 1);
  EXPECT_EQ(Get("/sessions/" + id).status, 200);
  std::filesystem::remove(Segment(id));
  EXPECT_EQ(Get("/sessions/" + id + "/frames").status, 200);
  EXPECT_EQ(Get("/pictures/" + id + "/0").headers.at("content-type"), "image/svg+xml");
  EXPECT_EQ(Get("/thumbnails/" + sound).headers.at("content-type"), "image/png");
}

TEST_F(ServePages, AnEncryptedSessionWithoutItsKeySaysSo) {
  const std::string id = VisitOf("v-5f3a91c2", {.encryption = Encryption::kPerSession});
  EXPECT_EQ(Get("/pictures/" + id + "/0").headers.at("content-type"), "image/png");
  std::filesystem::remove(KeyFile(folder_));
  EXPECT_THAT(Get("/pictures/" + id + "/0").body, HasSubstr("no key"));
  EXPECT_THAT(Get("/sessions/" + id + "/frames/0").body, HasSubstr("is encrypted and cannot be read"));
  EXPECT_EQ(Get("/sessions/" + id).status, 200);
}

TEST_F(ServePages, AWithdrawnConsentCoversPicturesAndReports) {
  const std::string id = VisitOf("v-5f3a91c2");
  (void)AddFit(id, "f1");
  const std::string report = "/sessions/" + id + "/fits/f1/files/report/index.html";
  EXPECT_EQ(Get(report).status, 200);
  ASSERT_TRUE(WithdrawConsent(folder_, "v-5f3a91c2").ok());
  EXPECT_THAT(Get("/pictures/" + id + "/0").body, HasSubstr("withheld"));
  EXPECT_THAT(Get("/thumbnails/" + id).body, HasSubstr("withheld"));
  EXPECT_EQ(Get(report).status, 403);
  EXPECT_THAT(Get(report).body, Not(HasSubstr("<h1>report</h1>")));
  EXPECT_THAT(Get("/sessions/" + id).body, HasSubstr("consent was withdrawn on"));
  EXPECT_THAT(Get("/consent").body, HasSubstr("consent withdrawn"));
}

TEST_F(ServePages, AConsentWithoutFittingCoversNoLook) {
  const std::string id = VisitOf("v-5f3a91c2"), agreed = VisitOf("v-77aa0011");
  (void)AddFit(id, "f1");
  // No capture and no fit begins without that scope here: as another program's store may bring it.
  auto index = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(
      index
          ->Execute("UPDATE sessions SET consent_json = json_set(consent_json, '$.scope', json('[\"research\"]'))"
                    " WHERE id = '" +
                    id + "'")
          .ok());
  const Answer picture = Get("/pictures/" + id + "/0");
  EXPECT_EQ(picture.headers.at("content-type"), "image/svg+xml");
  EXPECT_THAT(picture.body, HasSubstr("withheld"));
  EXPECT_THAT(Get("/thumbnails/" + id).body, HasSubstr("withheld"));
  EXPECT_THAT(Get("/sessions/" + id).body, HasSubstr("no consent of the visitor allows viewing them (scope fit)"));
  EXPECT_THAT(Get("/sessions/" + id + "/frames/0").body, HasSubstr("pictures are not shown"));
  EXPECT_THAT(Get("/sessions/" + id + "/frames/0").body, Not(HasSubstr("<img")));
  EXPECT_THAT(Get("/sessions/" + id + "/fits/f1").body, Not(HasSubstr("position.exr")));
  const Answer report = Get("/sessions/" + id + "/fits/f1/files/report/index.html");
  EXPECT_EQ(report.status, 403);
  EXPECT_THAT(report.body, Not(HasSubstr("<h1>report</h1>")));
  EXPECT_TRUE(ListAccess(folder_, id)->empty()) << "nobody looked";
  EXPECT_EQ(Get("/pictures/" + agreed + "/0").headers.at("content-type"), "image/png") << "of another visitor";
}

TEST_F(ServePages, ALookThatCannotBeLoggedIsRefused) {
  const std::string id = VisitOf("v-5f3a91c2");
  (void)AddFit(id, "f1");
  auto index = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(index
                  ->Execute("CREATE TRIGGER full BEFORE INSERT ON access_log BEGIN"
                            " SELECT raise(ABORT, 'the log takes no row'); END")
                  .ok());
  const std::string report = "/sessions/" + id + "/fits/f1/files/report/index.html";
  for (const std::string& place : {"/pictures/" + id + "/0", "/thumbnails/" + id, report}) {
    const Answer refused = Get(place);
    EXPECT_GE(refused.status, 400) << place;
    EXPECT_EQ(refused.headers.at("content-type"), "text/html; charset=utf-8") << place;
    EXPECT_THAT(refused.body, HasSubstr("what leaves the store is logged first")) << place;
    EXPECT_THAT(refused.body, Not(AnyOf(HasSubstr("PNG"), HasSubstr("<h1>report</h1>")))) << place;
  }
  EXPECT_EQ(Get("/sessions/" + id).status, 200) << "figures need no entry";
  ASSERT_TRUE(index->Execute("DROP TRIGGER full").ok());
  EXPECT_EQ(Get(report).status, 200) << "what was refused counts as no look";
  EXPECT_EQ(Get("/pictures/" + id + "/0").headers.at("content-type"), "image/png");
  EXPECT_EQ(ListAccess(folder_, id)->size(), 2U);
}

TEST_F(ServePages, AForgottenSessionIsGoneAndAPageNeverHoldsUpAForget) {
  const std::string id = VisitOf("v-5f3a91c2");
  (void)AddFit(id, "f1");
  EXPECT_EQ(Get("/pictures/" + id + "/0").status, 200);
  Logger quiet(LogLevel::kError);
  const auto report =
      Forget(folder_, {.sessions = {id}, .visitors = {}, .reason = ForgetReason::kForget, .after_step = {}}, quiet);
  ASSERT_TRUE(report.ok()) << report.status().message();
  EXPECT_TRUE(report->leftovers.empty());
  for (const std::string& place :
       std::vector<std::string>{"/sessions/" + id, "/sessions/" + id + "/frames", "/pictures/" + id + "/0",
                                "/sessions/" + id + "/fits/f1", "/sessions/" + id + "/fits/f1/files/report/index.html"})
    EXPECT_EQ(Get(place).status, 404) << place;
  EXPECT_THAT(Get("/sessions/" + id).body, HasSubstr("was forgotten"));
  EXPECT_THAT(Get("/deletions").body, HasSubstr(id));
}

TEST_F(ServePages, LooksAreLoggedBeforeTheyAreAnswered) {
  const std::string id = StoreSession(3), other = StoreSession(1);
  (void)AddFit(id, "f1");
  const auto logged = [this](const std::string& session) { return ListAccess(folder_, session)->size(); };
  EXPECT_EQ(Get("/sessions/" + id).status, 200);
  EXPECT_EQ(logged(id), 0U);  // lists and proofs are none
  for (int i = 0; i < 3; ++i) EXPECT_EQ(Get("/pictures/" + id + "/" + std::to_string(i)).status, 200);
  ASSERT_EQ(logged(id), 1U);
  const auto entry = ListAccess(folder_, id)->front();
  EXPECT_EQ(entry.action, "serve");
  EXPECT_EQ(entry.detail, "pictures, to 127.0.0.1");
  EXPECT_EQ(Get("/sessions/" + id + "/fits/f1/files/report/index.html").status, 200);
  EXPECT_EQ(ListAccess(folder_, id)->back().detail, "fit f1, to 127.0.0.1");
  EXPECT_EQ(logged(other), 0U);
  Restart();
  EXPECT_EQ(Get("/pictures/" + id + "/0").status, 200);
  EXPECT_EQ(logged(id), 3U);
}

TEST_F(ServePages, FilesOfAFitStayInTheirFolder) {
  const std::string id = StoreSession(1);
  const auto fit = AddFit(id, "f1");
  WriteText(folder_ / "secret.txt", "secret");
  std::filesystem::create_symlink(folder_ / "secret.txt", fit / "link.txt");
  std::filesystem::create_symlink(folder_, fit / "up");
  std::filesystem::create_directories(fit.parent_path() / "unregistered");
  WriteText(fit.parent_path() / "unregistered" / "a.txt", "secret");
  std::filesystem::create_directory_symlink(fit, fit.parent_path() / "linked");
  const std::string place = "/sessions/" + id + "/fits/";
  const Answer report = Get(place + "f1/files/report/index.html");
  EXPECT_EQ(report.headers.at("content-type"), "text/html; charset=utf-8");
  EXPECT_THAT(report.headers.at("content-security-policy"), HasSubstr("sandbox allow-scripts; default-src 'none'"));
  EXPECT_THAT(report.headers.at("content-security-policy"), Not(HasSubstr("allow-same-origin")));
  const Answer map = Get(place + "f1/files/position.exr");
  EXPECT_EQ(map.headers.at("content-type"), "application/octet-stream");
  EXPECT_EQ(map.headers.at("content-disposition"), "attachment");
  for (const char* name : {"f1/files/link.txt", "f1/files/up/secret.txt", "f1/files/up/index.sqlite", "f1/files/report",
                           "f1/files/none", "unregistered/files/a.txt", "linked/files/position.exr"})
    EXPECT_EQ(Get(place + name).status, 404) << name;
  for (const char* name : {"f1/files/../../../../secret.txt", "f1/files/..%2f..%2fsecret.txt", "%2e%2e/files/a"})
    EXPECT_THAT(Get(place + name).status, AnyOf(400, 404)) << name;
  EXPECT_THAT(Get(place + "f1").body, Not(HasSubstr("link.txt")));
}

TEST_F(ServePages, NeverMigrateAndSayWhatToDo) {
  StoreSession(1);
  const auto index = folder_ / "index.sqlite";
  ASSERT_EQ(Shell("sqlite3 " + index.string() +
                  " 'PRAGMA user_version = 4' 2>/dev/null || python3 -c \"import sqlite3;"
                  " c = sqlite3.connect('" +
                  index.string() + "'); c.execute('PRAGMA user_version = 4'); c.close()\"")
                .code,
            0);
  for (const char* place : {"/", "/sessions", "/consent", "/deletions", "/queries/rigs"})
    EXPECT_THAT(Get(place).body, HasSubstr("has schema 4")) << place;
  EXPECT_FALSE(std::filesystem::exists(folder_ / "index-before-5.sqlite"));
}

// The program itself: what it prints, how it ends.
class ServeCommand : public StoreTest {
 protected:
  // Its first bytes of stdout, once there is a whole line of JSON; the program runs on.
  nlohmann::json Start(std::vector<std::string> more = {}) {
    int ends[2];
    EXPECT_EQ(pipe2(ends, O_CLOEXEC), 0);
    std::vector<std::string> words = {
        std::string(STRATALUX_BIN_DIR) + "/stratalux-db", "serve", "--store", folder_.string(), "--json", "--no-open"};
    words.insert(words.end(), more.begin(), more.end());
    pid_ = fork();
    if (pid_ == 0) {
      dup2(ends[1], 1);
      std::signal(SIGHUP, hang_up_);
      std::vector<char*> arguments;
      for (std::string& word : words) arguments.push_back(word.data());
      arguments.push_back(nullptr);
      alarm(60);
      execv(arguments[0], arguments.data());
      _exit(127);
    }
    close(ends[1]);
    std::string text;
    char c = 0;
    while (text.find("\n}\n") == std::string::npos && read(ends[0], &c, 1) == 1) text += c;
    close(ends[0]);
    return nlohmann::json::parse(text, nullptr, false);
  }
  // On a terminal with a desktop, whose browser has been given a page: `desktop` holds its `page` and `arguments`, and
  // `runtime` is where the program may write. The terminal's other end; -1: no page came.
  [[nodiscard]] int StartOnTerminal(const std::filesystem::path& desktop, const std::filesystem::path& runtime) {
    std::filesystem::create_directories(runtime);
    WriteText(desktop / "xdg-open", "#!/bin/sh\nset -e\nprintf '%s' \"$*\" > '" + (desktop / "arguments").string() +
                                        "'\ncp -p \"$1\" '" + (desktop / "page.part").string() + "'\nmv '" +
                                        (desktop / "page.part").string() + "' '" + (desktop / "page").string() + "'\n");
    std::filesystem::permissions(desktop / "xdg-open", std::filesystem::perms::owner_all);
    int terminal = -1;
    pid_ = forkpty(&terminal, nullptr, nullptr, nullptr);
    if (pid_ == 0) {
      std::signal(SIGHUP, SIG_DFL);  // the tests may run under nohup
      setenv("PATH", (desktop.string() + ":" + std::getenv("PATH")).c_str(), 1);
      setenv("XDG_RUNTIME_DIR", runtime.c_str(), 1);
      setenv("DISPLAY", ":77", 1);
      alarm(60);
      const std::string program = std::string(STRATALUX_BIN_DIR) + "/stratalux-db", store = folder_.string();
      execl(program.c_str(), program.c_str(), "serve", "--store", store.c_str(), static_cast<char*>(nullptr));
      _exit(127);
    }
    for (int tries = 0; pid_ > 0 && tries < 3000 && !std::filesystem::exists(desktop / "page"); ++tries) usleep(10'000);
    return std::filesystem::exists(desktop / "page") ? terminal : -1;
  }
  int End(int signal) {
    kill(pid_, signal);
    return Wait();
  }
  [[nodiscard]] int Wait() const {
    int status = 0;
    waitpid(pid_, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  [[nodiscard]] Outcome Serve(const std::string& arguments) const {
    return Execute("stratalux-db serve --no-open --store " + folder_.string() + " " + arguments);
  }
  pid_t pid_ = -1;
  void (*hang_up_)(int) = SIG_DFL;  // SIG_IGN: under nohup
};

TEST_F(ServeCommand, ItsLinkOpensItOnceAndASignalEndsIt) {
  const std::string id = StoreSession(1);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP}) {
    const auto told = Start();
    ASSERT_TRUE(told.is_object());
    const int port = told["port"];
    const std::string url = told["url"];
    const std::string base = "http://127.0.0.1:" + std::to_string(port);
    ASSERT_EQ(url.substr(0, base.size()), base);
    EXPECT_EQ(http::Get(port, "/sessions").status, 401);
    const Answer entered = http::Get(port, url.substr(base.size()));
    EXPECT_EQ(entered.status, 303);
    const std::string cookie = entered.headers.at("set-cookie");
    EXPECT_THAT(http::Get(port, "/sessions", {{"Cookie", cookie.substr(0, cookie.find(';'))}}).body, HasSubstr(id));
    EXPECT_EQ(http::Get(port, url.substr(base.size())).status, 401);
    EXPECT_EQ(http::Get(port, "/sessions", {{"Host", "evil.example"}}).status, 421);
    EXPECT_EQ(End(signal), 0);
  }
}

// What a program is started with, everybody on the machine may read: the browser gets a page that its owner alone can.
TEST_F(ServeCommand, TheBrowserIsGivenThePageOfAnOwnerAndNotTheLink) {
  (void)StoreSession(1);
  const std::filesystem::path fake = folder_ / "desktop", runtime = fake / "runtime";
  const int terminal = StartOnTerminal(fake, runtime);
  ASSERT_GE(terminal, 0);
  const std::string arguments = *ReadFile(fake / "arguments"), page = *ReadFile(fake / "page");
  EXPECT_THAT(arguments, Not(HasSubstr("token")));
  EXPECT_TRUE(std::filesystem::path(arguments).parent_path() == runtime) << arguments;
  EXPECT_EQ(std::filesystem::status(arguments).permissions(),
            std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  const size_t link = page.find("url=http://127.0.0.1:");
  ASSERT_NE(link, std::string::npos) << page;
  const std::string url = page.substr(link + 4, page.find('"', link) - link - 4);
  const std::string rest = url.substr(std::string("http://127.0.0.1:").size());
  EXPECT_EQ(http::Get(std::stoi(rest), rest.substr(rest.find('/'))).status, 303);
  EXPECT_EQ(End(SIGTERM), 0);
  EXPECT_TRUE(std::filesystem::is_empty(runtime)) << "the page outlives the program";
  close(terminal);
}

// The token must stay in no address: not in the browser's history, not in what is copied and passed on.
TEST_F(ServeCommand, ALinkToAPageLeadsThereWithoutItsToken) {
  const std::string id = StoreSession(1), token = "0123456789abcdef0123456789";
  WriteText(folder_ / "token", token + "\n");
  std::filesystem::permissions(folder_ / "token", std::filesystem::perms(0600));
  const auto told = Start({"--token-file", (folder_ / "token").string()});
  ASSERT_TRUE(told.is_object());
  const int port = told["port"];
  const Answer led = http::Get(port, "/sessions?rig=bench&token=" + token + "&status=complete");
  ASSERT_EQ(led.status, 303);
  const std::string place = led.headers.at("location");
  EXPECT_EQ(place, "/sessions?rig=bench&status=complete");
  EXPECT_THAT(led.body, Not(HasSubstr(id)));
  const std::string cookie = led.headers.at("set-cookie");
  EXPECT_THAT(cookie, Not(HasSubstr(token)));
  EXPECT_THAT(cookie, HasSubstr("HttpOnly; SameSite=Strict"));
  const Answer there = http::Get(port, place, {{"Cookie", cookie.substr(0, cookie.find(';'))}});
  EXPECT_EQ(there.status, 200);
  EXPECT_THAT(there.body, HasSubstr(id));
  EXPECT_EQ(http::Get(port, place).status, 401) << "the place alone opens nothing";
  for (const std::string target : {"//evil.example/?token=", "/%2fevil.example/?token=", "/\\evil.example?token="})
    EXPECT_EQ(http::Get(port, target + token).status, 400) << target << " leads to another server";
  EXPECT_EQ(End(SIGTERM), 0);
}

TEST_F(ServeCommand, TheTokenOfAFileIsNotRepeated) {
  const std::string token = "0123456789abcdef0123456789";
  WriteText(folder_ / "token", token + "\n");
  std::filesystem::permissions(folder_ / "token", std::filesystem::perms(0600));
  const auto told = Start({"--token-file", (folder_ / "token").string()});
  ASSERT_TRUE(told.is_object());
  EXPECT_THAT(told.dump(), Not(HasSubstr(token)));
  EXPECT_EQ(http::Get(told["port"], "/", {{"Authorization", "Bearer " + token}}).status, 200);
  // A second one on its port says so.
  const Outcome second = Serve("--port " + std::to_string(told["port"].get<int>()));
  EXPECT_EQ(second.code, 5);
  EXPECT_THAT(second.out, HasSubstr("another program listens there"));
  EXPECT_EQ(End(SIGTERM), 0);
}

TEST_F(ServeCommand, WrongUseIsRefused) {
  const Outcome open = Serve("--address 0.0.0.0");
  EXPECT_EQ(open.code, 2);
  EXPECT_THAT(open.out, HasSubstr("give --token-file FILE"));
  EXPECT_EQ(Serve("--token-file /none").code, 2);
  EXPECT_EQ(Serve("--port 70000").code, 2);
  EXPECT_EQ(Serve("--address 127.0.0.x --token-file /none").code, 2);
  EXPECT_EQ(Execute("stratalux-db serve --no-open --store " + (folder_ / "none").string()).code, 4);
}

TEST_F(ServeCommand, AClosedTerminalEndsItAndItsPage) {
  (void)StoreSession(1);
  const std::filesystem::path fake = folder_ / "desktop", runtime = fake / "runtime";
  const int terminal = StartOnTerminal(fake, runtime);
  ASSERT_GE(terminal, 0);
  EXPECT_FALSE(std::filesystem::is_empty(runtime));
  close(terminal);
  EXPECT_EQ(Wait(), 0);
  EXPECT_TRUE(std::filesystem::is_empty(runtime)) << "the page outlives the program";
}

TEST_F(ServeCommand, UnderNohupAHangUpDoesNotEndIt) {
  (void)StoreSession(1);
  hang_up_ = SIG_IGN;
  const auto told = Start();
  ASSERT_TRUE(told.is_object());
  kill(pid_, SIGHUP);
  usleep(200'000);
  EXPECT_EQ(http::Get(told["port"], "/sessions").status, 401) << "it goes on";
  EXPECT_EQ(End(SIGTERM), 0);
}

TEST_F(ServePages, AFrameNumberThatNoNumberHoldsIsRefused) {
  const std::string id = StoreSession(1);
  for (const std::string number : {"9223372036854775808", "99999999999999999999999", "-1", "0x1", "1a"}) {
    EXPECT_EQ(Get("/sessions/" + id + "/frames/" + number).status, 400) << number;
    EXPECT_EQ(Get("/pictures/" + id + "/" + number).status, 400) << number;
    EXPECT_EQ(Get("/sessions/" + id + "/frames?from=" + number).status, 400) << number;
  }
  EXPECT_EQ(Get("/sessions/" + id + "/frames/9223372036854775807").status, 404);
}

// Killed between the ledger's entry and the index, or brought by a pull.
TEST_F(ServePages, AWithdrawalThatStandsInTheLedgerAloneCoversPicturesToo) {
  const std::string id = VisitOf("v-5f3a91c2");
  EXPECT_EQ(Get("/pictures/" + id + "/0").headers.at("content-type"), "image/png");
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kWithdrawal, WallNow(), {id}, "", ""}).ok());
  EXPECT_THAT(Get("/pictures/" + id + "/0").body, HasSubstr("withheld"));
  EXPECT_THAT(Get("/sessions/" + id).body, HasSubstr("consent was withdrawn on"));
}

}  // namespace
}  // namespace stratalux::db
