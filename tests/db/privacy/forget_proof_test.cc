// SPDX-License-Identifier: Apache-2.0
// The two halves of a forgetting: the first does not depend on the size of the store, the second can be ended and harms
// nobody who writes meanwhile.
#include <fstream>

#include <fcntl.h>
#include <sys/wait.h>

#include "shared/base/read_file.h"
#include "tests/db/privacy/forget_fixture.h"

namespace stratalux::db {
namespace {

namespace fs = std::filesystem;
using ::testing::IsEmpty;
using ForgetHalves = ForgetTest;

// Bytes that this process has read so far, of whatever file.
int64_t BytesRead() {
  std::ifstream file("/proc/self/io");
  std::string name;
  int64_t bytes = -1;
  file >> name >> bytes;
  EXPECT_EQ(name, "rchar:");
  return bytes;
}

// A visitor waits for the first half.
TEST_F(ForgetHalves, TheFirstHalfReadsNothingOfOtherSessions) {
  constexpr int64_t kOthers = int64_t{256} << 20, kMost = int64_t{8} << 20;
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession), other = Visit(kOther, 2, Encryption::kPerSession);
  const Traces traces = TracesOf(id);
  WriteText(folder_ / "sessions" / other / "large.bin", "sparse");
  fs::resize_file(folder_ / "sessions" / other / "large.bin", kOthers);
  ForgetRequest request;
  request.sessions = {id};
  const int64_t before = BytesRead();
  auto proof = BeginForget(folder_, request);
  const int64_t removed = BytesRead();
  ASSERT_TRUE(proof.ok()) << proof.status().message();
  EXPECT_LT(removed - before, kMost);
  EXPECT_EQ(OpenStore(AccessMode::kReadOnly).FindSession(id).status().code(), StatusCode::kNotFound);
  EXPECT_FALSE(fs::exists(folder_ / "sessions" / id));
  EXPECT_FALSE(fs::exists(folder_ / "forgetting"));
  for (const std::string& hidden : {traces.key, traces.hashes[0]})
    for (const auto& [file, count] : FilesWith(ReadRaw(folder_ / "ledger"), hidden)) ADD_FAILURE() << file << count;
  Logger quiet(LogLevel::kError);
  ASSERT_TRUE(proof->Search(quiet).ok());
  EXPECT_GE(BytesRead() - removed, kOthers) << "the second half reads all";
  EXPECT_THAT(proof->Certify()->leftovers, IsEmpty());
  EXPECT_EQ(CertificateOf(id)["verification"]["clean"], true);
  fs::remove(folder_ / "sessions" / other / "large.bin");
  ExpectGone(traces, kVisitor);
}

// As another account's, whose mode forbids it: a loop of links stops root, too.
TEST_F(ForgetHalves, ABegunForgettingThatCannotBeReadIsNotTakenForDone) {
  const std::string id = Visit(kVisitor, 1, Encryption::kNone);
  WriteText(folder_ / "notes.txt", "nice face in " + id + "\n");
  EXPECT_EQ(ForgetNow({id})->leftovers.size(), 1U);
  fs::remove(folder_ / "notes.txt");
  const fs::path intent = folder_ / "ledger" / (id + ".forgetting"), aside = exports_ / "intent";
  fs::create_directories(exports_);
  fs::copy(intent, aside);
  fs::remove(intent);
  fs::create_symlink(intent.filename(), intent);
  const auto refused = ForgetNow({});
  EXPECT_EQ(refused.status().code(), StatusCode::kFailed);
  EXPECT_THAT(refused.status().message(), ::testing::HasSubstr(intent.string()));
  EXPECT_THAT(refused.status().message(), ::testing::HasSubstr("--resume"));
  // Somebody else who asks is forgotten all the same.
  const std::string other = Visit(kOther, 2, Encryption::kNone);
  const auto asked = ForgetNow({other});
  ASSERT_TRUE(asked.ok()) << asked.status().message();
  ASSERT_EQ(asked->leftovers.size(), 1U);
  EXPECT_THAT(asked->leftovers[0], ::testing::HasSubstr("--resume"));
  EXPECT_EQ(CertificateOf(other)["verification"]["clean"], true);
  // And who was begun beside it is finished by a --resume.
  ASSERT_TRUE(GiveConsent(folder_, kOther, {"1", "de", true, false, false, {}}).ok());
  const std::string third = Visit(kOther, 3, Encryption::kNone);
  WriteText(folder_ / "notes.txt", "nice face in " + third + "\n");
  EXPECT_EQ(ForgetNow({third})->leftovers.size(), 2U);
  fs::remove(folder_ / "notes.txt");
  const auto resumed = ForgetNow({});
  ASSERT_TRUE(resumed.ok()) << resumed.status().message();
  EXPECT_THAT(resumed->leftovers, ::testing::ElementsAre(::testing::HasSubstr(intent.string())));
  EXPECT_EQ(CertificateOf(third)["verification"]["clean"], true);
  fs::remove(intent);
  fs::copy(aside, intent);
  EXPECT_THAT(ForgetNow({})->leftovers, IsEmpty());
  EXPECT_EQ(CertificateOf(id)["verification"]["clean"], true);
}

TEST_F(ForgetHalves, ASearchThatIsEndedCertifiesNothingAndIsMadeAgain) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession);
  const Traces traces = TracesOf(id);
  ForgetRequest request;
  request.sessions = {id};
  Logger quiet(LogLevel::kError);
  {
    auto proof = BeginForget(folder_, request);
    ASSERT_TRUE(proof.ok()) << proof.status().message();
    int reads = 0;
    EXPECT_EQ(proof->Search(quiet, [&reads] { return ++reads < 3; }).code(), StatusCode::kTryAgain);
    EXPECT_EQ(reads, 3);
  }
  EXPECT_THAT(*UnfinishedForgets(folder_), ::testing::ElementsAre(id));
  auto first = BeginForget(folder_, {}), second = BeginForget(folder_, {});
  for (auto* proof : {&first, &second}) ASSERT_TRUE(proof->ok() && (*proof)->Search(quiet).ok());
  EXPECT_EQ(first->Certify()->sessions.size(), 1U);
  EXPECT_THAT(*UnfinishedForgets(folder_), IsEmpty());
  auto late = BeginForget(folder_, {});
  ASSERT_TRUE(late.ok() && late->Search(quiet).ok());
  EXPECT_THAT(late->Certify()->sessions, IsEmpty()) << "certified already";
  ExpectGone(traces, kVisitor);
}

