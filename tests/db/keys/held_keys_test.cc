// SPDX-License-Identifier: Apache-2.0
// Keys that a program is handed: through pipes alone, whole or not at all.
#include "db/keys/held_keys.h"

#include <cstdlib>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <sodium.h>
#include <sys/wait.h>
#include <unistd.h>

#include "shared/base/unique_fd.h"
#include "tests/db/keys/random_key.h"
#include "tests/support/scratch_folder.h"

namespace stratalux::db {
namespace {

using ::testing::HasSubstr;

struct Pipe {
  Pipe() {
    int ends[2] = {-1, -1};
    EXPECT_EQ(pipe(ends), 0);
    out = UniqueFd(ends[0]);
    in = UniqueFd(ends[1]);
  }
  UniqueFd out, in;
};

class HeldKeysTest : public ScratchFolderTest {};

// What a pipe gives into which these bytes were written.
Result<std::vector<SessionKey>> ReadBack(const std::string& bytes) {
  Pipe pipe;
  EXPECT_EQ(write(pipe.in.get(), bytes.data(), bytes.size()), static_cast<ssize_t>(bytes.size()));
  pipe.in = UniqueFd();
  return ReadKeys(pipe.out.get());
}
std::string Sent(const std::vector<SessionKey>& keys) {
  Pipe pipe;
  EXPECT_EQ(WriteKeys(pipe.in.get(), keys).message(), "");
  pipe.in = UniqueFd();
  std::string bytes(65536, '\0');
  bytes.resize(static_cast<size_t>(read(pipe.out.get(), bytes.data(), bytes.size())));
  return bytes;
}

TEST_F(HeldKeysTest, ComeThroughAPipeAsTheyWere) {
  const std::vector<SessionKey> keys = {RandomKey(), RandomKey(), RandomKey()};
  const auto read = ReadBack(Sent(keys));
  ASSERT_TRUE(read.ok()) << read.status().message();
  ASSERT_EQ(read->size(), keys.size());
  for (size_t i = 0; i < keys.size(); ++i) {
    EXPECT_EQ((*read)[i].id, keys[i].id);
    EXPECT_EQ((*read)[i].key->bytes, keys[i].key->bytes);
  }
  EXPECT_TRUE(ReadBack(Sent({}))->empty());
}

TEST_F(HeldKeysTest, ComeWholeOrNotAtAll) {
  const std::string sent = Sent({RandomKey(), RandomKey()});
  for (size_t size = 0; size < sent.size(); ++size)
    EXPECT_EQ(ReadBack(sent.substr(0, size)).status().code(), StatusCode::kIntegrity) << size << " bytes";
  EXPECT_EQ(ReadBack(sent + "x").status().code(), StatusCode::kIntegrity);
  EXPECT_EQ(ReadBack("no keys at all, and long enough").status().code(), StatusCode::kIntegrity);
}

TEST_F(HeldKeysTest, LandInNoFile) {
  const UniqueFd file(open((folder_ / "keys").c_str(), O_RDWR | O_CREAT, 0600));
  const Status written = WriteKeys(file.get(), {RandomKey()});
  EXPECT_EQ(written.code(), StatusCode::kUsage);
  EXPECT_THAT(written.message(), HasSubstr("only through a pipe"));
  EXPECT_EQ(std::filesystem::file_size(folder_ / "keys"), 0U);
  EXPECT_EQ(ReadKeys(file.get()).status().code(), StatusCode::kUsage);
  EXPECT_EQ(ReadKeys(-1).status().code(), StatusCode::kUsage);
}

// In a process of its own: what the environment says is read once a process.
int CodeOfChild(const std::string& descriptor, const KeyId& id, const SessionKey* also = nullptr) {
  const pid_t child = fork();
  if (child == 0) {
    setenv(kHeldKeysVariable, descriptor.c_str(), 1);
    if (also != nullptr) HoldKeys({*also});
    const auto found = FindHeldKey(id);
    _exit(found.ok() ? (found->id == id ? 0 : 99) : found.status().exit_code());
  }
  int status = 0;
  waitpid(child, &status, 0);
  return WEXITSTATUS(status);
}

TEST_F(HeldKeysTest, AreFoundWhereTheEnvironmentNamesThePipe) {
  const SessionKey key = RandomKey(), other = RandomKey();
  Pipe pipe;
  ASSERT_TRUE(WriteKeys(pipe.in.get(), {key}).ok());
  pipe.in = UniqueFd();
  EXPECT_EQ(CodeOfChild(std::to_string(pipe.out.get()), key.id), 0);

  Pipe again;
  ASSERT_TRUE(WriteKeys(again.in.get(), {key}).ok());
  again.in = UniqueFd();
  EXPECT_EQ(CodeOfChild(std::to_string(again.out.get()), other.id, &other), 0) << "and those it was given otherwise";

  Pipe empty;
  empty.in = UniqueFd();
  EXPECT_EQ(CodeOfChild(std::to_string(empty.out.get()), key.id), 6);
  EXPECT_EQ(CodeOfChild("keys", key.id), 2);
  EXPECT_EQ(CodeOfChild("999999", key.id), 2);
  EXPECT_EQ(FindHeldKey(key.id).status().code(), StatusCode::kNotFound) << "nobody handed this process any";
}

}  // namespace
}  // namespace stratalux::db
