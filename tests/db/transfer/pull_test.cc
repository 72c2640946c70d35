// SPDX-License-Identifier: Apache-2.0
// Pull: what arrives is whole, what is damaged or of a later version does not keep the others away, what was forgotten
// stays away, also of what an earlier pull left behind.
#include <nlohmann/json.hpp>

#include "db/base/own_hash.h"
#include "db/care/incoming.h"
#include "db/care/reindex.h"
#include "db/care/verify.h"
#include "db/catalogue/consent.h"
#include "db/keys/sealed_key.h"
#include "db/ledger/ledger.h"
#include "db/ledger/ledger_folder.h"
#include "db/privacy/forget.h"
#include "shared/base/read_file.h"
#include "tests/db/transfer/transfer_fixture.h"

namespace stratalux::db {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class PullTest : public TransferTest {
 protected:
  void SetUp() override {
    TransferTest::SetUp();
    ASSERT_TRUE(SessionStore::Create(other_).ok());
  }
  // As a cut rsync leaves it.
  void LeaveBehind(const std::string& id) const {
    std::filesystem::create_directories(IncomingFolder(other_, id));
    std::filesystem::copy_file(Segment(id), IncomingFolder(other_, id) / "frames-0001.seg");
    std::filesystem::resize_file(IncomingFolder(other_, id) / "frames-0001.seg", 500);
  }
  // ssh HOST COMMAND...: runs here what the other side would run, after `first`.
  void MakeSsh(const std::string& first) const {
    std::filesystem::create_directories(far_ / "bin");
    WriteText(far_ / "bin" / "ssh", "#!/bin/sh\necho \"$@\" >> " + (far_ / "ssh.log").string() + "\n" + first +
                                        "\nwhile [ \"$1\" != rsync ]; do shift; done\nexec \"$@\"\n");
    ASSERT_EQ(chmod((far_ / "bin" / "ssh").c_str(), 0755), 0);
  }
  Result<PullReport> PullOverSsh(std::chrono::seconds timeout = std::chrono::seconds(60)) {
    const std::string path = std::getenv("PATH");
    setenv("PATH", ((far_ / "bin").string() + ":" + path).c_str(), 1);
    auto pulled = Pull(other_, "kiosk@rig:" + folder_.string(), {.timeout = timeout}, logger_);
    setenv("PATH", path.c_str(), 1);
    return pulled;
  }
};

TEST_F(PullTest, TakesFinishedSessionsInTheirOrderAndOnce) {
  const std::string first = StoreSession(1), second = StoreSession(2);
  {
    SessionStore store = OpenStore();
    ASSERT_TRUE(store.BeginSession(SimulatedVisit()).ok());  // dropped: unfinished
  }
  EXPECT_THAT(PullHere({.mode = PullMode::kDryRun})->sessions, SizeIs(2));
  EXPECT_THAT(Ids(other_), IsEmpty());
  const auto pulled = Pull(other_, folder_.string() + "/", {}, logger_);
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_EQ(pulled->unfinished, 1);
  EXPECT_EQ(Ids(other_), (std::vector{second, first}));
  EXPECT_EQ(PullHere()->present, 2);
}

TEST_F(PullTest, ACutOneGoesOnAndADamagedSessionNeverBecomesVisible) {
  const std::string id = StoreSession(4);
  LeaveBehind(id);
  FlipBits(Segment(id), 64 + 320 + 3, 1);
  const auto damaged = PullHere();
  ASSERT_TRUE(damaged.ok()) << damaged.status().message();
  EXPECT_THAT(damaged->problems, SizeIs(1));
  EXPECT_THAT(Ids(other_), IsEmpty());
  EXPECT_FALSE(std::filesystem::exists(other_ / "sessions" / id));
  EXPECT_THAT(ListIncoming(other_), IsEmpty());
  FlipBits(Segment(id), 64 + 320 + 3, 1);
  std::filesystem::last_write_time(Segment(id), std::filesystem::file_time_type::clock::now());
  ASSERT_TRUE(PullHere().ok());
  EXPECT_EQ(Ids(other_), std::vector{id});
}

// The issue's case: a value of the next version with right hashes, in the middle of three.
TEST_F(PullTest, ASessionOfALaterVersionIsNamedAndStaysOutsideWhileTheOthersCome) {
  const std::string first = StoreSession(1), later = StoreSession(2), last = StoreSession(1);
  const std::filesystem::path manifest = folder_ / "sessions" / later / "manifest.json";
  const auto good = ReadBytes(Segment(later)), good_manifest = ReadBytes(manifest);
  RewriteSegment(Segment(later), [](FrameHeader& header) { header.phase = 10; });
  const std::string command = "pull --from " + folder_.string() + " --store " + other_.string();
  for (int i = 0; i < 2; ++i) {
    const Outcome outcome = Db(command);
    EXPECT_EQ(outcome.code, 3) << outcome.out;
    EXPECT_THAT(outcome.out, HasSubstr("session " + later + " was not fetched"));
    EXPECT_EQ(Ids(other_), (std::vector{last, first}));
    EXPECT_FALSE(std::filesystem::exists(other_ / "sessions" / later)) << "nothing was moved";
  }
  const auto index = Reindex(other_, logger_);
  ASSERT_TRUE(index.ok()) << index.status().message();
  EXPECT_THAT(index->problems, IsEmpty());
  WriteBytes(Segment(later), good);
  WriteBytes(manifest, good_manifest);
  EXPECT_EQ(Db(command).code, 0);
  EXPECT_THAT(Ids(other_), SizeIs(3));
}

TEST_F(PullTest, FindingsComeAlongAndThoseOfALaterVersionStayOutside) {
  const auto capture = [this] {
    SessionStore store = OpenStore();
    SessionInfo info = SimulatedVisit();
    info.visit = "evening";
    info.attempt = 2;
    auto writer = store.BeginSession(info);
    EXPECT_TRUE(AppendTo(*writer, 0).ok());
    EXPECT_TRUE(writer->Finish(SessionStatus::kDegraded, {"the visitor moved"}, SomeFindings()).ok());
    return writer->info().id;
  };
  const std::string good = capture(), later = capture();
  const auto manifest = folder_ / "sessions" / later / "manifest.json";
  auto json = nlohmann::ordered_json::parse(ReadBytes(manifest));
  json["findings"][0]["kind"] = "sneezed";
  json.erase("hash");
  WriteText(manifest, WithOwnHash(json.dump(1)));
  EXPECT_THAT(PullHere()->problems, ElementsAre(AllOf(HasSubstr(later), HasSubstr("sneezed"))));
  ASSERT_EQ(Ids(other_), std::vector{good});
  const auto info = SessionStore::Open(other_, AccessMode::kReadOnly)->FindSession(good)->info;
  EXPECT_EQ(info.visit, "evening");
  EXPECT_EQ(info.attempt, 2);
  EXPECT_EQ(info.found, SomeFindings());
}

// Right hashes all over, but not those of which the manifest speaks.
TEST_F(PullTest, ASegmentSealedAnewIsNotTheManifestsAndStaysOutside) {
  const std::string changed = StoreSession(2), good = StoreSession(1);
  const std::filesystem::path manifest = folder_ / "sessions" / changed / "manifest.json";
  const auto before = ReadBytes(manifest);
  RewriteSegment(Segment(changed), [](FrameHeader& header) { header.gain *= 2; });
  WriteBytes(manifest, before);
  EXPECT_THAT(PullHere()->problems, ElementsAre(HasSubstr("is not the file that the manifest describes")));
  EXPECT_EQ(Ids(other_), std::vector{good});
}

TEST_F(PullTest, NumbersThatAreNoneAreOneSessionsProblem) {
  const std::string bad = StoreSession(1), good = StoreSession(1);
  RewriteSegment(Segment(bad),
                 [](FrameHeader& header) { header.exposure_ms = std::numeric_limits<double>::quiet_NaN(); });
  EXPECT_THAT(PullHere()->problems, ElementsAre(HasSubstr(bad)));
  EXPECT_EQ(Ids(other_), std::vector{good});
}

// Every hash of payload, header, footer and manifest is right: only decoding tells.
TEST_F(PullTest, FramesAreDecodedBeforeTheirSessionIsTaken) {
  const std::string other_pixels = StoreSession(2), no_pixels = StoreSession(2), good = StoreSession(1);
  RewriteSegment(Segment(other_pixels), [](FrameHeader& header) { header.pixel_hash[3] ^= 1U; });
  RewriteSegment(Segment(no_pixels), [](FrameHeader& header) {
    header.codec = static_cast<decltype(header.codec)>(Codec::kDelta);  // the payload is raw
    std::fill(std::begin(header.pixel_hash), std::end(header.pixel_hash), uint8_t{0});
  });
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_THAT(pulled->problems,
              ElementsAre(AllOf(HasSubstr(other_pixels), HasSubstr("pixel hash"), HasSubstr("and 1 more frames")),
                          HasSubstr(no_pixels)));
  EXPECT_EQ(Ids(other_), std::vector{good});
}

TEST_F(PullTest, ADamagedFitStaysOutAndItsSessionComes) {
  const std::string id = StoreSession(1);
  SessionStore store = OpenStore();
  for (const char* fit : {"damaged", "good", "lost"}) {
    std::filesystem::create_directories(store.FitFolder(id, fit));
    WriteText(store.FitFolder(id, fit) / "map.bin", "a map");
    ASSERT_TRUE(store.RegisterFit({fit, id, "{}", R"({"rms": 0.25})", {5}}).ok());
  }
  FlipBits(store.FitFolder(id, "damaged") / "map.bin", 2, 1);
  std::filesystem::remove(store.FitFolder(id, "lost") / "fit.json");
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_THAT(pulled->problems, ElementsAre(AllOf(HasSubstr(id + "/damaged was not fetched"), HasSubstr("map.bin"))));
  EXPECT_THAT(pulled->notes, ElementsAre(HasSubstr(id + "/lost was not fetched")));
  EXPECT_EQ(Ids(other_), std::vector{id});
  EXPECT_THAT(*SessionStore::Open(other_, AccessMode::kReadOnly)->ListFits(id), SizeIs(1));
  FlipBits(store.FitFolder(id, "damaged") / "map.bin", 2, 1);
  EXPECT_THAT(PullHere()->fits, ElementsAre(id + "/damaged")) << "the next pull asks for it again";
}

TEST_F(PullTest, ABitInAFitsRecordIsFound) {
  const std::string id = StoreSession(1);
  SessionStore store = OpenStore();
  std::filesystem::create_directories(store.FitFolder(id, "f1"));
  ASSERT_TRUE(store.RegisterFit({"f1", id, "{}", R"({"rms": 0.25})", {5}}).ok());
  const auto file = store.FitFolder(id, "f1") / "fit.json";
  const auto bytes = ReadBytes(file);
  const std::string text(bytes.begin(), bytes.end());
  FlipBits(file, text.find("0.25"), 1);  // still a number
  EXPECT_THAT(PullHere()->problems, ElementsAre(HasSubstr("does not match its own hash")));
  EXPECT_EQ(Ids(other_), std::vector{id});
}

TEST_F(PullTest, SegmentsThatTheManifestDoesNotNameStayOut) {
  const std::string id = StoreSession(2);
  std::filesystem::copy_file(Segment(id), Segment(id, 5));
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_THAT(pulled->problems, IsEmpty());
  EXPECT_THAT(pulled->notes, ElementsAre(HasSubstr("frames-0005.seg was left out")));
  EXPECT_EQ(Ids(other_), std::vector{id});
}

// A chain that another account wrote, or that lies on a bad block.
TEST_F(PullTest, NobodyReturnsWhileAChainCannotBeReadOrIsLost) {
  const std::string id = StoreSession(1);
  const std::filesystem::path chain = other_ / "ledger" / (std::string(32, 'f') + ".jsonl");
  WriteText(chain, "");
  std::filesystem::resize_file(chain, static_cast<uintmax_t>(kMostChainBytes) + 1);
  const auto refused = PullHere();
  EXPECT_EQ(refused.status().code(), StatusCode::kFailed);
  EXPECT_THAT(refused.status().message(), HasSubstr(chain.string()));
  EXPECT_THAT(Ids(other_), IsEmpty());
  std::filesystem::remove(chain);
  // The index knows it, too, and either of the two may be lost.
  ASSERT_TRUE(AppendToLedger(other_, {LedgerKind::kForgetting, WallNow(), {id}, "", R"({"reason": "forget"})"}).ok());
  ASSERT_TRUE(SessionStore::Open(other_, AccessMode::kReadWrite).ok());
  std::filesystem::remove_all(other_ / "ledger");
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_EQ(pulled->forgotten, 1);
  EXPECT_THAT(Ids(other_), IsEmpty());
}

TEST_F(PullTest, ObeysForgettingsOfBothSidesAndOfOlderStores) {
  const std::string first = StoreSession(1), second = StoreSession(1), third = StoreSession(1);
  Forget(folder_, first);
  Forget(other_, second);
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_EQ(pulled->forgotten, 2);
  EXPECT_EQ(pulled->unfinished, 0) << "the forgotten are counted once";
  EXPECT_EQ(Ids(other_), std::vector{third});
  EXPECT_TRUE(Ledger::Read(other_)->IsForgotten(first)) << "adopted: it holds for those who ask this store";
  for (const auto& entry : std::filesystem::recursive_directory_iterator(other_ / "incoming")) {
    EXPECT_THAT(entry.path().filename().string(), ::testing::Not(HasSubstr(first))) << "a tombstone is not kept here";
  }
  Forget(folder_, third);
  EXPECT_THAT(PullHere()->problems, ElementsAre(HasSubstr("forget " + third)));
}

// Both stores certify; chains are read in the order of their random names, which one direction has the other way round.
TEST_F(PullTest, OfTwoCertificatesTheLatestCountsInWhateverOrderTheChainsAreRead) {
  const std::string first = StoreSession(1), second = StoreSession(1);
  ASSERT_TRUE(PullHere().ok());
  const PullOptions obeying{.forgotten = ForgottenElsewhere::kForget};
  const auto forget = [this](const std::filesystem::path& store, const std::string& id) {
    ForgetRequest request;
    request.sessions = {id};
    return db::Forget(store, request, logger_).status();
  };
  ASSERT_TRUE(forget(folder_, first).ok());
  ASSERT_TRUE(forget(other_, second).ok());
  ASSERT_TRUE(Pull(other_, folder_.string(), obeying, logger_).ok());
  ASSERT_TRUE(Pull(folder_, other_.string(), obeying, logger_).ok());
  for (const auto& store : {folder_, other_}) {
    EXPECT_THAT(Ids(store), IsEmpty());
    EXPECT_THAT(VerifyStore(*SessionStore::Open(store, AccessMode::kReadOnly))->problems, IsEmpty());
  }
}

// The issue's case: pull killed, visitor forgotten at the rig, pull again.
TEST_F(PullTest, NothingOfAForgottenFaceStaysInIncoming) {
  const std::string gone = StoreSession(4), here = StoreSession(4), vanished = StoreSession(1), stays = StoreSession(1);
  for (const auto& id : {gone, here, vanished, stays}) LeaveBehind(id);
  ASSERT_EQ(Db("forget " + gone + " --yes --store " + folder_.string()).code, 0);
  Forget(other_, here);
  std::filesystem::remove_all(folder_ / "sessions" / vanished);
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_THAT(pulled->wiped, ::testing::UnorderedElementsAre(HasSubstr(gone), HasSubstr(here), HasSubstr(vanished)));
  EXPECT_EQ(Ids(other_), std::vector{stays});
  for (const auto& entry : std::filesystem::recursive_directory_iterator(other_ / "incoming")) {
    EXPECT_NE(entry.path().extension(), ".seg") << entry.path();
    if (entry.is_regular_file() && entry.path().filename() == "manifest.json") {
      EXPECT_EQ(entry.path().parent_path().filename(), stays) << entry.path();
    }
  }
}

TEST_F(PullTest, AForgettingHereWipesWhatABrokenOffPullLeft) {
  const std::string id = StoreSession(2);
  ASSERT_TRUE(PullHere().ok());
  LeaveBehind(id);
  const Outcome outcome = Db("forget " + id + " --yes --store " + other_.string());
  EXPECT_EQ(outcome.code, 0) << outcome.out;
  EXPECT_THAT(ListIncoming(other_), IsEmpty());
}

TEST_F(PullTest, ObeysWhereItIsToldTo) {
  const std::string id = StoreSession(1), stays = StoreSession(1);
  ASSERT_TRUE(PullHere().ok());
  ASSERT_EQ(Db("forget " + id + " --yes --store " + folder_.string()).code, 0);
  const std::string command = "pull --from " + folder_.string() + " --store " + other_.string();
  EXPECT_EQ(Db(command).code, 3);
  EXPECT_EQ(Ids(other_), (std::vector{stays, id})) << "named, not deleted";
  const Outcome obeyed = Db(command + " --obey");
  EXPECT_EQ(obeyed.code, 0) << obeyed.out;
  EXPECT_EQ(Ids(other_), std::vector{stays});
  EXPECT_EQ(Db(command).code, 0);
}

TEST_F(PullTest, AWithdrawalAtTheSourceIsOneHere) {
  const std::string id = StoreSession(1);
  ASSERT_TRUE(PullHere().ok());
  ASSERT_TRUE(WithdrawConsent(folder_, kSimulatedVisitor).ok());
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_TRUE(ListConsents(other_, kSimulatedVisitor)->front().withdrawn.has_value());
  EXPECT_TRUE(Ledger::Read(other_)->WithdrawnAt(id).has_value());
}

TEST_F(PullTest, FetchesManifestsThatChangedAndNoOthers) {
  const std::string id = StoreSession(1);
  MakeSsh("");
  ASSERT_TRUE(PullOverSsh().ok());
  std::filesystem::path kept;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(IncomingSources(other_)))
    if (entry.path().filename() == "manifest.json") kept = entry.path();
  ASSERT_FALSE(kept.empty());
  struct stat before {
  }, after{};
  ASSERT_EQ(stat(kept.c_str(), &before), 0);
  ASSERT_TRUE(PullOverSsh().ok());
  ASSERT_EQ(stat(kept.c_str(), &after), 0);
  EXPECT_EQ(before.st_ino, after.st_ino) << "rsync writes a file anew when it sends it";
  EXPECT_EQ(before.st_ctim.tv_nsec, after.st_ctim.tv_nsec);
  std::filesystem::last_write_time(folder_ / "sessions" / id / "manifest.json",
                                   std::filesystem::file_time_type::clock::now());
  ASSERT_TRUE(PullOverSsh().ok());
  ASSERT_EQ(stat(kept.c_str(), &after), 0);
  EXPECT_NE(before.st_ctim.tv_nsec, after.st_ctim.tv_nsec);
}

