// SPDX-License-Identifier: Apache-2.0
// Encrypted sessions for a reader elsewhere: sealed as they begin and afterwards, carried by pull, read there by who
// has the private key; gone with the reader, with the session, and out of every backup.
#include "db/privacy/key_sharing.h"

#include <cstdlib>

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>
#include <sys/wait.h>
#include <unistd.h>

#include "db/base/write_lock.h"
#include "db/care/verify.h"
#include "db/keys/readers.h"
#include "db/keys/rig_key.h"
#include "db/keys/sealed_key.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"
#include "tests/support/text_file.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

const WriterOptions kSealed{.encryption = Encryption::kPerSession};

class KeySharing : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    std::string name = (TemporaryFolder() / "stratalux-reader-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    far_ = name;
    other_ = far_ / "store";
    ASSERT_TRUE(SessionStore::Create(other_).ok());
    ASSERT_EQ(Db("key reader-init --out " + Private().string() + " > " + Public().string()).code, 0);
    reader_ = IdOf(ReaderKey::Read(Private())->public_key());
  }
  void TearDown() override {
    fs::remove_all(far_);
    StoreTest::TearDown();
  }
  // STRATALUX_STORE is the rig's; `environment` in front.
  [[nodiscard]] Outcome Db(const std::string& arguments, const std::string& environment = "",
                           const std::string& errors = "2>&1") const {
    return Shell(environment + " STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR + "/stratalux-db " +
                 arguments + " " + errors);
  }
  [[nodiscard]] Outcome Share() const { return Db("key share " + Public().string()); }
  [[nodiscard]] Outcome PullThere(const std::string& more = "") const {
    return Db("pull --from " + folder_.string() + " --store " + other_.string() + more);
  }
  [[nodiscard]] nlohmann::json Json(const std::string& arguments) const {
    return nlohmann::json::parse(Db(arguments + " --json", "", "2>/dev/null").out, nullptr, false);
  }
  [[nodiscard]] fs::path Private() const { return far_ / "reader.key"; }
  [[nodiscard]] fs::path Public() const { return far_ / "reader.pub"; }
  [[nodiscard]] fs::path SealedIn(const fs::path& store, const std::string& id) const {
    return SealedKeyFile(store / "sessions" / id, reader_);
  }
  // Exit code of having every frame of a session of the other store decoded, by a program with the private key.
  [[nodiscard]] Outcome ReadThere(const std::string& id, const std::string& environment) const {
    const fs::path out = far_ / "pictures";
    fs::remove_all(out);
    return Db("export " + id + " --out " + out.string() + " --store " + other_.string(), environment);
  }
  [[nodiscard]] std::string WithReader() const { return "STRATALUX_READER_KEY=" + Private().string(); }
  [[nodiscard]] VerifyReport Verified(const std::string& id) const {
    const SessionStore store = OpenStore(AccessMode::kReadOnly);
    return *VerifySession(store, *store.FindSession(id));
  }

  fs::path far_, other_;
  ReaderId reader_;
};

TEST_F(KeySharing, SealsWhatIsThereAndWhatBegins) {
  const std::string before = StoreSession(1, kSealed), plain = StoreSession(1);
  const Outcome shared = Share();
  EXPECT_EQ(shared.code, 0) << shared.out;
  EXPECT_THAT(shared.out, HasSubstr("1 keys sealed; 1 reader(s), 1 encrypted sessions"));
  const std::string after = StoreSession(1, kSealed);
  EXPECT_TRUE(fs::exists(SealedIn(folder_, before)));
  EXPECT_TRUE(fs::exists(SealedIn(folder_, after)));
  EXPECT_FALSE(fs::exists(SealedIn(folder_, plain)));
  const auto readers = Json("key readers");
  ASSERT_EQ(readers.size(), 1U);
  EXPECT_EQ(readers[0]["reader"], ToHex(reader_));
  EXPECT_EQ(readers[0]["sealed"], 2);
  EXPECT_EQ(readers[0]["public_key"], Json("key reader-public " + Private().string())["public_key"]);
  for (const std::string& id : {before, after, plain}) {
    const VerifyReport report = Verified(id);
    EXPECT_THAT(report.problems, IsEmpty()) << id;
    EXPECT_THAT(report.notes, IsEmpty()) << id;
  }
  EXPECT_THAT(Share().out, HasSubstr("0 keys sealed")) << "again is no error";
}

