// SPDX-License-Identifier: Apache-2.0
// Two stores and a backup; segments made again with other headers; programs that are killed.
#pragma once

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <functional>
#include <thread>

#include <gmock/gmock.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "db/care/verify.h"
#include "db/catalogue/manifest.h"
#include "db/segment/segment.h"
#include "db/transfer/backup.h"
#include "db/transfer/pull.h"
#include "tests/db/store_fixture.h"
#include "tests/support/run_program.h"

namespace stratalux::db {

class TransferTest : public StoreTest {
 protected:
  void SetUp() override {
    StoreTest::SetUp();
    std::string name = (TemporaryFolder() / "stratalux-far-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    far_ = name;
    backup_ = far_ / "backup";
    other_ = far_ / "other";
  }
  void TearDown() override {
    std::filesystem::remove_all(far_);
    StoreTest::TearDown();
  }

  // As a program before the ledger left it.
  static void Forget(const std::filesystem::path& store, const std::string& id) {
    std::filesystem::create_directories(store / "deletions");
    WriteText(store / "deletions" / (id + ".json"), R"({"session":")" + id + "\"}");
  }
  // Newest first; each verified.
  static std::vector<std::string> Ids(const std::filesystem::path& store) {
    std::vector<std::string> ids;
    const auto open = SessionStore::Open(store, AccessMode::kReadOnly);
    EXPECT_TRUE(open.ok()) << open.status().message();
    if (!open.ok()) return ids;
    const auto rows = open->ListSessions();
    EXPECT_TRUE(rows.ok()) << rows.status().message();
    for (const auto& listed : *rows) {
      ids.push_back(listed.info.id);
      const auto row = open->FindSession(listed.info.id);
      EXPECT_TRUE(row.ok()) << row.status().message();
      const auto verified = VerifySession(*open, *row);
      EXPECT_TRUE(verified.ok() && verified->problems.empty()) << listed.info.id;
    }
    return ids;
  }
  [[nodiscard]] std::filesystem::path Copied(const std::string& id, const std::string& name = "frames-0001.seg") const {
    return backup_ / "sessions" / id / name;
  }
  // Every frame again, its header changed, every hash right.
  static void RewriteSegment(const std::filesystem::path& file, const std::function<void(FrameHeader&)>& change) {
    const std::filesystem::path fresh = file.string() + ".fresh";
    {
      const auto reader = SegmentReader::Open(file);
      ASSERT_TRUE(reader.ok()) << reader.status().message();
      bool sealed = false;
      const auto frames = reader->Walk(true, &sealed);
      ASSERT_TRUE(frames.ok()) << frames.status().message();
      auto writer = SegmentWriter::Create(fresh, reader->session_id());
      ASSERT_TRUE(writer.ok()) << writer.status().message();
      std::vector<uint8_t> payload;
      for (const SegmentFrame& frame : *frames) {
        ASSERT_TRUE(reader->ReadPayload(frame.offset, frame.header, payload).ok());
        FrameHeader header = frame.header;
        change(header);
        ASSERT_TRUE(writer->Append(header, static_cast<Codec>(header.codec), payload).ok());
      }
      ASSERT_TRUE(writer->Seal().ok());
    }
    std::filesystem::rename(fresh, file);
    const auto contents = ReadManifestContents(file.parent_path());
    ASSERT_TRUE(contents.ok()) << contents.status().message();
    ASSERT_TRUE(ReplaceSegments(file.parent_path(), contents->segments).ok());
  }
  Result<RestoreReport> RestoreNew(const std::string& ledger = kNoLedger) {
    return Restore(backup_, other_, {RestoreInto::kNewStore, ledger}, logger_);
  }
  Result<RestoreReport> RestoreMerged() { return Restore(backup_, other_, {RestoreInto::kMerge, ""}, logger_); }
  Result<PullReport> PullHere(const PullOptions& options = {}) {
    return Pull(other_, folder_.string(), options, logger_);
  }
  static Outcome Db(const std::string& arguments) { return Execute("stratalux-db " + arguments); }
  // Runs stratalux-db and kills it after `delay`. True where it ended before.
  static bool RunAndKill(const std::vector<std::string>& arguments, std::chrono::microseconds delay) {
    const pid_t child = fork();
    if (child == 0) {
      std::vector<std::string> all = {std::string(STRATALUX_BIN_DIR) + "/stratalux-db"};
      all.insert(all.end(), arguments.begin(), arguments.end());
      std::vector<char*> argv;
      for (std::string& argument : all) argv.push_back(argument.data());
      argv.push_back(nullptr);
      if (std::freopen("/dev/null", "w", stdout) == nullptr || std::freopen("/dev/null", "w", stderr) == nullptr)
        _exit(126);
      execv(argv[0], argv.data());
      _exit(127);
    }
    std::this_thread::sleep_for(delay);
    kill(child, SIGKILL);
    int status = 0;
    waitpid(child, &status, 0);
    return WIFEXITED(status);
  }

  std::filesystem::path far_, backup_, other_;
  Logger logger_{LogLevel::kError};
};

}  // namespace stratalux::db
