// SPDX-License-Identifier: Apache-2.0
// Reports of encrypted visits over loopback.
#include <gmock/gmock.h>

#include "db/apps/serve/site.h"
#include "db/catalogue/fit_reader.h"
#include "db/keys/key_store.h"
#include "shared/http/server.h"
#include "tests/db/store_fixture.h"
#include "tests/shared/http/http_client.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class ServeSealed : public StoreTest {};

// Out of memory: the store holds nothing plain before or after.
TEST_F(ServeSealed, ASealedReportIsShownWhereTheKeyIs) {
  const std::string id = StoreSession(1, {.encryption = Encryption::kPerSession});
  Logger logger;
  Site site(folder_, logger);
  auto server = http::Server::Start({}, RoutesOf(site), logger);
  ASSERT_TRUE(server.ok()) << server.status().message();
  const auto get = [&](const std::string& target) { return http::Get(server->port(), target); };
  const auto fit = OpenStore().FitFolder(id, "f1"), plain = folder_ / "plain.html";
  const std::string html = "<h1>a face</h1>", files = "/sessions/" + id + "/fits/f1/files/";
  std::filesystem::create_directories(fit / "report");
  WriteText(plain, html);
  auto seal = FindSeal(OpenStore(AccessMode::kReadOnly), id);
  ASSERT_TRUE(seal.ok());
  ASSERT_TRUE(seal->Seal(plain, "fits/f1/report/index.html", fit / "report" / "index.html").ok());
  ASSERT_TRUE(seal->Seal(plain, "fits/f1/report/index.html", fit / "report" / "moved.html").ok());
  WriteText(fit / "report" / "older.html", html);
  WriteText(fit / "metrics.json", R"({"fit": {"divergence": 0.5}})");
  ASSERT_TRUE(OpenStore().RegisterFit({"f1", id, "{}", R"({"fit": {"divergence": 0.5}})", {5}}).ok());

  const http::Answer report = get(files + "report/index.html");
  EXPECT_EQ(report.status, 200);
  EXPECT_EQ(report.body, html);
  EXPECT_THAT(report.headers.at("content-type"), HasSubstr("text/html"));
  for (const char* name : {"report/moved.html", "report/older.html"}) {
    EXPECT_NE(get(files + name).status, 200) << name;
    EXPECT_THAT(get(files + name).body, Not(HasSubstr("a face"))) << name;
  }
  std::filesystem::remove(KeyFile(folder_));
  EXPECT_THAT(get(files + "report/index.html").body, HasSubstr("is encrypted and cannot be read"));
  EXPECT_EQ(get(files + "metrics.json").status, 200);
  EXPECT_THAT(get("/sessions/" + id + "/fits/f1").body, HasSubstr("fit.divergence"));
}

}  // namespace
}  // namespace stratalux::db