TEST_F(KeySharing, NeedsAReaderAndItsRightKey) {
  EXPECT_EQ(Db("key share").code, 2);
  EXPECT_THAT(Db("key share").out, HasSubstr("has no reader"));
  EXPECT_EQ(Db("key sign-init > " + (far_ / "rig.pub").string()).code, 0);
  EXPECT_EQ(Db("key share " + (far_ / "rig.pub").string()).code, 2) << "a key that signs";
  EXPECT_EQ(Db("key share " + Private().string()).code, 2) << "the private half";
  EXPECT_EQ(Db("key unshare 00").code, 4);
  EXPECT_EQ(Db("key reader-init --out " + Private().string()).code, 2);
  EXPECT_EQ(Json("key readers").size(), 0U);
  EXPECT_THAT(Db("key readers").out, HasSubstr("(none)"));
}

TEST_F(KeySharing, IsReadElsewhereByTheReaderAlone) {
  ASSERT_EQ(Share().code, 0);
  const std::string id = StoreSession(2, kSealed);
  ASSERT_EQ(PullThere().code, 0);
  EXPECT_FALSE(fs::exists(KeyFile(other_))) << "no key of the rig's";
  const Outcome without = ReadThere(id, "");
  EXPECT_EQ(without.code, 4);
  EXPECT_THAT(without.out, HasSubstr("there is a sealed copy, but no reader's key was given ($STRATALUX_READER_KEY)"));
  const Outcome with = ReadThere(id, WithReader());
  EXPECT_EQ(with.code, 0) << with.out;

  ASSERT_EQ(Db("key reader-init --out " + (far_ / "stranger.key").string()).code, 0);
  const Outcome stranger = ReadThere(id, "STRATALUX_READER_KEY=" + (far_ / "stranger.key").string());
  EXPECT_EQ(stranger.code, 4);
  EXPECT_THAT(stranger.out, HasSubstr("no copy of it is sealed to this reader"));
  ASSERT_EQ(chmod(Private().c_str(), 0644), 0);
  EXPECT_EQ(ReadThere(id, WithReader()).code, 1);
  EXPECT_THAT(ReadThere(id, WithReader()).out, HasSubstr("can be read by others"));
}

TEST_F(KeySharing, IsPulledForSessionsThatCameBefore) {
  const std::string id = StoreSession(1, kSealed);
  ASSERT_EQ(PullThere().code, 0);
  EXPECT_EQ(ReadThere(id, WithReader()).code, 4);
  ASSERT_EQ(Share().code, 0);
  const auto pulled = Json("pull --from " + folder_.string() + " --store " + other_.string());
  EXPECT_EQ(pulled["keys"], 1);
  EXPECT_THAT(pulled["problems"], IsEmpty());
  EXPECT_EQ(ReadThere(id, WithReader()).code, 0);
  EXPECT_EQ(Json("pull --from " + folder_.string() + " --store " + other_.string())["keys"], 0) << "once";
}