TEST_F(PullTest, LaterFitsFollow) {
  const std::string id = StoreSession(1);
  ASSERT_TRUE(PullHere().ok());
  {
    SessionStore store = OpenStore();
    std::filesystem::create_directories(store.FitFolder(id, "f1"));
    WriteText(store.FitFolder(id, "f1") / "map.bin", "a map");
    ASSERT_TRUE(store.RegisterFit({"f1", id, "{}", R"({"rms": 0.25})", {5}}).ok());
  }
  EXPECT_THAT(PullHere({.mode = PullMode::kDryRun})->fits, ElementsAre(id + "/f1"));
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_THAT(pulled->problems, IsEmpty());
  EXPECT_THAT(pulled->fits, ElementsAre(id + "/f1"));
  const auto store = SessionStore::Open(other_, AccessMode::kReadOnly);
  EXPECT_THAT(*store->ListFits(id), SizeIs(1));
  EXPECT_EQ(ReadBytes(store->FitFolder(id, "f1") / "map.bin").size(), 5U);
  EXPECT_THAT(PullHere()->fits, IsEmpty());
  // Listed, and its record lost: whole again once, and no more said to be.
  const std::filesystem::path record = store->FitFolder(id, "f1") / "fit.json";
  std::filesystem::remove(record);
  EXPECT_THAT(PullHere()->fits, ElementsAre(id + "/f1"));
  EXPECT_TRUE(std::filesystem::exists(record));
  EXPECT_THAT(PullHere()->fits, IsEmpty());
  EXPECT_EQ(Ids(other_), std::vector{id});
  EXPECT_THAT(ListIncoming(other_), IsEmpty());
}

