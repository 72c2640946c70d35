// SPDX-License-Identifier: Apache-2.0
// Keys for a task that asks: those of its share and no others, readable by the process that asked alone.
#include "fitter/batch/key_exchange.h"

#include <algorithm>
#include <cstring>
#include <future>
#include <set>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include "db/base/file_lock.h"
#include "db/keys/reader_key.h"
#include "db/keys/sealed_key.h"
#include "db/privacy/access_log.h"
#include "fitter/batch/shard_keys.h"
#include "fitter/batch/shard_manifest.h"
#include "shared/base/unique_fd.h"
#include "tests/db/store_fixture.h"
#include "tests/support/text_file.h"

namespace stratalux::fit {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr milliseconds kLong{20'000}, kLook{5};

class KeyExchange : public db::StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    results_ = folder_.string() + ".results";
    for (int i = 0; i < 4; ++i) {
      const std::string session = StoreSession(1, {.encryption = db::Encryption::kPerSession});
      plan_.visits.push_back({session, "fit" + std::to_string(i), 1000, {}});
    }
    ASSERT_TRUE(WritePlan(results_, plan_).ok());
    plan_ = *ReadPlan(results_);
  }
  void TearDown() override {
    fs::remove_all(results_);
    StoreTest::TearDown();
  }
  [[nodiscard]] Result<std::vector<db::SessionKey>> Ask(const Shard& shard, milliseconds wait = kLong,
                                                        int stop = -1) const {
    Logger quiet(LogLevel::kError);
    return AskForKeys(results_, plan_, shard, wait, kLook, stop, quiet);
  }
  // Another thread asks as another machine would.
  [[nodiscard]] std::future<Result<std::vector<db::SessionKey>>> Asked(const Shard& shard) const {
    const size_t before = AskFiles().size();
    auto asked = std::async(std::launch::async, [this, shard] { return Ask(shard); });
    while (AskFiles().size() == before && asked.wait_for(kLook) != std::future_status::ready) {
    }
    return asked;
  }
  [[nodiscard]] std::vector<fs::path> AskFiles() const {
    std::vector<fs::path> files;
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(results_ / "keys", error))
      if (entry.path().extension() == ".json") files.push_back(entry.path());
    return files;
  }
  // An ask by `reader` as a task writes one.
  fs::path AskBy(const db::ReaderKey& reader, nlohmann::json changed = nlohmann::json::object()) const {
    nlohmann::json ask = {
        {"schema", 1}, {"plan", plan_.id}, {"shard", "1/2"}, {"reader", db::ToText(reader.public_key())}};
    ask.update(changed);
    fs::create_directories(results_ / "keys");
    fs::permissions(results_ / "keys", fs::perms::owner_all);
    const fs::path file = results_ / "keys" / ("ask-" + db::ToHex(db::IdOf(reader.public_key())) + ".json");
    WriteText(file, ask.dump());
    fs::permissions(file, fs::perms::owner_read | fs::perms::owner_write);
    return file;
  }
  [[nodiscard]] std::vector<std::string> ProblemsOfALook() const {
    const KeyAnswers look = AnswerAsks(folder_, results_, plan_);
    EXPECT_EQ(look.answered, 0);
    return look.problems.empty() ? std::vector<std::string>{""} : look.problems;
  }
  // Files of the results that hold the key's very bytes.
  [[nodiscard]] std::vector<fs::path> FilesWith(const db::SessionKey& key) const {
    std::vector<fs::path> found;
    for (const auto& entry : fs::recursive_directory_iterator(results_)) {
      if (!entry.is_regular_file()) continue;
      const auto bytes = db::ReadBytes(entry.path());
      if (std::search(bytes.begin(), bytes.end(), key.key->bytes.begin(), key.key->bytes.end()) != bytes.end())
        found.push_back(entry.path());
    }
    return found;
  }

  fs::path results_;
  ShardPlan plan_;
};