TEST_F(KeySharing, DamagedOnTheWayIsNamedAndKeepsTheSessionNotAway) {
  ASSERT_EQ(Share().code, 0);
  const std::string cut = StoreSession(1, kSealed), swapped = StoreSession(1, kSealed), good = StoreSession(1, kSealed);
  fs::resize_file(SealedIn(folder_, cut), 40);
  fs::copy_file(SealedIn(folder_, good), SealedIn(folder_, swapped), fs::copy_options::overwrite_existing);
  EXPECT_THAT(Verified(cut).problems, ElementsAre(HasSubstr("was cut off or changed")));
  EXPECT_THAT(Verified(swapped).problems, ElementsAre(HasSubstr("is the sealed key of session " + good)));
  const Outcome pulled = PullThere();
  EXPECT_EQ(pulled.code, 3);
  EXPECT_THAT(pulled.out, HasSubstr("3 sessions pulled"));
  EXPECT_THAT(pulled.out, HasSubstr("session " + cut + ": a sealed key was not fetched"));
  EXPECT_EQ(ReadThere(good, WithReader()).code, 0);
  EXPECT_EQ(ReadThere(cut, WithReader()).code, 4);
  EXPECT_THAT(Share().out, HasSubstr("2 keys sealed")) << "what is damaged is made anew";
  EXPECT_EQ(PullThere().code, 0);
  EXPECT_EQ(ReadThere(cut, WithReader()).code, 0);
  EXPECT_EQ(ReadThere(swapped, WithReader()).code, 0);
  // Here, a damaged one is no missing one.
  FlipBits(SealedIn(other_, good), 70, 1);
  EXPECT_EQ(ReadThere(good, WithReader()).code, 6);
}

TEST_F(KeySharing, EndsWithUnshare) {
  const std::string id = StoreSession(1, kSealed);
  ASSERT_EQ(Share().code, 0);
  const Outcome removed = Db("key unshare " + ToHex(reader_).substr(0, 6));
  EXPECT_EQ(removed.code, 0) << removed.out;
  EXPECT_THAT(removed.out, HasSubstr("with 1 sealed keys"));
  EXPECT_FALSE(fs::exists(SealedIn(folder_, id)));
  const std::string next = StoreSession(1, kSealed);
  EXPECT_FALSE(fs::exists(SealedIn(folder_, next)));
  EXPECT_EQ(Json("key readers").size(), 0U);
  EXPECT_EQ(Db("key unshare " + Public().string()).code, 4);
}

// Killed behind its first step, which takes the reader away.
TEST_F(KeySharing, AnUnshareThatWasBrokenOffIsNamedAndFinished) {
  const std::string id = StoreSession(1, kSealed);
  ASSERT_EQ(Share().code, 0);
  fs::remove(folder_ / kReadersFolder / (ToHex(reader_) + ".pub"));
  EXPECT_THAT(Verified(id).problems, ElementsAre(HasSubstr("is sealed to someone who is not a reader of this store")));
  EXPECT_THAT(Db("key readers").out, HasSubstr("not a reader of this store"));
  EXPECT_EQ(Db("key unshare " + ToHex(reader_)).code, 0);
  EXPECT_THAT(Verified(id).problems, IsEmpty());
}

// Killed behind its first step, which makes the reader known, or in the midst of a file.
TEST_F(KeySharing, AShareThatWasBrokenOffIsNotedAndFinished) {
  const std::string id = StoreSession(1, kSealed);
  ASSERT_TRUE(AddReader(folder_, *ParseReaderPublicKey(Public())).ok());
  WriteText(SealedIn(folder_, id).string() + ".new", "half");
  EXPECT_THAT(Verified(id).notes, Contains(HasSubstr("is not sealed to reader " + ToHex(reader_))));
  EXPECT_EQ(Db("key share").code, 0);
  EXPECT_THAT(Verified(id).notes, IsEmpty());
  EXPECT_FALSE(fs::exists(SealedIn(folder_, id).string() + ".new"));
}

TEST_F(KeySharing, IsForgottenWithTheSession) {
  ASSERT_EQ(Share().code, 0);
  const std::string id = StoreSession(1, kSealed);
  ASSERT_EQ(PullThere().code, 0);
  EXPECT_EQ(Db("forget " + id + " --yes").code, 0);
  EXPECT_FALSE(fs::exists(SealedIn(folder_, id)));
  // The workstation's copy stays until people decide; its key goes with the rig's.
  EXPECT_TRUE(fs::exists(SealedIn(other_, id)));
  EXPECT_EQ(PullThere().code, 3);
  EXPECT_FALSE(fs::exists(SealedIn(other_, id)));
  EXPECT_EQ(ReadThere(id, WithReader()).code, 2) << "nothing is exported of it any more";
  EXPECT_EQ(Db("forget " + id + " --yes --store " + other_.string()).code, 0);
  for (const auto& entry : fs::recursive_directory_iterator(other_))
    EXPECT_FALSE(IsSealedKeyName(entry.path().filename().string())) << entry.path();
}