// Whoever comes meanwhile does not wait for it.
TEST_F(ForgetHalves, ARewritingThatIsEndedLeavesTheIndexAndIsMadeAgain) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession), other = Visit(kOther, 2, Encryption::kPerSession);
  const Traces traces = TracesOf(id);
  ForgetRequest request;
  request.sessions = {id};
  Logger quiet(LogLevel::kError);
  auto proof = BeginForget(folder_, request);
  ASSERT_TRUE(proof.ok() && proof->Search(quiet).ok());
  int asked = 0;
  EXPECT_EQ(proof->RewriteIndex([&asked] { return ++asked < 3; }).code(), StatusCode::kTryAgain);
  EXPECT_EQ(asked, 3);
  EXPECT_TRUE(OpenStore().FindSession(other).ok()) << "nobody holds it, and it is whole";
  const Status rewritten = proof->RewriteIndex([] { return true; });
  ASSERT_TRUE(rewritten.ok()) << rewritten.message();
  EXPECT_THAT(proof->Certify()->leftovers, IsEmpty());
  ExpectGone(traces, kVisitor);
}

// While one search runs, others wait: one takes up all of them.
TEST_F(ForgetHalves, AProofIncludesWhatWaited) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession), other = Visit(kOther, 2, Encryption::kPerSession);
  const Traces traces = TracesOf(id), others = TracesOf(other);
  ForgetRequest request;
  request.sessions = {id};
  auto first = BeginForget(folder_, request);
  request.sessions = {other};
  auto second = BeginForget(folder_, request);
  ASSERT_TRUE(first.ok() && second.ok());
  // Of the session that both know one certificate is written; what is known to the earlier one alone is not lost.
  first->Include(std::move(*second));
  Logger quiet(LogLevel::kError);
  ASSERT_TRUE(first->Search(quiet).ok());
  const auto report = first->Certify();
  ASSERT_TRUE(report.ok());
  EXPECT_EQ(report->sessions.size(), 2U);
  EXPECT_THAT(*UnfinishedForgets(folder_), IsEmpty());
  EXPECT_EQ(CertificateOf(id)["verification"]["clean"], true);
  EXPECT_EQ(CertificateOf(other)["verification"]["clean"], true);
  ExpectGone(traces, kVisitor);
  ExpectGone(others, kOther);
}