TEST_F(PullTest, SpeaksSshWithoutQuestionsAndSaysWhatIsMissing) {
  const std::string id = StoreSession(2);
  MakeSsh("");
  const auto pulled = PullOverSsh();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_EQ(Ids(other_), std::vector{id});
  const auto log = ReadBytes(far_ / "ssh.log");
  const std::string words(log.begin(), log.end());
  for (const char* word : {"BatchMode=yes", "ConnectTimeout=60", "ServerAliveInterval=15"})
    EXPECT_THAT(words, HasSubstr(word));
  MakeSsh("echo Host key verification failed. >&2; exit 255");
  const auto refused = PullOverSsh();
  EXPECT_EQ(refused.status().code(), StatusCode::kFailed);
  EXPECT_THAT(refused.status().message(), HasSubstr("ssh-copy-id kiosk@rig"));
  const std::string path = std::getenv("PATH");
  setenv("PATH", (far_ / "bin").c_str(), 1);
  const auto without = PullHere();
  setenv("PATH", path.c_str(), 1);
  EXPECT_EQ(without.status().code(), StatusCode::kNotFound);
  EXPECT_THAT(without.status().message(), HasSubstr("apt-get install rsync"));
  EXPECT_EQ(Pull(other_, "-oProxyCommand=x:/y", {}, logger_).status().code(), StatusCode::kUsage);
  EXPECT_EQ(Pull(other_, (far_ / "no-store").string(), {}, logger_).status().code(), StatusCode::kNotFound);
}