TEST_F(KeySharing, StaysOutOfBackups) {
  ASSERT_EQ(Share().code, 0);
  const std::string id = StoreSession(1, kSealed);
  const fs::path backup = far_ / "backup", again = far_ / "again";
  ASSERT_EQ(Db("backup --to " + backup.string() + " --keys " + (far_ / "keys.sqlite").string()).code, 0);
  for (const auto& entry : fs::recursive_directory_iterator(backup))
    EXPECT_FALSE(IsSealedKeyName(entry.path().filename().string())) << entry.path();
  // As the operator's guide says: the keys by hand, then shared again.
  ASSERT_EQ(Db("restore --from " + backup.string() + " --ledger none --store " + again.string()).code, 0);
  fs::copy_file(far_ / "keys.sqlite", KeyFile(again));
  EXPECT_EQ(Db("key share " + Public().string() + " --store " + again.string()).code, 0);
  EXPECT_TRUE(fs::exists(SealedIn(again, id)));
}

TEST_F(KeySharing, SaysWhoseKeyIsNotHere) {
  const std::string id = StoreSession(1, kSealed), here = StoreSession(1, kSealed);
  KeyId key{};
  ASSERT_TRUE(FromHex(OpenStore().FindSession(id)->key_id, key).ok());
  ASSERT_TRUE(DestroyKey(folder_, key).ok());
  const Outcome shared = Share();
  EXPECT_EQ(shared.code, 3);
  EXPECT_THAT(shared.out, HasSubstr("not sealed: session " + id));
  EXPECT_TRUE(fs::exists(SealedIn(folder_, here)));
}

TEST_F(KeySharing, WaitsForNoCaptureAndGoesOnAfterIt) {
  const std::string id = StoreSession(1, kSealed);
  {
    SessionStore store = OpenStore();
    const auto writer = store.BeginSession(SimulatedVisit(), kSealed);
    ASSERT_TRUE(writer.ok());
    EXPECT_EQ(Share().code, 5);
    EXPECT_EQ(Db("key unshare " + Public().string()).code, 5);
  }
  EXPECT_EQ(Share().code, 0);
  EXPECT_TRUE(fs::exists(SealedIn(folder_, id)));
}

TEST_F(KeySharing, IsDoneOnceByProgramsThatBeginTogether) {
  std::vector<std::string> ids;
  for (int i = 0; i < 5; ++i) ids.push_back(StoreSession(1, kSealed));
  const Outcome both = Shell("for i in 1 2 3; do STRATALUX_STORE=" + folder_.string() + " " + STRATALUX_BIN_DIR +
                             "/stratalux-db key share " + Public().string() + " >/dev/null 2>&1 & done; wait");
  EXPECT_EQ(both.code, 0);
  EXPECT_EQ(Share().code, 0);
  for (const std::string& id : ids) {
    EXPECT_THAT(ListSealedKeys(folder_ / "sessions" / id), SizeIs(1));
    EXPECT_THAT(Verified(id).problems, IsEmpty());
  }
}

TEST_F(KeySharing, NoCaptureBeginsWhoseReadersCannotBeRead) {
  ASSERT_EQ(Share().code, 0);
  WriteText(folder_ / kReadersFolder / (ToHex(reader_) + ".pub"), "x25519-" + std::string(64, '0') + "\n");
  SessionStore store = OpenStore();
  const auto writer = store.BeginSession(SimulatedVisit(), kSealed);
  EXPECT_EQ(writer.status().code(), StatusCode::kIntegrity);
  EXPECT_THAT(writer.status().message(), HasSubstr(".pub does not hold the public key that its name stands for"));
  EXPECT_THAT(Db("verify").out, HasSubstr(".pub does not hold the public key"));
}

}  // namespace
}  // namespace stratalux::db
