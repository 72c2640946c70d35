// SPDX-License-Identifier: Apache-2.0
// Visits with traces of their own, and the proof in raw bytes that none is left.
#pragma once

#include <algorithm>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "db/apps/extract.h"
#include "db/base/sqlite.h"
#include "db/care/verify.h"
#include "db/catalogue/consent.h"
#include "db/catalogue/fit_reader.h"
#include "db/keys/key_store.h"
#include "db/ledger/ledger.h"
#include "db/privacy/forget.h"
#include "db/segment/segment.h"
#include "tests/db/privacy/raw_bytes.h"
#include "tests/db/store_fixture.h"

namespace stratalux::db {

inline constexpr const char* kVisitor = "v-5f3a91c2";
inline constexpr const char* kOther = "v-77e0b3d4";

// Bytes that give a session away.
struct Traces {
  std::string id, key_id, key;
  std::vector<std::string> hashes;  // first 8 bytes
};

class ForgetTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    for (const char* visitor : {kVisitor, kOther})
      ASSERT_TRUE(GiveConsent(folder_, visitor, {"2026-03", "de", true, true, false, {}}).ok());
  }
  void TearDown() override {
    StoreTest::TearDown();
    std::filesystem::remove_all(exports_);
  }

  // Forgets in a process of its own, which `after_step` may end: its exit status, 0 where it finished, -1 where
  // something else ended it.
  [[nodiscard]] int ForgetApart(const std::string& session, const std::function<void(ForgetStep)>& after_step) const {
    const pid_t child = fork();
    if (child == 0) {
      Logger quiet(LogLevel::kError);
      ForgetRequest request;
      request.sessions = {session};
      request.after_step = after_step;
      _exit(Forget(folder_, request, quiet).ok() ? 0 : 1);
    }
    int status = 0;
    if (child < 0 || waitpid(child, &status, 0) != child) return -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }

  // A session with pixels of its own, a fit with files, and an export outside the store.
  std::string Visit(const std::string& visitor, int seed, Encryption encryption) {
    SessionStore store = OpenStore();
    SessionInfo info;
    info.visitor = visitor;
    auto writer = store.BeginSession(info, {.max_segment_bytes = 1500, .encryption = encryption});
    EXPECT_TRUE(writer.ok()) << writer.status().message();
    for (int i = 0; i < 6; ++i) EXPECT_TRUE(AppendTo(*writer, 100 * seed + i).ok());
    const Image<float> map(4, 4, 1, static_cast<float>(seed) + 0.25F);
    EXPECT_TRUE(writer->AppendTruth("depth", map.view()).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kComplete).ok());
    const std::string id = writer->info().id;
    for (const std::filesystem::path& folder : {store.FitFolder(id, "f1") / "report", exports_})
      std::filesystem::create_directories(folder);
    const std::filesystem::path page = store.FitFolder(id, "f1") / "report" / "index.html",
                                plain = exports_ / "page.html";
    WriteText(plain, "<h1>" + id + " " + visitor + "</h1>");
    auto seal = FindSeal(store, id);
    EXPECT_TRUE(seal.ok());
    if (seal->active())
      EXPECT_TRUE(seal->Seal(plain, "fits/f1/report/index.html", page).ok());
    else
      std::filesystem::copy_file(plain, page);
    std::filesystem::remove(plain);
    EXPECT_TRUE(store.RegisterFit({"f1", id, "{}", R"({"session": ")" + id + R"("})", {5}}).ok());
    Logger quiet(LogLevel::kError);
    EXPECT_TRUE(ExtractFrames(store, id, *store.ListFrames(id), exports_ / id, quiet).ok());
    return id;
  }
  [[nodiscard]] Traces TracesOf(const std::string& id) const {
    Traces traces{id, {}, {}, {}};
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    for (int n = 1; std::filesystem::exists(Segment(id, n)); ++n) {
      bool sealed = false;
      const auto reader = SegmentReader::Open(Segment(id, n));
      const auto frames = reader->Walk(true, &sealed);
      for (const SegmentFrame& f : *frames) {
        traces.hashes.emplace_back(reinterpret_cast<const char*>(f.header.payload_hash), 8);
        traces.key_id.assign(reinterpret_cast<const char*>(f.header.key_id), 16);
      }
    }
    if (traces.key_id == std::string(16, '\0')) {
      traces.key_id.clear();
      return traces;
    }
    KeyId key_id{};
    std::copy(traces.key_id.begin(), traces.key_id.end(), key_id.begin());
    const auto key = FindKey(folder_, key_id);
    traces.key.assign(key->key->bytes.begin(), key->key->bytes.end());
    return traces;
  }
  Result<ForgetReport> ForgetNow(const std::vector<std::string>& sessions) const {
    Logger quiet(LogLevel::kError);
    ForgetRequest request;
    request.sessions = sessions;
    return Forget(folder_, request, quiet);
  }
  [[nodiscard]] nlohmann::json CertificateOf(const std::string& id) const {
    const auto ledger = Ledger::Read(folder_);
    EXPECT_TRUE(ledger.ok() && ledger->IsForgotten(id));
    return nlohmann::json::parse(ledger->forgotten().at(id));
  }
  // Nothing but the id where it must be: the ledger, and in the index the tombstone and the access log.
  void ExpectGone(const Traces& traces, const std::string& visitor) const {
    int64_t rows = 0;
    {
      auto connection = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadOnly);
      // Each access_log row in table and index and once in its folder's name; the tombstone in table and key, its
      // certificate once, and once for the export it names.
      rows =
          *connection->QueryInteger("SELECT 3 * count(*) FROM access_log WHERE session_id = '" + traces.id + "'") + 4;
      EXPECT_EQ(*connection->QueryInteger("SELECT count(*) FROM sessions WHERE id = '" + traces.id + "'"), 0);
    }
    const RawFiles raw = ReadRaw(folder_);
    for (const std::string& hash : traces.hashes)
      EXPECT_THAT(FilesWith(raw, hash), ::testing::IsEmpty()) << "payload hash";
    if (!traces.key.empty()) {
      EXPECT_THAT(FilesWith(raw, traces.key_id), ::testing::IsEmpty()) << "key id";
      EXPECT_THAT(FilesWith(raw, traces.key), ::testing::IsEmpty()) << "key";
    }
    EXPECT_THAT(FilesWith(raw, visitor), ::testing::IsEmpty()) << "pseudonym";
    std::map<std::string, int> expected = {{"ledger/" + *StoreId(folder_) + ".jsonl", 1}};
    auto found = FilesWith(raw, traces.id);
    EXPECT_LE(found["index.sqlite"], rows);
    found.erase("index.sqlite");
    for (auto& [file, count] : found) count = 1;
    EXPECT_EQ(found, expected);
    for (const auto& [file, bytes] : raw) EXPECT_THAT(file, ::testing::Not(::testing::HasSubstr(".forgetting")));
  }
  void ExpectUnharmed(const std::string& id, int seed) const {
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    EXPECT_THAT(VerifySession(store, *store.FindSession(id))->problems, ::testing::IsEmpty());
    const auto rows = store.ListFrames(id);
    ASSERT_EQ(rows->size(), 6U);
    for (const FrameRow& row : *rows) {
      EXPECT_EQ(row.record.step / 100, seed);
      EXPECT_TRUE(store.ReadFrame(id, row).ok());
    }
    EXPECT_EQ(store.ListFits(id)->size(), 1U);
  }

  std::filesystem::path exports_ = TemporaryFolder() / ("stratalux-exports-" + std::to_string(getpid()));
};

}  // namespace stratalux::db