TEST_F(KeyExchange, GivesEachShardItsOwnKeysAndLeavesNothing) {
  std::set<db::KeyId> all;
  for (const Shard shard : {Shard{1, 2}, Shard{2, 2}}) {
    auto asked = Asked(shard);
    const KeyAnswers look = AnswerAsks(folder_, results_, plan_);
    EXPECT_EQ(look.answered, 1);
    EXPECT_EQ(look.keys, 2U);
    EXPECT_THAT(look.problems, IsEmpty());
    const auto keys = asked.get();
    ASSERT_TRUE(keys.ok()) << keys.status().message();
    const auto own = KeysOf(folder_, plan_, shard);
    ASSERT_EQ(keys->size(), own->keys.size());
    for (size_t i = 0; i < keys->size(); ++i) {
      EXPECT_EQ((*keys)[i].id, own->keys[i].id);
      EXPECT_EQ((*keys)[i].key->bytes, own->keys[i].key->bytes);
      all.insert((*keys)[i].id);
    }
    EXPECT_THAT(fs::directory_iterator(results_ / "keys"), testing::Eq(fs::directory_iterator())) << "nothing is left";
  }
  EXPECT_THAT(all, SizeIs(4));
}

TEST_F(KeyExchange, WhatLiesInTheFolderHoldsNoKeyAndEachIsLoggedBefore) {
  const db::ReaderKey reader = db::ReaderKey::Passing();
  AskBy(reader);
  ASSERT_EQ(AnswerAsks(folder_, results_, plan_).keys, 2U);
  const auto own = KeysOf(folder_, plan_, {1, 2});
  for (const db::SessionKey& key : own->keys) EXPECT_THAT(FilesWith(key), IsEmpty());
  const std::string asked_as = db::ToHex(db::IdOf(reader.public_key()));
  for (const std::string& session : own->sessions) {
    const auto log = db::ListAccess(folder_, session);
    ASSERT_TRUE(log.ok() && log->size() == 1U);
    EXPECT_EQ(log->front().action, "batch keys");
    EXPECT_THAT(log->front().detail, HasSubstr(asked_as));
  }
  // Answered once: a killed task's ask is no work for ever.
  EXPECT_EQ(AnswerAsks(folder_, results_, plan_).answered, 0);
}

TEST_F(KeyExchange, AnotherTasksAnswerOpensForNobodyElse) {
  const db::ReaderKey first = db::ReaderKey::Passing();
  AskBy(first);
  ASSERT_EQ(AnswerAsks(folder_, results_, plan_).answered, 1);
  auto asked = Asked({1, 2});
  // Somebody hands it what was sealed to the first.
  const fs::path theirs = results_ / "keys" / db::ToHex(db::IdOf(first.public_key()));
  fs::path file;
  for (const fs::path& ask : AskFiles())
    if (ask.string().find(db::ToHex(db::IdOf(first.public_key()))) == std::string::npos) file = ask;
  const std::string hex = file.stem().string().substr(std::strlen("ask-"));
  const fs::path mine = results_ / "keys" / hex;
  fs::copy(theirs, mine.string() + ".new", fs::copy_options::recursive);
  for (const auto& session : fs::directory_iterator(mine.string() + ".new"))
    if (session.is_directory())
      fs::rename(session.path() / ("key-" + theirs.filename().string() + ".sealed"),
                 session.path() / ("key-" + hex + ".sealed"));
  fs::rename(mine.string() + ".new", mine);
  const auto keys = asked.get();
  ASSERT_TRUE(keys.ok()) << keys.status().message();
  EXPECT_THAT(*keys, IsEmpty()) << "each is named, and what the share has besides is fitted";
}

TEST_F(KeyExchange, OfAnAnswerWithADamagedKeyTheOthersAreTaken) {
  auto asked = Asked({1, 2});
  const std::string hex = AskFiles().front().stem().string().substr(std::strlen("ask-"));
  const auto own = KeysOf(folder_, plan_, {1, 2});
  // As an answerer writes it, and one of the two is cut.
  const fs::path answer = results_ / "keys" / hex;
  const db::ReaderPublicKey reader =
      *db::ParseReaderPublicKey(nlohmann::json::parse(ReadText(AskFiles().front())).at("reader").get<std::string>());
  for (size_t i = 0; i < 2; ++i) {
    fs::create_directories(answer / own->sessions[i]);
    ASSERT_TRUE(db::WriteSealedKey(answer / own->sessions[i], own->sessions[i], own->keys[i], reader).ok());
  }
  const fs::path cut = db::SealedKeyFile(answer / own->sessions[0], db::IdOf(reader));
  fs::resize_file(cut, fs::file_size(cut) / 2);
  WriteText(results_ / "answer",
            nlohmann::json({{"schema", 1}, {"sessions", own->sessions}, {"missing", nlohmann::json::array()}}).dump());
  fs::rename(results_ / "answer", answer / "answer.json");
  const auto keys = asked.get();
  ASSERT_TRUE(keys.ok()) << keys.status().message();
  ASSERT_THAT(*keys, SizeIs(1));
  EXPECT_EQ(keys->front().id, own->keys[1].id);
}