TEST_F(PullTest, ASourceThatNeverAnswersEndsIt) {
  MakeSsh("exec sleep 300");
  const auto begun = std::chrono::steady_clock::now();
  const auto pulled = PullOverSsh(std::chrono::seconds(1));
  EXPECT_EQ(pulled.status().code(), StatusCode::kFailed);
  EXPECT_THAT(pulled.status().message(), HasSubstr("did not answer in time"));
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(60));
}

TEST_F(PullTest, KilledAnywhereItGoesOnWithoutLossAndWithoutDoubles) {
  std::vector<std::string> ids;
  for (int i = 0; i < 6; ++i) ids.insert(ids.begin(), StoreSession(3));
  int ended = 0;
  for (int i = 0; i < 6; ++i) {
    std::filesystem::remove_all(other_);
    ASSERT_TRUE(SessionStore::Create(other_).ok());
    ended += RunAndKill({"pull", "--from", folder_.string(), "--store", other_.string()},
                        std::chrono::milliseconds(5 + 100 * i))
                 ? 1
                 : 0;
    auto pulled = PullHere();
    // What the killed one had just forked, to become rsync, holds its lock for an instant.
    for (int wait = 0; wait < 100 && pulled.status().code() == StatusCode::kBusy; ++wait) {
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      pulled = PullHere();
    }
    ASSERT_TRUE(pulled.ok()) << pulled.status().message();
    EXPECT_THAT(pulled->problems, IsEmpty()) << i;
    EXPECT_EQ(Ids(other_), ids) << i;
    EXPECT_THAT(ListIncoming(other_), IsEmpty()) << i;
  }
  EXPECT_LT(ended, 6) << "no kill met a running pull";
}