// Of this process on `file`, as another process sees it: a kernel's answer, no attempt.
bool IsLockedByUs(const fs::path& file) {
  const pid_t parent = getpid(), child = fork();
  if (child == 0) {
    const int fd = open(file.c_str(), O_RDWR | O_CLOEXEC);
    struct flock asked {};
    asked.l_type = F_WRLCK;
    asked.l_whence = SEEK_SET;
    _exit(fd >= 0 && fcntl(fd, F_GETLK, &asked) == 0 && asked.l_type != F_UNLCK && asked.l_pid == parent ? 1 : 0);
  }
  int status = 0;
  EXPECT_EQ(waitpid(child, &status, 0), child);
  return WIFEXITED(status) && WEXITSTATUS(status) == 1;
}

// The kiosk searches while it captures, in one process.
TEST_F(ForgetHalves, ASearchLeavesTheLocksOfThisProcessOnTheIndex) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession);
  ForgetRequest request;
  request.sessions = {id};
  auto proof = BeginForget(folder_, request);
  ASSERT_TRUE(proof.ok()) << proof.status().message();
  auto writer = Connection::Open(folder_ / "index.sqlite", Connection::Mode::kReadWrite);
  ASSERT_TRUE(writer.ok() && writer->Execute("BEGIN IMMEDIATE").ok());
  for (const char* file : {"index.sqlite", "index.sqlite-shm"}) ASSERT_TRUE(IsLockedByUs(folder_ / file)) << file;
  Logger quiet(LogLevel::kError);
  ASSERT_TRUE(proof->Search(quiet).ok());
  for (const char* file : {"index.sqlite", "index.sqlite-shm"}) EXPECT_TRUE(IsLockedByUs(folder_ / file)) << file;
  ASSERT_TRUE(writer->Execute("ROLLBACK").ok());
  EXPECT_THAT(proof->Certify()->leftovers, IsEmpty());
}

// As a power cut or a bad block leaves it.
TEST_F(ForgetHalves, ABegunForgettingWhoseNoteIsDamagedKeepsNobodyWaiting) {
  const std::string id = Visit(kVisitor, 1, Encryption::kPerSession), other = Visit(kOther, 2, Encryption::kNone);
  const Traces traces = TracesOf(id);
  const int ended = ForgetApart(id, [](ForgetStep step) {
    if (step == ForgetStep::kEntered) _exit(9);
  });
  ASSERT_EQ(ended, 9);
  const fs::path intent = folder_ / "ledger" / (id + ".forgetting");
  std::string of_other = *ReadFile(intent);
  WriteText(intent, std::string(of_other.size(), '\0'));
  const auto asked = ForgetNow({other});
  ASSERT_TRUE(asked.ok()) << asked.status().message();
  ASSERT_EQ(asked->leftovers.size(), 1U);
  EXPECT_THAT(asked->leftovers[0], ::testing::HasSubstr(intent.string()));
  EXPECT_THAT(asked->leftovers[0], ::testing::HasSubstr("`stratalux-db forget " + id + "`"));
  EXPECT_EQ(CertificateOf(other)["verification"]["clean"], true);
  // Nor is one taken for what its name says that speaks of another session.
  of_other.replace(of_other.find(id), id.size(), other);
  WriteText(intent, of_other);
  EXPECT_THAT(ForgetNow({}).status().message(), ::testing::HasSubstr(intent.string()));
  EXPECT_TRUE(fs::exists(intent));
  // The remedy, as it was said.
  fs::remove(intent);
  const auto again = ForgetNow({id});
  ASSERT_TRUE(again.ok()) << again.status().message();
  EXPECT_THAT(again->leftovers, IsEmpty());
  ExpectGone(traces, kVisitor);
}

}  // namespace
}  // namespace stratalux::db