TEST_F(KeyExchange, OneAskThatCannotBeAnsweredKeepsNobodyElseWaiting) {
  // Nothing can be sealed to a point of low order.
  const std::string low = "x25519-" + std::string(64, '0');
  const std::string hex = db::ToHex(db::IdOf(*db::ParseReaderPublicKey(low)));
  fs::create_directories(results_ / "keys");
  fs::permissions(results_ / "keys", fs::perms::owner_all);
  const fs::path file = results_ / "keys" / ("ask-" + hex + ".json");
  WriteText(file, nlohmann::json({{"schema", 1}, {"plan", plan_.id}, {"shard", "1/2"}, {"reader", low}}).dump());
  fs::permissions(file, fs::perms::owner_read | fs::perms::owner_write);
  auto asked = Asked({2, 2});
  const KeyAnswers look = AnswerAsks(folder_, results_, plan_);
  EXPECT_EQ(look.answered, 1);
  EXPECT_THAT(look.problems, SizeIs(1));
  EXPECT_THAT(*asked.get(), SizeIs(2));
  EXPECT_FALSE(fs::exists(results_ / "keys" / hex / "answer.json")) << "the next look tries again";
}

TEST_F(KeyExchange, OneAnswersAtATime) {
  const db::ReaderKey reader = db::ReaderKey::Passing();
  AskBy(reader);
  {
    const auto other = db::FileLock::TryTake(results_ / ".answer.lock", "");
    ASSERT_TRUE(other.ok());
    EXPECT_THAT(ProblemsOfALook().front(), HasSubstr("another program already answers"));
  }
  EXPECT_EQ(AnswerAsks(folder_, results_, plan_).answered, 1);
}

TEST_F(KeyExchange, AsksThatAreNotWhatTheySayAreNamedAndNotAnswered) {
  const db::ReaderKey reader = db::ReaderKey::Passing();
  const auto problem_of = [&](const nlohmann::json& changed) {
    AskBy(reader, changed);
    const auto problems = ProblemsOfALook();
    return problems.empty() ? std::string() : problems.front();
  };
  EXPECT_THAT(problem_of({{"plan", "another"}}), HasSubstr("asks for another plan"));
  EXPECT_THAT(problem_of({{"shard", "3/2"}}), HasSubstr("3/2"));
  EXPECT_THAT(problem_of({{"schema", 2}}), HasSubstr("schema 2"));
  EXPECT_THAT(problem_of({{"reader", "x25519-00"}}), HasSubstr("x25519-00"));
  EXPECT_THAT(problem_of({{"reader", db::ToText(db::ReaderKey::Passing().public_key())}}), HasSubstr("than its own"));
  const fs::path file = AskBy(reader);
  WriteText(file, "{");
  EXPECT_THAT(ProblemsOfALook().front(), HasSubstr(file.string()));
  AskBy(reader);
  fs::permissions(file, fs::perms::others_write, fs::perm_options::add);
  EXPECT_THAT(ProblemsOfALook().front(), HasSubstr("others may write"));
  fs::permissions(file, fs::perms::others_write, fs::perm_options::remove);
  fs::rename(file, results_ / "elsewhere");
  fs::create_symlink(results_ / "elsewhere", file);
  EXPECT_THAT(ProblemsOfALook().front(), HasSubstr("not a plain file"));
  fs::remove(file);
  AskBy(reader, {{"padding", std::string(5000, 'x')}});
  EXPECT_THAT(ProblemsOfALook().front(), HasSubstr("too large"));
  AskBy(reader, {{"reader", "/etc/passwd"}});
  EXPECT_THAT(ProblemsOfALook().front(), HasSubstr("'/etc/passwd' is not a public key"));
  AskBy(reader);
  fs::permissions(results_ / "keys", fs::perms::group_write, fs::perm_options::add);
  EXPECT_THAT(ProblemsOfALook().front(), HasSubstr("others may write"));
  fs::permissions(results_ / "keys", fs::perms::group_write, fs::perm_options::remove);
  if (geteuid() == 0) {
    AskBy(reader);
    ASSERT_EQ(chown(file.c_str(), 65534, 65534), 0);
    EXPECT_THAT(ProblemsOfALook().front(), HasSubstr("belongs to user 65534"));
  }
}