// The source answers three times; by then one session of two is here.
TEST_F(PullTest, AWithdrawalBindsWhatCameBeforeTheSourceWentAway) {
  const std::string first = StoreSession(1);
  StoreSession(1);
  ASSERT_TRUE(AppendToLedger(folder_, {LedgerKind::kWithdrawal, WallNow(), {first}, "", ""}).ok());
  MakeSsh("[ $(wc -l < " + (far_ / "ssh.log").string() + ") -lt 4 ] || exit 255");
  EXPECT_EQ(PullOverSsh().status().code(), StatusCode::kFailed);
  ASSERT_EQ(Ids(other_), std::vector{first});
  const auto consents = ListConsents(other_, kSimulatedVisitor);
  ASSERT_TRUE(consents.ok());
  ASSERT_THAT(*consents, SizeIs(1));
  EXPECT_TRUE(consents->front().withdrawn.has_value());
}

// Longer than any record: one such file kept every session away.
TEST_F(PullTest, ASealedKeyThatIsTooLargeConcernsItsSessionAlone) {
  const std::string first = StoreSession(1);
  ASSERT_TRUE(PullHere().ok());
  const auto large = SealedKeyFile(folder_ / "sessions" / first, ReaderId{});
  WriteText(large, "SLXSKEY");
  std::filesystem::resize_file(large, kMostRecordBytes + 1);
  const std::string second = StoreSession(1);
  const auto pulled = PullHere();
  ASSERT_TRUE(pulled.ok()) << pulled.status().message();
  EXPECT_THAT(pulled->problems, ElementsAre(AllOf(HasSubstr(first), HasSubstr("a sealed key was not fetched"),
                                                  HasSubstr(std::to_string(kMostRecordBytes + 1)))));
  EXPECT_THAT(pulled->sessions, ElementsAre(second));
}

}  // namespace
}  // namespace stratalux::db