TEST_F(KeyExchange, IsNeededWhereAnEncryptedVisitorsKeyIsNotHere) {
  const db::ReaderKey reader = db::ReaderKey::Passing();
  const auto own = KeysOf(folder_, plan_, {1, 2});
  EXPECT_FALSE(KeysAreMissing(folder_, results_, plan_, {1, 2}));
  for (size_t i = 0; i < own->keys.size(); ++i)
    ASSERT_TRUE(
        db::WriteSealedKey(folder_ / "sessions" / own->sessions[i], own->sessions[i], own->keys[i], reader.public_key())
            .ok());
  EXPECT_FALSE(KeysAreMissing(folder_, results_, plan_, {1, 2})) << "the store has them";
  fs::remove(folder_ / "keys.sqlite");
  EXPECT_TRUE(KeysAreMissing(folder_, results_, plan_, {1, 2}));
  EXPECT_FALSE(KeysAreMissing(folder_, results_, plan_, {2, 2})) << "sealed to nobody: no answer would have them";
  ShardManifest fitted{plan_.id, {1, 2}, {}};
  for (const std::string& session : own->sessions) {
    NightEvent end;
    end.kind = NightEventKind::kDone;
    end.session = session;
    fitted.Say({end, {}});
  }
  ASSERT_TRUE(WriteManifest(results_, fitted).ok());
  EXPECT_FALSE(KeysAreMissing(folder_, results_, plan_, {1, 2})) << "who is fitted needs none";
}

TEST_F(KeyExchange, NamesWhoseKeyIsNotHere) {
  fs::remove(folder_ / "keys.sqlite");
  auto asked = Asked({1, 2});
  const KeyAnswers look = AnswerAsks(folder_, results_, plan_);
  EXPECT_EQ(look.keys, 0U);
  EXPECT_THAT(look.problems, SizeIs(2));
  const auto keys = asked.get();
  ASSERT_TRUE(keys.ok()) << keys.status().message();
  EXPECT_THAT(*keys, IsEmpty());
}

TEST_F(KeyExchange, WithoutAnAnswerNoAskIsLeft) {
  const auto keys = Ask({1, 2}, milliseconds(30));
  EXPECT_EQ(keys.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(keys.status().message(), HasSubstr("batch keys --answer"));
  const UniqueFd stop(eventfd(1, 0));
  EXPECT_EQ(Ask({1, 2}, kLong, stop.get()).status().code(), StatusCode::kTryAgain);
  EXPECT_THAT(AskFiles(), IsEmpty());
  EXPECT_EQ(AnswerAsks(folder_, results_, plan_).answered, 0) << "no ask stands";
}

TEST_F(KeyExchange, AnAnswerForAnotherShardIsRefused) {
  auto asked = Asked({1, 2});
  const std::string hex = AskFiles().front().stem().string().substr(std::strlen("ask-"));
  const std::string other = KeysOf(folder_, plan_, {2, 2})->sessions.front();
  fs::create_directories(results_ / "keys" / hex);
  const fs::path answer = results_ / "keys" / hex / "answer.json";
  WriteText(answer.string() + ".new",
            nlohmann::json({{"schema", 1}, {"sessions", {other}}, {"missing", nlohmann::json::array()}}).dump());
  fs::rename(answer.string() + ".new", answer);
  const auto keys = asked.get();
  EXPECT_EQ(keys.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(keys.status().message(), HasSubstr("does not belong to shard 1/2"));
}

}  // namespace
}  // namespace stratalux::fit
